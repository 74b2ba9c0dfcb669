"""The tangent of a medium that remembers in cells what rods have done to its places."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.tangent.compare import alike, that_change
from rodnet.tangent.differences import CORNER, FAINT, STEP, share
from rodnet.tangent.state import CELL
from rodnet.terms.drag.line import LineSites
from rodnet.terms.drag.medium import BoundMediumLaw, Field

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part
    from rodnet.tangent.variation import Variation


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
    columns : list of Variation
        The columns.
    """

    def __init__(self, model: Model, number: int, columns: list[Variation]) -> None:
        bound = model.bound[number]
        assert isinstance(bound, BoundMediumLaw)
        self.number, self.bound, s = number, bound, bound.sites
        axes = np.arange(3)
        self._rows = 3 * s.node[:, None] + axes
        other = np.where(s.edgeB < 0, s.edgeA, s.edgeB)
        self._sides = [(e, c, *(3 * model.edges[e][:, end, None] + axes for end in (0, 1)))
                       for e, c in ((s.edgeA, s.cA), (other, s.cB))]  # fmt: skip
        self._near: list[tuple[int, list[tuple[float, Any]]]] = []
        self._two_sided: set[int] = set()  # columns with a law to either side nearby
        # changes of the columns' quantities that are small
        self._small = np.array([0.5 / max((abs(w) for w, _ in c.near), default=np.inf) for c in columns])

    @staticmethod
    def knows(bound: Any) -> bool:
        """Whether the law is of this kind; what inherits it may remember otherwise."""
        return type(bound) is BoundMediumLaw

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the law, with weights and bound terms nearby."""
        self._near = that_change(self.bound, number, parts)
        same = lambda other: alike(self.bound.constants, other.constants)  # noqa: E731
        self._two_sided = {
            c for c, near in self._near if len(near) == 2 and not any(same(b) for _, b in near)
        }

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
        count = len(self._small)  # others are none
        sizes = (np.abs(found[:, :, :count]) * self._small).max(axis=(0, 2), initial=0.0)
        slope = b.by_memory(self._site, m, sizes=sizes)
        force = np.einsum("nim,nmk->nik", slope, found) * self._site.length[:, None, None]
        for c, near in self._near:
            for weight, other in near:
                site, field = self._as_seen(other)
                m, _ = field.gather(site.x, False)
                force[:, :, c] += weight * site.length[:, None] * other.law.update(site, other.p, m)[0]
        np.subtract.at(out, self._rows, force)

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (1 + cells, 3 + 2 m, k).

        ``dq`` and ``dv``, shape (dof_count, k), are those of its degrees of freedom and rates; turned frames do not
        matter.
        """
        b, site, field, before = self.bound, self._site, self._field, self._before
        base = b.evolved(site, field)
        codes, here = base.codes, base.values
        size = b.law.memory_size
        new = np.zeros((1 + len(codes), CELL + 2 * size, dq.shape[1]))
        motion = dv[self._rows], dq[self._rows], self._turning(dq)
        for c in range(dq.shape[1]):
            v, x, tangent = (part[:, :, c] for part in motion)
            scale = max(float(np.abs(x).max()), site.dt * float(np.abs(v).max())) / field.size
            scale = max(scale, float(np.abs(tangent).max()))
            if len(before):
                scale = max(scale, self._share(field.values, before[:, :, c], c))
            if scale == 0.0:
                continue
            sides = []
            for h in (STEP / scale, -STEP / scale):
                moved = replace(site, v=site.v + h * v, x=site.x + h * x, tangent=site.tangent + h * tangent)
                changed = replace(field, values=field.values + h * before[:, :, c])
                sides.append((0.5 / h, b.evolved(moved, changed).at(codes)))
            new[1:, CELL : CELL + size, c] = _quotient(sides, here)
        for c, near in self._near:
            sides = [(weight, other.evolved(*self._as_seen(other)).at(codes)) for weight, other in near]
            if c in self._two_sided:
                new[1:, CELL : CELL + size, c] += _quotient(sides, here)
            else:
                new[1:, CELL : CELL + size, c] += sum(weight * values for weight, values in sides)
        new[1 + np.searchsorted(codes, field.codes), CELL + size :] = before
        return new

    def _share(self, values: np.ndarray, change: np.ndarray, c: int) -> float:
        """Size of a column's change of the memory against what it holds; what is zero yet has no size of its own."""
        known = np.any(values != 0.0, axis=0)
        found = share(values[:, known], change[:, known]) if known.any() else 0.0
        if not change[:, ~known].any():
            return found
        small = self._small[c]
        return max(found, STEP / small if small > 0.0 else share(values, change))

    def _as_seen(self, other: BoundMediumLaw) -> tuple[LineSites, Field]:
        """Sites and field as a law nearby has them: radii, lengths and the untouched medium are its own."""
        site = replace(self._site, radius=other.sites.radius, length=other.sites.weight)
        return site, replace(self._field, untouched=other.field.untouched)

    def _turning(self, dq: np.ndarray) -> np.ndarray:
        """Derivative of the sites' tangents, shape (n, 3, k)."""
        T, L = self._edges
        found = np.zeros((*self._rows.shape, dq.shape[1]))
        for e, c, start, end in self._sides:
            t, change = T[e], (dq[end] - dq[start]) / L[e, None, None]
            change -= t[:, :, None] * np.einsum("ni,nik->nk", t, change)[:, None]
            found += c[:, None, None] * change
        return found


def _quotient(sides: list[tuple[float, np.ndarray]], here: np.ndarray) -> np.ndarray:
    """Central quotient of memories, cells by columns; where it meets a jump, that to the side without it.

    A step ends on a jump but by chance: which side it took is what counts, and the other is not felt. ``sides`` are
    the two weights, of which one is minus the other, and the memories there.
    """
    (weight, up), (_, down) = sides
    rise, fall = up - here, here - down
    bend, change = np.abs(rise - fall), np.abs(rise + fall)
    least = np.maximum(
        CORNER * change.max(axis=0, initial=0.0), FAINT * np.abs(here).max(axis=0, initial=0.0)
    )
    nearer = np.where(np.abs(rise) < np.abs(fall), rise, fall)
    return np.where(bend > least, 2.0 * weight * nearer, weight * (rise + fall))
