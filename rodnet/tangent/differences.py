"""The tangent of a step by differences of single evaluations: general, and the measure of every quicker way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from rodnet.errors import DerivativeError
from rodnet.solve.steppers import Rates
from rodnet.tangent.state import StateTangent, combined, joined, moved
from rodnet.tangent.twin import Twin

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State
    from rodnet.solve.watch import Stage
    from rodnet.tangent.variation import Variation

STEP = 1e-5  # of differences, against edges, radians and what memories hold
CLOSER = 0.01  # what is left of a step where the first try meets a corner
CORNER = 0.1  # of a change, by which it may differ from that to the other side
FAINT = 1e-9  # of forces, moments and memories: changes whose sides are not compared
STRAIN = 1e-5  # of what is stiffest: what round-off in it amounts to is less than `FAINT` of that

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
        here: tuple[np.ndarray, tuple[float, float]],
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
        here : tuple
            The residual of the solution, shape (free,), and the largest force [N] and moment [N m].

        Returns
        -------
        residual : ndarray, shape (free, n)
        held : ndarray, shape (3, held, n)
            Of prescribed degrees of freedom, their rates and accelerations.

        Raises
        ------
        DerivativeError
            Where a law has a corner or a jump.
        """
        model = self.twin.model
        base, (force, moment) = here
        axial = model.axial_stiffness[np.isfinite(model.axial_stiffness)].max(initial=0.0)
        bending = np.abs(model.quadratic_stiffness()).max(initial=0.0)
        force, moment = max(force, STRAIN * axial), max(moment, STRAIN * bending)
        scale = np.where(model.free < model.twist0, force, moment)
        out, held = np.zeros((len(model.free), len(which))), np.zeros((3, len(model.held), len(which)))
        before = stage.done[:-1]
        for k, (c, step, counts) in enumerate(zip(which, steps, near, strict=True)):
            for small in (step, CLOSER * step) if step else ():
                found = []
                for sign in (1.0, -1.0):
                    state, rates = self._moved(stage, tangent, done, c, sign * small)
                    r = self.twin.residual(stage, state, rates, q, sensors(c, sign * small))
                    found.append((r, self.twin.held()))
                (up, held_up), (down, held_down) = found
                if corner(up, down, base, scale) is None:
                    break
            else:
                if step:
                    self._refuse(stage, c, corner(up, down, base, scale))
            if step:
                out[:, k] += (up - down) / (2.0 * small)
                held[:, :, k] += (held_up - held_down) / (2.0 * small)
            sides = []
            for weight, twin in self.near[c] if counts else ():
                sides.append(twin.residual(stage, stage.state, before, q, stage.sensors))
                out[:, k] += weight * sides[-1]
                held[:, :, k] += weight * twin.held()
            if len(sides) == 2:
                worst = corner(sides[0], sides[1], base, scale)
                if worst is not None:
                    self._refuse(stage, c, worst)
        return out, held

    def _refuse(self, stage: Stage, c: int, worst: int | None) -> NoReturn:
        m = self.twin.model
        where = "a memory" if worst is None else f"the balance of {m.dof_name(int(m.free[worst]))}"
        raise DerivativeError(
            f"there is no derivative by '{self.columns[c].name}' at t = {stage.now:g} s: {where} answers to an "
            "increase otherwise than to a decrease. A law has a corner or a jump there: make it smooth"
        )

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

            for small in (step, CLOSER * step) if step else ():
                others.clear()
                kept = v[:, c].copy(), a[:, c].copy()
                for sign in (1.0, -1.0):
                    state, rates = self._moved(stage, tangent, done, c, sign * small)
                    self.twin.residual(
                        stage, state, rates, q + sign * small * dq[:, c], sensors(c, sign * small)
                    )
                    collect(sign / (2.0 * small), self.twin, state)
                if accept is None or not self._bent(accept, others):
                    break
                v[:, c], a[:, c] = kept
            else:
                if step:
                    self._refuse(stage, c, None)
            moved_by = len(others)
            for weight, twin in self.near[c]:
                twin.residual(stage, stage.state, before, q, stage.sensors)
                collect(weight, twin, stage.state)
            if accept is not None:
                if len(self.near[c]) == 2 and self._bent(accept, others[moved_by:]):
                    self._refuse(stage, c, None)
                parts.append(combined(self.twin.model, accept, others))
        return (v, a) if accept is None else joined(parts)

    def _bent(self, accept: State, others: list[tuple[float, State]]) -> bool:
        """Whether a memory answers to an increase otherwise than to a decrease."""
        (_, up), (_, down) = others
        for bound, here, one, other in zip(
            self.twin.model.bound, accept.memories, up.memories, down.memories, strict=True
        ):
            if here is None or one is None or other is None or bound.growing or not here.size:
                continue
            scale = np.abs(here).reshape(-1, here.shape[-1]).max(axis=0)
            scale = np.where(scale > 0.0, scale, scale.max() or 1.0)
            if corner(one, other, here, scale) is not None:
                return True
        return False

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
                largest = max(largest, share(memory, d[..., c]))
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


def share(memory: np.ndarray, change: np.ndarray) -> float:
    """Size of the change of a memory against what it holds, column by column, for they differ in kind."""
    sizes = np.abs(memory).reshape(-1, memory.shape[-1]).max(axis=0)
    changes = np.abs(change).reshape(-1, memory.shape[-1]).max(axis=0)
    known = sizes > 0.0
    share = float((changes[known] / sizes[known]).max(initial=0.0))
    # of what is zero still, nothing is known but what the others are
    return max(share, float(changes[~known].max(initial=0.0)) / (float(sizes.max()) or 1.0))


def corner(up: np.ndarray, down: np.ndarray, here: np.ndarray, scale: np.ndarray) -> int | None:
    """Where values at equal distances to either side do not lie on a line with that in the middle; None if they do.

    The arrays are of one shape, and ``scale`` is what they are measured by.
    """
    bend = np.abs(up + down - 2.0 * here) / scale
    worst = int(np.argmax(bend))
    change = float((np.abs(up - down) / scale).max(initial=0.0))
    return worst if bend.flat[worst] > max(CORNER * change, FAINT) else None
