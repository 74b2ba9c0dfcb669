"""The tangent of a medium that remembers in cells what rods have done to its places."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.tangent.compare import that_change
from rodnet.tangent.differences import STEP, share
from rodnet.tangent.state import CELL
from rodnet.terms.drag.line import LineSites
from rodnet.terms.drag.medium import BoundMediumLaw

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part


class MediumTangent:
    """How what the cells of a medium remember changes, and what that does.

    Forces follow the memory to first order by the law's own derivative. How the medium goes on from there is any
    function of its places, and of the motion of all sites: differences of that alone tell its derivative.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the law is.
    """

    def __init__(self, model: Model, number: int) -> None:
        bound = model.bound[number]
        assert isinstance(bound, BoundMediumLaw)
        self.number, self.bound, s = number, bound, bound.sites
        axes = np.arange(3)
        self._rows = 3 * s.node[:, None] + axes
        other = np.where(s.edgeB < 0, s.edgeA, s.edgeB)
        self._sides = [(e, c, *(3 * model.edges[e][:, end, None] + axes for end in (0, 1)))
                       for e, c in ((s.edgeA, s.cA), (other, s.cB))]  # fmt: skip
        self._near: list[tuple[int, list[tuple[float, Any]]]] = []

    @staticmethod
    def knows(bound: Any) -> bool:
        """Whether the law is of this kind."""
        return isinstance(bound, BoundMediumLaw)

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the law, with weights and bound terms nearby."""
        self._near = that_change(self.bound, number, parts)

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from the memory and the law, at fixed positions.

        ``before``, shape (1 + cells, 3 + 2 m, k), is the derivative of the memory that the step begins with.
        """
        assert before is not None
        b = self.bound
        self._field, self._site, self._edges = b.field, b.view(ev), (ev.T.copy(), ev.L.copy())
        self._before = before[1:, CELL : CELL + b.law.memory_size]
        m, _ = self._field.gather(self._site.x, False)
        found = self._field.gathered(self._site.x, self._before)
        force = (
            np.einsum("nim,nmk->nik", b.by_memory(self._site, m), found) * self._site.length[:, None, None]
        )
        for c, near in self._near:
            for weight, other in near:
                site = _as_seen(other, self._site)
                force[:, :, c] += weight * site.length[:, None] * other.law.update(site, other.p, m)[0]
        np.subtract.at(out, self._rows, force)

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (1 + cells, 3 + 2 m, k).

        ``dq`` and ``dv``, shape (dof_count, k), are those of its degrees of freedom and rates; turned frames do not
        matter.
        """
        b, site, field, before = self.bound, self._site, self._field, self._before
        codes = b.evolved(site, field).codes
        size = b.law.memory_size
        new = np.zeros((1 + len(codes), CELL + 2 * size, dq.shape[1]))
        motion = dv[self._rows], dq[self._rows], self._turning(dq)
        for c in range(dq.shape[1]):
            v, x, tangent = (part[:, :, c] for part in motion)
            scale = max(float(np.abs(x).max()), site.dt * float(np.abs(v).max())) / field.size
            scale = max(scale, float(np.abs(tangent).max()))
            if len(before):
                scale = max(scale, share(field.values, before[:, :, c]))
            if scale == 0.0:
                continue
            step = STEP / scale
            for h in (step, -step):
                moved = replace(site, v=site.v + h * v, x=site.x + h * x, tangent=site.tangent + h * tangent)
                changed = replace(field, values=field.values + h * before[:, :, c])
                new[1:, CELL : CELL + size, c] += b.evolved(moved, changed).at(codes) / (2.0 * h)
        for c, near in self._near:
            for weight, other in near:
                found = other.evolved(_as_seen(other, site), field)
                new[1:, CELL : CELL + size, c] += weight * found.at(codes)
        new[1 + np.searchsorted(codes, field.codes), CELL + size :] = before
        return new

    def _turning(self, dq: np.ndarray) -> np.ndarray:
        """Derivative of the sites' tangents, shape (n, 3, k)."""
        T, L = self._edges
        found = np.zeros((*self._rows.shape, dq.shape[1]))
        for e, c, start, end in self._sides:
            t, change = T[e], (dq[end] - dq[start]) / L[e, None, None]
            change -= t[:, :, None] * np.einsum("ni,nik->nk", t, change)[:, None]
            found += c[:, None, None] * change
        return found


def _as_seen(other: BoundMediumLaw, site: LineSites) -> LineSites:
    """Sites as a law nearby has them: radii and lengths are its own."""
    return replace(site, radius=other.sites.radius, length=other.sites.weight)
