"""Contact of rods with each other and with themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.base import BoundTerm
from rodnet.terms.contact.base import Contact, edge_radii, firmness, law_table
from rodnet.terms.drag.line import edge_dofs

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

BEND = 0.5 * np.pi  # a rod whose ends touch is at least so many times longer than the sum of radii
JOINT = 10.0  # what overlaps within so many times the sum of radii along the rods belongs to a joint
RATE = 2.4  # the largest rate of a gap over the largest displacement of a node


class RodContact(Contact):
    """Rods that do not pass through each other, nor through themselves.

    Edges that share a node, or that are joined by a path shorter than pi/2 times the sum of their
    radii, never touch; edges that overlap at an acute joint from the beginning are left out as well.

    Parameters
    ----------
    on : str or sequence of str
        The rods that may touch each other.
    **options
        ``friction``, ``stiffness``, ``reach``, ``slip``, ``damping``, ``rod_radius`` (see `Contact`) and ``name``.

    Raises
    ------
    TermError
        When the robot is made: if rods overlap in their initial shape, away from a common joint.
    """

    default_name = "contact"
    source = "Li et al. 2020 (incremental potential contact); Li, Kaufman & Jiang 2021 (rods)"
    claims: ClassVar[set[str]] = {"objective"}
    example: ClassVar[dict[str, Any]] = {
        "reach": 0.1, "stiffness": 10.0, "rod_radius": 1e-5, "friction": 0.4, "slip": 0.05,
    }  # fmt: skip

    def __init__(self, on: Any = "*", **options: Any) -> None:
        super().__init__(on, **options)
        for name, p in self.parameter_items():
            if np.ndim(p.value):
                raise TermError(f"RodContact: {name} belongs to pairs of rods and must be one number")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges that ``on`` names."""
        return _BoundRods(self, model)


@dataclass
class _Pairs:
    """Pairs of edges whose gap is below ``bound`` with their nodes at the positions ``x``."""

    x: np.ndarray
    bound: float
    pairs: np.ndarray
    sizes: np.ndarray
    law: np.ndarray

    def take(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.pairs[chosen], self.sizes[chosen], self.law[chosen]


class _BoundRods(BoundTerm):
    """Keeps a list of pairs that may be within reach, and makes it anew when the robot has deformed.

    The list is but a short cut: what is computed depends on the positions alone.
    """

    def __init__(self, term: RodContact, model: Model) -> None:
        from rodnet.terms.contact import pair_kernels
        from rodnet.terms.contact.candidates import Paths, close_pairs
        from rodnet.terms.contact.law import stored_energy

        super().__init__(term)
        self.kernels, self.stored, self.close_pairs = pair_kernels, stored_energy, close_pairs
        self.graph, self.model = model.graph, model
        graph = model.graph
        self.edges = np.ascontiguousarray(graph.edges, dtype=np.int64)
        self.chosen = np.sort(graph.edge_indices(term.on))
        self.nodes = np.unique(self.edges[self.chosen])
        self.radius, self.p = edge_radii(term, graph), term.values()
        self.EA = firmness(term, graph)
        self.widest = 2.0 * float(self.radius[self.chosen].max())
        self.reach = float(self._law(np.stack([self.chosen, self.chosen], axis=1))[:, 1].max())
        self.piece = max(2.0 * float(np.median(graph.rest_length[self.chosen])), self.widest)
        self.margin = self.reach + 0.25 * self.piece
        self.paths = Paths(self.edges, graph.rest_length, graph.node_count, JOINT * self.widest)
        self.joints = np.zeros(0, dtype=np.int64)  # keys of pairs that overlap at a joint
        self.held = np.zeros(graph.edge_count, dtype=bool)
        self.body = np.full(graph.edge_count, -1)  # rigid body of each edge
        for k, body in enumerate(graph.bodies):
            self.body[body.edges] = k
        self.blocks: tuple[np.ndarray, np.ndarray] | None = None  # edges and derivatives of active pairs

    # -- pairs ----------------------------------------------------------------------------
    def _law(self, pairs: np.ndarray) -> np.ndarray:
        sums = self.radius[pairs].sum(axis=1)
        return law_table(self.p, sums, self.EA[pairs].min(axis=1))

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Find which edges are held, and refuse rods that overlap from the beginning."""
        x0 = self.model.x0
        free = self.model.movable[3 * self.edges[:, :, None] + np.arange(3)]
        self.held = ~free.any(axis=(1, 2))
        near = self._search(x0, 2.0 * self.reach)
        gaps = self._gaps(near, x0)
        path = self.paths.between(near.pairs) / near.sizes[:, 0]
        joint = (path < JOINT) & (gaps < near.law[:, 1])
        self.joints = self._keys(near.pairs[joint])
        wrong = np.flatnonzero((gaps <= 0.0) & ~joint)
        if len(wrong):
            k = wrong[np.argmin(gaps[wrong])]
            first, second = (self.graph.edge_name(int(e)) for e in near.pairs[k])
            raise TermError(
                f"contact '{self.term.name}': the edges '{first}' and '{second}' overlap in the initial shape, by "
                f"{-gaps[k]:.3g} m of the {near.sizes[k, 0]:.3g} m of their radii; draw them apart, join them, or "
                "choose with on= what may touch"
            )
        self.near = self._search(x0, self.reach + self.margin)

    def _keys(self, pairs: np.ndarray) -> np.ndarray:
        return pairs[:, 0] * len(self.edges) + pairs[:, 1]

    def _search(self, x: np.ndarray, bound: float) -> _Pairs:
        """Return the pairs that can touch and whose gap is below ``bound``."""
        from rodnet.terms.contact.law import THICKER

        pairs = self.close_pairs(x, self.edges, self.chosen, self.piece, self.widest + bound)
        sums = self.radius[pairs].sum(axis=1)
        apart = self.paths.between(pairs) >= BEND * sums
        apart &= (self.body[pairs[:, 0]] < 0) | (self.body[pairs[:, 0]] != self.body[pairs[:, 1]])
        apart &= ~np.isin(self._keys(pairs), self.joints) & ~self.held[pairs].all(axis=1)
        apart &= (self.edges[pairs[:, 0], :, None] != self.edges[pairs[:, 1], None, :]).all(axis=(1, 2))
        pairs = np.ascontiguousarray(pairs[apart])
        radius = self.radius[pairs]
        sums = radius.sum(axis=1)
        sizes = np.stack([sums, 8.0 * THICKER * sums * radius.min(axis=1)], axis=1)
        found = _Pairs(x[self.nodes], bound, pairs, sizes, self._law(pairs))
        chosen = self._gaps(found, x) < bound
        return _Pairs(found.x, bound, *found.take(chosen))

    def _gaps(self, near: _Pairs, x: np.ndarray) -> np.ndarray:
        gaps = np.empty(len(near.pairs))
        self.kernels.pair_gaps(near.pairs, near.sizes, self.edges, x, gaps)
        return gaps

    def _largest(self, dx: np.ndarray) -> float:
        """Largest displacement of a node beyond that of all as a whole [m], shape (len(nodes), 3)."""
        return float(np.sqrt(np.square(dx - dx.mean(axis=0)).sum(axis=1).max()))

    def _known(self, x: np.ndarray) -> float:
        """Gap up to which the list knows every pair at the positions ``x``."""
        return self.near.bound - RATE * self._largest(x[self.nodes] - self.near.x)

    def _within_reach(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Pairs within reach with their sizes, laws and gaps."""
        if not self._known(x) >= self.reach and np.all(np.isfinite(x)):
            self.near = self._search(x, self.reach + self.margin)
        gaps = self._gaps(self.near, x)
        active = np.flatnonzero(gaps < self.near.law[:, 1])
        return *self.near.take(active), gaps[active]

    # -- what the solver asks -------------------------------------------------------------
    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        pairs, sizes, law, gaps = self._within_reach(ev.x)
        self.blocks = None
        if not len(pairs):
            return 0.0
        if not gaps.min() > 0.0:
            F[3 * self.edges[pairs[np.argmin(gaps), 0], 0]] = np.inf
            return np.inf
        J = np.empty((len(pairs) if jac else 0, 14, 14))
        grip, twist0 = 0.0 if self.at_rest else 1.0, ev.model.twist0
        shares = self.radius[pairs] / sizes[:, :1]
        largest = self.kernels.pair_forces(
            pairs, sizes, shares, law, grip, self.edges, twist0, ev.state, ev.cv, F, J, jac
        )
        if jac:
            self.blocks = pairs, J
        return largest

    def coupling(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        if self.blocks is None:
            return None
        pairs, J = self.blocks
        dofs = edge_dofs(ev.model, pairs.ravel()).reshape(-1, 14)
        return np.repeat(dofs, 14, axis=1).ravel(), np.tile(dofs, (1, 14)).ravel(), -J.ravel()

    def largest_step(self, x: np.ndarray, dx: np.ndarray) -> float:
        # pairs further apart than this cannot come to a fifth of their gap or of the reach
        bound = 1.25 * RATE * self._largest(dx[self.nodes]) + self.reach
        near = self.near if self._known(x) >= bound else self._search(x, bound)
        return self.kernels.pair_step(near.pairs, near.sizes, near.law, self.edges, x, dx)

    def energy(self, ev: Evaluation) -> float:
        _, _, law, gaps = self._within_reach(ev.x)
        return self.stored(law, gaps)

    def gaps(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of edges within reach of each other, shape (n, 2), and their gaps [m]."""
        pairs, _, _, gaps = self._within_reach(x)
        return pairs, gaps
