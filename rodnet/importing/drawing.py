"""From chains of points between nodes to the rods of a stick figure."""

from __future__ import annotations

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
    ends : (int, int) or None
        Numbers of the nodes at its ends; None of a ring that is joined to nothing.
    aspect : float
        Largest ratio of its sections' principal radii of gyration.
    axis, profile : ndarray, shape (m, 3) and (m,)
        What points and radii were taken from [m].
    """

    points: np.ndarray
    radii: np.ndarray
    ends: tuple[int, int] | None
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
    degree: dict[int, int] = {}
    for chain in chains:
        for node in chain.ends or ():
            degree[node] = degree.get(node, 0) + 1
    chains = [_outward(chain, degree) for chain in chains]
    length = [arc_length(chain.points)[-1] for chain in chains]
    # the longest first; what is equally long by thickness, then by place, however the file was numbered
    scale = max(length)
    key = [
        (
            -round(s / scale, 4),
            -round(float(c.radii.mean()) / scale, 5),
            *np.round(c.points.mean(axis=0) / scale, 4),
        )
        for s, c in zip(length, chains, strict=True)
    ]
    figure, known = StickFigure(), {}
    rods: list[ImportedRod] = []
    members: dict[int, list[str]] = {}
    for number, k in enumerate(sorted(range(len(chains)), key=lambda k: key[k])):
        chain, rod = chains[k], f"{name}{number}"
        points: list[Any] = list(chain.points)
        ring = chain.ends is None
        if ring:
            points.pop()
        else:
            for end, node, label in ((0, chain.ends[0], "start"), (-1, chain.ends[1], "end")):
                members.setdefault(node, []).append(rod)
                if node in known:
                    points[end] = known[node]
                else:
                    known[node] = f"{rod}.{label}"
        radii = chain.radii[0] if np.ptp(chain.radii) <= 1e-3 * chain.radii.mean() else chain.radii
        figure.rod(rod, points, material=material, radius=radii, closed=ring)
        steps = np.linalg.norm(np.diff(chain.points, axis=0), axis=1)
        mean = float(np.sqrt(np.sum(chain.radii**2 * steps) / steps.sum()))
        rods.append(
            ImportedRod(
                rod,
                length[k],
                len(chain.radii),
                mean,
                arc_length(chain.axis),
                chain.profile,
                chain.aspect,
                ring,
            )
        )
    joints = [node for node, count in degree.items() if count > 2]
    place = {
        node: next(
            tuple(map(float, c.points[0 if c.ends[0] == node else -1]))
            for c in chains
            if c.ends and node in c.ends
        )
        for node in joints
    }
    junctions = tuple(
        ImportedJunction(
            known[node], place[node], tuple(dict.fromkeys(members[node])), float(misses.get(node, 0.0))
        )
        for node in sorted(
            joints, key=lambda node: (int(known[node].rpartition(".")[0][len(name) :]), known[node])
        )
    )
    return figure, tuple(rods), junctions, sum(count == 1 for count in degree.values())


def _without_returns(chain: Chain, chains: list[Chain]) -> list[Chain]:
    """Cut a chain that comes back to its own node in the middle."""
    if chain.ends is None or chain.ends[0] != chain.ends[1]:
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


def _outward(chain: Chain, degree: dict[int, int]) -> Chain:
    """Start at the node where more rods meet; of two alike, at the one that comes first in space."""
    if chain.ends is None:
        return chain
    a, b = (degree[node] for node in chain.ends)
    if a > b or (a == b and tuple(chain.points[0]) <= tuple(chain.points[-1])):
        return chain
    points, radii, (i, j), aspect, axis, profile = chain
    return Chain(points[::-1], radii[::-1], (j, i), aspect, axis[::-1], profile[::-1])
