"""From a stick figure's specifications to the arrays of a `RodGraph`."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from rodnet.errors import GraphError
from rodnet.graph.joints import Springs, make_springs, natural_rotation, pair_edges
from rodnet.graph.rod_graph import Rod, RodGraph
from rodnet.kinematics.frames import any_normal, carry_director, material_frames, transport, unit

if TYPE_CHECKING:
    from rodnet.graph.stick_figure import RodSpec, StickFigure


def build_graph(fig: StickFigure) -> RodGraph:
    """Turn a `StickFigure` into a `RodGraph` (see `StickFigure.build`)."""
    x0 = np.asarray(fig.points, dtype=float)
    specs = list(fig.specs.values())
    edges = np.array([pair for spec in specs for pair in _edge_pairs(spec)], dtype=np.int64)
    first = np.cumsum([0] + [spec.edge_count for spec in specs])
    owner = np.repeat(np.arange(len(specs)), [spec.edge_count for spec in specs])
    vectors = x0[edges[:, 1]] - x0[edges[:, 0]]
    length = np.linalg.norm(vectors, axis=1)
    _check_geometry(specs, x0, edges, owner, length)
    tangents = unit(vectors)
    d1 = _directors(specs, first, edges, tangents)
    props = _edge_properties(specs, first, length)
    compliance = 0.5 * length[:, None] / np.stack([props["EI2"], props["EI1"], props["GJ"]], axis=1)
    half_natural = np.broadcast_to(np.eye(3), (len(edges), 3, 3))
    for k, spec in enumerate(specs):
        if isinstance(spec.natural, dict):
            half_natural = half_natural.copy() if not half_natural.flags.writeable else half_natural
            for e in range(first[k], first[k + 1]):
                half_natural[e] = _natural(spec, e - first[k], 0.5 * length[e])
    springs = _springs(fig, specs, first, owner, edges, length, tangents, d1, compliance, props, half_natural)
    mass = np.zeros(len(x0))
    np.add.at(mass, edges, 0.5 * props.pop("mass")[:, None])
    rods = {
        spec.name: Rod(
            spec.name,
            spec.kind,
            np.array(spec.nodes + spec.nodes[:1] if spec.closed else spec.nodes),
            np.arange(first[k], first[k + 1]),
            spec.material,
            spec.sections[0] if spec.sections else None,
            float(length[first[k] : first[k + 1]].sum()),
            spec.root,
            spec.closed,
        )
        for k, spec in enumerate(specs)
    }
    return RodGraph(
        x0=x0,
        edges=edges,
        d1=d1,
        rest_length=length,
        node_mass=mass,
        edge_inertia=props.pop("inertia"),
        half_natural=half_natural,
        rigid=np.array([specs[k].kind == "rigid" for k in owner]),
        springs=springs,
        rods=rods,
        groups=dict(fig.group_names),
        figure=fig,
        **props,
    )


def _edge_pairs(spec: RodSpec) -> list[tuple[int, int]]:
    ring = spec.nodes + spec.nodes[:1] if spec.closed else spec.nodes
    return list(pairwise(ring))


def _check_geometry(specs, x0, edges, owner, length) -> None:
    if not np.all(np.isfinite(x0)):
        raise GraphError("a node position is not finite")
    short = np.flatnonzero(length < 1e-9 * length.max())
    if len(short):
        raise GraphError(
            f"rod '{specs[owner[short[0]]].name}' has an edge of zero length; move or merge its points"
        )
    names: dict[int, str] = {}
    for spec in specs:
        for k, node in enumerate(spec.nodes):
            names.setdefault(node, f"{spec.name}:{k}")
    used = np.array(sorted(names))
    close = cKDTree(x0[used]).query_pairs(1e-6 * float(np.median(length)))
    for a, b in close:
        first, second = names[used[a]], names[used[b]]
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
    framed_at: dict[int, int] = {}
    pending = list(range(len(specs)))
    while pending:
        k = next((k for k in pending if {specs[k].nodes[0], specs[k].nodes[-1]} & framed_at.keys()), None)
        if k is None:
            k = next((k for k in pending if framed_at.keys() & set(specs[k].nodes)), pending[0])
        pending.remove(k)
        spec, span = specs[k], list(range(first[k], first[k + 1]))
        forward = spec.director is not None or spec.nodes[-1] not in framed_at or spec.nodes[0] in framed_at
        order = span if forward else span[::-1]
        node = spec.nodes[0] if forward else spec.nodes[-1]
        director = any_normal(tangents[order[0]])
        if spec.director is not None:
            normal = spec.director - spec.director @ tangents[order[0]] * tangents[order[0]]
            if not np.linalg.norm(normal) > 1e-6 * np.linalg.norm(spec.director):
                raise GraphError(
                    f"rod '{spec.name}': director {spec.director} is parallel to the rod's first edge"
                )
            director = unit(normal)
        elif node in framed_at:
            e = framed_at[node]
            inward = tangents[e] if edges[e, 1] == node else -tangents[e]
            outward = tangents[order[0]] if forward else -tangents[order[0]]
            carried = transport(d1[e], inward, outward)
            director = carried if np.all(np.isfinite(carried)) else director
        along = np.array(order)
        d1[along] = carry_director(tangents[along], director)
        if not np.all(np.isfinite(d1[along])):
            raise GraphError(f"rod '{spec.name}' folds back on itself; two of its edges are antiparallel")
        for e, pair in zip(order, edges[along].tolist(), strict=True):
            for n in pair:
                framed_at.setdefault(n, e)
    return d1


def _edge_properties(specs, first, length) -> dict[str, np.ndarray]:
    names = ("EA", "EI1", "EI2", "GJ", "radius", "mass", "inertia")
    props = {name: np.zeros(len(length)) for name in names}
    for k, spec in enumerate(specs):
        if spec.kind == "rigid":
            continue
        for e, section in zip(range(first[k], first[k + 1]), spec.sections, strict=True):
            m = spec.material
            props["EA"][e], props["GJ"][e] = m.E * section.area, m.G * section.J
            props["EI1"][e], props["EI2"][e] = m.E * section.I1, m.E * section.I2
            props["radius"][e] = section.radius
            props["mass"][e] = m.rho * section.area * length[e]
            props["inertia"][e] = m.rho * section.polar * length[e]
    if not props["EA"].any():
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
        radius = spec.radius or props["radius"][top]
        total = length[span].sum()
        per_length = spec.mass / total if spec.mass else props["mass"][top] / length[top]
        props["radius"][span] = radius
        props["mass"][span] = per_length * length[span]
        props["inertia"][span] = 0.5 * per_length * length[span] * radius**2
    return props


def _soft(specs, first, count) -> np.ndarray:
    mask = np.zeros(count, dtype=bool)
    for k, spec in enumerate(specs):
        mask[first[k] : first[k + 1]] = spec.kind == "rod"
    return mask


def _springs(
    fig, specs, first, owner, edges, length, tangents, d1, compliance, props, half_natural
) -> Springs:
    incident: dict[int, list[int]] = {}
    for e, (i, j) in enumerate(edges.tolist()):
        incident.setdefault(i, []).append(e)
        incident.setdefault(j, []).append(e)
    start_of, owner_of = edges[:, 0].tolist(), owner.tolist()
    hubs = {node: int(first[list(fig.specs).index(name)]) + k for node, (name, k) in fig.hubs.items()}
    mean = (props["EI1"] + props["EI2"]) / length
    pairs: list[tuple[int, int, int, float]] = []
    natural: dict[int, np.ndarray] = {}
    overrides: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    rigid_root = {
        (spec.nodes[0], int(first[k])): _root_factor(specs)
        for k, spec in enumerate(specs)
        if spec.kind == "rod" and spec.root == "rigid"
    }
    for node, around in incident.items():
        # the order along a rod, so that a motor's rotor is the later edge
        around = sorted(around, key=lambda e: (start_of[e] == node, owner_of[e], e))
        for pair in pair_edges(node, around, hubs.get(node), mean):
            index, (a, b) = len(pairs), pair[:2]
            pairs.append(pair)
            spec = specs[owner[a]]
            if owner[a] == owner[b] and spec.kind == "rod" and spec.natural != "initial":
                natural[index] = _natural(spec, a - first[owner[a]], 0.5 * (length[a] + length[b]))
            factors = [rigid_root.get((node, e), 1.0) for e in (a, b)]
            if factors != [1.0, 1.0]:
                overrides[index] = (compliance[a] / factors[0], compliance[b] / factors[1])
    frames = material_frames(tangents, d1, np.zeros(len(edges)))
    return make_springs(pairs, edges, length, frames, compliance, half_natural, natural, overrides)


def _root_factor(specs) -> float:
    """How much stiffer than the rod its half edge at a rigid root is: as stiff as the stiff parts."""
    rigid = [spec.stiffening[1] for spec in specs if spec.kind == "rigid"]
    return max(rigid, default=1e4)


def _natural(spec: RodSpec, k: int, ds: float) -> np.ndarray:
    """Natural rotation (3, 3) over the length ds [m] around the node after the rod's k-th edge."""
    if isinstance(spec.natural, str):  # "straight"
        return np.eye(3)
    count = max(spec.edge_count - (0 if spec.closed else 1), 1)
    try:
        curvature = np.broadcast_to(spec.natural["curvature"], (count, 2))[min(k, count - 1)]
        twist = np.broadcast_to(spec.natural["twist"], (count,))[min(k, count - 1)]
    except ValueError:
        raise GraphError(
            f"rod '{spec.name}': natural_curvature needs shape (2,) or ({count}, 2), natural_twist () or ({count},)"
        ) from None
    turn = float(np.hypot(*curvature)) * ds
    if turn > 0.8 * np.pi or abs(twist * ds) > 0.8 * np.pi:
        raise GraphError(
            f"rod '{spec.name}': its natural shape turns by {max(turn, abs(twist * ds)):.3g} rad from one edge to the "
            "next; use more edges"
        )
    bend = curvature * ds * (np.tan(0.5 * turn) / (0.5 * turn) if turn > 1e-12 else 1.0)
    return natural_rotation(np.array([[*bend * np.cos(0.5 * twist * ds), twist * ds]]))[0]
