"""How much of a surface the rods stand for, and how far off they are."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rodnet.importing.curves import arc_length, interpolate
from rodnet.importing.drawing import Chain
from rodnet.importing.findings import Findings, mm, place
from rodnet.importing.surface import Surface
from rodnet.importing.wavefronts import unique_edges

NEAR = 0.25  # of a radius: as far a surface may be off and still be covered
PATCH = 0.02  # of the area: the smallest patch without rods that is worth a warning


class Coverage(NamedTuple):
    """Share of the area that is covered, and the root mean square distance there [m]."""

    share: float
    residual: float


def cover(surface: Surface, chains: list[Chain], findings: Findings) -> Coverage:
    """Compare a surface with that of the rods; warn of the largest patches that no rod stands for."""
    centres, radii, is_tip = _samples(chains)
    corners = surface.vertices[surface.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    middle = corners.mean(axis=1)
    tree = cKDTree(centres)
    distance, index = tree.query(middle, k=min(8, len(centres)))
    off = distance - radii[index]
    best = np.take_along_axis(index, np.argmin(np.abs(off), axis=1)[:, None], axis=1)[:, 0]
    gap = np.min(np.abs(off), axis=1)
    # a flat end is nearer to the tip of its rod than a radius
    capped = is_tip[index[:, 0]] & (distance[:, 0] < (1.0 + NEAR) * radii[index[:, 0]])
    side = (gap <= NEAR * radii[best]) & ~capped
    covered = side | capped
    residual = float(np.sqrt(np.average(gap[side] ** 2, weights=area[side]))) if side.any() else float("nan")
    _warn_of_patches(surface, area, middle, covered, findings)
    return Coverage(float(area[covered].sum() / area.sum()), residual)


def _samples(chains: list[Chain]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres along the axes, a quarter radius apart, their radii, and which of them end at a tip."""
    shared = Counter(node for chain in chains for node in chain.ends)
    centres, radii, tips = [], [], []
    for chain in chains:
        s = arc_length(chain.axis)
        step = 0.25 * float(np.median(chain.profile))
        at = np.linspace(0.0, s[-1], int(np.clip(s[-1] / step, 8, 4000)) + 1)
        centres.append(interpolate(at, s, chain.axis))
        radius = np.interp(at, s, chain.profile)
        tip = np.zeros(len(at), dtype=bool)
        for end, node in zip((0, -1), chain.ends, strict=False):
            if shared[node] == 1:
                # caps, pointed or blunt: what is no farther from the tip than the limb is thick there
                near = np.abs(at - at[end]) <= 2.0 * step
                widest = radius[np.abs(at - at[end]) <= 6.0 * step].max()
                tip |= near
                radius = np.where(near, np.maximum(radius, widest), radius)
        radii.append(radius)
        tips.append(tip)
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(tips)


def _warn_of_patches(surface, area, middle, covered, findings: Findings) -> None:
    """Name patches of the surface that hang together and belong to no rod."""
    edges, face_edges = unique_edges(surface.faces)
    bare = np.flatnonzero(~covered)
    if not len(bare):
        return
    n = len(bare)
    links = coo_array(
        (np.ones(3 * n, dtype=np.int8), (np.repeat(np.arange(n), 3), face_edges[bare].ravel())),
        shape=(n, len(edges)),
    ).tocsr()
    label = connected_components((links @ links.T), directed=False)[1]
    size = np.bincount(label, area[bare])
    for k in np.argsort(-size)[:3]:
        if size[k] < PATCH * area.sum():
            break
        points = middle[bare[label == k]]
        share, span = 100.0 * size[k] / area.sum(), float(np.ptp(points, axis=0).max())
        findings.warn(
            f"no rod stands for {share:.0f} % of the surface, {mm(span)} "
            f"across at {place(points.mean(axis=0))}: a body there, or a junction unlike round limbs; "
            "add what is missing to the figure (fig.rod, fig.rigid)"
        )
