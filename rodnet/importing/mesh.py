"""Surface meshes of limbed shapes become stick figures with radii."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import MeshError
from rodnet.graph.material import Material
from rodnet.importing.axes import finish, fit_axes, miss, nodes_and_radii
from rodnet.importing.coverage import cover
from rodnet.importing.curves import arc_length
from rodnet.importing.drawing import Chain, draw, edge_counts
from rodnet.importing.findings import Findings, mm, place
from rodnet.importing.limbs import Limb, LimbGraph
from rodnet.importing.refine import refine
from rodnet.importing.report import ImportedFigure, ImportReport
from rodnet.importing.sections import Sections, Slicer
from rodnet.importing.surface import Surface, check_overlap, read_surface
from rodnet.importing.wavefronts import Regions, wavefront_regions

if TYPE_CHECKING:
    from pathlib import Path

    import trimesh

BAND = 0.7  # width of the distance bands, and
TRIANGLE = 0.5  # longest edge, in thicknesses 2 V/A: the radius, of a long cylinder
SHEET = 4.0  # pieces of a distance band this much wider than the thickness are no rings
SLENDER = 2.0  # the least length of the slenderest limb, in widths
STUBBY = 4.0  # lengths, in widths, below which rod theory is in doubt
COVERED = 0.3  # share of the surface below which the rods are of another shape
FLAT = 1.3  # ratio of radii of gyration above which a limb is not round


def from_mesh(
    source: str | Path | trimesh.Trimesh | trimesh.Scene,
    *,
    material: Material,
    units: str | float | None = None,
    edge_length: float | None = None,
    edges: int | None = None,
    name: str = "limb",
) -> ImportedFigure:
    """Make a stick figure with radii from the surface mesh of a limbed shape.

    Limbs become rods, which share nodes where they meet; radii vary along them, those of circles of the
    area of each cross-section. The method: docs, theory, robots from meshes.

    Parameters
    ----------
    source : path, trimesh.Trimesh or trimesh.Scene
        A surface: STL, OBJ, PLY, GLB, OFF or 3MF.
    material : Material
        Material of the rods.
    units : {"m", "cm", "mm", "um", "in"} or float, optional
        Unit of length of the mesh, or metres per unit. Must be given unless the file says it (GLB does).
    edge_length : float, optional
        Length of the rods' edges [m], about; by default two radii of the rod, six edges at least.
    edges : int, optional
        Number of edges of every rod instead.
    name : str
        Rods are called by this name and a number, the longest first.

    Returns
    -------
    ImportedFigure
        With ``figure``, to be edited or built, and ``report``: rods, junctions, coverage, residual, warnings.

    Raises
    ------
    MeshError
        If the file cannot be read, its unit is not known, it has separate parts, its surface is torn, or
        the shape has no limbs.

    Warns
    -----
    UserWarning
        For everything that may make it another robot than was meant; also in ``report.warnings``.
    """
    if not isinstance(material, Material):
        raise MeshError(f"material must be a rodnet.Material, got {type(material).__name__}")
    findings = Findings()
    closed, title = read_surface(source, units, findings)
    findings.announce(title)
    thickness = 2.0 * closed.volume / closed.area
    check_overlap(closed, thickness, findings)
    surface = Surface(*refine(closed.vertices, closed.faces, TRIANGLE * thickness))
    regions = wavefront_regions(surface.vertices, surface.faces, BAND * thickness)
    _check_sheet(title, regions, thickness)
    slicer = Slicer(surface.vertices, surface.faces)
    graph = LimbGraph(regions)
    fit_axes(graph, slicer)
    lost = [limb for limb in graph.limbs if limb.sections is None]
    if lost:
        where = place(lost[0].path.mean(axis=0))
        raise MeshError(
            f"{title}: no closed cross-section was found of the limb at {where}; is the surface closed there?"
        )
    _check_limbs(title, graph, closed, findings)
    chains = []
    for limb in graph.limbs:
        axis, radius, sections = finish(limb, graph, slicer)
        _check_round(sections, findings)
        ends = () if limb.closed else tuple(limb.ends)
        count = edge_counts(
            arc_length(axis)[-1],
            float(np.median(radius)),
            edge_length,
            edges,
            ring=len(set(ends)) < 2,
        )
        points, radii = nodes_and_radii(axis, radius, count)
        chains.append(Chain(points, radii, ends, float(sections.aspect.max()), axis, radius))
    misses = {node: miss(graph, node)[0] for node in graph.nodes if graph.degree(node) > 1}
    figure, rods, junctions, tips = draw(chains, misses, material, name)
    coverage = cover(surface, chains, findings)
    if coverage.share < COVERED:
        raise MeshError(
            f"{title} is no shape of limbs: the rods that were found stand for {100.0 * coverage.share:.0f} % of its "
            "surface; draw its middle by rods, or as a stiff part (fig.rigid), its drag by rodnet.stokes_resistance"
        )
    report = ImportReport(
        title, rods, junctions, tips, graph.loops,
        coverage=coverage.share,
        radius_residual=coverage.residual,
        volume_ratio=sum(np.pi * rod.radius**2 * rod.length for rod in rods) / closed.volume,
        faces=len(closed.faces),
        notes=tuple(findings.notes),
        warnings=tuple(findings.warnings),
    )  # fmt: skip
    findings.announce(title)
    return ImportedFigure(figure, report, closed)


def _check_sheet(title: str, regions: Regions, thickness: float) -> None:
    order = np.argsort(regions.spread)
    share = np.cumsum(regions.area[order])
    width = 2.0 * float(regions.spread[order][np.searchsorted(share, 0.5 * share[-1])])
    if width > 2.0 * SHEET * thickness:
        raise MeshError(
            f"{title} is a plate, a thin shell or a tube with a bore, about {mm(thickness)} thick and "
            f"{mm(width)} wide, and no shape of limbs; fill it, or draw its middle by rods"
        )


def _slenderness(limb: Limb, graph: LimbGraph) -> float:
    return graph.length(limb) / float(np.median(limb.sections.width))  # type: ignore[union-attr]


def _check_limbs(title: str, graph: LimbGraph, surface: Surface, findings: Findings) -> None:
    """Refuse what is no robot of rods, and doubt what hardly is."""
    slender = [_slenderness(limb, graph) for limb in graph.limbs]
    if max(slender) < SLENDER:
        raise MeshError(
            f"{title} is not limbed: its slenderest limb is {max(slender):.2g} times as long as wide. Rods want ten "
            "and more; draw it as a stiff part with fig.rigid(...), its drag is rodnet.stokes_resistance(mesh, ...)"
        )
    for limb, ratio in zip(graph.limbs, slender, strict=True):
        middle = place(limb.path[len(limb.path) // 2])
        if limb.sections is not None and limb.sections.hollow.mean() > 0.5:
            raise MeshError(
                f"{title}: the limb at {middle} is a tube with an inner wall; fill its bore before the import, "
                "and give the rod section=rodnet.hollow(...) afterwards"
            )
        if ratio < STUBBY:
            findings.warn(
                f"the limb at {middle} is only {ratio:.2g} times as long as wide, which rod theory does not cover; "
                "a stiff part (fig.rigid) may stand for it better"
            )
    if surface.handles != graph.loops:
        findings.warn(
            f"the surface has {surface.handles} handles and the rods have {graph.loops} loops; a bore, a dimple "
            "through the shape or a narrow slot is not in the figure"
        )
    for node in graph.nodes:
        if graph.degree(node) > 2:
            off, radius = miss(graph, node)
            if off > 0.5 * radius:
                findings.warn(
                    f"the axes at the junction at {place(graph.nodes[node])} miss it by up to {mm(off)}: a body joins "
                    "them there; the rods run to its middle, a stiff part (fig.rigid) may stand for it better"
                )


def _check_round(sections: Sections, findings: Findings) -> None:
    k = int(np.argmax(sections.aspect))
    if np.median(sections.aspect) > FLAT:
        findings.warn(
            f"the limb at {place(sections.centroid[k])} is not round, its section is {sections.aspect[k]:.2g} times "
            "as wide as thick; the rod is round, of equal area: give it section=rodnet.elliptic(...) for its stiffness"
        )
