"""A column of sensitivities: a quantity, and simulations with it changed a little."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rodnet.errors import ParameterError
from rodnet.kinematics.frames import cross, transport, unit
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.tangent.state import StateTangent, combined, zero
from rodnet.terms.base import Term

STEP = float(np.cbrt(np.finfo(float).eps))  # of central differences, relative


class Near(NamedTuple):
    """As much of a simulation as most columns need."""

    model: Model


@dataclass(frozen=True)
class Variation:
    """One column: a quantity, and simulations with it changed by small steps.

    The derivative of whatever these simulations have is the sum of weights times it, a difference
    quotient. It is only ever taken of single evaluations and of initial states.

    Attributes
    ----------
    name, unit : str
        Its path and SI unit.
    value : float
        Where the derivative is taken.
    near : tuple of (float, Simulation)
        Weights, whose sum is zero, and simulations; with ``start`` their models are enough.
    acts : bool
        Whether it changes anything but the initial state.
    start : tuple of ndarray, optional
        Displacements [m] and velocities [m/s] of the nodes, shapes (node_count, 3), where these are all that
        it changes of the initial state.
    added : tuple of (float, tuple of Term)
        Weights, and terms that a robot has beside those of the simulation, with no effect but the column's own.
    turn : ndarray, shape (edge_count,), optional
        Beside ``start``, angles of the directors about the edges [rad].
    """

    name: str
    unit: str
    value: float
    near: tuple[tuple[float, Any], ...]
    acts: bool = True
    start: tuple[np.ndarray, np.ndarray] | None = None
    added: tuple[tuple[float, tuple[Term, ...]], ...] = ()
    turn: np.ndarray | None = None

    def initial(self, sim: Simulation) -> StateTangent:
        """Derivative of the initial state of ``sim``."""
        if self.start is not None:
            tangent = zero(sim.model, sim.state, 1)
            for array, change in zip((tangent.q, tangent.v), self.start, strict=True):
                array[: change.size, 0] = change.ravel()
                array[sim.model.held] = 0.0
            tangent.spin[:, 0] = _start_spin(sim, self.start[0], tangent.q[:, 0])
            if self.turn is not None:
                tangent.spin[:, 0] += self.turn
            return tangent
        others = [(weight, other.state) for weight, other in self.near]
        return combined(sim.model, sim.state, others)


def _start_spin(sim: Simulation, dx: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Spin of the initial directors: none but where constraints have moved an edge from where it is drawn.

    There the ways from the drawn to the changed tangents and from there on enclose an angle.
    """
    model, state = sim.model, sim.state
    if not dx.any():
        return np.zeros(model.edge_count)

    def tangents(x: np.ndarray) -> np.ndarray:
        return unit(x[model.edges[:, 1]] - x[model.edges[:, 0]])

    x, drawn = state.q[: model.twist0].reshape(-1, 3), model.x0.copy()
    moved = dq[: model.twist0].reshape(-1, 3)
    side, spin = cross(state.tangents, state.directors), np.zeros(model.edge_count)
    step = STEP * float(model.rest_length.min()) / float(np.abs(dx).max())
    for h in (step, -step):
        drawn[: len(dx)] = model.x0[: len(dx)] + h * dx
        begin, end = tangents(drawn), tangents(x + h * moved)
        d1 = transport(transport(model.d10, model.t0, begin), begin, end)
        spin += np.sum(transport(d1, end, state.tangents) * side, axis=1) / (2.0 * h)
    return spin


def stencil(value: float, step: float, bounds: tuple[float, float]) -> list[tuple[float, float]]:
    """Weights and places of a difference quotient of second order within bounds."""
    low, high = bounds
    if low <= value - step and value + step <= high:
        return [(0.5 / step, value + step), (-0.5 / step, value - step)]
    if value + 2.0 * step > high:
        step = -step
    if not low <= value + 2.0 * step <= high:
        raise ParameterError(f"the bounds [{low:g}, {high:g}] leave no room for a derivative at {value:g}")
    return [(-1.5 / step, value), (2.0 / step, value + step), (-0.5 / step, value + 2.0 * step)]
