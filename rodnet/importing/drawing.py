"""From chains of points between nodes to the rods of a stick figure."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from rodnet.errors import MeshError
from rodnet.graph.material import Material
from rodnet.graph.selectors import check_name
from rodnet.graph.stick_figure import StickFigure
from rodnet.importing.curves import arc_length
from rodnet.importing.report import ImportedJunction, ImportedRod


class Chain(NamedTuple):
    """A rod to be.

    Attributes
    ----------
    points : ndarray, shape (n + 1, 3)
        Nodes [m]; of a ring the first again at the end.
    radii : ndarray, shape (n,)
        Radii of the edges [m].
    ends : tuple of int
        Numbers of the nodes at its ends; empty of a ring that is joined to nothing.
    aspect : float
        Largest ratio of its sections' principal radii of gyration.
    axis, profile : ndarray, shape (m, 3) and (m,)
        What points and radii were taken from [m].
    """

    points: np.ndarray
    radii: np.ndarray
    ends: tuple[int, ...]
    aspect: float
    axis: np.ndarray
    profile: np.ndarray


def edge_counts(
    length: float, radius: float, edge_length: float | None, edges: int | None, ring: bool
) -> int:
    """Return the number of edges of a rod: given, or from the length of an edge, or two radii each."""
    if edges is not None:
        if edge_length is not None:
            raise MeshError("give edges= (of every rod) or edge_length=, not both")
        if isinstance(edges, bool) or not isinstance(edges, int | np.integer) or edges < 1:
            raise MeshError(f"edges = {edges!r} must be a positive integer")
        return max(int(edges), 4 if ring else 1)
    if edge_length is not None and not (np.isfinite(edge_length) and edge_length > 0):
        raise MeshError(f"edge_length = {edge_length!r} must be positive and finite [m]")
    least = 4 if ring else 1
    if edge_length is None:
        edge_length, least = 2.0 * radius, 12 if ring else 6
    return max(round(length / edge_length), least)


def draw(
    chains: list[Chain], misses: dict[int, float], material: Material, name: str
) -> tuple[StickFigure, tuple[ImportedRod, ...], tuple[ImportedJunction, ...], int]:
    """Draw chains as rods that share nodes; those that start and end at one node become two rods.

    Returns
    -------
    figure : StickFigure
        The figure.
    rods, junctions : tuple
        What it has, for the report.
    tips : int
        Number of free ends.
    """
    check_name(name)
    chains = [part for chain in chains for part in _without_returns(chain, chains)]
    degree = Counter(node for chain in chains for node in chain.ends)
    chains = [_outward(chain, degree) for chain in chains]
    figure = StickFigure()
    rods: list[ImportedRod] = []
    known: dict[int, str] = {}  # selectors of the nodes drawn so far
    places: dict[int, np.ndarray] = {}
    members: dict[int, list[str]] = {}
    for number, chain in enumerate(_in_order(chains)):
        rod = f"{name}{number}"
        points: list[Any] = list(chain.points)
        if not chain.ends:
            points.pop()
        for end, node, label in zip((0, -1), chain.ends, ("start", "end"), strict=False):
            members.setdefault(node, []).append(rod)
            if node in known:
                points[end] = known[node]
            else:
                known[node], places[node] = f"{rod}.{label}", chain.points[end]
        uniform = np.ptp(chain.radii) <= 1e-3 * chain.radii.mean()
        radius: Any = float(chain.radii.mean()) if uniform else chain.radii
        figure.rod(rod, points, material=material, radius=radius, closed=not chain.ends)
        rods.append(_described(rod, chain))
    junctions = tuple(
        ImportedJunction(
            at, tuple(map(float, places[node])), tuple(dict.fromkeys(members[node])), misses.get(node, 0.0)
        )
        for node, at in known.items()
        if degree[node] > 2
    )
    return figure, tuple(rods), junctions, sum(count == 1 for count in degree.values())


def _in_order(chains: list[Chain]) -> list[Chain]:
    """The longest first; what is equally long by thickness, then by place, however the file was numbered."""
    scale = max(arc_length(chain.points)[-1] for chain in chains)

    def key(chain: Chain) -> tuple[float, ...]:
        thick, middle = float(chain.radii.mean()), chain.points.mean(axis=0)
        return (
            -round(arc_length(chain.points)[-1] / scale, 4),
            -round(thick / scale, 5),
            *np.round(middle / scale, 4),
        )

    return sorted(chains, key=key)


def _described(name: str, chain: Chain) -> ImportedRod:
    steps = np.linalg.norm(np.diff(chain.points, axis=0), axis=1)
    mean = float(np.sqrt(np.sum(chain.radii**2 * steps) / steps.sum()))
    s = arc_length(chain.axis)
    length = float(steps.sum())
    return ImportedRod(
        name, length, len(chain.radii), mean, s, chain.profile, chain.aspect, closed=not chain.ends
    )


def _without_returns(chain: Chain, chains: list[Chain]) -> list[Chain]:
    """Cut a chain that comes back to its own node in the middle."""
    if not chain.ends or chain.ends[0] != chain.ends[1]:
        return [chain]
    new = -1 - next(k for k, other in enumerate(chains) if other is chain)
    half = len(chain.radii) // 2
    s, middle = arc_length(chain.axis), arc_length(chain.points)[half]
    cut = int(np.clip(np.searchsorted(s, middle), 1, len(s) - 2))
    return [
        Chain(
            chain.points[: half + 1],
            chain.radii[:half],
            (chain.ends[0], new),
            chain.aspect,
            chain.axis[: cut + 1],
            chain.profile[: cut + 1],
        ),
        Chain(
            chain.points[half:],
            chain.radii[half:],
            (new, chain.ends[0]),
            chain.aspect,
            chain.axis[cut:],
            chain.profile[cut:],
        ),
    ]


def _outward(chain: Chain, degree: Counter[int]) -> Chain:
    """Start at the node where more rods meet; of two alike, at the one that comes first in space."""
    if not chain.ends:
        return chain
    a, b = (degree[node] for node in chain.ends)
    if a > b or (a == b and tuple(chain.points[0]) <= tuple(chain.points[-1])):
        return chain
    points, radii, (i, j), aspect, axis, profile = chain
    return Chain(points[::-1], radii[::-1], (j, i), aspect, axis[::-1], profile[::-1])
