"""From a stick figure's specifications to the arrays of a `RodGraph`."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from rodnet.errors import GraphError
from rodnet.graph.bodies import make_bodies
from rodnet.graph.joint_specs import Joint, attach, bearings, bodies_of, root_factor
from rodnet.graph.joints import Springs, make_springs, natural_rotation, pair_all_edges
from rodnet.graph.rod_graph import Rod, RodGraph
from rodnet.kinematics.frames import any_normal, carry_director, material_frames, transport, unit
from rodnet.names import Named

if TYPE_CHECKING:
    from rodnet.graph.rod_spec import RodSpec
    from rodnet.graph.stick_figure import StickFigure


def build_graph(fig: StickFigure) -> RodGraph:
    """Turn a `StickFigure` into a `RodGraph` (see `StickFigure.build`)."""
    x0 = fig.points
    specs = list(fig.specs.values())
    rings = [np.array(spec.nodes + spec.nodes[:1] if spec.closed else spec.nodes) for spec in specs]
    edges = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]).astype(np.int64)
    first = np.cumsum([0] + [spec.edge_count for spec in specs])
    owner = np.repeat(np.arange(len(specs)), [spec.edge_count for spec in specs])
    vectors = x0[edges[:, 1]] - x0[edges[:, 0]]
    length = np.linalg.norm(vectors, axis=1)
    _check_geometry(specs, x0, edges, owner, length)
    length = length * np.array([specs[k].stretched for k in owner])
    tangents = unit(vectors)
    d1 = _directors(specs, first, edges, tangents)
    fused = {part for body in fig.bodies.values() for part in body.parts}
    props = _edge_properties(specs, first, length, fused)
    bodies = make_bodies(fig, first, x0, edges, props)
    body_of = np.full(len(edges), -1)
    for k, body in enumerate(bodies):
        body_of[body.edges] = k
    compliance = 0.5 * length[:, None] / np.stack([props["EI2"], props["EI1"], props["GJ"]], axis=1)
    half_natural = np.broadcast_to(np.eye(3), (len(edges), 3, 3))
    for k, spec in enumerate(specs):
        if isinstance(spec.natural, dict):
            half_natural = half_natural.copy() if not half_natural.flags.writeable else half_natural
            span = np.arange(first[k], first[k + 1])
            half_natural[span] = _natural(spec, span - first[k], 0.5 * length[span])
    springs, joints = _springs(
        fig, specs, first, owner, body_of, edges, length, tangents, d1, compliance, props, half_natural
    )
    mass = np.zeros(len(x0))
    edge_mass = props.pop("mass")
    np.add.at(mass, edges, 0.5 * edge_mass[:, None])
    rods = Named(
        {
            spec.name: Rod(
                spec.name,
                spec.kind,
                rings[k],
                np.arange(first[k], first[k + 1]),
                spec.material,
                spec.sections[0] if spec.sections else None,
                float(length[first[k] : first[k + 1]].sum()),
                spec.root,
                spec.closed,
            )
            for k, spec in enumerate(specs)
        },
        what="rod",
    )
    return RodGraph(
        x0=x0,
        edges=edges,
        d1=d1,
        rest_length=length,
        node_mass=mass,
        edge_mass=edge_mass,
        edge_inertia=props.pop("inertia"),
        half_natural=half_natural,
        rigid=np.array([specs[k].kind == "rigid" for k in owner]),
        springs=springs,
        rods=rods,
        groups=dict(fig.group_names),
        bodies=bodies,
        joints=joints,
        balls={node: spec.at for node, spec in fig.joints.items() if spec.kind == "ball"},
        figure=fig,
        **props,
    )


def _check_geometry(specs, x0, edges, owner, length) -> None:
    if not np.all(np.isfinite(x0)):
        raise GraphError("a node position is not finite")
    short = np.flatnonzero(length < 1e-9 * length.max())
    if len(short):
        raise GraphError(
            f"rod '{specs[owner[short[0]]].name}' has an edge of zero length; move or merge its points"
        )
    used = np.unique(edges)
    close = cKDTree(x0[used]).query_pairs(1e-6 * float(np.median(length)))
    for pair in close:
        first, second = (
            next(f"{spec.name}:{spec.nodes.index(used[i])}" for spec in specs if used[i] in spec.nodes)
            for i in pair
        )
        raise GraphError(
            f"nodes '{first}' and '{second}' coincide but are not joined; to join them pass the reference "
            f"'{first}' instead of its coordinates, otherwise move one"
        )
    low, high = edges.min(axis=1), edges.max(axis=1)
    order = np.lexsort((high, low))
    again = np.flatnonzero((np.diff(low[order]) == 0) & (np.diff(high[order]) == 0))
    if len(again):
        a, b = sorted(order[again[0] : again[0] + 2])
        raise GraphError(
            f"rods '{specs[owner[a]].name}' and '{specs[owner[b]].name}' both have an edge between the same two nodes"
        )


def _directors(specs, first, edges, tangents) -> np.ndarray:
    """First directors: given, or carried outward from a rod that is already framed, without twist."""
    d1 = np.full_like(tangents, np.nan)
    queue = _Queue(specs)
    framed_at = np.full(edges.max() + 1, -1)  # the first framed edge at each node
    while (k := queue.next()) is not None:
        spec, order = specs[k], np.arange(first[k], first[k + 1])
        start, end = spec.nodes[0], spec.nodes[-1]
        forward = spec.director is not None or framed_at[end] < 0 or framed_at[start] >= 0
        if not forward:
            order = order[::-1]
        node = start if forward else end
        director = any_normal(tangents[order[0]])
        if spec.director is not None:
            normal = spec.director - spec.director @ tangents[order[0]] * tangents[order[0]]
            if not np.linalg.norm(normal) > 1e-6 * np.linalg.norm(spec.director):
                raise GraphError(
                    f"rod '{spec.name}': director {spec.director} is parallel to the rod's first edge"
                )
            director = unit(normal)
        elif framed_at[node] >= 0:
            e = framed_at[node]
            inward = tangents[e] if edges[e, 1] == node else -tangents[e]
            outward = tangents[order[0]] if forward else -tangents[order[0]]
            carried = transport(d1[e], inward, outward)
            director = carried if np.all(np.isfinite(carried)) else director
        d1[order] = carry_director(tangents[order], director)
        if not np.all(np.isfinite(d1[order])):
            raise GraphError(f"rod '{spec.name}' folds back on itself; two of its edges are antiparallel")
        # a node belongs to the first edge that comes to it, so the last to be assigned is the first
        ends, edge = edges[order].ravel()[::-1], np.repeat(order, 2)[::-1]
        new = framed_at[ends] < 0
        framed_at[ends[new]] = edge[new]
        queue.reach(ends[new])
    return d1


class _Queue:
    """Rods in the order in which they are framed: outward from those that are.

    First comes the first rod that ends at a framed node, else the first that has one, else the first.
    """

    def __init__(self, specs: list[RodSpec]) -> None:
        self.pending = [True] * len(specs)
        self.ending: list[int] = []
        self.touching: list[int] = []
        self.first = 0
        nodes = np.concatenate([np.array(spec.nodes) for spec in specs])
        owner = np.repeat(np.arange(len(specs)), [len(spec.nodes) for spec in specs])
        self.shared = np.bincount(nodes) > 1
        self.rods_at: dict[int, list[tuple[int, bool]]] = {}
        common = self.shared[nodes]
        for node, k in zip(nodes[common].tolist(), owner[common].tolist(), strict=True):
            is_end = node in (specs[k].nodes[0], specs[k].nodes[-1])
            self.rods_at.setdefault(node, []).append((k, is_end))

    def reach(self, nodes: np.ndarray) -> None:
        """Note that nodes are framed."""
        for node in nodes[self.shared[nodes]].tolist():
            for k, is_end in self.rods_at[node]:
                heapq.heappush(self.ending if is_end else self.touching, k)

    def next(self) -> int | None:
        """Take the next rod; None at the end."""
        for heap in (self.ending, self.touching):
            while heap:
                k = heapq.heappop(heap)
                if self.pending[k]:
                    self.pending[k] = False
                    return k
        while self.first < len(self.pending) and not self.pending[self.first]:
            self.first += 1
        if self.first == len(self.pending):
            return None
        self.pending[self.first] = False
        return self.first


def _edge_properties(specs, first, length, fused) -> dict[str, np.ndarray]:
    """Stiffnesses, radii and masses of all edges; parts that are ``fused`` to rigid bodies do not yield."""
    names = ("EA", "EI1", "EI2", "GJ", "radius", "mass", "inertia")
    props = {name: np.zeros(len(length)) for name in names}
    for k, spec in enumerate(specs):
        if spec.kind == "rigid":
            continue
        span = slice(first[k], first[k + 1])
        E, G, rho = (spec.property(name) for name in ("E", "G", "rho"))
        kinds = list({id(section): section for section in spec.sections}.values())
        which = {id(section): i for i, section in enumerate(kinds)}
        kind = np.array([which[id(section)] for section in spec.sections])
        of = lambda name: np.array([getattr(section, name) for section in kinds])[kind]  # noqa: B023, E731
        props["EA"][span], props["GJ"][span] = E * of("area"), G * of("J")
        props["EI1"][span], props["EI2"][span] = E * of("I1"), E * of("I2")
        props["radius"][span] = of("radius")
        props["mass"][span] = rho * of("area") * length[span]
        props["inertia"][span] = rho * of("polar") * length[span]
    if not props["EA"].any() and any(spec.name not in fused for spec in specs):
        raise GraphError(
            "a figure of stiff parts alone has no stiffness to refer to; add at least one soft rod"
        )
    top = int(np.argmax(props["EI1"] + props["EI2"]))
    bend = max(props["EI1"][top], props["EI2"][top])
    for k, spec in enumerate(specs):
        if spec.kind != "rigid":
            continue
        span = slice(first[k], first[k + 1])
        axial, angular = spec.stiffening
        props["EA"][span] = axial * props["EA"].max(where=_soft(specs, first, len(length)), initial=0.0)
        props["EI1"][span] = props["EI2"][span] = angular * bend
        props["GJ"][span] = angular * props["GJ"][top]
        total = length[span].sum()
        radius = spec.radius or (props["radius"][top] if props["EA"].any() else 0.05 * total)
        per_length = spec.mass / total if spec.mass else props["mass"][top] / length[top]
        props["radius"][span] = radius
        props["mass"][span] = per_length * length[span]
        props["inertia"][span] = 0.5 * per_length * length[span] * radius**2
        if spec.name in fused:
            for key in ("EA", "EI1", "EI2", "GJ"):
                props[key][span] = np.inf
    return props


def _soft(specs, first, count) -> np.ndarray:
    mask = np.zeros(count, dtype=bool)
    for k, spec in enumerate(specs):
        mask[first[k] : first[k + 1]] = spec.kind == "rod"
    return mask


def _springs(
    fig, specs, first, owner, body_of, edges, length, tangents, d1, compliance, props, half_natural
) -> tuple[Springs, tuple[Joint, ...]]:
    numbers = {name: k for k, name in enumerate(fig.specs)}
    number = lambda edge: int(first[numbers[edge[0]]]) + edge[1]  # noqa: E731
    hubs = {node: number(edge) for node, edge in fig.hubs.items()}
    bodies = {
        node: bodies_of(spec, _around(edges, node), [number(edge) for edge in spec.of])
        for node, spec in fig.joints.items()
    }
    welded = {node: b if fig.joints[node].kind == "ball" else [] for node, b in bodies.items()}
    pairs = pair_all_edges(edges, hubs, (props["EI1"] + props["EI2"]) / length, body_of, welded)
    rigid_root = np.full(len(edges), -1)  # the node where an edge begins a rod with a rigid root
    for k, spec in enumerate(specs):
        if spec.kind == "rod" and spec.root == "rigid":
            rigid_root[first[k]] = spec.nodes[0]
    factor = root_factor(specs) if np.any(rigid_root >= 0) else 1.0
    softness = tuple(
        compliance[e] / np.where(rigid_root[e] == pairs.node, factor, 1.0)[:, None]
        for e in (pairs.edge1, pairs.edge2)
    )
    natural = _natural_shapes(specs, first, owner, length, pairs)
    frames = material_frames(tangents, d1, np.zeros(len(edges)))
    springs = make_springs(pairs, edges, length, frames, softness, half_natural, natural)
    joints = []
    for node, spec in fig.joints.items():
        if spec.kind == "ball":
            continue  # nothing to carry: no spring joins its bodies
        local = bearings(compliance, props["EI1"], _soft(specs, first, len(edges)), length)
        local = local / np.where(rigid_root == node, factor, 1.0)[:, None]
        joints.append(attach(spec, node, bodies[node], edges, length, frames, local, half_natural))
    return springs, tuple(joints)


def _around(edges: np.ndarray, node: int) -> list[int]:
    """Edges at a node: those that end there first, as along a rod."""
    return [int(e) for column in (1, 0) for e in np.flatnonzero(edges[:, column] == node)]


def _natural_shapes(specs, first, owner, length, pairs) -> tuple[np.ndarray, np.ndarray] | None:
    """Springs inside rods whose natural shape is not the one that is drawn, and their natural rotations."""
    given = np.array([spec.kind == "rod" and spec.natural != "initial" for spec in specs])
    rod = owner[pairs.edge1]
    index = np.flatnonzero((rod == owner[pairs.edge2]) & given[rod])
    if not len(index):
        return None
    index = index[np.argsort(rod[index], kind="stable")]
    shapes = []
    for mine in np.split(index, np.flatnonzero(np.diff(rod[index])) + 1):
        k, a, b = rod[mine[0]], pairs.edge1[mine], pairs.edge2[mine]
        shapes.append(_natural(specs[k], a - first[k], 0.5 * (length[a] + length[b])))
    return index, np.concatenate(shapes)


def _natural(spec: RodSpec, k: np.ndarray, ds: np.ndarray) -> np.ndarray:
    """Natural rotations (n, 3, 3) over the lengths ds [m] around the nodes after a rod's k-th edges."""
    if isinstance(spec.natural, str):  # "straight"
        return np.broadcast_to(np.eye(3), (len(k), 3, 3))
    count = max(spec.edge_count - (0 if spec.closed else 1), 1)
    curvature = np.broadcast_to(spec.natural["curvature"], (count, 2))[np.minimum(k, count - 1)]
    twist = np.broadcast_to(spec.natural["twist"], (count,))[np.minimum(k, count - 1)] * ds
    turn = np.hypot(*curvature.T) * ds
    largest = np.maximum(turn, np.abs(twist)).max(initial=0.0)
    if largest > 0.8 * np.pi:
        raise GraphError(
            f"rod '{spec.name}': its natural shape turns by {largest:.3g} rad from one edge to the "
            "next; use more edges"
        )
    half = np.where(turn > 1e-12, 0.5 * turn, 1.0)
    bend = ds * np.where(turn > 1e-12, np.tan(half) / half, 1.0) * np.cos(0.5 * twist)
    return natural_rotation(np.column_stack([bend[:, None] * curvature, twist]))
