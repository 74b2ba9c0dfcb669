"""Ways of stepping that rodnet offers; a new one is a line here."""

from __future__ import annotations

from typing import Any, NamedTuple

import rodnet as rn


class Mode(NamedTuple):
    """A name for the tables and the options of `rodnet.Simulation`."""

    name: str
    options: dict[str, Any]


EULER = Mode("implicit Euler", {"stepper": "euler"})
UNPREDICTED = Mode("implicit Euler, from the last state", {"stepper": "euler", "predict": False})
SDIRK2 = Mode("SDIRK2", {"stepper": "sdirk2"})
LOOSE = Mode("SDIRK2, residual 1e-4", {"stepper": "sdirk2", "tolerance": rn.Tolerance(residual=1e-4)})
ADAPTIVE = Mode("SDIRK2, adaptive", {"stepper": "sdirk2", "adaptive": 0.03})
MODES = [EULER, UNPREDICTED, SDIRK2, ADAPTIVE]


def simulate(robot: rn.Robot, dt: float, mode: Mode = EULER, **changes: Any) -> rn.Simulation:
    """Return a simulation of the robot in this mode."""
    return rn.Simulation(robot, dt, **(mode.options | changes))


class Done(NamedTuple):
    """What it took to simulate some time: steps, Newton iterations, factorisations."""

    steps: int
    iterations: int
    factorisations: int


def advance(sim: rn.Simulation, duration: float) -> Done:
    """Run on for so long without recording.

    Raises
    ------
    RuntimeError, rodnet.ConvergenceError
        If a step fails: a benchmark must not time failures.
    """
    solver = sim.model.solver
    factorisations = solver.factorizations
    if getattr(sim, "adaptive", None) is not None:
        iterations, steps = sim.newton.iterations, 0
        for _ in sim.iterate(duration):
            steps += 1
        return Done(steps, sim.newton.iterations - iterations, solver.factorizations - factorisations)
    steps, iterations = max(round(duration / sim.dt), 1), 0
    for _ in range(steps):
        result = sim.step()
        iterations += result.iterations
        if not result.ok:
            raise RuntimeError(f"a step failed: {result.status.value}")
    return Done(steps, iterations, solver.factorizations - factorisations)
