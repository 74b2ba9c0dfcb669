"""Plane cross-sections of a surface: area, centroid and second moments of the loop around a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rodnet.importing.wavefronts import unique_edges


class Sections(NamedTuple):
    """Cross-sections, one per plane; rows of planes that cut no closed loop are NaN.

    Attributes
    ----------
    centroid : ndarray, shape (n, 3)
        Centroids [m].
    radius : ndarray, shape (n,)
        Radius of the circle of equal area [m].
    width : ndarray, shape (n,)
        Four radii of gyration about the softer axis [m]: the diameter, of a circle.
    aspect : ndarray, shape (n,)
        Ratio of the principal radii of gyration [1]; 1 for a circle or a square.
    hollow : ndarray, shape (n,)
        Whether the surface has an inner wall there.
    """

    centroid: np.ndarray
    radius: np.ndarray
    width: np.ndarray
    aspect: np.ndarray
    hollow: np.ndarray

    def take(self, index: np.ndarray) -> Sections:
        """Return the rows at ``index`` (integers or a mask)."""
        return Sections(*(values[index] for values in self))


class Slicer:
    """Cuts a triangle mesh with many small planes at once."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self.edges, self.face_edges = unique_edges(faces)
        corners = vertices[faces]
        middle = corners.mean(axis=1)
        self.middle, self.tree = middle, cKDTree(middle)
        self.size = float(np.linalg.norm(corners - middle[:, None], axis=2).max())

    def around(self, point: np.ndarray, radius: float) -> np.ndarray:
        """Corners of the triangles near a point [m], shape (n, 3)."""
        found = self.tree.query_ball_point(point, radius + self.size)
        return self.vertices[self.faces[found]].reshape(-1, 3)

    def cut(self, points: np.ndarray, normals: np.ndarray, reach: np.ndarray) -> Sections:
        """Cut with planes through points; of each take the loop around the point, or the nearest.

        Parameters
        ----------
        points, normals : ndarray, shape (n, 3)
            Points [m] and unit normals of the planes.
        reach : ndarray, shape (n,)
            How far from the point a section may lie [m]; a loop that is cut off there does not count.
        """
        n = len(points)
        found = self.tree.query_ball_point(points, reach + self.size, return_sorted=False)
        counts = np.array([len(f) for f in found], dtype=np.int64)
        plane = np.repeat(np.arange(n), counts)
        face = np.concatenate([np.asarray(f, dtype=np.int64) for f in found]) if counts.sum() else plane
        close = np.abs(np.einsum("fc,fc->f", self.middle[face] - points[plane], normals[plane])) <= self.size
        plane, face = plane[close], face[close]
        corner = self.vertices[self.faces[face]] - points[plane][:, None]
        height = np.einsum("fkc,fc->fk", corner, normals[plane])
        above = height >= 0.0
        crossed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
        plane, face, corner, height = plane[crossed], face[crossed], corner[crossed], height[crossed]
        above = above[crossed]
        lone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)  # the corner on its own side
        row = np.arange(len(face))
        ends, keys = [], []
        for other in ((lone + 1) % 3, (lone + 2) % 3):
            ha, hb = height[row, lone], height[row, other]
            share = (ha / (ha - hb))[:, None]
            ends.append(corner[row, lone] * (1.0 - share) + corner[row, other] * share)
        for side in (lone, (lone + 2) % 3):
            keys.append(plane * np.int64(len(self.edges)) + self.face_edges[face, side])
        outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        along = np.einsum("fc,fc->f", np.cross(normals[plane], outward), ends[1] - ends[0])
        swap = (along < 0.0)[:, None]
        a, b = np.where(swap, ends[1], ends[0]), np.where(swap, ends[0], ends[1])
        return _measure(points, normals, plane, a, b, np.stack(keys))


def _measure(points, normals, plane, a, b, keys) -> Sections:
    """From oriented segments a -> b, relative to their plane's point, to the loop of each plane."""
    n = len(points)
    radius, width, aspect = np.full((3, n), np.nan)
    out = Sections(np.full((n, 3), np.nan), radius, width, aspect, np.zeros(n, dtype=bool))
    if not len(plane):
        return out
    _, node = np.unique(keys, return_inverse=True)
    node = node.reshape(2, -1)
    size = int(node.max()) + 1
    count, label = connected_components(
        coo_array((np.ones(len(plane), dtype=np.int8), (node[0], node[1])), shape=(size, size)),
        directed=False,
    )
    loop = label[node[0]]
    ends = np.bincount(node.ravel(), minlength=size)
    odd = np.bincount(label, ends % 2 != 0, minlength=count) > 0  # a loop with a loose end is open
    owner = np.zeros(count, dtype=np.int64)
    owner[loop] = plane
    normal = normals[plane]
    twice = np.einsum("fc,fc->f", np.cross(a, b), normal)
    area = 0.5 * np.bincount(loop, twice, minlength=count)
    turn = np.arctan2(twice, np.einsum("fc,fc->f", a, b))
    winding = np.bincount(loop, turn, minlength=count) / (2.0 * np.pi)
    safe = np.where(np.abs(area) > 0.0, area, np.inf)
    s = a + b
    first = np.stack([np.bincount(loop, twice * s[:, k], minlength=count) for k in range(3)], axis=1)
    centroid = first / (6.0 * safe[:, None])
    distance = np.linalg.norm(centroid, axis=1)
    closed = ~odd & (area > 0.0)
    around = closed & (winding > 0.5)
    near = closed & (distance < 2.0 * np.sqrt(np.maximum(area, 0.0) / np.pi))
    # loops around the point first, the smallest of them; then the nearest
    rank = np.where(around, 0.0, np.where(near, 1.0, 2.0))
    order = np.lexsort((np.where(around, area, distance), rank, owner))
    order = order[rank[order] < 2.0]
    chosen = order[np.unique(owner[order], return_index=True)[1]]
    tensor = np.zeros((count, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            term = twice * (s[:, i] * s[:, j] + a[:, i] * a[:, j] + b[:, i] * b[:, j]) / 24.0
            tensor[:, i, j] = tensor[:, j, i] = np.bincount(loop, term, minlength=count)
    tensor = tensor[chosen] / area[chosen, None, None] - centroid[chosen, :, None] * centroid[chosen, None, :]
    moment = np.sqrt(np.maximum(np.linalg.eigvalsh(tensor), 1e-300))
    k = owner[chosen]
    out.centroid[k] = points[k] + centroid[chosen]
    out.radius[k] = np.sqrt(area[chosen] / np.pi)
    out.width[k] = 4.0 * moment[:, 2]
    out.aspect[k] = moment[:, 2] / moment[:, 1]
    inner = ~odd & (area < 0.0) & (winding < -0.5)
    out.hollow[owner[inner]] = True
    return out
