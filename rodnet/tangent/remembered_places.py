"""The tangent of a medium that remembers where nodes came from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.tangent.compare import that_change
from rodnet.terms.drag.maxwell import _BoundMaxwell

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part


class PlaceMemoryTangent:
    """How the stretch of a medium changes, and what that does.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the law is.
    """

    def __init__(self, model: Model, number: int) -> None:
        bound = model.bound[number]
        assert isinstance(bound, _BoundMaxwell)
        self.number, self.bound = number, bound
        self._near: list[tuple[int, list[tuple[float, Any]]]] = []

    @staticmethod
    def knows(bound: Any) -> bool:
        """Whether the law is of this kind."""
        return isinstance(bound, _BoundMaxwell)

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the law, with weights and bound terms nearby."""
        self._near = that_change(self.bound, number, parts)

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from the stretch, at fixed positions.

        ``before``, shape (n, 13, k), is the derivative of the memory that the step begins with.
        """
        assert before is not None
        b, memory = self.bound, stage.state.memories[self.number]
        assert memory is not None
        self._before, self._dt, self._x, self._memory = before, ev.dt, ev.x[b.node], memory
        still = np.zeros((len(b.node), 3, before.shape[2]))
        force, _ = b.linear(self._x, memory, ev.dt, still, before)
        for c, near in self._near:
            for weight, other in near:
                force[:, :, c] += weight * other.law(self._x, memory, ev.dt)[0]
        out[b.dofs] -= force

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (n, 13, k).

        ``dq``, shape (dof_count, k), is that of its degrees of freedom; rates and turned frames do not matter.
        """
        b = self.bound
        _, new = b.linear(self._x, self._memory, self._dt, dq[b.dofs], self._before)
        for c, near in self._near:
            for weight, other in near:
                new[..., c] += weight * other.law(self._x, self._memory, self._dt)[1]
        return np.asarray(new)
