"""What an import returns: the figure, and how well it stands for the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.importing.findings import digits, mm, place, unit_of

if TYPE_CHECKING:
    from rodnet.graph.stick_figure import StickFigure
    from rodnet.importing.surface import Surface


@dataclass(frozen=True)
class ImportedRod:
    """One rod of an import.

    Attributes
    ----------
    name : str
        Its name in the figure.
    length : float
        Length from node to node [m].
    edges : int
        Number of its edges.
    radius : float
        Mean radius [m], that of a uniform rod of the same volume.
    s, profile : ndarray, shape (n,)
        Arc lengths [m] and the radii there [m].
    aspect : float
        Largest ratio of the principal radii of gyration of its cross-sections [1].
    closed : bool
        Whether it is a ring.
    """

    name: str
    length: float
    edges: int
    radius: float
    s: np.ndarray
    profile: np.ndarray
    aspect: float = 1.0
    closed: bool = False


@dataclass(frozen=True)
class ImportedJunction:
    """A node where three rods or more meet.

    Attributes
    ----------
    at : str
        Its node, as a selector.
    position : tuple of float
        Its position [m].
    rods : tuple of str
        The rods that meet.
    miss : float
        Largest distance at which their axes pass it [m].
    """

    at: str
    position: tuple[float, ...]
    rods: tuple[str, ...]
    miss: float = 0.0


@dataclass(frozen=True)
class ImportReport:
    """How well a stick figure stands for the file it was made from.

    Attributes
    ----------
    source : str
        What was imported.
    rods : tuple of ImportedRod
        The rods.
    junctions : tuple of ImportedJunction
        Nodes of three rods or more.
    tips : int
        Number of free ends.
    loops : int
        Number of independent loops.
    coverage : float
        Share of the surface's area that lies within a quarter radius of the rods' surfaces [1]; NaN of line data.
    radius_residual : float
        Root mean square, over what is covered, of the distance between the two surfaces [m]; NaN of line data.
    volume_ratio : float
        Volume of the rods over that of the mesh [1], with the overlap at junctions counted in every rod; NaN of
        line data.
    faces : int
        Number of triangles of the mesh.
    notes, warnings : tuple of str
        What was mended, and what to look after.
    """

    source: str
    rods: tuple[ImportedRod, ...]
    junctions: tuple[ImportedJunction, ...]
    tips: int
    loops: int
    coverage: float = float("nan")
    radius_residual: float = float("nan")
    volume_ratio: float = float("nan")
    faces: int = 0
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        values = asdict(self)
        for rod in values["rods"]:
            rod["s"], rod["profile"] = rod["s"].tolist(), rod["profile"].tolist()
        return values

    def __str__(self) -> str:
        count = lambda n, word: f"{n} {word}{'s' * (n != 1)}"  # noqa: E731
        total = sum(rod.length for rod in self.rods)
        lines = [
            f"{self.source}: {count(len(self.rods), 'rod')}, {count(len(self.junctions), 'junction')}, "
            f"{count(self.tips, 'tip')}, {count(self.loops, 'loop')}; {mm(total)} in all"
        ]
        if self.coverage == self.coverage:
            lines.append(
                f"  covers {100 * self.coverage:.1f} % of the surface, off by {mm(self.radius_residual)} (rms); "
                f"volume {100 * self.volume_ratio:.1f} % of the mesh's"
            )
        lines += self._table() + self._joints()
        lines += [f"  note: {text}" for text in self.notes]
        lines += [f"  warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    def _table(self) -> list[str]:
        """The rods as rows, each column in one unit."""
        long, length = unit_of(*(rod.length for rod in self.rods))
        thick, radius = unit_of(*(float(rod.profile.max()) for rod in self.rods))
        rows = [("rod", f"length [{long}]", f"radius [{thick}]", "edges", "")]
        for rod in self.rods:
            low, mean, high = (digits(r / radius) for r in (rod.profile.min(), rod.radius, rod.profile.max()))
            even = rod.profile.max() - rod.profile.min() < 0.01 * rod.profile.max()
            shown = mean if even else f"{mean} ({low} to {high})"
            rows.append((rod.name, digits(rod.length / length), shown, str(rod.edges), "ring" * rod.closed))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]

    def _joints(self) -> list[str]:
        """The junctions, a line each, all in one unit."""
        unit = unit_of(*(abs(x) for junction in self.junctions for x in junction.position))
        lines = []
        for junction in self.junctions:
            near = (
                f", axes pass it at {digits(junction.miss / unit[1])} {unit[0]}"
                if junction.miss > 1e-6
                else ""
            )
            where = place(np.array(junction.position), unit)
            lines.append(f"  {junction.at} joins {', '.join(junction.rods)} at {where}{near}")
        return lines


@dataclass(frozen=True)
class ImportedFigure:
    """A stick figure made from a file.

    Attributes
    ----------
    figure : StickFigure
        The figure, to be edited and built like one drawn by hand.
    report : ImportReport
        How well it stands for the file.
    surface : Surface or None
        The closed surface in metres, of a mesh.
    """

    figure: StickFigure
    report: ImportReport
    surface: Surface | None = None
