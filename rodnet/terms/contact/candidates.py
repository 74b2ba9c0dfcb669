"""Which edges may touch: neighbours along the rods are left out, the rest is searched by a k-d tree."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

ROWS = 256  # of distances along the rods at a time


class Paths:
    """Lengths of the paths along a graph between nodes that are near each other.

    Parameters
    ----------
    edges, lengths : ndarray, shapes (E, 2) and (E,)
        The graph, and the lengths of its edges [m].
    node_count : int
        Number of nodes.
    limit : float
        Longer paths are not kept [m].
    """

    def __init__(self, edges: np.ndarray, lengths: np.ndarray, node_count: int, limit: float) -> None:
        self.edges, self.node_count = edges.astype(np.int64), node_count
        links = csr_matrix((lengths, edges.T), shape=(node_count, node_count))
        keys, values = [], []
        for first in range(0, node_count, ROWS):
            rows = np.arange(first, min(first + ROWS, node_count))
            distance = dijkstra(links, directed=False, indices=rows, limit=limit)
            near = np.nonzero(np.isfinite(distance))
            keys.append((near[0] + first) * node_count + near[1])
            values.append(distance[near])
        self.keys, self.values = np.concatenate(keys), np.concatenate(values)

    def between(self, pairs: np.ndarray) -> np.ndarray:
        """Length of the path between the nearest nodes of pairs of edges, infinite if far, shape (n,)."""
        shortest = np.full(len(pairs), np.inf)
        for a in (0, 1):
            for b in (0, 1):
                key = self.edges[pairs[:, 0], a] * self.node_count + self.edges[pairs[:, 1], b]
                place = np.minimum(np.searchsorted(self.keys, key), len(self.keys) - 1)
                found = np.where(self.keys[place] == key, self.values[place], np.inf)
                np.minimum(shortest, found, out=shortest)
        return shortest


def close_pairs(x: np.ndarray, edges: np.ndarray, chosen: np.ndarray, piece: float, gap: float) -> np.ndarray:
    """Pairs of edges whose axes may be nearer to each other than ``gap``, sorted, shape (n, 2).

    Parameters
    ----------
    x, edges : ndarray, shapes (N, 3) and (E, 2)
        Node positions [m] and the edges' nodes.
    chosen : ndarray of int
        The edges that count.
    piece : float
        A point stands for at most so much of an edge [m].
    gap : float
        Distance [m].
    """
    start, vector = x[edges[chosen, 0]], x[edges[chosen, 1]] - x[edges[chosen, 0]]
    length = np.linalg.norm(vector, axis=1)
    count = np.maximum(np.ceil(length / piece), 1).astype(np.int64)
    owner = np.repeat(np.arange(len(chosen)), count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    points = start[owner] + ((place + 0.5) / count[owner])[:, None] * vector[owner]
    found = cKDTree(points).query_pairs(piece + gap, output_type="ndarray")
    first, second = np.sort(chosen[owner[found]], axis=1).T
    keys = np.unique(first[first != second] * len(edges) + second[first != second])
    return np.stack([keys // len(edges), keys % len(edges)], axis=1)
