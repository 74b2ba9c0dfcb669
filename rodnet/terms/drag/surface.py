"""Stokes resistance of a closed surface: drag force and torque of a head of any shape."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import GraphError, ParameterError

if TYPE_CHECKING:
    from trimesh import Trimesh

SHARP = np.radians(40.0)  # a turn of the surface that makes the traction singular
LEVELS = 3  # halvings of the triangles at sharp edges
INNER = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0  # second order on a triangle
LARGE = 2.0  # a head larger than this is more likely one in millimetres [m]


def stokes_resistance(
    mesh: Trimesh | str | Path,
    viscosity: float = 1.0,
    *,
    about: Any = None,
    scale: float = 1.0,
    faces: int = 1000,
) -> np.ndarray:
    """Resistance matrix of a rigid body in Stokes flow, from its surface.

    A single layer of tractions, constant on each triangle, moves the surface rigidly (Galerkin, with exact
    inner integrals). Triangles at sharp edges, where tractions are singular, are halved up to three
    times, and the result is extrapolated over the last halving.

    Parameters
    ----------
    mesh : trimesh.Trimesh or path
        The surface, closed [m].
    viscosity : float
        Dynamic viscosity [Pa s].
    about : array_like, shape (3,), optional
        The point that moves with the velocity and that torques are about [m]; by default the centre of volume.
    scale : float
        Factor from the units of the mesh to metres: 1e-3 for millimetres.
    faces : int
        Largest number of triangles to compute with: a finer surface is simplified, its volume kept. Time grows
        with the third power (1000: some 5 s).

    Returns
    -------
    ndarray, shape (6, 6)
        From (velocity, angular velocity) to minus (force, torque), in the axes of the mesh: blocks in
        [N s/m], [N s] and [N m s]. Symmetric and positive definite.

    Raises
    ------
    GraphError
        The surface is open, of several pieces, or crosses itself so that it has no volume.
    ParameterError
        A number is out of its range.

    Notes
    -----
    Source: Pozrikidis 1992, chapter 4 (single-layer representation of rigid motion).

    Examples
    --------
    >>> import numpy as np, trimesh, rodnet as rn
    >>> R = rn.stokes_resistance(trimesh.creation.icosphere(subdivisions=2, radius=0.02))
    >>> bool(abs(R[0, 0] / (6 * np.pi * 0.02) - 1) < 0.02)
    True
    """
    for name, value in (("viscosity", viscosity), ("scale", scale), ("faces", faces)):
        if not (np.isfinite(value) and value > 0):
            raise ParameterError(f"stokes_resistance: {name} = {value!r} must be positive")
    body, place, size = _closed(mesh, scale)
    centre = np.asarray(place + size * body.center_mass if about is None else about, dtype=float)
    if centre.shape != (3,) or not np.all(np.isfinite(centre)):
        raise ParameterError(f"stokes_resistance: about = {about!r} must be a point (x, y, z) [m]")
    if len(body.faces) > faces:
        body = _coarse(body, faces)
    corners, sharp = _triangles(body)
    corners = corners - (centre - place) / size
    corners, sharp = _until_small(corners, sharp, faces)
    levels = [_resistance(corners)]
    for _ in range(LEVELS):
        at_edges = np.any(sharp, axis=1)
        if not at_edges.any() or len(corners) + 3 * at_edges.sum() > faces:
            break
        corners, sharp = _split(corners, sharp, np.asarray(at_edges))
        levels.append(_resistance(corners))
    # the error goes with the size of the smallest triangles
    found = 2.0 * levels[-1] - levels[-2] if len(levels) > 1 else levels[-1]
    units = np.repeat([1.0, size], 3)
    return viscosity * size * np.outer(units, units) * found


def _closed(mesh: Any, scale: float) -> tuple[Trimesh, np.ndarray, float]:
    """Return a copy of size one, checked, its normals outward; its place and its size [m]."""
    import trimesh

    what = "the surface"
    if not isinstance(mesh, trimesh.Trimesh):
        what = str(mesh)
        if not Path(mesh).is_file():
            raise GraphError(f"stokes_resistance: there is no mesh file {what}")
        mesh = trimesh.load_mesh(mesh)
    places = np.asarray(mesh.vertices, dtype=float)
    if len(places) == 0 or not np.all(np.isfinite(places)):
        raise GraphError(f"stokes_resistance: {what} has no corners, or some that are not finite")
    corner, size = places.min(axis=0), float(np.linalg.norm(np.ptp(places, axis=0)))
    # of size one: vertices are merged, and surfaces simplified, by absolute distances
    body = trimesh.Trimesh((places - corner) / (size or 1.0), mesh.faces, process=True)
    pieces = body.body_count
    if len(body.faces) == 0 or not body.is_watertight:
        raise GraphError(
            f"stokes_resistance: {what} is open, so it has no inside; close it, e.g. by trimesh.repair.fill_holes"
        )
    if pieces > 1:
        raise GraphError(f"stokes_resistance: {what} consists of {pieces} pieces; give them one by one")
    trimesh.repair.fix_normals(body)
    if body.volume <= 1e-9 * body.area**1.5:
        raise GraphError(f"stokes_resistance: {what} encloses no volume: it is flat, or crosses itself")
    if size * scale > LARGE:
        warnings.warn(
            f"stokes_resistance: {what} is {size * scale:.3g} m large; if its unit is the millimetre, pass scale=1e-3",
            stacklevel=3,
        )
    return body, corner * scale, size * scale


def _coarse(body: Trimesh, faces: int) -> Trimesh:
    """Return a surface of so many triangles that encloses as much: chords cut off what is round."""
    coarse = body.simplify_quadric_decimation(face_count=faces)
    if not coarse.is_watertight or abs(coarse.volume / body.volume - 1.0) > 0.1:
        raise GraphError(
            f"stokes_resistance: the surface of {len(body.faces)} triangles cannot be simplified to {faces}; "
            "pass more faces="
        )
    middle = coarse.center_mass
    coarse.vertices = middle + (coarse.vertices - middle) * (body.volume / coarse.volume) ** (1.0 / 3.0)
    return coarse


def _triangles(body: Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) of the triangles, and whether the edge after each corner is sharp (n, 3)."""
    pairs = np.sort(body.face_adjacency_edges[body.face_adjacency_angles > SHARP], axis=1)
    edges = np.sort(np.stack([body.faces, np.roll(body.faces, -1, axis=1)], axis=2), axis=2)
    key = lambda a: a[..., 0].astype(np.int64) * len(body.vertices) + a[..., 1]  # noqa: E731
    return np.array(body.triangles), np.isin(key(edges), key(pairs))


def _until_small(corners: np.ndarray, sharp: np.ndarray, faces: int) -> tuple[np.ndarray, np.ndarray]:
    """Split the largest triangles as long as a quarter of the wanted number is not exceeded."""
    while True:
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        large = np.asarray(sides > 0.6 * sides.max())
        if len(corners) + 3 * large.sum() > faces / 4:
            return corners, sharp
        corners, sharp = _split(corners, sharp, large)


def _split(corners: np.ndarray, sharp: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split the triangles that ``which`` marks into four each."""
    c, s = corners[which], sharp[which]
    a, b, d = (0.5 * (c[:, k] + c[:, (k + 1) % 3]) for k in range(3))
    no = np.zeros(len(c), dtype=bool)
    parts = ((c[:, 0], a, d), (a, c[:, 1], b), (d, b, c[:, 2]), (a, b, d))
    sharps = ((s[:, 0], no, s[:, 2]), (s[:, 0], s[:, 1], no), (no, s[:, 1], s[:, 2]), (no, no, no))
    stacked = [np.concatenate([np.stack(p, axis=1) for p in group]) for group in (parts, sharps)]
    return np.concatenate([corners[~which], stacked[0]]), np.concatenate([sharp[~which], stacked[1]])


def _resistance(corners: np.ndarray) -> np.ndarray:
    """Resistance about the origin for unit viscosity, shape (6, 6)."""
    from scipy.linalg import cho_factor, cho_solve

    from rodnet.terms.drag.surface_kernels import single_layer

    corners = np.ascontiguousarray(corners)
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(area, axis=1)
    kept = size > 1e-14 * size.max()  # slivers carry nothing
    corners, area, size = np.ascontiguousarray(corners[kept]), area[kept], size[kept]
    normals, n = area / size[:, None], len(size)
    weights = np.repeat(size, 3)
    A, part = np.zeros((3 * n, 3 * n)), np.empty((3 * n, 3 * n))
    for inner in INNER:
        single_layer(corners, normals, np.einsum("k,nkc->nc", inner, corners), part)
        A += part
    A *= weights[:, None] / len(INNER)
    A += A.T.copy()
    A *= 0.5
    # an even pressure moves nothing: without this its strength is unknown
    even = area.ravel()
    A += 8.0 * np.pi / np.sqrt(size.sum()) * even[:, None] * even
    motion, middle = np.zeros((n, 3, 6)), corners.mean(axis=1)
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3:] = np.stack([np.cross(axis, middle) for axis in np.eye(3)], axis=2)
    load = weights[:, None] * motion.reshape(3 * n, 6)
    R = 8.0 * np.pi * load.T @ cho_solve(cho_factor(A, lower=True, overwrite_a=True), load)
    return 0.5 * (R + R.T)
