"""Figures of imports: the surface and the rods that stand for it (matplotlib)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.storage import check_writable
from rodnet.viz.plots import MEASURED, PREDICTED, _figure, _tidy, _unit, _views

if TYPE_CHECKING:
    from rodnet.importing.report import ImportedFigure

SHOWN_FACES = 20_000


def plot_import(found: ImportedFigure, path: str | Path) -> Path:
    """Draw an imported stick figure in its surface: axes, nodes, radii and names of rods.

    Two views along the axes (one, if the shape is plane).

    Parameters
    ----------
    found : ImportedFigure
        What `rodnet.from_mesh` or `rodnet.from_lines` returned.
    path : path
        The PNG (or PDF, SVG) to write.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    path = check_writable(path)
    x = found.figure.points if found.surface is None else found.surface.vertices
    views = _views(x)
    unit, scale = _unit(float(np.ptp(x, axis=0).max()))
    shape = np.array([np.ptp(x, axis=0)[[i, j]] for i, j in views])
    height = 6.0 / len(views) * float(np.clip(np.max(shape[:, 1] / shape[:, 0]), 0.25, 1.6)) + 0.8
    figure = _figure(7.5, height)
    for ax, (i, j) in zip(np.atleast_1d(figure.subplots(1, len(views))), views, strict=True):
        if found.surface is not None:
            _draw_surface(ax, found.surface, i, j, scale)
        _draw_rods(ax, found, i, j, scale)
        ax.set(xlabel=f"{'xyz'[i]} [{unit}]", ylabel=f"{'xyz'[j]} [{unit}]", aspect="equal")
        _tidy(ax)
    figure.savefig(path, dpi=150)
    return path


def _draw_surface(ax: Any, surface: Any, i: int, j: int, scale: float) -> None:
    from matplotlib.collections import PolyCollection

    step = -(-len(surface.faces) // SHOWN_FACES)
    triangles = scale * surface.vertices[surface.faces[::step]][:, :, [i, j]]
    ax.add_collection(
        PolyCollection(triangles, facecolor="0.75", edgecolor="0.6", lw=0.15, alpha=0.25, zorder=1)
    )


def _draw_rods(ax: Any, found: ImportedFigure, i: int, j: int, scale: float) -> None:
    from matplotlib.collections import EllipseCollection

    x = found.figure.points
    for name, spec in found.figure.specs.items():
        nodes = [*spec.nodes, spec.nodes[0]] if spec.closed else spec.nodes
        line = scale * x[nodes][:, [i, j]]
        ax.plot(*line.T, color=MEASURED, lw=1.6, marker="o", ms=2.5, zorder=3)
        size = 2.0 * scale * np.array([section.radius for section in spec.sections])
        circles = EllipseCollection(
            size, size, 0.0 * size, units="xy", offsets=0.5 * (line[1:] + line[:-1]), transOffset=ax.transData,
            facecolor="none", edgecolor=MEASURED, lw=0.6, alpha=0.5, zorder=2,
        )  # fmt: skip
        ax.add_collection(circles)
        ax.annotate(
            name, line[len(line) // 2], xytext=(4, 4), textcoords="offset points", fontsize=8, zorder=5
        )
    for junction in found.report.junctions:
        ax.plot(*(scale * np.array(junction.position)[[i, j]]), "o", color=PREDICTED, ms=5, zorder=4)
    ax.autoscale_view()
