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
STRIPS, NARROW = 3, 0.25  # strips along sharp edges; the width of each in widths of the one behind it
RIDGES = 1e-3, 1e-2  # of the diagonal: decide between tractions on both sides of a thin plate
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
    inner integrals). Along sharp edges, where tractions are singular, triangles are cut into narrower and
    narrower strips, and the result is extrapolated over the width of the last one.

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
    corners, sharp = _few_triangles(body, int(faces))
    strips = _strips(corners, sharp, faces)
    point = (centre - place) / size
    found = _resistance(_graded(corners, sharp, strips), point)
    if strips:  # the error goes with the width of the strip at the edge
        before = _resistance(_graded(corners, sharp, strips - 1), point)
        found += NARROW / (1.0 - NARROW) * (found - before)
    _check(found, float(np.linalg.norm(corners - point, axis=2).max()))
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


def _few_triangles(body: Trimesh, faces: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, and which of their edges are sharp, so few that strips along those can be paid for, too."""
    target = faces
    corners, sharp = _triangles(_coarse(body, target) if len(body.faces) > target else body)
    while sharp.any() and _strips(corners, sharp, faces) < 2 and target > faces // 4:
        target = int(0.8 * target)
        if len(body.faces) > target:
            corners, sharp = _triangles(_coarse(body, target))
    while True:
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        halved = _halved(
            corners, sharp, np.asarray(sides.max(axis=1) > 0.7 * sides.max()), np.argmax(sides, axis=1)
        )
        # more triangles make a coarse mesh of something round no rounder
        if len(_graded(*halved, STRIPS)) > (faces if sharp.any() else faces / 4):
            return corners, sharp
        corners, sharp = halved


def _strips(corners: np.ndarray, sharp: np.ndarray, faces: float) -> int:
    """Return the number of strips along sharp edges that ``faces`` triangles allow."""
    allowed = [k for k in range(1, STRIPS + 1) if sharp.any() and len(_graded(corners, sharp, k)) <= faces]
    return max(allowed, default=0)


def _coarse(body: Trimesh, faces: int) -> Trimesh:
    """Return a surface of so many triangles with the same moments: chords cut off what is round."""
    from scipy.linalg import sqrtm

    def spread(solid: Trimesh) -> np.ndarray:
        inertia = solid.moment_inertia / solid.volume
        return np.real(sqrtm(0.5 * np.trace(inertia) * np.eye(3) - inertia))

    # as wide in all directions, so that needles and lenses are simplified as balls are
    shape = spread(body)
    coarse = body.copy()
    coarse.vertices = (body.vertices - body.center_mass) @ np.linalg.inv(shape)
    coarse = coarse.simplify_quadric_decimation(face_count=faces)
    if not coarse.is_watertight or len(coarse.faces) > 1.1 * faces or coarse.volume <= 0.0:
        raise GraphError(
            f"stokes_resistance: the surface of {len(body.faces)} triangles cannot be simplified to {faces}; "
            "simplify it first, or pass more faces="
        )
    coarse.vertices = (
        body.center_mass + (coarse.vertices - coarse.center_mass) @ np.linalg.inv(spread(coarse)) @ shape
    )
    if abs(coarse.volume / body.volume - 1.0) > 0.1:
        raise GraphError(
            f"stokes_resistance: the surface of {len(body.faces)} triangles loses its shape in {faces}; "
            "pass more faces="
        )
    return coarse


def _triangles(body: Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) of the triangles, and whether the edge after each corner is sharp (n, 3)."""
    turns = (body.face_adjacency_angles > SHARP) & body.face_adjacency_convex
    pairs = np.sort(body.face_adjacency_edges[turns], axis=1)
    edges = np.sort(np.stack([body.faces, np.roll(body.faces, -1, axis=1)], axis=2), axis=2)
    key = lambda a: a[..., 0].astype(np.int64) * len(body.vertices) + a[..., 1]  # noqa: E731
    return np.array(body.triangles), np.isin(key(edges), key(pairs))


def _halved(
    corners: np.ndarray, sharp: np.ndarray, which: np.ndarray, side: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Halve the triangles that ``which`` marks at one side each."""
    turn = (side[which, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners[which], turn[:, :, None], axis=1), 1, 0)
    ab, bc, ca = np.take_along_axis(sharp[which], turn, axis=1).T
    m, no = 0.5 * (a + b), np.zeros(len(a), dtype=bool)
    parts = [np.stack(p, axis=1) for p in ((a, m, c), (m, b, c))]
    sharps = [np.stack(s, axis=1) for s in ((ab, no, ca), (ab, bc, no))]
    return np.concatenate([corners[~which], *parts]), np.concatenate([sharp[~which], *sharps])


def _graded(corners: np.ndarray, sharp: np.ndarray, strips: int) -> np.ndarray:
    """Cut triangles parallel to their sharp edge, each strip a quarter as wide as the one behind it."""
    if not (strips and sharp.any()):
        return corners
    # triangles with several sharp edges become three with one at most
    several, no = sharp.sum(axis=1) > 1, np.zeros((np.sum(sharp.sum(axis=1) > 1), 2), dtype=bool)
    c, s, centre = corners[several], sharp[several], corners[several].mean(axis=1)
    thirds = [np.stack([c[:, k], c[:, (k + 1) % 3], centre], axis=1) for k in range(3)]
    corners = np.concatenate([corners[~several], *thirds])
    sharp = np.concatenate([sharp[~several], *(np.column_stack([s[:, k], no]) for k in range(3))])
    at_edge = sharp.any(axis=1)
    turn = (np.argmax(sharp[at_edge], axis=1)[:, None] + np.arange(3)) % 3
    a, b, apex = np.moveaxis(np.take_along_axis(corners[at_edge], turn[:, :, None], axis=1), 1, 0)
    height = np.linalg.norm(np.cross(b - a, apex - a), axis=1) / np.linalg.norm(b - a, axis=1)
    # what is narrow already, as the rim of a plate, is left as it is
    finest = 0.5 * NARROW**strips * height.max()
    cuts = np.clip(np.log(finest / height) / np.log(NARROW), 0, strips).astype(int)
    parts = [corners[~at_edge]]
    for k in range(strips, 0, -1):
        cut = cuts >= k
        share = NARROW**k
        left, right = (p + share * (apex - p) for p in (a, b))
        parts += [np.stack(p, axis=1)[cut] for p in ((a, b, right), (a, right, left))]
        a, b = np.where(cut[:, None], left, a), np.where(cut[:, None], right, b)
    return np.concatenate([*parts, np.stack([a, b, apex], axis=1)])


def _resistance(corners: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Resistance about a point for unit viscosity, shape (6, 6)."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    from rodnet.terms.drag.surface_kernels import averaged_layer

    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(area, axis=1)
    kept = size > 1e-14 * size.max()  # slivers carry nothing
    corners, area, size = np.ascontiguousarray(corners[kept]), area[kept], size[kept]
    n = len(size)
    A = np.empty((3 * n, 3 * n))
    averaged_layer(corners, area / size[:, None], size, A)
    ridge = A.diagonal().copy()
    # an even pressure moves nothing: without this its strength is unknown
    even = area.ravel()
    A += 8.0 * np.pi / np.sqrt(size.sum()) * even[:, None] * even
    motion, middle = np.zeros((n, 3, 6)), corners.mean(axis=1) - about
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3:] = np.stack([np.cross(axis, middle) for axis in np.eye(3)], axis=2)
    load = np.repeat(size, 3)[:, None] * motion.reshape(3 * n, 6)
    for share in RIDGES:
        A.ravel()[:: 3 * n + 1] += share * ridge
        try:
            R = 8.0 * np.pi * load.T @ cho_solve(cho_factor(A, lower=True), load)
        except LinAlgError:
            continue
        return 0.5 * (R + R.T)
    return np.full((6, 6), np.nan)


def _check(R: np.ndarray, radius: float) -> None:
    """Refuse what no body inside of a sphere can have: it resists, but less than the sphere (Hill & Power 1956)."""
    sphere = np.repeat([6.0 * np.pi * radius, 8.0 * np.pi * radius**3], 3)
    share = np.full(6, np.nan)
    if np.all(np.isfinite(R)):
        share = np.linalg.eigvalsh(R / np.sqrt(np.outer(sphere, sphere)))
    if not (share[0] > 1e-12 and share[-1] < 1.01):
        raise GraphError(
            "stokes_resistance: the triangles are too flat, or run through one another, and give no resistance that a "
            "body can have; make an even mesh of the surface, e.g. by trimesh.remesh.subdivide_to_size, "
            "or pass more faces="
        )
