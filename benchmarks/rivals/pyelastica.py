"""PyElastica: Cosserat rods (with shear and rotary inertia), explicit in time (position Verlet)."""

from __future__ import annotations

import numpy as np

from benchmarks.rivals import first_edge
from benchmarks.scenes import DENSITY, GRAVITY, LENGTH, RADIUS, YOUNG

LABEL, PACKAGE = "PyElastica", "pyelastica"
SIZES = (50, 100, 200, 400)
SPAN = 0.2  # of the fall that is timed [s]: its steps all cost the same


def check() -> None:
    """Import the package."""
    import elastica  # noqa: F401


def stable_step(edges: int, young: float = YOUNG) -> float:
    """Time step somewhat below the stability limit, which sound and the shear mode of an edge set [s].

    Found by trial with 50 to 400 edges: at 1.1 times this step the run explodes.
    """
    speed, shear = np.sqrt(young / DENSITY), np.sqrt(young / 3.0 / DENSITY)
    slowest = 1.0 / np.hypot(speed * edges / LENGTH, shear / RADIUS)
    return float(0.9 * slowest)


class Cantilever:
    """The falling cantilever."""

    def __init__(
        self, edges: int, dt: float | None = None, *, young: float = YOUNG, straddle: bool = True
    ) -> None:
        import elastica as ea

        class System(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
            """What the rod needs."""

        start, length = first_edge(edges, LENGTH) if straddle else (0.0, LENGTH)
        self.dt = dt or stable_step(edges, young)
        self.system, self.time = System(), np.float64(0.0)
        self.rod = ea.CosseratRod.straight_rod(
            edges, np.array([start, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), length,
            RADIUS, DENSITY, youngs_modulus=young, shear_modulus=young / 3.0,
        )  # fmt: skip
        self.system.append(self.rod)
        fixed = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
        self.system.constrain(self.rod).using(ea.OneEndFixedBC, **fixed)
        gravity = np.array([0.0, 0.0, -GRAVITY])
        self.system.add_forcing_to(self.rod).using(ea.GravityForces, acc_gravity=gravity)
        self.system.finalize()
        self.stepper = ea.PositionVerlet()

    def advance(self, duration: float) -> int:
        """Run on for so long; return the number of steps."""
        count = max(1, round(duration / self.dt))
        dt = duration / count
        for _ in range(count):
            self.time = self.stepper.step(self.system, self.time, dt)
        return count

    def tip(self) -> np.ndarray:
        """Position of the free end [m]."""
        return self.rod.position_collection[:, -1].copy()
