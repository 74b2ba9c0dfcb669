"""Fitting the axes of limbs: cross-sections along them, junctions where they meet, tips where they end.

Cross-sections normal to a limb give its axis and radius whatever the triangles are, as long as they cut
that limb alone. Near a junction they do not; there the axes are continued, and the junction is
seated where they meet best (docs, theory: robots from meshes).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from rodnet.importing.curves import End, arc_length, curve_end, interpolate, spread_evenly, tangents
from rodnet.importing.limbs import Limb, LimbGraph
from rodnet.importing.sections import Sections, Slicer

STEP = 0.5  # between stations, in radii
REACH = 3.0, 2.0  # how far from its station a section may extend, in radii: at first, and later
ROUNDS = 30  # at most, after those
SETTLED = 0.02  # of a radius that junctions may still move
WIDE = 4.0  # radii that a clearance may have as long as directions are first guesses
TIP = (2.0, 1.5, 0.75)  # in radii from a tip, by rounds: planes that are tilted cut the cap
MARGIN = 1.1  # beyond the clearance, for fillets
JUMP = 1.25  # growth of the radius within a step towards a junction at which a body begins
PULL = 1e-3  # of the former position on a junction, where the axes leave it undetermined


def fit_axes(graph: LimbGraph, slicer: Slicer) -> None:
    """Measure all limbs and seat all junctions; edit the graph until every limb is one."""
    while True:
        for cap in TIP:
            _round(graph, slicer, cap, guess=True)
        # a limb that still grows goes on to its end, and junctions follow
        for _ in range(ROUNDS):
            before, seats = [_extent(limb) for limb in graph.limbs], dict(graph.nodes)
            _round(graph, slicer, TIP[-1], guess=False)
            grown = any(
                _extent(k) > s + 1.5 * STEP * k.radius for k, s in zip(graph.limbs, before, strict=True)
            )
            least = min(limb.radius for limb in graph.limbs)
            if not grown and all(np.linalg.norm(graph.nodes[k] - seats[k]) < SETTLED * least for k in seats):
                break
        if not _edit(graph):
            return


def _round(graph: LimbGraph, slicer: Slicer, cap: float, guess: bool) -> None:
    for limb in graph.limbs:
        _measure(limb, graph, slicer, first=limb.sections is None)
    for node in graph.nodes:
        _seat(graph, node, WIDE if guess else np.inf)
    for limb in graph.limbs:
        _trim(limb, graph, slicer, cap, at_least=2 if guess else 0)


def _extent(limb: Limb) -> float:
    return float(arc_length(limb.path)[-1]) if limb.sections is not None else 0.0


def clearance(own: float, other: float, cosine: float) -> float:
    """How far along its axis a limb is touched by another one that starts at the same node [m].

    The other limb is a ray with a radius; the distance of the own surface's nearest line,
    (s, own), from that ray is ``other`` at the s that is returned.
    """
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    if sine > 1e-3:
        s = (other + own * cosine) / sine
        if s * cosine + own * sine >= 0.0:
            return max(s, 0.0)
    elif cosine > 0.0:
        return math.inf  # side by side
    return math.sqrt(max(other * other - own * own, 0.0))


def _measure(limb: Limb, graph: LimbGraph, slicer: Slicer, first: bool) -> None:
    """Cut a limb at stations along its path, continued at both ends, and move the path to the centroids."""
    if len(limb.path) < 2:
        limb.sections = None
        return
    step = max(STEP * limb.radius, 1e-3 * arc_length(limb.path)[-1])
    before = arc_length(limb.path)
    radii = np.full(len(before), limb.radius) if limb.sections is None else limb.sections.radius
    if limb.closed:
        ring = np.vstack([limb.path, limb.path[:1]])
        points = spread_evenly(ring, step, 13)[:-1]
        local = np.interp(arc_length(points), before, radii)
        directions, inside = tangents(points, closed=True), np.ones(len(points), dtype=bool)
    else:
        points = spread_evenly(limb.path, step)
        local = np.interp(arc_length(points), before, radii)
        ahead, behind = (_continued(limb, graph, end, step) for end in (0, 1))
        inside = np.repeat([False, True, False], [len(ahead), len(points), len(behind)])
        points = np.vstack([ahead[::-1], points, behind])
        local = np.concatenate([np.full(len(ahead), local[0]), local, np.full(len(behind), local[-1])])
        directions = tangents(points)
    cuts = slicer.cut(points, directions, REACH[not first] * local)
    off = np.linalg.norm(cuts.centroid - points, axis=1)
    good = np.isfinite(cuts.radius) & (
        off < (2.0 if first else 0.5) * np.maximum(local, np.nan_to_num(cuts.radius))
    )
    if not limb.closed:
        good = _connected(good, inside)
    forward = np.flatnonzero(good)
    if len(forward) < 2:
        limb.sections = None
        return
    limb.path, limb.sections = cuts.centroid[forward], cuts.take(forward)
    limb.radius = float(np.median(limb.sections.radius))


def _continued(limb: Limb, graph: LimbGraph, end: int, step: float) -> np.ndarray:
    """Stations beyond an end of a limb's path: past a tip, or up to the clearance of a junction."""
    curve = curve_end(limb.path if end == 0 else limb.path[::-1])
    node = limb.ends[end]
    count = 3
    if graph.degree(node) > 1:
        gap = float((graph.nodes[node] - curve.point) @ curve.outward) - limb.clear[end]
        count = int(np.clip(gap / step, 0, 8))
    return curve.at(step * np.arange(1, count + 1))


def _connected(good: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Good stations inside of the former path, and those that continue it without a gap."""
    good = good.copy()
    low, high = np.flatnonzero(inside)[[0, -1]]
    good[:low] &= np.logical_and.accumulate(good[:low][::-1])[::-1]
    good[high + 1 :] &= np.logical_and.accumulate(good[high + 1 :])
    return good


def _end(limb: Limb, end: int) -> tuple[End, float]:
    """End of the path, and the radius there."""
    path = limb.path if end == 0 else limb.path[::-1]
    radius = limb.radius
    if limb.sections is not None:
        radii = limb.sections.radius if end == 0 else limb.sections.radius[::-1]
        radius = float(np.median(radii[:3]))
    return curve_end(path), radius


def _meeting(graph: LimbGraph, node: int) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Of each limb at a junction: where its axis passes, the tangent out of the limb there, and its radius."""
    ends = [_end(limb, end) for limb, end in graph.at(node) if len(limb.path) > 1]
    return [(*curve.toward(graph.nodes[node], 3.0 * radius), radius) for curve, radius in ends]


def _seat(graph: LimbGraph, node: int, widest: float) -> None:
    """Move a junction to the point nearest to all axes; find how far its limbs are in each other's way."""
    here = [(limb, end) for limb, end in graph.at(node) if len(limb.path) > 1]
    if graph.degree(node) < 2:
        return
    axes = _meeting(graph, node)
    matrix, right = PULL * np.eye(3), PULL * graph.nodes[node]
    for point, tangent, _ in axes:
        across = np.eye(3) - np.outer(tangent, tangent)
        matrix, right = matrix + across, right + across @ point
    graph.nodes[node] = np.linalg.solve(matrix, right)
    for k, (limb, end) in enumerate(here):
        _, tangent, radius = axes[k]
        others = [clearance(radius, r, float(tangent @ t)) for i, (_, t, r) in enumerate(axes) if i != k]
        # of two limbs side by side nobody knows where they part: then the sections must tell
        clear = MARGIN * max((c for c in others if c < 20.0 * radius), default=0.0)
        limb.clear[end] = min(clear, widest * max(r for _, _, r in axes))


def miss(graph: LimbGraph, node: int) -> tuple[float, float]:
    """Largest distance of a junction from the axes that it joins, and the smallest radius there [m]."""
    axes = _meeting(graph, node)
    offset = [graph.nodes[node] - point for point, _, _ in axes]
    away = [np.linalg.norm(d - (d @ t) * t) for d, (_, t, _) in zip(offset, axes, strict=True)]
    return float(max(away)), min(r for _, _, r in axes)


def _trim(limb: Limb, graph: LimbGraph, slicer: Slicer, cap: float, at_least: int) -> None:
    """Drop stations at a tip, within the clearance of a junction, or in a body that is thicker than the limb."""
    if limb.closed or limb.sections is None:
        return
    for end in (0, 1):
        node = limb.ends[end]
        joined = graph.degree(node) > 1
        if end == 1:
            limb.flip()
        curve, radius = _end(limb, 0)
        stop, need = (
            (graph.nodes[node], limb.clear[0]) if joined else (tip(limb, 0, slicer)[-1], cap * radius)
        )
        free = (limb.path - stop) @ -curve.outward >= need
        first = int(np.argmax(free)) if free.any() else len(free)
        if joined:
            half = (len(free) + 1) // 2
            radii = limb.sections.radius
            steps = np.flatnonzero(radii[: half - 1] > JUMP * radii[1:half])
            first = max(first, int(steps[-1]) + 1 if len(steps) else 0)
        first = min(first, max(len(free) - at_least, 0) if joined else max((len(free) - 2) // 2, 0))
        if first < len(free):
            kept = np.arange(first, len(free))
            limb.path, limb.sections = limb.path[kept], limb.sections.take(kept)
        else:
            limb.sections = None  # nothing of it is free; the path stays, as a guess
        if end == 1:
            limb.flip()
        if limb.sections is None:
            return


def _edit(graph: LimbGraph) -> bool:
    """Remove bumps, contract what lies between junctions that are one; whether anything was done."""
    done: set[int] = set()
    found = []
    for limb in graph.limbs:
        double = _is_double(limb, graph)
        if len(graph.limbs) > 1 and not limb.closed and (double or _is_stub(limb, graph)):
            found.append((graph.length(limb), double, set(limb.ends), limb))
    for _, double, ends, limb in sorted(found, key=lambda stub: stub[0]):
        # one at a node in a go: what is left is measured anew
        if done & ends:
            continue
        done |= ends
        if double or any(graph.degree(node) == 1 for node in ends):
            graph.remove(limb)
        else:
            graph.contract(limb)
    return bool(done)


def _is_double(limb: Limb, graph: LimbGraph) -> bool:
    """Whether a limb has slipped into a longer one: they have most of their sections in common."""
    if limb.sections is None:
        return False
    length, rank = graph.length(limb), graph.limbs.index(limb)
    for k, other in enumerate(graph.limbs):
        if other is limb or other.sections is None or (graph.length(other), k) < (length, rank):
            continue
        apart = cKDTree(other.path).query(limb.path)[0]
        if np.mean(apart < 0.5 * other.radius) > 0.5:
            return True
    return False


def _is_stub(limb: Limb, graph: LimbGraph) -> bool:
    """Whether nothing to speak of is left of a limb outside of its neighbours."""
    if limb.sections is None or len(limb.path) < 2:
        return True
    tips = sum(graph.degree(node) == 1 for node in limb.ends)
    free = arc_length(limb.path)[-1] + STEP * limb.radius * tips
    return tips > 0 and free < 1.5 * limb.radius


def tip(limb: Limb, end: int, slicer: Slicer) -> np.ndarray:
    """Continuation of the axis to the tip of a limb, where it leaves the surface [m], shape (3, 3)."""
    curve, _ = _end(limb, end)
    radii = limb.sections.radius  # type: ignore[union-attr]
    radius = float(np.max(radii[:5] if end == 0 else radii[-5:]))
    near = slicer.around(curve.point, 3.0 * radius) - curve.point
    along = near @ curve.outward
    across = np.linalg.norm(near - along[:, None] * curve.outward, axis=1)
    length = along[(across < 1.3 * radius) & (along < 2.5 * radius)].max(initial=0.0)
    return curve.at(np.array([0.4, 0.8, 1.0]) * length)


def finish(limb: Limb, graph: LimbGraph, slicer: Slicer) -> tuple[np.ndarray, np.ndarray, Sections]:
    """Axis from node to node with the radius at each point; the sections that it rests on.

    Returns
    -------
    axis : ndarray, shape (n, 3)
        Points [m]; of a ring the first again at the end.
    radius : ndarray, shape (n,)
        Radii there [m].
    sections : Sections
        Sections of the limb proper, n - 2 or fewer.
    """
    assert limb.sections is not None
    axis, radius, sections = limb.path, limb.sections.radius, limb.sections
    if limb.closed:
        return np.vstack([axis, axis[:1]]), np.append(radius, radius[0]), sections
    for end in (0, 1):
        node = limb.ends[end]
        at, r = (axis[0], radius[0]) if end == 0 else (axis[-1], radius[-1])
        if graph.degree(node) > 1:
            new, radii = graph.nodes[node][None], np.array([r])
        else:
            new = tip(limb, end, slicer)
            graph.nodes[node] = new[-1]
            # the last step matters for the shape of a cap
            normal = np.broadcast_to((new[2] - at) / max(np.linalg.norm(new[2] - at), 1e-300), (2, 3))
            cap = slicer.cut(new[:2], normal, np.full(2, REACH[1] * r)).radius
            cap = np.where(np.isfinite(cap), cap, 0.0 if np.isfinite(cap).any() else r)
            radii = np.append(cap, max(2.0 * cap[1] - cap[0], 0.0) if cap[1] < 0.9 * r else cap[1])
        order = slice(None, None, -1) if end == 0 else slice(None)
        parts = (new[order], axis) if end == 0 else (axis, new)
        axis = np.vstack(parts)
        radius = np.concatenate([radii[order], radius] if end == 0 else [radius, radii])
    kept = np.concatenate([[True], np.linalg.norm(np.diff(axis, axis=0), axis=1) > 1e-9 * limb.radius])
    return axis[kept], radius[kept], sections


def nodes_and_radii(axis: np.ndarray, radius: np.ndarray, edges: int) -> tuple[np.ndarray, np.ndarray]:
    """Spread edges along an axis; each has the radius of equal volume.

    Returns
    -------
    points : ndarray, shape (edges + 1, 3)
        Nodes [m].
    radii : ndarray, shape (edges,)
        Radii [m].
    """
    s = arc_length(axis)
    fine = 16
    at = (np.arange(edges * fine) + 0.5) * (s[-1] / (edges * fine))
    square = np.interp(at, s, radius) ** 2
    points = interpolate(np.linspace(0.0, s[-1], edges + 1), s, axis)
    return points, np.sqrt(square.reshape(edges, fine).mean(axis=1))
