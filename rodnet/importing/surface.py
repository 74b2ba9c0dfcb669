"""From a mesh as it comes to one closed surface, oriented outward, in metres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rodnet.errors import MeshError
from rodnet.importing.findings import Findings, mm, place
from rodnet.importing.units import check_size, metres_per_unit
from rodnet.importing.wavefronts import unique_edges

if TYPE_CHECKING:
    import trimesh

SURFACES = (".stl", ".obj", ".ply", ".glb", ".gltf", ".off", ".3mf")
MANY_FACES = 100_000


@dataclass(frozen=True)
class Surface:
    """A closed triangle surface.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Positions [m].
    faces : ndarray, shape (m, 3)
        Corners, counter-clockwise seen from outside.
    """

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def area(self) -> float:
        """Area [m^2]."""
        return float(0.5 * np.linalg.norm(self._cross(), axis=1).sum())

    @property
    def volume(self) -> float:
        """Volume inside [m^3]."""
        middle = self.vertices[self.faces].mean(axis=1) - self.vertices.mean(axis=0)
        return float(np.einsum("fc,fc->", middle, self._cross()) / 6.0)

    @property
    def handles(self) -> int:
        """Number of handles: 0 for a ball, 1 for a torus."""
        edges, _ = unique_edges(self.faces)
        return 1 - (len(np.unique(self.faces)) - len(edges) + len(self.faces)) // 2

    def _cross(self) -> np.ndarray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)


def read_surface(source: Any, units: Any, findings: Findings) -> tuple[Surface, str]:
    """Load, check and mend a surface mesh.

    Parameters
    ----------
    source : path or trimesh.Trimesh or trimesh.Scene
        The mesh.
    units : str, float or None
        Its unit of length.
    findings : Findings
        Takes notes and warnings.

    Returns
    -------
    surface : Surface
        One closed surface.
    name : str
        What messages call it.

    Raises
    ------
    MeshError
        If there is no such file, it holds no surface, or the surface is beyond mending.
    """
    mesh, name = _load(source)
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)
    if not len(faces):
        raise MeshError(f"{name} has no faces; points alone do not say what is joined: export a surface")
    if not np.all(np.isfinite(vertices[faces])):
        raise MeshError(f"{name} has vertices that are not finite numbers; export it again")
    scale = metres_per_unit(units, mesh.units, name)
    extent = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max())
    if not extent > 0.0:
        raise MeshError(f"{name}: all its vertices coincide; export it again")
    check_size(extent * scale, scale, findings)
    if len(faces) > MANY_FACES:
        findings.warn(
            f"{len(faces):,} faces take long (half a minute per million) and say no more than a few thousand would; "
            "decimate, e.g. mesh.simplify_quadric_decimation(face_count=50_000)"
        )
        findings.announce(name)  # before the wait
    vertices, faces = merge(vertices * scale, faces, extent * scale, findings)
    if not len(faces):
        raise MeshError(f"{name}: all its faces are degenerate, without any area; export it again")
    faces = _orient(name, faces, findings)
    surface = _close(name, Surface(vertices, faces), findings)
    return _unite(name, surface, findings), name


def _load(source: Any) -> tuple[trimesh.Trimesh, str]:
    import trimesh

    name = "the mesh"
    if isinstance(source, str | Path):
        path = Path(source)
        name = f"'{path.name}'"
        if not path.is_file():
            raise MeshError(f"there is no file '{path}'")
        if path.suffix.lower() not in SURFACES:
            raise MeshError(
                f"{name}: surfaces are read from {', '.join(SURFACES)}; drawings of lines by rodnet.from_lines"
            )
        try:
            source = trimesh.load(path, process=False)
        except Exception as error:  # trimesh's readers raise whatever their formats bring about
            raise MeshError(f"{name} cannot be read as {path.suffix[1:].upper()}: {error}") from error
        if path.suffix.lower() in (".glb", ".gltf"):
            source.units = "m"  # by the standard
    if isinstance(source, trimesh.Scene) and source.geometry:
        units = source.units
        solid = [g for g in source.geometry.values() if isinstance(g, trimesh.Trimesh)]
        if not solid:
            raise MeshError(
                f"{name} holds no surface; lines are read by rodnet.from_lines (rodnet import --lines)"
            )
        source = source.to_mesh()
        source.units = units
    if isinstance(source, trimesh.Scene):
        raise MeshError(f"{name} has no faces, it is empty; export it again")
    if isinstance(source, trimesh.path.path.Path | trimesh.PointCloud):
        raise MeshError(
            f"{name} holds lines or points and no surface; lines are read by rodnet.from_lines (rodnet import --lines)"
        )
    if not isinstance(source, trimesh.Trimesh):
        raise MeshError(f"a surface is a path or a trimesh.Trimesh, not {type(source).__name__}")
    return source, name


def merge(
    vertices: np.ndarray, faces: np.ndarray, size: float, findings: Findings
) -> tuple[np.ndarray, np.ndarray]:
    """Merge coincident vertices, drop faces that collapse or are there twice.

    Vertices that are merely close are merged only if the surface is not closed without: slivers
    that close it would be lost.
    """
    for tolerance in (0.0, 1e-7 * size):
        key = np.round((vertices - vertices.min(axis=0)) / tolerance) if tolerance else vertices
        first, inverse = _distinct(key)
        merged = inverse[faces]
        kept = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
        if kept.any() and (np.bincount(unique_edges(merged[kept])[1].ravel()) == 2).all():
            break
    else:
        _, once = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
        kept &= np.isin(np.arange(len(merged)), once)
    if not kept.all():
        findings.note(f"{int((~kept).sum())} degenerate or repeated faces left out")
    used, faces = np.unique(merged[kept], return_inverse=True)
    return vertices[first][used], faces.reshape(-1, 3)


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First of each kind of row, and the kind of each row; np.unique takes minutes for millions of rows."""
    order = np.lexsort(rows.T[::-1])
    new = np.concatenate([[True], np.any(rows[order[1:]] != rows[order[:-1]], axis=1)])
    kind = np.empty(len(rows), dtype=np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind


def _directed(faces: np.ndarray) -> np.ndarray:
    """Directed edges of all faces, shape (3 m, 2); edge k of a face at 3 f + k."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """Pairs of directed edges (rows of `_directed`) at the edges that exactly two faces share."""
    edge = unique_edges(faces)[1].ravel()
    order = np.argsort(edge, kind="stable")
    edge = edge[order]
    pair = np.flatnonzero((edge[1:] == edge[:-1]) & (np.bincount(edge)[edge[1:]] == 2))
    return np.stack([order[pair], order[pair + 1]], axis=1)


def _orient(name: str, faces: np.ndarray, findings: Findings) -> np.ndarray:
    """Turn faces so that neighbours agree: they run along a shared edge in opposite directions."""
    pairs = _neighbours(faces)
    start = _directed(faces)[:, 0]
    odd = start[pairs[:, 0]] == start[pairs[:, 1]]
    if not odd.any():
        return faces
    # every face twice, as it is and turned over; neighbours are linked where they agree
    n = len(faces)
    f, g = (pairs // 3).T
    i, j = np.concatenate([f, f + n]), np.concatenate([g + n * odd, g + n * ~odd])
    links = coo_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(2 * n, 2 * n))
    upper, lower = connected_components(links, directed=False)[1].reshape(2, n)
    if (upper == lower).any():
        raise MeshError(
            f"{name}: the surface has one side only, like a Möbius strip; there is no inside to it"
        )
    turned = upper > lower
    findings.note("faces turned so that neighbours agree which side is outside")
    return np.where(turned[:, None], faces[:, ::-1], faces)


def _close(name: str, surface: Surface, findings: Findings) -> Surface:
    """Close holes by fans from their middle."""
    vertices, faces = surface.vertices, surface.faces
    _, face_edges = unique_edges(faces)
    uses = np.bincount(face_edges.ravel())
    crowded = int((uses > 2).sum())
    if crowded:
        findings.warn(
            f"{crowded} edges belong to more than two faces, so that inside and outside are not told apart there; "
            "make it one solid in the CAD program (union) and export again"
        )
    rim = _directed(faces)[(uses == 1)[face_edges.ravel()]]
    if not len(rim):
        return surface
    if len(np.unique(rim[:, 0])) < len(rim) or len(np.unique(rim[:, 1])) < len(rim):
        raise MeshError(
            f"{name}: the surface is torn, {len(rim)} edges have a face on one side only and form no plain holes; "
            "mend it first (trimesh.repair, MeshLab, or export it as one solid)"
        )
    n = len(vertices)
    label = connected_components(coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(n, n)))[1]
    hole = np.unique(label[rim[:, 0]], return_inverse=True)[1].reshape(-1)
    total = np.bincount(hole)
    middle = np.stack([np.bincount(hole, vertices[rim[:, 0], k]) / total for k in range(3)], axis=1)
    span = np.zeros(len(total))
    np.maximum.at(span, hole, 2.0 * np.linalg.norm(vertices[rim[:, 0]] - middle[hole], axis=1))
    largest = int(np.argmax(span))
    findings.warn(
        f"the surface is open: {len(total)} hole{'s' * (len(total) > 1)} closed, the largest {mm(span[largest])} "
        f"across at {place(middle[largest])}; check the rods there, or close it before the import"
    )
    fans = np.column_stack([rim[:, 1], rim[:, 0], n + hole])
    return Surface(np.vstack([vertices, middle]), np.vstack([faces, fans]))


def _shells(surface: Surface) -> list[Surface]:
    """Connected parts, by falling size."""
    # over edges of two faces: shells that touch at a corner or an edge are not one
    face = _neighbours(surface.faces) // 3
    n = len(surface.faces)
    joined = coo_array((np.ones(len(face), dtype=np.int8), (face[:, 0], face[:, 1])), shape=(n, n))
    of_face = connected_components(joined, directed=False)[1]
    parts = []
    for k in np.unique(of_face):
        used, faces = np.unique(surface.faces[of_face == k], return_inverse=True)
        parts.append(Surface(surface.vertices[used], faces.reshape(-1, 3)))
    return sorted(parts, key=lambda part: -part.area)


def _unite(name: str, surface: Surface, findings: Findings) -> Surface:
    """Make one solid of several shells that overlap; leave cavities out."""
    shells = _shells(surface)
    solids = []
    for k, shell in enumerate(shells):
        others = [s for i, s in enumerate(shells) if i != k]
        inside = any(
            winding_number(other, shell.vertices[:1])[0] > 0.5 for other in others if other.volume > 0
        )
        if shell.volume < 0 and inside:
            findings.warn(
                f"a cavity of {mm(float(np.ptp(shell.vertices, axis=0).max()))} is left out, the rods are solid; "
                "give hollow ones section=rodnet.hollow(...)"
            )
            continue
        solids.append(shell if shell.volume > 0 else Surface(shell.vertices, shell.faces[:, ::-1]))
    if len(solids) == 1:
        return solids[0]
    import trimesh

    try:
        whole = trimesh.boolean.union(
            [trimesh.Trimesh(s.vertices, s.faces, process=False) for s in solids], engine="manifold"
        )
    except Exception as error:  # the engine's own, e.g. of a shell that is not manifold
        raise MeshError(
            f"{name} has {len(solids)} shells that cannot be united ({error}); make it one solid and export again"
        ) from error
    size = float(np.ptp(surface.vertices, axis=0).max())
    vertices, faces = merge(np.asarray(whole.vertices), np.asarray(whole.faces), size, Findings())
    parts = _shells(Surface(vertices, faces))
    parts = [part for part in parts if part.volume > 1e-9 * size**3]
    if len(parts) > 1:
        sizes = ", ".join(
            f"{mm(float(np.ptp(p.vertices, axis=0).max()))} at {place(p.vertices.mean(axis=0))}"
            for p in parts[:4]
        )
        raise MeshError(
            f"{name} has {len(parts)} separate parts ({sizes}{', ...' * (len(parts) > 4)}); join them in the file, or "
            "import them one by one: for part in mesh.split(): rodnet.from_mesh(part, ...)"
        )
    findings.note(f"{len(solids)} shells that overlap united into one solid")
    return parts[0]


def winding_number(surface: Surface, points: np.ndarray) -> np.ndarray:
    """How often a closed surface winds around points: 1 inside, 0 outside, 2 where it overlaps itself."""
    out = np.empty(len(points))
    corners = surface.vertices[surface.faces]
    for k, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.sqrt(np.einsum("fc,fc->f", v, v)) for v in (a, b, c))
        volume = np.einsum("fc,fc->f", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("fc,fc->f", u, v) for u, v in ((a, b), (b, c), (c, a)))
        out[k] = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2.0 * np.pi)
    return out


def check_overlap(surface: Surface, thickness: float, findings: Findings) -> None:
    """Warn where the surface runs through itself: just outside of it one is inside again."""
    corners = surface.vertices[surface.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    samples = int(np.clip(4_000_000 // len(area), 16, 256))
    share = np.cumsum(area) / area.sum()
    chosen = np.unique(np.searchsorted(share, (np.arange(samples) + 0.5) / samples))
    # not the very middle: the middles of a regular mesh lie on its planes of symmetry
    points = np.einsum("fkc,k->fc", corners[chosen], [0.29, 0.34, 0.37])
    outside = points + 1e-3 * thickness * cross[chosen] / area[chosen, None]
    inside = winding_number(surface, outside) > 0.5
    if inside.sum() > max(1.0, 0.01 * len(inside)):  # one sample alone may sit in a sliver
        findings.warn(
            f"the surface runs through itself: about {100.0 * inside.mean():.0f} % of it lie inside the shape, e.g. at "
            f"{place(points[inside][0])}; limbs that cross there are not joined: make it one solid (union)"
        )
