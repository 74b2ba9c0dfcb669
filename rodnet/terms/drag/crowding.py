"""Drag that depends on neighbours: rods near each other jam the medium between them, or shield each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm
from rodnet.terms.drag.line import SiteTable, _BoundLaw, line_sites
from rodnet.terms.drag.resistive import ResistiveForce, given

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

NORM = 231.0 / 320.0  # 1 / integral of the step (`_step`) of 1 - s^2 from -1 to 1
# of the range along the rods: from where on pieces are neighbours, and where they are wholly
NEAR, APART = 1.0, 2.0
FULL = 2.0  # kappa of a crowd, by which it is soon full, over 1 / softness^2 - 1


class CrowdedForce(ResistiveForce):
    """Resistive force theory whose coefficients are exp(crowding n) times as large, n being the crowd.

    The crowd at a place grows with the length of rods within the distance ``range``, pieces that are nearer counting
    more: one straight rod beside it that touches makes about 1. Rods jam each other for ``crowding`` > 0
    and shield each other for ``crowding`` < 0. With a small ``softness`` a piece counts wholly as soon as it is nearer
    than the range, and one makes the crowd as full as many do. Pieces are no neighbours that are next to each other
    along the rods, by way of joints, too, up to the range, and are wholly from twice that on: a straight rod has no
    crowd of its own, one that is folded has, and rods that meet at a joint the more the sharper the angle.

    The length and its rate of change are taken at the beginning of each step and extrapolated to
    its end: second order in time, and the Jacobian keeps the pattern of the graph.

    Parameters
    ----------
    crowding : float or Parameter
        Logarithm of the factor on the drag beside one straight neighbour that touches [1].
    range : float or Parameter
        Distance between axes from which on rods do not notice each other [m]; no edge may be longer than half of it.
    softness : float or Parameter
        Share of the range in which a piece that comes nearer gets to count wholly [1]: near zero, a step.
    """

    crowding = Parameter(0.0, unit="1", null=0.0, doc="logarithm of the factor for one neighbour")
    range = Parameter(0.02, unit="m", bounds=(1e-12, None), kind="shape", doc="distance at which it ends")
    softness = Parameter(
        1.0, unit="1", bounds=(0.05, 1.0), kind="shape", doc="share of the range in which neighbours begin"
    )
    source = "phenomenological; Du et al., results (tails that jam the grains between them)"
    example: ClassVar[dict[str, Any]] = {"viscosity": 1.0, "crowding": 0.7, "range": 0.06}

    def __init__(self, on: Any = "*", **options: Any) -> None:
        super().__init__(on, **options)
        if self.axial_torque:
            raise TermError("CrowdedForce has no axial torque; add a ResistiveForce that has for it")
        for key in ("range", "softness"):
            value = getattr(self, key).value
            if np.ndim(value):
                raise TermError(f"CrowdedForce: {key} must be one number, not {value}")

    @property
    def alone(self) -> ResistiveForce:
        """What it is without neighbours, of the same parameters."""
        args, options = self._given
        own = ("crowding", "range", "softness")
        found = ResistiveForce(*args, **{k: v for k, v in options.items() if k not in own})
        for key, parameter in self.parameter_items():
            if key not in own:
                setattr(found, key, parameter)
        return found

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the sites of the rods that ``on`` names; these are each other's neighbours.

        Raises
        ------
        TermError
            If an edge is longer than half the range: rods would pass between each other's nodes unnoticed.
        """
        self._refuse_coarse(model)
        return _BoundCrowded(self, model, line_sites(model, self.on, self.tangent))

    def _refuse_coarse(self, model: Model) -> None:
        graph, half = model.graph, 0.5 * float(self.range.value)
        mine = graph.edge_indices(self.on)
        for rod in graph.rods.values():
            length = graph.rest_length[np.intersect1d(rod.edges, mine)]
            longest = float(length.max(initial=0.0))
            if longest > half * (1.0 + 1e-9):  # whatever the rounding, edges of just this length are fine
                edges = int(np.ceil(rod.length / half * (1.0 - 1e-9)))
                raise TermError(
                    f"CrowdedForce: an edge of rod '{rod.name}' is {longest:.3g} m long, more than half of "
                    f"range = {2.0 * half:g} m: other rods could pass between its nodes unnoticed. Give the rod "
                    f"edges={edges} or more, or the law a range of {2.0 * longest:.3g} m or more"
                )


class _BoundCrowded(_BoundLaw):
    """Holds the length of neighbours at the nodes.

    The memory's columns are it, over that of one that touches, its rate, both a step ago, and the step.
    """

    def __init__(self, term: CrowdedForce, model: Model, sites: SiteTable) -> None:
        from rodnet.terms.drag.kernels import resistive_force

        super().__init__(term, model, sites)
        self.resistive_force = resistive_force
        self.eta = term.site_coefficients(model, sites)
        self.crowding, self.range = self.p.crowding, float(term.range.value)
        softness = float(term.softness.value)
        self.shell = 1.0 - (1.0 - softness) ** 2  # of the square of the range
        self.full = FULL * (softness**-2 - 1.0)
        self.scaled = self.eta.copy()  # by the crowd of the step, in place
        self.p = given(self.scaled)
        self.node, self.place = np.unique(sites.node, return_inverse=True)
        self.weight = np.bincount(self.place, weights=sites.weight)
        self.next, self.apart = self._ways(model)
        start = self._length(model.x0[self.node], np.zeros((len(self.node), 3)))
        self._keep(start, start, 1.0)

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        super().find_slots(pattern, stencils)
        self.packed = self.pack(self.scaled)

    def _ways(self, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the pairs of nodes that are no whole neighbours, for the way between them, and how much they are.

        A pair i, j of n nodes has the number i n + j.
        """
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import dijkstra

        graph, n = model.graph, len(self.node)
        ways = coo_matrix(
            (graph.rest_length, (graph.edges[:, 0], graph.edges[:, 1])), shape=(graph.node_count,) * 2
        ).tocsr()
        numbers, lengths = [], []
        for first in range(0, n, 256):  # rows at a time: the whole table would be large
            rows = np.arange(first, min(first + 256, n))
            way = dijkstra(ways, directed=False, indices=self.node[rows], limit=APART * self.range)
            way = way[:, self.node]
            i, j = np.nonzero(np.isfinite(way))
            numbers.append(rows[i] * n + j)
            lengths.append(way[i, j])
        gone = (np.concatenate(lengths) / self.range - NEAR) / (APART - NEAR)
        return np.concatenate(numbers), _step(gone)[0]

    def _pairs(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pairs of nodes that are within the range of each other, and how much they are neighbours."""
        from scipy.spatial import cKDTree

        n = len(x)
        i, j = cKDTree(x).query_pairs(self.range, output_type="ndarray").T
        # in an order of their own, so that sums do not depend on the tree's
        number = np.sort(i * n + j)
        at = np.minimum(np.searchsorted(self.next, number), len(self.next) - 1)
        apart = np.where(self.next[at] == number, self.apart[at], 1.0)
        number, apart = number[apart > 0.0], apart[apart > 0.0]
        return number // n, number % n, apart

    def _length(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Length of neighbours at the nodes and its rate [1/s], shape (n, 2)."""
        out, n = np.zeros((len(x), 2)), len(x)
        i, j, apart = self._pairs(x)
        d, w, square = x[i] - x[j], NORM / self.range * apart, self.range**2
        value, slope, _ = _step((1.0 - np.sum(d**2, axis=1) / square) / self.shell)
        rate = -2.0 / (square * self.shell) * slope * np.sum(d * (v[i] - v[j]), axis=1)
        for k, values in enumerate((value, rate)):
            out[:, k] += np.bincount(i, weights=w * values * self.weight[j], minlength=n)
            out[:, k] += np.bincount(j, weights=w * values * self.weight[i], minlength=n)
        return out

    def length_slopes(self, x: np.ndarray, v: np.ndarray) -> tuple[csr_matrix, csr_matrix]:
        """Derivatives of the length of neighbours and of its rate by the nodes' places, shape (n, 3 n).

        The derivative of the rate by the nodes' velocities is that of the length by their places.
        """
        from scipy.sparse import coo_matrix

        i, j, apart = self._pairs(x)
        d, u, scale = x[i] - x[j], v[i] - v[j], -2.0 / (self.range**2 * self.shell)
        _, first, second = _step((1.0 - np.sum(d**2, axis=1) / self.range**2) / self.shell)
        w = NORM / self.range * apart * scale
        slope = (w * first)[:, None] * d
        rate = (w * first)[:, None] * u + (w * scale * second * np.sum(d * u, axis=1))[:, None] * d
        row = np.concatenate([i, i, j, j]).repeat(3)
        column = (3 * np.concatenate([i, j, i, j])[:, None] + np.arange(3)).ravel()
        found = []
        for by_distance in (slope, rate):
            at_i, at_j = self.weight[j][:, None] * by_distance, self.weight[i][:, None] * by_distance
            values = np.concatenate([at_i, -at_i, at_j, -at_j]).ravel()
            found.append(coo_matrix((values, (row, column)), shape=(len(x), 3 * len(x))).tocsr())
        return found[0], found[1]

    def crowd(self, ev: Evaluation) -> np.ndarray:
        """Crowd at the sites in a step, shape (n,)."""
        return self.crowd_of(self.length(ev))[self.place]

    def crowd_of(self, length: np.ndarray) -> np.ndarray:
        """Crowd [1] that neighbours of some length make, over that of one that touches, both of shape (n,)."""
        return np.asarray((1.0 + self.full) * length / (1.0 + self.full * length))

    def crowd_slope(self, ev: Evaluation) -> np.ndarray:
        """Its derivative by the length of neighbours, shape (n,)."""
        length = self.length(ev)
        slope = (1.0 + self.full) / (1.0 + self.full * length) ** 2
        return np.asarray(np.where(length > 0.0, slope, 0.0)[self.place])

    def length(self, ev: Evaluation) -> np.ndarray:
        """Length of neighbours at the nodes in a step, over that of one that touches, shape (n,)."""
        assert self.memory is not None
        elapsed = ev.dt if self.past_dt is None else self.past_dt
        return np.maximum(self.memory[:, 0] + elapsed * self.memory[:, 1], 0.0)

    def _take_crowd(self, ev: Evaluation) -> None:
        """Put the coefficients of a step in place."""
        np.multiply(self.eta, np.exp(self.crowding * self.crowd(ev)[:, None]), out=self.scaled)

    def site_forces(self, ev: Evaluation) -> np.ndarray:
        """Forces on the sites [N], shape (n, 3)."""
        self._take_crowd(ev)
        return self._force(self.view(ev)) * self.sites.weight[:, None]

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        self._take_crowd(ev)
        if self.flow is not None:
            return super().add(ev, F, data, jac)
        return self.resistive_force(self.packed.table, ev.state, ev.cv, F, data, jac)

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        assert self.memory is not None
        new, old = self._length(ev.x[self.node], ev.v[self.node]), self.memory[:, :2]
        return np.concatenate([new, old, np.full((len(new), 1), ev.dt)], axis=1)

    def rewind(self) -> None:
        assert self.memory is not None
        self.past_dt = float(self.memory[0, -1])
        self._keep(self.memory[:, 2:4], self.memory[:, 2:4], self.past_dt)


def _step(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth step from 0 at 0 to 1 at 1, and its first two derivatives, which are zero there."""
    u = np.clip(u, 0.0, 1.0)
    bump = u * (1.0 - u)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2), 30.0 * bump**2, 60.0 * bump * (1.0 - 2.0 * u)
