"""Spreading edges along a polyline."""

from __future__ import annotations

import heapq

import numpy as np


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
