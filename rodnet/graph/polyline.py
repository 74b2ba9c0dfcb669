"""Spreading edges along a polyline."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.parameters import is_number

MOST = 1_000_000  # edges of one rod


def distribute_edges(points: np.ndarray, edges: int) -> np.ndarray:
    """Nodes of ``edges`` edges along a polyline, shape (edges + 1, 3) [m].

    A coarse polyline (fewer segments than edges) keeps its vertices and divides each segment
    evenly; a fine one is resampled at equal steps of arc length.
    """
    segments = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(segments) > edges:
        s = np.concatenate([[0.0], np.cumsum(segments)])
        target = np.linspace(0.0, s[-1], edges + 1)
        return np.stack([np.interp(target, s, points[:, k]) for k in range(3)], axis=1)
    counts = np.ones(len(segments), dtype=int)
    longest = [(-length, k) for k, length in enumerate(segments)]
    heapq.heapify(longest)
    if len(segments) == 1:
        counts[0] = edges
    else:
        for _ in range(edges - len(segments)):  # give the next edge to the segment with the longest pieces
            k = longest[0][1]
            counts[k] += 1
            heapq.heapreplace(longest, (-segments[k] / counts[k], k))
    pieces = [
        points[k] + (points[k + 1] - points[k]) * (np.arange(n) / n)[:, None] for k, n in enumerate(counts)
    ]
    return np.vstack([*pieces, points[-1:]])


def coordinates_of(name: str, point: Any) -> np.ndarray:
    """Coordinates of a point that a rod is drawn through [m], shape (3,), checked."""
    try:
        xyz = np.asarray(point, dtype=float)
    except (TypeError, ValueError):
        xyz = np.zeros(0)
    if xyz.shape != (3,) or not np.all(np.isfinite(xyz)):
        raise GraphError(
            f"'{name}': {point!r} is not a finite point (x, y, z) [m] nor a reference like 'rod.end'"
        )
    return xyz


def laid_out(
    name: str, line: np.ndarray, ids: list[int | None], edges: int | None, closed: bool
) -> tuple[np.ndarray, list[int | None]]:
    """Nodes of a rod that is drawn along a polyline, with the numbers of those that exist.

    Parameters
    ----------
    name : str
        Name of the rod.
    line : ndarray, shape (n, 3)
        The polyline [m].
    ids : list of int or None
        Number of the node at each of its points, None for a new one.
    edges : int or None
        Number of edges to spread along it; None keeps its points.
    closed : bool
        Whether its end is joined to its start; the start then comes again at the end.

    Raises
    ------
    GraphError
        For an edge of zero length or a bad count.
    """
    if closed:
        line = np.vstack([line, line[:1]])
    zero = np.flatnonzero(np.linalg.norm(np.diff(line, axis=0), axis=1) <= 0.0)
    if len(zero):
        raise GraphError(
            f"'{name}' has an edge of zero length between its points {zero[0]} and {zero[0] + 1}; remove one"
        )
    if edges is None:
        return line, ids
    if isinstance(edges, bool) or not (is_number(edges) and edges >= 1 and edges % 1 == 0):
        raise GraphError(f"'{name}': edges = {edges!r} must be a positive integer")
    if edges > MOST:
        raise GraphError(f"'{name}': edges = {edges!r} are too many; a rod may have {MOST:,} at most")
    if any(i is not None for i in (ids[1:] if closed else ids[1:-1])):
        which = (
            "its first point may be a reference" if closed else "its first and last points may be references"
        )
        raise GraphError(f"'{name}': with edges=, only {which}")
    line = distribute_edges(line, int(edges))
    inner: list[int | None] = [None] * (len(line) - 2)
    return line, [ids[0], *inner] if closed else [ids[0], *inner, ids[-1]]
