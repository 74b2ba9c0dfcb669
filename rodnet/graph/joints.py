"""Bend-twist springs: which edges are paired at a node, how stiff, and in which natural shape.

A spring is two half edges in series (docs, theory: springs and joints). It compares the frames
V = F1 Q1 and W = F2 Q2 that its edges carry; flips and the natural shape live in Q1 and Q2.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from rodnet.kinematics.frames import about_z, relative_rotation, relative_strains, rotation, rotation_vector

FLIP = np.diag([1.0, -1.0, -1.0])
# rotation vector (rho1, rho2, rho3) = P (kappa1, kappa2, tau)
_P = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Springs:
    """Arrays over the bend-twist springs of a graph.

    Attributes
    ----------
    edge1, edge2, node : ndarray, shape (n,)
        The paired edges and the node that they share; the stencil runs edge1 -> node -> edge2.
    sign1, sign2 : ndarray, shape (n,)
        +1 where the edge points along the stencil, -1 where it is flipped.
    Q1, Q2 : ndarray, shape (n, 3, 3)
        Rotation from each edge's frame to the spring's: a flip of edges against the stencil, then half of
        the natural relative rotation (mid-frame).
    compliance1, compliance2 : ndarray, shape (n, 3)
        Compliances of the two half edges for rotations about m1, m2, t of their own edge [rad/(N m)].
    weight : ndarray, shape (n,)
        Share of the pair at a joint without hub (star-mesh), 1 elsewhere.
    length : ndarray, shape (n,)
        Voronoi length [m].
    """

    edge1: np.ndarray
    edge2: np.ndarray
    node: np.ndarray
    sign1: np.ndarray
    sign2: np.ndarray
    Q1: np.ndarray
    Q2: np.ndarray
    compliance1: np.ndarray
    compliance2: np.ndarray
    weight: np.ndarray
    length: np.ndarray

    def __len__(self) -> int:
        return len(self.edge1)

    @property
    def stiffness(self) -> np.ndarray:
        """Stiffness by (kappa1, kappa2, tau) [N m], shape (n, 3, 3)."""
        return stiffness(self.Q1, self.Q2, self.compliance1, self.compliance2, self.weight)

    def take(self, index: np.ndarray) -> Springs:
        """Return the springs at ``index`` (integers or a mask)."""
        return Springs(*(getattr(self, f.name)[index] for f in fields(self)))

    @staticmethod
    def concatenate(parts: list[Springs]) -> Springs:
        """Join several sets of springs."""
        return Springs(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Springs)))


def stiffness(
    Q1: np.ndarray, Q2: np.ndarray, c1: np.ndarray, c2: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Series stiffness of two half edges by (kappa1, kappa2, tau) [N m], shape (n, 3, 3)."""
    compliance = np.swapaxes(Q1, 1, 2) @ (c1[:, :, None] * Q1) + np.swapaxes(Q2, 1, 2) @ (c2[:, :, None] * Q2)
    return weight[:, None, None] * (_P.T @ np.linalg.inv(compliance) @ _P)


def half_rotations(natural: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split natural relative rotations (n, 3, 3) into the halves carried by the two edges.

    The natural rotation is a twist after a bend, the smallest rotation between the two tangents.
    Half of each gives a mid-frame along the bisector of the tangents, so that the energy does not
    depend on the directors that the edges were given to begin with, hence on no order of drawing.
    """
    if not len(natural):
        return np.zeros((0, 3, 3)), np.zeros((0, 3, 3))
    twist = relative_strains(np.eye(3), natural)[:, 2]
    bend = rotation_vector(natural @ about_z(-twist))
    first = rotation(0.5 * bend) @ about_z(0.5 * twist)
    return first, np.swapaxes(natural, 1, 2) @ first


def natural_rotation(strains: np.ndarray) -> np.ndarray:
    """Natural relative rotation (n, 3, 3) of natural strains (kappa1, kappa2, tau), shape (n, 3)."""
    return relative_rotation(strains)


def make_springs(
    pairs: Pairs,
    edges: np.ndarray,
    lengths: np.ndarray,
    frames: np.ndarray,
    compliance: tuple[np.ndarray, np.ndarray],
    half_natural: np.ndarray,
    natural: tuple[np.ndarray, np.ndarray] | None = None,
) -> Springs:
    """Build the springs of pairs of edges.

    Parameters
    ----------
    pairs : Pairs
        Which edges are welded together.
    edges, lengths, frames : ndarray, shapes (E, 2), (E,) and (E, 3, 3)
        Edge nodes, natural lengths [m] and initial material frames.
    compliance : tuple of ndarray, shape (n, 3)
        Compliances about m1, m2, t [rad/(N m)] of the first and second half edge of each pair.
    half_natural : ndarray, shape (E, 3, 3)
        Natural rotation over half of each edge; the identity where the initial shape is natural.
    natural : tuple of ndarray, optional
        Positions in ``pairs`` of the springs whose natural shape is not the one that is drawn, and their
        natural rotations, shapes (m,) and (m, 3, 3).
    """
    e1, e2, node = pairs.edge1, pairs.edge2, pairs.node
    sign1 = np.where(edges[e1, 1] == node, 1.0, -1.0)
    sign2 = np.where(edges[e2, 0] == node, 1.0, -1.0)
    flip1, flip2 = (np.where((sign > 0)[:, None, None], np.eye(3), FLIP) for sign in (sign1, sign2))
    V, W = frames[e1] @ flip1, frames[e2] @ flip2
    # what is drawn lies between the ends of the edges; their natural shape adds their other halves
    rest = _along(half_natural[e1], sign1) @ np.swapaxes(V, 1, 2) @ W @ _along(half_natural[e2], sign2)
    if natural is not None:
        rest[natural[0]] = natural[1]
    half1, half2 = half_rotations(rest)
    Q1, Q2 = flip1 @ half1, flip2 @ half2
    length = 0.5 * (lengths[e1] + lengths[e2])
    return Springs(e1, e2, node, sign1, sign2, Q1, Q2, *compliance, pairs.weight, length)


def _along(half: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Rotations over half edges in the direction of the stencil."""
    return np.where((sign > 0)[:, None, None], half, FLIP @ np.swapaxes(half, 1, 2) @ FLIP)


class Pairs(NamedTuple):
    """Pairs of edges that are welded together at a node, arrays of shape (n,), and their weights."""

    edge1: np.ndarray
    edge2: np.ndarray
    node: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, rows: list[tuple[int, int, int, float]]) -> Pairs:
        """Collect rows (edge1, edge2, node, weight)."""
        edge1, edge2, node = (np.array([row[k] for row in rows], dtype=np.int64) for k in range(3))
        return cls(edge1, edge2, node, np.array([row[3] for row in rows], dtype=float))


def pair_all_edges(
    edges: np.ndarray,
    hubs: dict[int, int],
    mean_stiffness: np.ndarray,
    welded: dict[int, list[list[int]]] | None = None,
) -> Pairs:
    """Pairs at all nodes, in the order in which the edges come to them.

    Parameters
    ----------
    edges : ndarray, shape (E, 2)
        Nodes of each edge.
    hubs : dict
        The hub edge of nodes that have one.
    mean_stiffness : ndarray, shape (E,)
        Mean bending stiffness of each edge [N m].
    welded : dict, optional
        Of nodes with a joint that turns: the groups of edges that springs weld together.
    """
    welded = welded or {}
    ends, edge = edges.ravel(), np.repeat(np.arange(len(edges)), 2)
    leaving = np.tile([True, False], len(edges))
    nodes, first, group = np.unique(ends, return_index=True, return_inverse=True)
    rank = np.empty(len(nodes), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(nodes))
    # the order along a rod, so that a motor's rotor is the later edge
    order = np.lexsort((edge, leaving, rank[group]))
    around, start = edge[order], np.concatenate([[0], np.cumsum(np.bincount(rank[group]))])
    nodes = nodes[np.argsort(first)]
    plain = (np.diff(start) == 2) & ~np.isin(nodes, [*hubs, *welded])
    at = start[:-1][plain]
    inner = Pairs(around[at], around[at + 1], nodes[plain], np.ones(len(at)))
    special = np.flatnonzero(~plain)
    rows, place = [], [np.flatnonzero(plain)]
    for k in special.tolist():
        node = int(nodes[k])
        groups = welded.get(node, [around[start[k] : start[k + 1]].tolist()])
        mine = [row for group in groups for row in pair_edges(node, group, hubs.get(node), mean_stiffness)]
        rows += mine
        place.append(np.full(len(mine), k))
    order = np.argsort(np.concatenate(place), kind="stable")
    return Pairs(*(np.concatenate(parts)[order] for parts in zip(inner, Pairs.of(rows), strict=True)))


def pair_edges(
    node: int, incident: list[int], hub: int | None, mean_stiffness: np.ndarray
) -> list[tuple[int, int, int, float]]:
    """Pairs (edge1, edge2, node, weight) of the edges that are welded together at a node.

    With a ``hub`` edge every other edge is paired with it. Without one all pairs are taken and
    weighted (k_i + k_j) / sum k: the star-mesh condensation of a rigid node frame, which for two
    edges is the series rule and depends on no numbering.
    """
    if hub is not None:
        return [(hub, e, node, 1.0) for e in incident if e != hub]
    total = sum(mean_stiffness[e] for e in incident)
    return [
        (a, b, node, float((mean_stiffness[a] + mean_stiffness[b]) / total) if len(incident) > 2 else 1.0)
        for k, a in enumerate(incident)
        for b in incident[k + 1 :]
    ]
