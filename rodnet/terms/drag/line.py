"""Line drag: local laws of force per unit length, integrated per half edge or per node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.flow import Flow, as_flow

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.packed import Packed
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

_STEP = np.cbrt(np.finfo(float).eps)  # relative step of central differences


@dataclass(frozen=True)
class LineSites:
    """What a drag law sees: arrays over its sites, one row each.

    Attributes
    ----------
    v, x, tangent : ndarray, shape (n, 3)
        Velocity [m/s], position [m] and unit tangent (``tangent="node"``: the average, unnormalised).
    radius, length : ndarray, shape (n,)
        Outer radius [m], and the length [m] that the site stands for.
    t, dt : float
        Time and time step [s].
    """

    v: np.ndarray
    x: np.ndarray
    tangent: np.ndarray
    radius: np.ndarray
    length: np.ndarray
    t: float
    dt: float


class DragModel(Term):
    """A drag law: force per unit length [N/m] from the medium on a rod.

    Subclasses implement ``force(self, site, p)``, or with memory
    ``update(self, site, p, m_old) -> (force, m_new)`` and ``memory_size``. Both must be pure.
    ``jacobian(self, site, p) -> {"v": (n, 3, 3), "tangent": ..., "x": ...}`` is optional: what is
    missing is differenced. With ``memory_frame = "medium"`` the medium holds the memory, in cells of
    edge ``cell`` that stay in their place: see `disturb`, `settle` and `diffusivity`.
    ``kernel`` may hold a per-site twin, compiled by `rodnet.kernel`:
    ``kernel(v, x, tangent, radius, t, p, f, dfdv, dfdtangent)`` that fills its last three
    arguments; ``p`` is the vector of the declared parameters in order of declaration. The kernel of
    a law that depends on the place takes ``dfdx`` as a tenth argument.

    Parameters
    ----------
    on : str or sequence of str
        The rods that feel it.
    tangent : {"edge", "node"}
        Integrate per half edge with the edge's own tangent (defined at joints, independent of flips
        and splits), or per node with the averaged tangent (the paper's way).
    flow : Flow, (3,) or callable, optional
        Velocity of the medium: `rodnet.ShearFlow` and its like, a current [m/s], or a function
        ``flow(x, t)`` of places (n, 3) [m] and time that returns velocities (n, 3). Laws then see
        the velocity against the medium in ``site.v``; their vectorised form is used, not the kernel.
    cell : float, optional
        Edge of the medium's cells [m], for laws whose memory the medium holds.
    """

    kind = "drag"
    site: ClassVar[str] = "line"
    default_name = "drag"
    memory_size: ClassVar[int] = 0
    memory_frame: ClassVar[str] = "body"
    of_medium: ClassVar[bool] = True  # whether changes of the medium's drag change it
    memory_names: ClassVar[tuple[str, ...]] = ()  # what pictures call them
    example_memory: ClassVar[Any] = None  # one for which `rodnet.testing.check_term` checks a medium's law
    cell: float | None = None
    kernel: ClassVar[Any] = None

    def __init__(
        self, on: Any = "*", *, tangent: str = "edge", flow: Any = None, cell: float | None = None,
        name: str | None = None, **parameters: Any,
    ) -> None:  # fmt: skip
        super().__init__(on, name=name, **parameters)
        if tangent not in ("edge", "node"):
            raise TermError(f"{type(self).__name__}: tangent must be 'edge' or 'node', not {tangent!r}")
        self.tangent = tangent
        self.flow: Flow | None = None
        if flow is not None:
            self.flow = as_flow(flow, type(self).__name__)
            # a medium that moves by itself drives the robot, and singles out a place or a direction
            self.claims = set(self.claims) - {"dissipative", "objective"}  # type: ignore[misc]
        if cell is not None:
            if self.memory_frame != "medium":
                raise TermError(f"{type(self).__name__}: cell= is for laws with memory_frame = 'medium'")
            if not (np.isfinite(cell) and cell > 0):
                raise TermError(f"{type(self).__name__}: cell = {cell!r} must be a positive length [m]")
            self.cell = float(cell)

    @property
    def alone(self) -> DragModel:
        """What it is at each place by itself, whatever other rods do: that is what a `DragChange` changes."""
        return self

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        raise TermError(f"{type(self).__name__} must implement force(self, site, p)")

    def update(self, site: Any, p: Any, m_old: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force per unit length and new memory, shapes (n, 3) and (n, memory_size)."""
        return self.force(site, p), m_old

    def initial_memory(self, site: Any, p: Any) -> np.ndarray:
        """Memory before the first step, shape (n, memory_size); zeros by default."""
        return np.zeros((len(site.v), self.memory_size))

    def disturb(self, site: Any, p: Any, m: np.ndarray) -> np.ndarray:
        """What the sites together change in the medium's memory ``m``, shape (n, memory_size); pure, zero by default.

        It comes on top of each site's own change at the end of a step, and may depend on all sites at once.
        """
        return np.zeros_like(m)

    def settle(self, cells: Any, p: Any, m: np.ndarray) -> np.ndarray:
        """Memory of cells of the medium after a step on their own, shape (n, memory_size); pure.

        See `rodnet.terms.drag.medium.Cells`; the untouched medium must stay as it is.
        """
        return m

    def diffusivity(self, p: Any) -> Any:
        """Diffusivity [m^2/s] of what the medium remembers, a number or one for each memory; zero by default."""
        return 0.0

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return the derivatives that are known, each of shape (n, 3, 3); none by default.

        With memory, those of ``update(site, p, m_old)[0]``, the change of memory included; and where the
        medium holds it, ``"memory"``, by ``m_old``, of shape (n, 3, memory_size).
        """
        return {}

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the sites of the rods that ``on`` names."""
        from rodnet.compiled import config

        if self.site != "line":
            raise TermError(
                f"{type(self).__name__}.site = {self.site!r}; drag laws act on sites of kind 'line'"
            )
        sites = line_sites(model, self.on, self.tangent)
        if self.memory_frame != "body":
            if self.flow is not None:
                raise TermError(
                    f"{type(self).__name__}: flow= is for laws without memory_frame = 'medium', whose medium stays"
                )
            return self._bind_to_medium(model, sites)
        plain = self.memory_size or self.flow is not None or config.DISABLE_JIT
        if type(self).kernel is not None and not plain:
            return _BoundKernelLaw(self, model, sites)
        return _BoundLaw(self, model, sites)

    def _bind_to_medium(self, model: Model, sites: SiteTable) -> BoundTerm:
        from rodnet.terms.drag.medium import BoundMediumLaw

        name = type(self).__name__
        if self.memory_frame != "medium":
            raise TermError(f"{name}.memory_frame = {self.memory_frame!r} must be 'body' or 'medium'")
        if not self.memory_size:
            raise TermError(f"{name}: memory_frame = 'medium' is for laws with memory; set memory_size")
        if self.cell is None:
            raise TermError(f"{name}: give cell=, the edge of the medium's cells [m], some grains long")
        return BoundMediumLaw(self, model, sites)


@dataclass
class SiteTable:
    """Sites of a line law: node, the one or two edges of its tangent, and the length it stands for."""

    node: np.ndarray
    edgeA: np.ndarray
    edgeB: np.ndarray
    cA: np.ndarray
    cB: np.ndarray
    weight: np.ndarray
    radius: np.ndarray

    def dofs(self, edges: np.ndarray) -> np.ndarray:
        """Positions of the node and of its edges' ends, shape (n, 9) or (n, 15)."""
        columns = [self.node, edges[self.edgeA, 0], edges[self.edgeA, 1]]
        if np.any(self.edgeB >= 0):
            other = np.where(self.edgeB >= 0, self.edgeB, self.edgeA)
            columns += [edges[other, 0], edges[other, 1]]
        nodes = np.stack(columns, axis=1).astype(np.int32)
        return (3 * nodes[:, :, None] + np.arange(3, dtype=np.int32)).reshape(len(nodes), -1)


def line_sites(model: Model, on: Any, tangent: str) -> SiteTable:
    """Return the sites of the edges that ``on`` names: half edges, or the nodes of each rod."""
    graph = model.graph
    chosen = np.zeros(graph.edge_count, dtype=bool)
    chosen[graph.edge_indices(on)] = True
    if not chosen.any():
        raise TermError(f"the drag law on={on} acts on no edge")
    mine = [rod.edges[chosen[rod.edges]] for rod in graph.rods.values()]
    parts = [_half_edges(graph, e) if tangent == "edge" else _rod_nodes(graph, e) for e in mine]
    node, edgeA, edgeB, weight, radius = (np.concatenate(column) for column in zip(*parts, strict=True))
    share = np.where(edgeB < 0, 1.0, 0.5)
    node, edgeA, edgeB = (a.astype(np.int32) for a in (node, edgeA, edgeB))
    return SiteTable(node, edgeA, edgeB, share, np.where(edgeB < 0, 0.0, share), weight, radius)


def _half_edges(graph: RodGraph, edges: np.ndarray) -> tuple[np.ndarray, ...]:
    """Node, edge, -1, length [m] and radius [m] of both halves of each edge."""
    edge = np.repeat(edges, 2)
    half = 0.5 * graph.rest_length[edge]
    return graph.edges[edges].ravel(), edge, np.full(len(edge), -1), half, graph.radius[edge]


def _rod_nodes(graph: RodGraph, edges: np.ndarray) -> tuple[np.ndarray, ...]:
    """Node, its one or two edges (-1 for none), length [m] and mean radius [m] of a rod's nodes in order."""
    ends, edge = graph.edges[edges].ravel(), np.repeat(edges, 2)
    node, first, count = np.unique(ends, return_index=True, return_counts=True)
    last = len(ends) - 1 - np.unique(ends[::-1], return_index=True)[1]
    order = np.argsort(first)
    node, first, last, two = node[order], edge[first[order]], edge[last[order]], count[order] > 1
    mean = lambda a: np.where(two, 0.5 * (a[first] + a[last]), a[first])  # noqa: E731
    length = mean(graph.rest_length) * np.where(two, 1.0, 0.5)
    return node, first, np.where(two, last, -1), length, mean(graph.radius)


def edge_dofs(model: Model, edges: np.ndarray) -> np.ndarray:
    """Degrees of freedom of the start, the end and the twist of edges, shape (n, 7)."""
    ends, axes = model.edges[edges], np.arange(3)
    return np.concatenate(
        [3 * ends[:, :1] + axes, 3 * ends[:, 1:] + axes, model.twist0 + edges[:, None]], axis=1
    ).astype(np.int32)


class _BoundLine(BoundTerm):
    """What all bound line laws share: sites, stencil, parameters."""

    def __init__(self, term: Term, model: Model, sites: SiteTable) -> None:
        super().__init__(term)
        self.sites = sites
        self.stencils = [sites.dofs(model.edges)]
        self.p = term.values(len(sites.node))

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Find the places of the site's node's rows: forces act on no other (see `Pattern.triple_places`)."""
        sites, *others = stencils
        super().find_slots(pattern, others)
        self.slots.insert(0, pattern.triple_places(sites, range(0, sites.shape[1], 3), rows=3))

    def pack(self, coefficients: np.ndarray) -> Packed:
        """Pack the sites for kernels, with coefficients of shape (n, k); once the slots are known."""
        from rodnet.packed import Packed
        from rodnet.terms.drag.kernels import SITES

        s = self.sites
        return Packed(
            SITES, coefficients, s.node, s.edgeA, s.edgeB, s.cA, s.cB, s.weight, s.radius, self.slots[0]
        )

    def view(self, ev: Evaluation) -> LineSites:
        from rodnet.terms.drag.kernels import see_sites

        s = self.sites
        v, x, tangent = see_sites(s.node, s.edgeA, s.edgeB, s.cA, s.cB, ev.state)
        return LineSites(v, x, tangent, s.radius, s.weight, ev.t, ev.dt)

    def scatter(self, ev, f, dv, dt, cv, F, data, jac) -> float:
        from rodnet.terms.drag.kernels import scatter_line

        s = self.sites
        slots = self.slots[0] if jac else ev.model.no_slots
        return scatter_line(
            f, dv, dt, cv, s.node, s.edgeA, s.edgeB, s.cA, s.cB, ev.T, ev.L, F, slots, data, jac
        )


def start_sites(model: Model, sites: SiteTable) -> LineSites:
    """What a law sees before the first step."""
    s = sites
    tangent = s.cA[:, None] * model.t0[s.edgeA] + s.cB[:, None] * model.t0[s.edgeB]
    return LineSites(np.zeros((len(s.node), 3)), model.x0[s.node], tangent, s.radius, s.weight, 0.0, 1.0)


def difference(force: Callable[[LineSites], np.ndarray], site: LineSites, key: str) -> np.ndarray:
    """Central differences of a law by one of its arguments, all sites at once, shape (n, 3, 3)."""
    value = getattr(site, key)
    # velocities and positions have scales of their own; a law may be singular at v = 0
    scale = 1.0 if key == "tangent" else max(float(np.abs(value).max(initial=0.0)), 1e-6)
    out = np.empty((len(value), 3, 3))
    for k in range(3):
        step = np.zeros(3)
        step[k] = _STEP * scale
        up, down = (force(replace(site, **{key: value + sign * step})) for sign in (1.0, -1.0))
        out[:, :, k] = (up - down) / (2.0 * step[k])
    return out


class _BoundLaw(_BoundLine):
    """A vectorised NumPy law, with or without memory, differenced where no derivative is given."""

    def __init__(self, term: DragModel, model: Model, sites: SiteTable) -> None:
        super().__init__(term, model, sites)
        self.law, self.flow = term, term.flow
        self.past_dt: float | None = None  # dt of a recorded step that is evaluated again
        if term.memory_size:
            memory = np.asarray(term.initial_memory(start_sites(model, sites), self.p), dtype=float)
            self._keep(memory, memory, 1.0)

    # The memory holds that of the accepted state, that before its step, and the step's dt: with the
    # last two a recorded state can be evaluated again.
    def _keep(self, new: np.ndarray, old: np.ndarray, dt: float) -> None:
        self.memory = _packed(new, old, dt)

    @property
    def _m(self) -> np.ndarray:
        """Memory of the last accepted state, shape (n, memory_size)."""
        return self.memory[:, : self.law.memory_size]  # type: ignore[index]

    def rewind(self) -> None:
        if self.memory is not None:
            old = self.memory[:, self.law.memory_size : -1]
            self.past_dt = float(self.memory[0, -1])
            self._keep(old, old, self.past_dt)

    def view(self, ev: Evaluation) -> LineSites:
        site = super().view(ev)
        if self.flow is not None:
            site = replace(site, v=site.v - self.flow.velocity(site.x, site.t))
        return site if self.past_dt is None else replace(site, dt=self.past_dt)

    def _force(self, site: LineSites) -> np.ndarray:
        if self.memory is None:
            return np.asarray(self.law.force(site, self.p), dtype=float)
        return np.asarray(self.law.update(site, self.p, self._m)[0], dtype=float)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        site = self.view(ev)
        w = self.sites.weight[:, None]
        f = self._force(site) * w
        zero = np.zeros((len(f), 3, 3))
        if not jac:
            return self.scatter(ev, f, zero, zero, 0.0, F, data, False)
        known = self.law.jacobian(site, self.p, *(() if self.memory is None else (self._m,)))
        parts = {}
        for key in ("v", "tangent", "x"):
            given = known.get(key)
            slope = difference(self._force, site, key) if given is None else np.asarray(given)
            parts[key] = slope * w[:, :, None]
        if self.flow is not None:  # a site that moves meets another flow
            parts["x"] = parts["x"] - parts["v"] @ self.flow.gradient(site.x, site.t)
        largest = self.scatter(ev, f, ev.cv * parts["v"] + parts["x"], parts["tangent"], 1.0, F, data, True)
        return largest

    def next_memory(self, ev: Evaluation) -> np.ndarray | None:
        if self.memory is None:
            return None
        site, old = self.view(ev), self._m
        return _packed(np.asarray(self.law.update(site, self.p, old)[1], dtype=float), old, site.dt)

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory = memory


def _packed(new: np.ndarray, old: np.ndarray, dt: float) -> np.ndarray:
    return np.concatenate([new, old, np.full((len(new), 1), dt)], axis=1)


class _BoundKernelLaw(_BoundLine):
    """A law with a compiled per-site twin."""

    def __init__(self, term: DragModel, model: Model, sites: SiteTable) -> None:
        from rodnet.terms.drag.site_loop import is_placed, law_address, site_loop

        super().__init__(term, model, sites)
        self.law, self.address, self.loop = type(term).kernel, law_address, site_loop
        self.placed = is_placed(self.law)
        count = len(sites.node)
        columns = [np.broadcast_to(np.ravel(getattr(self.p, name)), count) for name in term.declared()]
        self.vector = np.ascontiguousarray(np.stack(columns, axis=1)) if columns else np.zeros((count, 0))

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        super().find_slots(pattern, stencils)
        self.packed = self.pack(self.vector)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        law = self.address(self.law)
        return self.loop(law, self.placed, ev.t, self.packed.table, ev.state, ev.cv, F, data, jac)
