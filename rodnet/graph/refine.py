"""A robot with a finer mesh: every edge in two, names of nodes and edges as before."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.kinematics.frames import unit
from rodnet.names import Named

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.graph.rod_spec import RodSpec
    from rodnet.graph.stick_figure import StickFigure

CORNER = 0.6  # [rad] turning angle at a node from which on it is a corner, not a part of a curve


def halved(graph: RodGraph, whole: np.ndarray) -> tuple[RodGraph, np.ndarray]:
    """Return a graph with two edges for each one, new nodes on a smooth line through the old ones.

    Selectors go on naming the same places: ``"rod:3"`` is the node where it was, ``"rod:3-4"`` the edges between.

    Parameters
    ----------
    graph : RodGraph
        The graph.
    whole : ndarray of bool, shape (E,)
        Edges that stay whole: stiff parts, and what is held with its direction.

    Returns
    -------
    graph : RodGraph
        The finer one.
    parents : ndarray of int, shape (N, 2)
        The nodes between which each node lies; twice itself where it was one before.
    """
    figure: StickFigure = graph.figure
    if figure is None:
        raise GraphError("a graph without its stick figure cannot be refined")
    finer, x = figure._kept(), figure.points
    parents = [(k, k) for k in range(len(x))]
    corners = [_middles(graph, x, whole), _middles(graph, graph.x0, whole)]
    numbered: dict[int, int] = {}
    for edge in np.flatnonzero(~whole):
        numbered[int(edge)] = len(parents)
        i, j = graph.edges[edge]
        parents.append((int(i), int(j)))
        finer._coordinates.extend(corners[0][edge].tolist())
    named: dict[str, np.ndarray] = {}
    for name, spec in figure.specs.items():
        rod = graph.rods[name]
        finer.specs[name], named[name] = _spec(spec, rod.edges.tolist(), numbered)
    ends = {
        name: lambda k, node, name=name: int(
            named[name][k] if figure.specs[name].nodes[k] == node else named[name][k + 1] - 1
        )
        for name in figure.specs
    }
    finer.hubs = {node: (rod, ends[rod](k, node)) for node, (rod, k) in figure.hubs.items()}
    finer.joints = {
        node: replace(spec, of=tuple((rod, ends[rod](k, node)) for rod, k in spec.of))
        for node, spec in figure.joints.items()
    }
    made = finer.build()
    rods = {n: replace(r, named=_composed(graph.rods[n].named, named[n])) for n, r in made.rods.items()}
    made = replace(made, rods=Named(rods, what="rod"))
    if not np.array_equal(x, graph.x0):
        posed = np.vstack([graph.x0, *(corners[1][e] for e in numbered)])
        made = made.with_positions(posed)
    turned = _turned(graph)
    if turned.any():
        angles = np.zeros(made.edge_count)
        for name, rod in made.rods.items():
            coarse = graph.rods[name].edges
            before, after = _midpoints(graph.rest_length[coarse]), _midpoints(made.rest_length[rod.edges])
            angles[rod.edges] = _continued(before, after, np.unwrap(turned[coarse]))
        made = made.twisted(angles)
    return made, np.array(parents)


def _midpoints(lengths: np.ndarray) -> np.ndarray:
    """Arc lengths of the middles of edges [m]."""
    return np.cumsum(lengths) - 0.5 * lengths


def _continued(s: np.ndarray, finer: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at finer places, linear between those at ``s`` and beyond their ends."""
    found = np.interp(finer, s, values)
    if len(s) > 1:
        for end, beyond in ((0, finer < s[0]), (-1, finer > s[-1])):
            inner = 1 if end == 0 else -2
            slope = (values[end] - values[inner]) / (s[end] - s[inner])
            found[beyond] = values[end] + slope * (finer[beyond] - s[end])
    return found


def _turned(graph: RodGraph) -> np.ndarray:
    """Angles [rad] by which the directors of edges are turned against those that its drawing has there, shape (E,)."""
    drawn = graph.drawn
    if not np.array_equal(drawn.x0, graph.x0):
        drawn = drawn.with_positions(graph.x0)
    if np.array_equal(drawn.d1, graph.d1):
        return np.zeros(graph.edge_count)
    along = unit(graph.x0[graph.edges[:, 1]] - graph.x0[graph.edges[:, 0]])
    sine = np.einsum("ei,ei->e", np.cross(drawn.d1, graph.d1), along)
    return np.arctan2(sine, np.einsum("ei,ei->e", drawn.d1, graph.d1))


def named_as(graph: RodGraph, other: RodGraph) -> RodGraph:
    """Return a graph, drawn anew with the same mesh as another one, whose names of places are that one's."""
    if all(rod.named is None for rod in other.rods.values()):
        return graph
    rods = {name: replace(rod, named=other.rods[name].named) for name, rod in graph.rods.items()}
    return replace(graph, rods=Named(rods, what="rod"))


def _composed(before: np.ndarray | None, now: np.ndarray) -> np.ndarray:
    """Places of the names after another refinement."""
    return now if before is None else now[before]


def _spec(spec: RodSpec, edges: list[int], numbered: dict[int, int]) -> tuple[RodSpec, np.ndarray]:
    """A rod with new nodes, and where its old nodes are in it."""
    nodes: list[int] = []
    named: list[int] = []
    parts: list[int] = []
    ring = [*spec.nodes, spec.nodes[0]] if spec.closed else spec.nodes
    for k, edge in enumerate(edges):
        named.append(len(nodes))
        nodes.append(ring[k])
        parts.append(2 if edge in numbered else 1)
        if edge in numbered:
            nodes.append(numbered[edge])
    named.append(len(nodes))
    if not spec.closed:
        nodes.append(ring[-1])
    changes: dict[str, Any] = {
        "nodes": nodes,
        "sections": _repeated(spec.sections, parts),
        "line": None,
        "taper": None,
    }
    if isinstance(spec.material, tuple):
        changes["material"] = tuple(_repeated(spec.material, parts))
    if isinstance(spec.natural, dict):
        changes["natural"] = {k: _between(v, k, np.array(named), len(nodes)) for k, v in spec.natural.items()}
    return replace(spec, **changes), np.array(named)


def _repeated(items: Any, parts: list[int]) -> list[Any]:
    """Items of the edges, for the parts of the edges."""
    return (
        list(items)
        if len(items) != len(parts)
        else [x for x, n in zip(items, parts, strict=True) for _ in range(n)]
    )


def _between(value: Any, key: str, named: np.ndarray, count: int) -> np.ndarray:
    """Values at inner nodes, for the inner nodes of the finer rod."""
    value = np.asarray(value, dtype=float)
    if value.ndim == (1 if key == "curvature" else 0):
        return value
    old, new = named[1:-1].astype(float), np.arange(1, count - 1)
    flat = value.reshape(len(value), -1)[: len(old)]
    made = np.stack([np.interp(new, old, column) for column in flat.T], axis=1)
    return made.reshape(len(new), *value.shape[1:])


def _middles(graph: RodGraph, x: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Middles of the edges on a cubic line through the nodes of each rod, straight at corners, shape (E, 3)."""
    out = 0.5 * (x[graph.edges[:, 0]] + x[graph.edges[:, 1]])
    for rod in graph.rods.values():
        y = x[rod.nodes]
        chord = np.diff(y, axis=0)
        length = np.linalg.norm(chord, axis=1)
        unit = chord / length[:, None]
        s = np.concatenate([[0.0], np.cumsum(length)])
        curved = np.ones(len(y), dtype=bool)
        curved[1:-1] = np.einsum("ij,ij->i", unit[1:], unit[:-1]) > np.cos(CORNER)
        curved[0] = curved[-1] = False
        curved[1:-1] &= ~(whole[rod.edges[1:]] | whole[rod.edges[:-1]])
        for k, edge in enumerate(rod.edges):
            h = length[k]
            # second derivatives at either end: of the parabola through three nodes; at an end, the neighbour's
            bends = [_bend(y, s, i) for i in (k, k + 1) if curved[i]]
            if bends:
                out[edge] -= h * h / 8.0 * np.mean(bends, axis=0)
    return out


def _bend(y: np.ndarray, s: np.ndarray, i: int) -> np.ndarray:
    """Second derivative of the parabola through three neighbouring nodes."""
    a, b = s[i] - s[i - 1], s[i + 1] - s[i]
    return np.asarray(2.0 * ((y[i + 1] - y[i]) / b - (y[i] - y[i - 1]) / a) / (a + b))
