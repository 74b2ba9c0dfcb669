"""The load at which an equilibrium loses its stability: buckling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import EquilibriumError, ParameterError
from rodnet.solve.modes import Modes, _simulation, modes
from rodnet.solve.statics import _imbalance, _slow_time, equilibrium
from rodnet.solve.steppers import ImplicitEuler, State

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.simulation import Simulation

BESIDE = 4  # modes that are looked at beside those at rest
SHORTLY = 1e-2  # of the way back to the first load
CLOSE = 1e-10  # displacement over the robot's size, or imbalance, at which a followed equilibrium is found


@dataclass(frozen=True)
class CriticalLoad:
    """Where an equilibrium loses its stability.

    Attributes
    ----------
    load : float
        The load, in the unit of `critical_load`'s argument.
    state : State
        The equilibrium there.
    mode : Modes
        The one mode in which the robot buckles, as it is shortly before.
    """

    load: float
    state: State
    mode: Modes


def critical_load(
    build: Callable[[float], Robot], low: float, high: float, *, steps: int = 8, rtol: float = 1e-6
) -> CriticalLoad:
    """Find the load at which an equilibrium stops being stable (divergence; for flutter look at `modes`).

    The equilibrium is followed from ``low`` to ``high``, past the point where `equilibrium` would leave it.

    Parameters
    ----------
    build : callable
        ``build(load)`` returns the robot under that load, the same for all loads otherwise.
    low, high : float
        A load at which the robot is stable, and one at which it is not.
    steps : int
        Steps from ``low`` to ``high`` in which the equilibrium is followed.
    rtol : float
        Relative error of the load.

    Returns
    -------
    CriticalLoad
        The load, the equilibrium and the mode in which it buckles.

    Raises
    ------
    EquilibriumError
        If it is not stable at ``low``, or still is at ``high``, or cannot be followed.
    """
    from scipy.optimize import brentq

    if not (np.isfinite(low) and np.isfinite(high) and low != high and steps >= 1 and rtol > 0):
        raise ParameterError(f"critical_load: low = {low!r} and high = {high!r} must be two finite loads")
    first = build(low)
    known = {low: equilibrium(first).state()}
    resting = BESIDE
    while (begin := modes(first, known[low], count=resting + BESIDE)).free.all() and len(begin) > resting:
        resting *= 2
    resting = int(np.sum(begin.free))
    if not begin.stable:
        raise EquilibriumError(f"critical_load: the robot is not stable at low = {low:g}; begin below")

    def slowest(load: float) -> float:
        """Square of the slowest mode's rate, signed: negative while it vibrates; free modes do not count."""
        nearest = min(known, key=lambda other: abs(other - load))
        sim = _simulation(build(load), known[nearest])
        known[load] = _follow(sim, known[nearest])
        found = modes(sim.robot, known[load], count=resting + BESIDE)
        square = np.sort((found.rate**2).real)[::-1]
        grows = square[0] > found.still**2
        return float(square[0] if grows else square[resting])

    before, after = low, low
    for load in np.linspace(low, high, steps + 1)[1:].tolist():
        before, after = after, load
        if slowest(after) > 0.0:
            break
    else:
        raise EquilibriumError(f"critical_load: the robot is still stable at high = {high:g}; look further")
    load = brentq(slowest, before, after, rtol=rtol, xtol=rtol * abs(after))
    slowest(load)
    # at the load itself the mode is at rest among rigid motions
    before = load + SHORTLY * (low - load)
    slowest(before)
    found = modes(build(before), known[before], count=resting + 1)
    mode = Modes(found.rate[resting:], found.x[resting:], found.theta[resting:], found.still)
    return CriticalLoad(float(load), known[load], mode)


def _follow(sim: Simulation, state: State) -> State:
    """Balance of forces next to a state, stable or not: Newton's method from there, little inertia added."""
    model = sim.model
    rest, dt = np.zeros(model.dof_count), 1e3 * _slow_time(model)
    for b in model.bound:
        b.at_rest = True
    for _ in range(20):
        still = replace(state, v=rest, a=rest, acc=rest)
        new, report = sim.newton.step(still, ImplicitEuler(), 0.0, dt, {}, {})
        if new is None:
            raise EquilibriumError(
                f"critical_load: the equilibrium cannot be followed ({report.status.value}); take more steps"
            )
        moved = float(np.abs(new.q - state.q)[: model.twist0].max()) / model.graph.size
        state = replace(new, v=rest, a=rest, acc=rest, t=0.0, index=0)
        if moved < CLOSE or _imbalance(sim.newton.ev, model, state, 0.0) < CLOSE:
            return state
    raise EquilibriumError("critical_load: the equilibrium cannot be followed; take more steps")
