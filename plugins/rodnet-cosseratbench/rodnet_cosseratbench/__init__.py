"""rodnet as a solver of cosseratbench."""

from rodnet_cosseratbench.robot import make_robot
from rodnet_cosseratbench.solver import RodnetSolver

__all__ = ["RodnetSolver", "make_robot"]
