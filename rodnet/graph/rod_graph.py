"""The immutable graph of rods: nodes, edges, springs, masses, and the selectors over it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.bodies import Body
from rodnet.graph.joint_specs import Joint
from rodnet.graph.joints import Springs
from rodnet.graph.material import Material, Section
from rodnet.graph.selectors import Selector, as_list, match_names, parse


@dataclass(frozen=True)
class Rod:
    """One named rod (or stiff part) of a graph.

    Attributes
    ----------
    name : str
        Its name.
    kind : {"rod", "rigid"}
        ``"rigid"`` marks a stiff part.
    nodes, edges : ndarray
        Node and edge indices from start to end; every edge points from start to end.
    material : Material, tuple of Material or None
        Of the rod, or of each edge; None for stiff parts, whose stiffness is a multiple of the soft rods'.
    section : Section or None
        Section of the first edge.
    length : float
        Natural length [m].
    named : ndarray of int or None
        Places in ``nodes`` that selectors count, where the mesh is finer than the names; None for all.
    """

    name: str
    kind: str
    nodes: np.ndarray
    edges: np.ndarray
    material: Material | tuple[Material, ...] | None
    section: Section | None
    length: float
    root: str = "clamped"
    closed: bool = False
    named: np.ndarray | None = None

    def place(self, k: int) -> int:
        """Place in ``nodes`` of the node that is called ``rod:k``."""
        return k if self.named is None else int(self.named[k])

    @property
    def names(self) -> int:
        """Number of nodes that have names."""
        return len(self.nodes) if self.named is None else len(self.named)

    def name_of(self, place: int) -> str:
        """Return what the node at a place is called; between names, ``rod:3+1``."""
        if self.named is None:
            return f"{self.name}:{place}"
        k = int(np.searchsorted(self.named, place, side="right")) - 1
        beyond = place - int(self.named[k])
        return f"{self.name}:{k}+{beyond}" if beyond else f"{self.name}:{k}"


@dataclass(frozen=True)
class RodGraph:
    """A robot's rods as arrays; made by `StickFigure.build`, never changed afterwards.

    Attributes
    ----------
    x0 : ndarray, shape (N, 3)
        Initial node positions [m].
    edges : ndarray, shape (E, 2)
        Node indices of each edge.
    d1 : ndarray, shape (E, 3)
        Initial first reference directors (the initial twist angles are zero).
    rest_length, radius : ndarray, shape (E,)
        Natural lengths and outer radii [m].
    EA, EI1, EI2, GJ : ndarray, shape (E,)
        Stiffnesses [N], [N m^2]; infinite on rigid bodies.
    node_mass : ndarray, shape (N,)
        Lumped masses [kg], without those of rigid bodies.
    edge_mass : ndarray, shape (E,)
        Masses of the edges [kg], half of each at either node; zero on rigid bodies.
    edge_inertia : ndarray, shape (E,)
        Moments of inertia about the edge's axis [kg m^2].
    half_natural : ndarray, shape (E, 3, 3)
        Natural rotation over half of each edge, where a natural curvature or twist was given.
    rigid : ndarray of bool, shape (E,)
        Edges of stiff parts.
    springs : Springs
        The bend-twist springs.
    rods : dict
        `Rod` by name, in order of definition.
    groups : dict
        Lists of rod names by group name.
    bodies : tuple of Body
        True rigid bodies.
    joints : tuple of Joint
        Joints whose bodies carry frames: hinges, elastic and rigid ones.
    balls : dict
        Names of the nodes with a ball joint, by number.
    """

    x0: np.ndarray
    edges: np.ndarray
    d1: np.ndarray
    rest_length: np.ndarray
    radius: np.ndarray
    EA: np.ndarray
    EI1: np.ndarray
    EI2: np.ndarray
    GJ: np.ndarray
    node_mass: np.ndarray
    edge_mass: np.ndarray
    edge_inertia: np.ndarray
    half_natural: np.ndarray
    rigid: np.ndarray
    springs: Springs
    rods: Mapping[str, Rod]
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    bodies: tuple[Body, ...] = ()
    joints: tuple[Joint, ...] = ()
    balls: Mapping[int, str] = field(default_factory=dict)
    # the StickFigure it was built from, kept so that a rod's material can be changed by rebuilding
    figure: Any = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in (
            "x0",
            "edges",
            "d1",
            "rest_length",
            "radius",
            "EA",
            "EI1",
            "EI2",
            "GJ",
            "node_mass",
            "edge_mass",
            "edge_inertia",
            "half_natural",
            "rigid",
        ):
            getattr(self, name).flags.writeable = False

    @cached_property
    def drawn(self) -> RodGraph:
        """The graph as its figure is drawn, whatever its pose; itself without a figure."""
        return self if self.figure is None else self.figure.build()

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.x0)

    @property
    def edge_count(self) -> int:
        """Number of edges."""
        return len(self.edges)

    @property
    def dof_count(self) -> int:
        """Number of degrees of freedom, 3 N + E (paper, section Kinematics)."""
        return 3 * self.node_count + self.edge_count

    @property
    def compliance(self) -> np.ndarray:
        """Compliances of half of each edge about its m1, m2, t [rad/(N m)], shape (E, 3)."""
        return 0.5 * self.rest_length[:, None] / np.stack([self.EI2, self.EI1, self.GJ], axis=1)

    @property
    def size(self) -> float:
        """Diagonal of the bounding box of the initial shape [m]."""
        return float(np.linalg.norm(np.ptp(self.x0, axis=0)))

    def __repr__(self) -> str:
        counts = f"{self.node_count} nodes, {self.edge_count} edges, {len(self.springs)} springs"
        return f"RodGraph({len(self.rods)} rods, {counts})"

    # -- selectors ------------------------------------------------------------------------
    def _rods(self, selector: Selector) -> list[Rod]:
        return [self.rods[name] for name in match_names(selector, list(self.rods), self.groups)]

    def rod_names(self, selectors: str | Iterable[str]) -> list[str]:
        """Return the names of the rods that the selectors match, in order of definition."""
        hits = {rod.name for text in as_list(selectors) for rod in self._rods(parse(text))}
        return [name for name in self.rods if name in hits]

    def nodes(self, selectors: str | Iterable[str]) -> np.ndarray:
        """Node indices named by the selectors, without repetition, in order of first appearance.

        Raises
        ------
        GraphError
            For an unknown rod, a node beyond the rod's end, or a station between nodes.
        """
        found: list[np.ndarray] = []
        for text in as_list(selectors):
            selector = parse(text)
            found += [self._rod_nodes(rod, selector) for rod in self._rods(selector)]
        return _without_repetition(found)

    def drawn_nodes(self, selectors: str | Iterable[str]) -> np.ndarray:
        """Of the nodes that the selectors name those that were drawn: a finer mesh has others between them.

        Raises
        ------
        GraphError
            As `nodes`.
        """
        nodes = self.nodes(selectors)
        drawn = [rod.nodes if rod.named is None else rod.nodes[rod.named] for rod in self.rods.values()]
        return nodes[np.isin(nodes, np.concatenate(drawn))]

    def parts(self, edges: np.ndarray) -> np.ndarray:
        """Number of the given edges that make up, together with each, one that was drawn.

        Parameters
        ----------
        edges : ndarray of int, shape (n,)
            Edges of this mesh, which may be finer than the drawing.

        Returns
        -------
        ndarray of int, shape (n,)
        """
        drawn = np.arange(self.edge_count)
        for rod in self.rods.values():
            if rod.named is not None:
                first = np.searchsorted(rod.named, np.arange(len(rod.edges)), side="right") - 1
                drawn[rod.edges] = rod.edges[rod.named[first]]
        return np.bincount(drawn[edges], minlength=self.edge_count)[drawn[edges]]

    def _rod_nodes(self, rod: Rod, selector: Selector) -> np.ndarray:
        if selector.end is not None:
            return rod.nodes[:1] if selector.end == "start" else rod.nodes[-1:]
        if selector.node is not None:
            for k in (selector.node, selector.node2):
                if k is not None and k >= rod.names:
                    raise GraphError(
                        f"selector '{selector.text}': rod '{rod.name}' has nodes 0 to {rod.names - 1}"
                    )
            last = selector.node if selector.node2 is None else selector.node2
            return rod.nodes[rod.place(selector.node) : rod.place(last) + 1]
        if selector.station is not None:
            edge, fraction = self._station(rod, selector)
            k = int(np.flatnonzero(rod.edges == edge)[0]) + round(fraction)
            if min(fraction, 1.0 - fraction) > 1e-6:
                raise GraphError(
                    f"selector '{selector.text}' lies between nodes of rod '{rod.name}'; "
                    f"the nearest is '{rod.name}:{k}'"
                )
            return rod.nodes[k : k + 1]
        return rod.nodes

    def _station(self, rod: Rod, selector: Selector) -> tuple[int, float]:
        assert selector.station is not None
        s = selector.station * rod.length if selector.relative else selector.station
        if not -1e-9 * rod.length <= s <= (1 + 1e-9) * rod.length:
            raise GraphError(f"selector '{selector.text}': rod '{rod.name}' is {rod.length:g} m long")
        ends = np.concatenate([[0.0], np.cumsum(self.rest_length[rod.edges])])
        k = min(max(int(np.searchsorted(ends, s, side="right")) - 1, 0), len(rod.edges) - 1)
        return int(rod.edges[k]), float(np.clip((s - ends[k]) / self.rest_length[rod.edges[k]], 0.0, 1.0))

    def node(self, selector: str) -> int:
        """Return the one node that the selector names (`GraphError` if it names several)."""
        found = self.nodes(selector)
        if len(found) != 1:
            raise GraphError(
                f"selector '{selector}' names {len(found)} nodes where one is needed; write e.g. 'rod:3'"
            )
        return int(found[0])

    def edge_indices(self, selectors: str | Iterable[str]) -> np.ndarray:
        """Edge indices named by the selectors: whole rods, ``rod:3-4``, or the edge at a rod's end."""
        found: list[np.ndarray] = []
        for text in as_list(selectors):
            selector = parse(text)
            for rod in self._rods(selector):
                if selector.node is not None:
                    last = selector.node2
                    if last is None or last != selector.node + 1 or last >= rod.names:
                        raise GraphError(
                            f"selector '{selector.text}' names no edge of rod '{rod.name}'; write '{rod.name}:k-k+1' "
                            f"with k from 0 to {rod.names - 2}"
                        )
                    found.append(rod.edges[rod.place(selector.node) : rod.place(last)])
                elif selector.end is not None:
                    found.append(rod.edges[:1] if selector.end == "start" else rod.edges[-1:])
                elif selector.station is not None:
                    found.append(np.array([self._station(rod, selector)[0]]))
                else:
                    found.append(rod.edges)
        return _without_repetition(found)

    def station(self, selector: str) -> tuple[int, float]:
        """Return the edge and the fraction along it of a node or station selector."""
        parsed = parse(selector)
        rods = self._rods(parsed)
        if len(rods) != 1:
            raise GraphError(f"selector '{selector}' matches {len(rods)} rods where one is needed")
        rod = rods[0]
        if parsed.station is not None:
            return self._station(rod, parsed)
        node = self.node(selector)
        k = int(np.flatnonzero(rod.nodes == node)[0])
        return (int(rod.edges[k]), 0.0) if k < len(rod.edges) else (int(rod.edges[-1]), 1.0)

    def spring_indices(self, selectors: str | Iterable[str]) -> np.ndarray:
        """Springs whose two edges both belong to what the selectors name."""
        mask = np.zeros(self.edge_count, dtype=bool)
        mask[self.edge_indices(selectors)] = True
        return np.flatnonzero(mask[self.springs.edge1] & mask[self.springs.edge2])

    # -- names for people -----------------------------------------------------------------
    def node_name(self, node: int) -> str:
        """Return ``rod:k`` for a node, by the first rod that it belongs to."""
        for rod in self.rods.values():
            hit = np.flatnonzero(rod.nodes == node)
            if len(hit):
                return rod.name_of(int(hit[0]))
        return f"node {node}"

    def edge_name(self, edge: int) -> str:
        """Return ``rod:k-k+1`` for an edge."""
        for rod in self.rods.values():
            hit = np.flatnonzero(rod.edges == edge)
            if len(hit):
                return (
                    f"{rod.name_of(int(hit[0]))}-{hit[0] + 1}"
                    if rod.named is None
                    else rod.name_of(int(hit[0]))
                )
        return f"edge {edge}"

    def dof_name(self, dof: int) -> str:
        """Return the name of a degree of freedom, e.g. ``x of tail0:3`` or ``twist of head:0-1``."""
        if dof < 3 * self.node_count:
            return f"{'xyz'[dof % 3]} of {self.node_name(dof // 3)}"
        return f"twist of {self.edge_name(dof - 3 * self.node_count)}"

    def with_positions(self, x0: np.ndarray) -> RodGraph:
        """Return the same graph in another initial position; the natural shape stays.

        The directors are carried along by parallel transport; what turns at joints first turns there as one.

        Raises
        ------
        GraphError
            For positions that deform a rigid body or tilt the axis of a hinge.
        """
        from rodnet.graph.poses import carried_directors

        x0 = np.array(x0, dtype=float)
        if x0.shape != self.x0.shape or not np.all(np.isfinite(x0)):
            raise GraphError(f"positions must be finite and of shape {self.x0.shape}, got {x0.shape}")
        length = np.linalg.norm(x0[self.edges[:, 1]] - x0[self.edges[:, 0]], axis=1)
        if length.min() <= 1e-9 * length.max():
            raise GraphError(
                f"positions leave no length to the edge {self.edge_name(int(np.argmin(length)))}"
            )
        d1, bodies = carried_directors(self, x0), []
        for body in self.bodies:
            moved, R = body.moved(self.x0, x0, self.edges)
            d1[body.edges] = self.d1[body.edges] @ R.T
            bodies.append(moved)
        return replace(self, x0=x0, bodies=tuple(bodies)).with_directors(d1)

    def twisted(self, angles: np.ndarray) -> RodGraph:
        """Return the same graph with its directors turned about the edges by angles [rad], shape (E,)."""
        from rodnet.kinematics.frames import rotation, unit

        along = unit(self.x0[self.edges[:, 1]] - self.x0[self.edges[:, 0]])
        turns = rotation(np.asarray(angles, dtype=float)[:, None] * along)
        return self.with_directors(np.einsum("eij,ej->ei", turns, self.d1))

    def with_directors(self, d1: np.ndarray) -> RodGraph:
        """Return the same graph with other first directors, shape (E, 3), with which its joints turn."""
        from rodnet.kinematics.frames import material_frames, unit

        tangents = unit(self.x0[self.edges[:, 1]] - self.x0[self.edges[:, 0]])
        frames = material_frames(tangents, d1, np.zeros(len(d1)))
        return replace(self, d1=d1, joints=tuple(joint.posed(frames) for joint in self.joints))


def _without_repetition(parts: list[np.ndarray]) -> np.ndarray:
    """All indices in order of first appearance."""
    indices = np.concatenate([np.zeros(0, dtype=np.int64), *parts])
    return indices[np.sort(np.unique(indices, return_index=True)[1])]
