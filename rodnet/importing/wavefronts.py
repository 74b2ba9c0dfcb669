"""The branching of a surface by wavefronts: the Reeb graph of the geodesic distance from a tip.

The distance is linear on each triangle, so that the pieces of a surface between two level lines are
found exactly, on coarse meshes too. On a closed surface without handles their graph is a tree, and a
surface with g handles has at most g loops in it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

SPECK = 0.5  # of the square of the width


class Regions(NamedTuple):
    """Connected pieces of the distance bands.

    Attributes
    ----------
    centroid : ndarray, shape (k, 3)
        Centroids [m].
    spread : ndarray, shape (k,)
        Root mean square distance of a piece from its centroid [m]; the radius, of a narrow ring.
    area : ndarray, shape (k,)
        Areas [m^2].
    arcs : ndarray, shape (a, 2)
        Pieces of neighbouring bands that touch.
    """

    centroid: np.ndarray
    spread: np.ndarray
    area: np.ndarray
    arcs: np.ndarray


def unique_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of triangles, shape (e, 2), and the edges of each triangle, shape (m, 3).

    Edge k of a triangle joins its corners k and k + 1.
    """
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = pairs[:, 0].astype(np.int64) * (int(faces.max()) + 1) + pairs[:, 1]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return pairs[first], inverse.reshape(-1, 3)


def wavefront_regions(vertices: np.ndarray, faces: np.ndarray, width: float) -> Regions:
    """Cut a surface into bands of equal geodesic distance, about ``width`` [m] wide, and those into pieces."""
    edges, face_edges = unique_edges(faces)
    distance = _distance_from_tip(vertices, edges)
    count = max(round(distance.max() / width), 3)
    level = np.minimum(distance * (count / distance.max()), count * (1.0 - 1e-12))
    face, band = _bands(level[faces])
    start = np.searchsorted(face, np.arange(len(faces)))  # a face's fragments are consecutive
    low = band[start]
    label = _pieces(face_edges, *_bands(level[edges]), start, low, len(face))
    weight = _areas(vertices, faces)[face] / np.bincount(face)[face]
    total = np.maximum(np.bincount(label, weight), 1e-300)
    middle = vertices[faces].mean(axis=1)[face]
    centroid = (
        np.stack([np.bincount(label, weight * middle[:, k]) for k in range(3)], axis=1) / total[:, None]
    )
    off = np.sum((middle - centroid[label]) ** 2, axis=1)
    same = np.flatnonzero(face[1:] == face[:-1])
    arcs = np.unique(np.sort(np.stack([label[same], label[same + 1]], axis=1), axis=1), axis=0)
    regions = Regions(centroid, np.sqrt(np.bincount(label, weight * off) / total), total, arcs)
    return _without_specks(regions, SPECK * width**2)


def _without_specks(regions: Regions, area: float) -> Regions:
    """Drop small pieces at the ends: distances along edges have little maxima of their own on flat parts."""
    arcs = regions.arcs
    while True:
        end = np.bincount(arcs.ravel(), minlength=len(regions.area)) == 1
        speck = end & (regions.area < area)
        kept = arcs[~speck[arcs].any(axis=1)]
        if len(kept) == len(arcs) or not len(kept):
            break
        arcs = kept
    used, arcs = np.unique(arcs, return_inverse=True)
    return Regions(regions.centroid[used], regions.spread[used], regions.area[used], arcs.reshape(-1, 2))


def _distance_from_tip(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Distance along edges [m] from the vertex that is farthest from the vertex farthest from the middle."""
    n = len(vertices)
    length = np.maximum(np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1), 1e-300)
    graph = csr_array(coo_array((length, (edges[:, 0], edges[:, 1])), shape=(n, n)))
    start = int(np.argmax(np.sum((vertices - vertices.mean(axis=0)) ** 2, axis=1)))
    for _ in range(2):
        distance = dijkstra(graph, directed=False, indices=start)
        start = int(np.argmax(distance))
    return distance


def _bands(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (row, band) of all bands that each row's values span; rows in order, bands ascending."""
    low = np.floor(level.min(axis=1)).astype(np.int64)
    counts = np.floor(level.max(axis=1)).astype(np.int64) - low + 1
    row = np.repeat(np.arange(len(level)), counts)
    first = np.cumsum(counts) - counts
    return row, low[row] + np.arange(len(row)) - first[row]


def _pieces(face_edges, edge, band, start, low, fragments) -> np.ndarray:
    """Label the fragments (face, band) that hang together by edges within their band."""
    owner = np.repeat(np.arange(len(face_edges)), 3)
    order = np.argsort(face_edges.ravel(), kind="stable")
    owner, sides = owner[order], face_edges.ravel()[order]
    next_ = np.flatnonzero(
        sides[1:] == sides[:-1]
    )  # successive faces at one edge; chains cover more than two
    first = np.searchsorted(edge, np.arange(edge[-1] + 2))
    spans = np.diff(first)[sides[next_]]
    pair = np.repeat(np.arange(len(next_)), spans)
    offset = np.arange(len(pair)) - np.repeat(np.cumsum(spans) - spans, spans)
    k = band[first[sides[next_]][pair] + offset]
    f, g = owner[next_][pair], owner[next_ + 1][pair]
    i, j = start[f] + k - low[f], start[g] + k - low[g]
    graph = coo_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(fragments, fragments))
    return connected_components(graph, directed=False)[1]


def _areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
