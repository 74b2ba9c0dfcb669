"""The tangent of a step by differences of single evaluations: general, and the measure of every quicker way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.solve.steppers import Rates
from rodnet.tangent.state import StateTangent, combined, joined, moved
from rodnet.tangent.twin import Twin

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State
    from rodnet.solve.watch import Stage
    from rodnet.tangent.columns import Variation

STEP = 1e-5  # of differences, against edges, radians and what memories hold

Sensors = Callable[[int, float], Mapping[str, Any]]


class Differences:
    """Differences of stages along columns.

    Parameters
    ----------
    twin : Twin
        Of the robot itself.
    columns : list of Variation
        The columns.
    """

    def __init__(self, twin: Twin, columns: list[Variation]) -> None:
        self.twin, self.columns = twin, columns
        self.near = [
            [(weight, Twin(sim.model)) for weight, sim in column.near] if column.acts else []
            for column in columns
        ]

    def residual(
        self,
        stage: Stage,
        tangent: StateTangent,
        done: Rates,
        q: np.ndarray,
        sensors: Sensors,
        which: list[int],
        steps: list[float],
        near: list[bool],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the residual at fixed free degrees of freedom, and of what is prescribed.

        Parameters
        ----------
        stage : Stage
            The solved stage.
        tangent : StateTangent
            Of the state that the step begins with.
        done : list
            Derivatives of the rates of the stages before, shapes (dof_count, k).
        q : ndarray, shape (dof_count,)
            The solution.
        sensors : callable
            ``sensors(column, step)`` are readings after a change of a column.
        which : list of int
            The columns.
        steps : list of float
            Changes of these columns that are small, 0 for no change.
        near : list of bool
            Whether what these columns change in the model counts, or is known already.

        Returns
        -------
        residual : ndarray, shape (free, n)
        held : ndarray, shape (3, held, n)
            Of prescribed degrees of freedom, their rates and accelerations.
        """
        model = self.twin.model
        out, held = np.zeros((len(model.free), len(which))), np.zeros((3, len(model.held), len(which)))
        before = stage.done[:-1]
        for k, (c, step, counts) in enumerate(zip(which, steps, near, strict=True)):
            if step:
                for sign in (1.0, -1.0):
                    state, rates = self._moved(stage, tangent, done, c, sign * step)
                    r = self.twin.residual(stage, state, rates, q, sensors(c, sign * step))
                    out[:, k] += sign * r / (2.0 * step)
                    held[:, :, k] += sign * self.twin.held() / (2.0 * step)
            for weight, twin in self.near[c] if counts else ():
                out[:, k] += weight * twin.residual(stage, stage.state, before, q, stage.sensors)
                held[:, :, k] += weight * twin.held()
        return out, held

    def rates(
        self,
        stage: Stage,
        tangent: StateTangent,
        done: Rates,
        q: np.ndarray,
        dq: np.ndarray,
        sensors: Sensors,
        accept: State | None,
        which: list[int],
    ) -> Any:
        """Derivatives of what a solved stage leaves: rates and accelerations, or the accepted state.

        Parameters
        ----------
        dq : ndarray, shape (dof_count, k)
            Derivatives of the solution.
        accept : State or None
            The state that the step has ended in, if this is its last stage; else rates are returned.
        which : list of int
            The columns; of the others, none are returned.

        Returns
        -------
        StateTangent, or (v, a) of shape (dof_count, k)
        """
        before = stage.done[:-1]
        parts, v, a = [], np.zeros_like(dq), np.zeros_like(dq)
        for c in which:
            step = self.step(stage, tangent, done, c, dq)
            others: list[tuple[float, State]] = []

            def collect(weight: float, twin: Twin, state: State, c: int = c, others: Any = others) -> None:
                if accept is not None:
                    others.append((weight, twin.accepted(stage, state)))
                else:
                    v_now, a_now = twin.rates_now()
                    v[:, c] += weight * v_now
                    a[:, c] += weight * a_now

            if step:
                for sign in (1.0, -1.0):
                    state, rates = self._moved(stage, tangent, done, c, sign * step)
                    self.twin.residual(
                        stage, state, rates, q + sign * step * dq[:, c], sensors(c, sign * step)
                    )
                    collect(sign / (2.0 * step), self.twin, state)
            for weight, twin in self.near[c]:
                twin.residual(stage, stage.state, before, q, stage.sensors)
                collect(weight, twin, stage.state)
            if accept is not None:
                parts.append(combined(self.twin.model, accept, others))
        return (v, a) if accept is None else joined(parts)

    def step(
        self, stage: Stage, tangent: StateTangent, done: Rates, c: int, dq: np.ndarray | None = None
    ) -> float:
        """Change of a column that is small against edges, radians and memories; 0 if nothing changes."""
        m = self.twin.model
        length = float(m.rest_length.min())

        def size(dofs: np.ndarray) -> float:
            positions, angles = dofs[: m.twist0], dofs[m.twist0 :]
            return max(float(np.abs(positions).max()) / length, float(np.abs(angles).max(initial=0.0)))

        largest = size(tangent.q[:, c])
        largest = max(largest, float(np.abs(tangent.spin[:, c]).max(initial=0.0)))
        largest = max(largest, stage.dt * size(tangent.v[:, c]), stage.dt**2 * size(tangent.acc[:, c]))
        for dv, _ in done:
            largest = max(largest, stage.dt * size(dv[:, c]))
        if dq is not None:
            largest = max(largest, size(dq[:, c]))
        for memory, d in zip(stage.state.memories, tangent.memories, strict=True):
            if d is not None and memory is not None and d.size:
                largest = max(largest, _share(memory, d[..., c]))
        return STEP / largest if largest > 0.0 else 0.0

    def _moved(
        self, stage: Stage, tangent: StateTangent, done: Rates, c: int, step: float
    ) -> tuple[State, Rates]:
        m: Model = self.twin.model
        state = moved(m, stage.state, tangent, c, step)
        before = stage.done[:-1]
        rates = [
            (v + step * dv[:, c], a + step * da[:, c]) for (v, a), (dv, da) in zip(before, done, strict=True)
        ]
        return state, rates


def _share(memory: np.ndarray, change: np.ndarray) -> float:
    """Size of the change of a memory against what it holds, column by column, for they differ in kind."""
    sizes = np.abs(memory).reshape(-1, memory.shape[-1]).max(axis=0)
    changes = np.abs(change).reshape(-1, memory.shape[-1]).max(axis=0)
    known = sizes > 0.0
    share = float((changes[known] / sizes[known]).max(initial=0.0))
    # of what is zero still, nothing is known but what the others are
    return max(share, float(changes[~known].max(initial=0.0)) / (float(sizes.max()) or 1.0))
