"""The tangent of crowds: what neighbours count for is a memory that scales the drag of a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.tangent.compare import alike
from rodnet.terms.drag.change import _BoundChange
from rodnet.terms.drag.crowding import _BoundCrowded

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part
    from rodnet.tangent.variation import Variation


class CrowdTangent:
    """How the length of neighbours at the nodes changes, and what that does to the drag.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the law is.
    columns : list of Variation
        Of which some may change what counts as a crowd.
    """

    def __init__(self, model: Model, number: int, columns: list[Variation]) -> None:
        bound = model.bound[number]
        assert isinstance(bound, _BoundCrowded)
        self.bound, axes = bound, np.arange(3)
        self._rows = 3 * bound.sites.node[:, None] + axes
        # changes of the law, which the crowd multiplies, too
        self._changes = [
            (b, one)
            for b in model.bound
            if isinstance(b, _BoundChange)
            for one in b.laws.crowds
            if one.number == number and not b.idle
        ]
        self._dofs = (3 * bound.node[:, None] + axes).ravel()
        near = [
            (c, [(w, sim.model.bound[number]) for w, sim in one.near if one.acts])
            for c, one in enumerate(columns)
        ]
        self._near = [(c, some) for c, some in near if any(self._differs(other) for _, other in some)]
        # the law's own part knows how full a crowd of some length is; changes look it up in the law as it is
        fuller = [(c, some) for c, some in near if any(other.full != bound.full for _, other in some)]
        self._fuller = fuller if self._changes else []
        self._before = np.zeros((len(bound.node), 5, 0))
        self._ev: Evaluation | None = None

    def _differs(self, other: _BoundCrowded) -> bool:
        b = self.bound
        same = (b.range, b.shell) == (other.range, other.shell)
        return not (same and alike([b.weight, b.apart], [other.weight, other.apart]))

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Nothing: what columns change of the drag, at a given crowd, their parts know."""

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from the crowd.

        ``before``, shape (n, 5, k), is the derivative of the memory that the step begins with.
        """
        assert before is not None
        b = self.bound
        self._before, self._ev = before, ev
        longer = (before[:, 0] + ev.dt * before[:, 1])[b.place]
        growth = np.reshape(b.crowding, (-1, 1)) * b.crowd_slope(ev)[:, None] * longer
        changed = np.zeros((len(b.place), 3))
        for change, one in self._changes:
            changed += change.site_forces(ev)[one.where]
        forces = b.site_forces(ev) + changed
        np.subtract.at(out, self._rows, forces[:, :, None] * growth[:, None, :])
        for c, some in self._fuller:
            filled = sum(w * other.crowd_of(b.length(ev)) for w, other in some)[b.place, None]
            fuller = np.reshape(b.crowding, (-1, 1)) * filled
            np.subtract.at(out[:, c], self._rows, changed * fuller)

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (n, 5, k).

        ``dq`` and ``dv``, shape (dof_count, k), are those of its degrees of freedom and rates; turned frames do not
        matter.
        """
        b, ev, new = self.bound, self._ev, np.zeros_like(self._before)
        assert ev is not None
        x, v = ev.x[b.node], ev.v[b.node]
        slope, rate = b.length_slopes(x, v)
        dx, du = dq[self._dofs], dv[self._dofs]
        new[:, 0], new[:, 1] = slope @ dx, rate @ dx + slope @ du
        for c, near in self._near:
            for weight, other in near:
                new[:, :2, c] += weight * other._length(x, v)
        new[:, 2:4] = self._before[:, :2]
        return new
