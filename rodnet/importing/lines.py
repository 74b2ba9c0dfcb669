"""Line drawings become rods: chains between junctions, which are shared nodes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rodnet.errors import MeshError
from rodnet.graph.material import Material
from rodnet.importing.axes import nodes_and_radii
from rodnet.importing.curves import arc_length
from rodnet.importing.drawing import Chain, draw, edge_counts
from rodnet.importing.findings import Findings, mm, place
from rodnet.importing.line_files import read_lines
from rodnet.importing.report import ImportedFigure, ImportReport
from rodnet.importing.units import check_size, metres_per_unit

if TYPE_CHECKING:
    import trimesh

SAME = 1e-6  # of the drawing's size: points as close as this are one
STUBBY = 0.5  # length of edges, in radii, below which they stand for no piece of a rod
FOLD = -0.999  # cosine between successive edges below which a chain folds back on itself


def from_lines(
    source: str | Path | trimesh.path.Path2D | trimesh.path.Path3D | tuple[Any, Any],
    *,
    material: Material,
    radius: float | None = None,
    units: str | float | None = None,
    edge_length: float | None = None,
    edges: int | None = None,
    join: float | None = None,
    name: str = "rod",
) -> ImportedFigure:
    """Make a stick figure of lines: chains between junctions become rods, junctions shared nodes.

    Parameters
    ----------
    source : path, trimesh path, or (vertices, segments)
        PLY with edges, OBJ with ``l`` records, SWC, DXF or SVG; or arrays of shapes (n, 3) and integer (m, 2).
    material : Material
        Material of the rods.
    radius : float, optional
        Their radius [m]; needed unless the file has radii (SWC).
    units : {"m", "cm", "mm", "um", "in"} or float, optional
        Unit of length of the drawing, or metres per unit. Must be given unless the file says it (SWC is in
        micrometres).
    edge_length : float, optional
        Length of the rods' edges [m], about; by default the points drawn are the nodes.
    edges : int, optional
        Number of edges of every rod instead.
    join : float, optional
        Distance [m] within which points are one, and ends are joined to the line that they meet; by default
        a millionth of the drawing's size.
    name : str
        Rods are called by this name and a number, the longest first.

    Returns
    -------
    ImportedFigure
        With ``figure`` and ``report``.

    Raises
    ------
    MeshError
        If the file cannot be read, its unit or the rods' radius is not known, or a chain folds back.

    Warns
    -----
    UserWarning
        For separate parts and doubtful units; also in ``report.warnings``.
    """
    if not isinstance(material, Material):
        raise MeshError(f"material must be a rodnet.Material, got {type(material).__name__}")
    data, title = read_lines(source)
    findings = Findings(list(data.notes))
    scale = metres_per_unit(units, data.unit, title)
    vertices, segments = data.vertices * scale, data.segments
    if data.radii is None and radius is None:
        raise MeshError(f"{title} has no radii; pass radius= [m] (rodnet import --radius)")
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise MeshError(f"radius = {radius!r} must be positive and finite [m]")
    size = float(np.ptp(vertices[segments].reshape(-1, 3), axis=0).max())
    if not size > 0.0:
        raise MeshError(f"{title}: all its points coincide")
    if data.unit != "um" or units is not None:  # SWC means what it says: cells are small
        check_size(size, scale, findings)
    if join is not None and not (np.isfinite(join) and 0 < join < size):
        raise MeshError(f"join = {join!r} must be a distance [m], smaller than the drawing")
    thick = (
        np.full(segments.shape, radius) if data.radii is None or radius is not None else data.radii * scale
    )
    near = SAME * size if join is None else join
    vertices, segments, thick = _joined(vertices, segments, thick, near, findings)
    if not len(segments):
        raise MeshError(f"{title}: all its lines are shorter than join = {mm(near)}")
    _check_parts(vertices, segments, findings)
    chains = []
    for chain, radii in _chains(segments, thick):
        ring = chain[0] == chain[-1]
        axis = vertices[chain]
        _check_folds(title, axis)
        # each segment has radii of its own at its ends: a profile that may have steps
        stations, profile = np.repeat(axis, 2, axis=0)[1:-1], radii.ravel()
        if edge_length is None and edges is None:
            points, mean = axis, np.sqrt((radii**2).sum(axis=1) / 3.0 + radii[:, 0] * radii[:, 1] / 3.0)
        else:
            count = edge_counts(arc_length(axis)[-1], float(radii.mean()), edge_length, edges, ring)
            points, mean = nodes_and_radii(stations, profile, count)
        ends = () if ring and _is_free(chain, segments) else (int(chain[0]), int(chain[-1]))
        chains.append(Chain(points, mean, ends, 1.0, stations, profile))
    _check_edges(chains, findings)
    figure, rods, junctions, tips = draw(chains, {}, material, name)
    _, compact = np.unique(segments, return_inverse=True)
    count = int(compact.max()) + 1
    parts = connected_components(_links(compact.reshape(-1, 2), count), directed=False)[0]
    loops = len(segments) - count + parts
    report = ImportReport(
        title, rods, junctions, tips, loops, notes=tuple(findings.notes), warnings=tuple(findings.warnings)
    )
    findings.announce(title)
    return ImportedFigure(figure, report)


def _links(pairs: np.ndarray, count: int) -> coo_array:
    return coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))


def _joined(
    vertices: np.ndarray, segments: np.ndarray, thick: np.ndarray, near: float, findings: Findings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge points that coincide, split lines where others end on them, drop what is there twice."""
    pairs = cKDTree(vertices).query_pairs(near, output_type="ndarray")
    _, label = connected_components(_links(pairs, len(vertices)), directed=False)
    weight = np.bincount(label)
    vertices = np.stack([np.bincount(label, vertices[:, k]) / weight for k in range(3)], axis=1)
    segments = label[segments].astype(np.int64)
    segments, thick = _split(vertices, segments, thick, near)
    kept = segments[:, 0] != segments[:, 1]
    _, once = np.unique(np.sort(segments, axis=1), axis=0, return_index=True)
    first = np.zeros(len(segments), dtype=bool)
    first[once] = True
    repeated = int((kept & ~first).sum())
    if repeated:
        findings.note(f"{repeated} lines drawn twice are taken once")
    kept &= first
    return vertices, segments[kept], thick[kept]


def _split(
    vertices: np.ndarray, segments: np.ndarray, thick: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Cut segments at the ends of others that lie on them."""
    free = np.flatnonzero(np.bincount(segments.ravel(), minlength=len(vertices)) == 1)
    a, b = vertices[segments[:, 0]], vertices[segments[:, 1]]
    along = b - a
    square = np.maximum(np.einsum("sc,sc->s", along, along), 1e-300)
    cuts: dict[int, list[tuple[float, int]]] = {}
    for node in free.tolist():
        share = np.einsum("sc,sc->s", vertices[node] - a, along) / square
        off = np.linalg.norm(a + share[:, None] * along - vertices[node], axis=1)
        margin = near / np.sqrt(square)
        hit = (off <= near) & (share > margin) & (share < 1.0 - margin) & (segments != node).all(axis=1)
        for k in np.flatnonzero(hit).tolist():
            cuts.setdefault(k, []).append((float(share[k]), node))
    if not cuts:
        return segments, thick
    whole = np.setdiff1d(np.arange(len(segments)), list(cuts))
    new, radii = [segments[whole]], [thick[whole]]
    for k, places in cuts.items():
        shares, nodes = zip(*sorted(places), strict=True)
        chain = np.array([segments[k, 0], *nodes, segments[k, 1]])
        r = np.interp([0.0, *shares, 1.0], [0.0, 1.0], thick[k])
        new.append(np.stack([chain[:-1], chain[1:]], axis=1))
        radii.append(np.stack([r[:-1], r[1:]], axis=1))
    return np.vstack(new), np.vstack(radii)


def _check_parts(vertices: np.ndarray, segments: np.ndarray, findings: Findings) -> None:
    """Say how far apart the parts of a drawing are that does not hang together."""
    label = connected_components(_links(segments, len(vertices)), directed=False)[1]
    used = np.unique(segments)
    part = np.unique(label[used], return_inverse=True)[1]
    if part.max() == 0:
        return
    one = part == np.argmin(np.bincount(part))
    distance = cKDTree(vertices[used[~one]]).query(vertices[used[one]])[0]
    k = int(np.argmin(distance))
    findings.warn(
        f"{part.max() + 1} separate parts, which are not joined: points {mm(float(distance[k]))} apart at "
        f"{place(vertices[used[one][k]])}; pass join= (a distance in m) to join what is close"
    )


def _check_edges(chains: list[Chain], findings: Findings) -> None:
    """Say which lines are drawn so finely that their points make no nodes."""
    for chain in chains:
        length = float(arc_length(chain.points)[-1]) / (len(chain.points) - 1)
        if len(chain.points) > 3 and length < STUBBY * float(np.mean(chain.radii)):
            findings.warn(
                f"the edges of the line at {place(chain.points[0])} are {mm(length)} long, much shorter than its "
                f"radius of {mm(float(np.mean(chain.radii)))}; pass edge_length= (m), two radii for instance"
            )
            return


def _chains(segments: np.ndarray, thick: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Chains of points between those that have not two segments, and the radii along; rings last."""
    at: dict[int, list[int]] = {}
    for k, (i, j) in enumerate(segments.tolist()):
        at.setdefault(i, []).append(k)
        at.setdefault(j, []).append(k)
    pending = np.ones(len(segments), dtype=bool)
    found = []
    for start in [*(i for i in at if len(at[i]) != 2), *at]:
        for k in at[start]:
            if not pending[k]:
                continue
            chain, radii = [start], []
            while True:
                pending[k] = False
                forward = segments[k, 0] == chain[-1]
                chain.append(int(segments[k, 1 if forward else 0]))
                radii.append(thick[k] if forward else thick[k][::-1])
                rest = [other for other in at[chain[-1]] if pending[other]]
                if len(at[chain[-1]]) != 2 or not rest:
                    break
                k = rest[0]
            found.append((np.array(chain), np.array(radii)))
    return found


def _is_free(chain: np.ndarray, segments: np.ndarray) -> bool:
    """Whether a closed chain is joined to nothing else."""
    return int((segments == chain[0]).sum()) == 2


def _check_folds(title: str, points: np.ndarray) -> None:
    step = np.diff(points, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    sharp = np.flatnonzero(np.einsum("sc,sc->s", step[:-1], step[1:]) < FOLD)
    if len(sharp):
        raise MeshError(
            f"{title}: a line folds back on itself at {place(points[sharp[0] + 1])}; draw it once"
        )
