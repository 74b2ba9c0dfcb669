"""The tangent of tendons: of their command, and of what friction at the eyelets remembers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.tangent.compare import that_change
from rodnet.terms.tendons import _BoundTendon

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part

TWISTS = (9, 16)  # among the degrees of freedom of an eyelet, those that turn the frames of its two edges


class TendonTangent:
    """How tensions change with command, friction and memory, and what that does.

    Where friction has a corner, the derivative is that on the side that the step took. Without friction, tensions
    change in proportion to its coefficient, limits and what is remembered growing together: the derivative by it
    follows the memory of a small friction.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the tendon is.
    """

    def __init__(self, model: Model, number: int) -> None:
        bound = model.bound[number]
        assert isinstance(bound, _BoundTendon)
        self.model, self.number, self.bound = model, number, bound
        self._near: list[tuple[int, list[tuple[float, Any]]]] = []

    @staticmethod
    def knows(model: Model, bound: Any) -> bool:
        """Whether the term is a tendon, and answers to no sensor."""
        return isinstance(bound, _BoundTendon) and not model.robot.sensors

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the tendon, with weights and bound terms nearby."""
        self._near = that_change(self.bound, number, parts)

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from the tensions, at fixed positions.

        ``before``, shape (10 n - 6, k), is the derivative of the memory that the step begins with.
        """
        assert before is not None
        b, memory = self.bound, stage.state.memories[self.number]
        assert memory is not None
        n, wide = b.count, before.shape[1]
        self._past, self._before = memory[1 : 3 * n - 1], before[1 : 3 * n - 1]
        self._d_past, state = self._before.copy(), slice(0, 2 * n - 2)
        b._place(ev)
        self._turns, normals = b._turns()
        self._length, self._u, self._P = b.length.copy(), b.u.copy(), b.P.copy()
        self._across, self._back = (normal.copy() for normal in normals)
        self._tension = b._tensions(self._length, self._turns, self._past, False)[0]
        self._command = np.zeros(wide)
        self._tensions, self._states = (
            np.zeros((n, wide)),
            np.zeros((2 * n - 2, wide)),
        )  # of the tendon itself
        for c, near in self._near:
            begins = b.p.friction == 0.0 and any(other.p.friction for _, other in near)
            for weight, other in near:
                other._take(stage.inputs)
                other.value = other._checked(stage.now, stage.sensors)
                past = self._past.copy()
                if begins:
                    past[state] += other.p.friction * self._before[state, c]
                tension, left, *_ = other._tensions(self._length, self._turns, past, False)
                self._command[c] += weight * other.value
                self._tensions[:, c] += weight * tension
                self._states[:, c] += weight * left
            if begins:
                self._d_past[state, c] = 0.0
        change, _ = self._changes(np.zeros((n, wide)), np.zeros((n - 1, wide)))
        pulls = self._u[:, :, None] * (change + self._tensions)[:, None, :]
        force = np.zeros((n + 1, 3, wide))
        force[:-1] += pulls
        force[1:] -= pulls
        np.subtract.at(out, b.dofs, np.swapaxes(self._P, 1, 2) @ force)

    def _changes(self, d_length: np.ndarray, d_turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        b = self.bound
        return b.changes(
            self._length, self._turns, self._tension, self._past, d_length, d_turns, self._d_past
        )

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (10 n - 6, k).

        Parameters
        ----------
        dq, dv : ndarray, shape (dof_count, k)
            Derivatives of the solution and of its rates; the latter do not matter.
        turned : ndarray, shape (edge_count, k)
            Angles by which changed source frames turn the directors.
        """
        b = self.bound
        motion = dq[b.dofs]
        for place, edges in zip(TWISTS, b.edges.T, strict=True):
            motion[edges >= 0, place] += turned[edges[edges >= 0]]
        apart = np.diff(self._P @ motion, axis=0)
        d_length = np.einsum("ki,kic->kc", self._u, apart)
        across, back = self._across / self._length[:-1, None], self._back / self._length[1:, None]
        d_turns = -np.einsum("ki,kic->kc", across, apart[:-1]) - np.einsum("ki,kic->kc", back, apart[1:])
        tension, state = self._changes(d_length, d_turns)
        tension, state = tension + self._tensions, state + self._states
        return np.concatenate([self._command[None], state, d_length, self._before, tension])
