"""Splitting the long edges of a triangle surface without leaving needles or loose corners."""

from __future__ import annotations

import numpy as np

from rodnet.importing.wavefronts import unique_edges


def refine(vertices: np.ndarray, faces: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Split edges until none is longer than ``longest`` [m]; neighbours stay joined.

    Every edge is cut into 2^k equal pieces. Triangles with three long edges are quartered; what is then
    left has one short edge, and is cut into rungs between the other two. So the long thin triangles
    of CAD programs become about as many as their area asks for.
    """
    edges, face_edges = unique_edges(faces)
    length = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
    pieces = 2 ** np.ceil(np.log2(np.maximum(length / longest, 1.0)) - 1e-12).astype(np.int64)
    if (pieces == 1).all():
        return vertices, faces
    corners, counts = vertices[faces], pieces[face_edges]
    done = []
    while len(corners):
        final = counts.min(axis=1) == 1
        done += _rungs(corners[final], counts[final])
        corners, counts = _quarter(corners[~final], counts[~final])
    soup = np.concatenate(done)
    # points on an edge are midpoints of midpoints on either side of it, the same to the last bit
    vertices, inverse = np.unique(soup.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, inverse.reshape(-1, 3)


def _quarter(corners: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = np.moveaxis(corners, 1, 0)
    x, y, z = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [np.stack(p, axis=1) for p in ((a, x, z), (x, b, y), (z, y, c), (y, z, x))]
    return np.concatenate(parts), np.tile(counts // 2, (4, 1))


def _rungs(corners: np.ndarray, counts: np.ndarray) -> list[np.ndarray]:
    """Cut triangles that have an edge in one piece."""
    # turn the edge in one piece to lie between the corners 1 and 2, opposite of the apex 0
    lead = (np.argmin(counts, axis=1) + 2) % 3
    turn = (lead[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turn[:, :, None], axis=1)
    counts = np.take_along_axis(counts, turn, axis=1)
    out = []
    for left, right in np.unique(counts[:, ::2], axis=0).tolist():
        these = corners[(counts[:, 0] == left) & (counts[:, 2] == right)]
        p, q = _divide(these[:, 0], these[:, 1], left), _divide(these[:, 0], these[:, 2], right)
        i = j = 0
        while i < left or j < right:
            # advance on the side that lags behind; at the apex both sides are one point
            if j == right or (i < left and (i + 1) * right <= (j + 1) * left):
                new = (p[i], p[i + 1], q[j])
                i += 1
            else:
                new = (p[i], q[j + 1], q[j])
                j += 1
            if i + j > 1:  # the first step from the apex spans no triangle
                out.append(np.stack(new, axis=1))
    return out


def _divide(a: np.ndarray, b: np.ndarray, pieces: int) -> list[np.ndarray]:
    """Points that divide segments into 2^k pieces, by repeated halving."""
    if pieces == 1:
        return [a, b]
    middle = 0.5 * (a + b)
    return [*_divide(a, middle, pieces // 2)[:-1], *_divide(middle, b, pieces // 2)]
