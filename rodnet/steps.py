"""What a time step of a simulation did, or why it failed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rodnet.errors import ConvergenceError, FoldedStateError
from rodnet.observer import Observer
from rodnet.solve.newton import Status

if TYPE_CHECKING:
    from rodnet.simulation import Simulation
    from rodnet.trajectory import Trajectory

MAX_HALVINGS = 10


@dataclass(frozen=True)
class StepResult:
    """What `Simulation.step` did.

    Attributes
    ----------
    ok : bool
        Whether the step converged; if not, the simulation stays at the last accepted state.
    status : Status
        How it ended.
    state : Observer
        The state after the step (before it, if it failed).
    iterations : int
        Linear solves, over all substeps.
    substeps : int
        1, or more where the step had to be halved.
    """

    ok: bool
    status: Status
    state: Observer
    iterations: int
    substeps: int


def failed_step(sim: Simulation, status: Status, traj: Trajectory | None) -> ConvergenceError:
    """Return the error for the step that a simulation cannot take, and write the recording of that step.

    Parameters
    ----------
    sim : Simulation
        At its last accepted state.
    status : Status
        How the step ended.
    traj : Trajectory or None
        What came before.
    """
    worst = sim.model.dof_name(sim.report.worst) if sim.report.worst >= 0 else "none"
    debug = None
    try:
        from rodnet.viz import debug as write_debug

        debug = str(
            write_debug(sim, Path(traj.path).with_suffix(".debug.rrd") if traj and traj.path else None)
        )
    except Exception as error:  # a broken viewer must not hide the failure itself
        debug_note = f" (the debug recording could not be written: {error})"
    else:
        debug_note = f" The failing step is in {debug}."
    shortest = sim.adaptive.shortest if sim.adaptive else sim.dt / 2**MAX_HALVINGS
    kind = FoldedStateError if status is Status.FOLDED else ConvergenceError
    kept = f" What was computed is in {traj.path}." if traj is not None and traj.path else ""
    return kind(
        f"the step after t = {sim.t:g} s failed even at dt = {shortest:.3g} s: {status.value}; "
        f"largest residual at {worst}. Try a smaller dt, a finer mesh there, or look for a load, speed or "
        f"stiffness that is off by orders of magnitude.{kept}{debug_note}",
        trajectory=traj,
        time=sim.t,
        worst=worst,
        debug_path=debug,
    )
