"""Bend-twist springs: which edges are paired at a node, how stiff, and in which natural shape.

A spring is two half edges in series (docs, theory: springs and joints). It compares the frames
V = F1 Q1 and W = F2 Q2 that its edges carry; flips and the natural shape live in Q1 and Q2.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

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
    pairs: list[tuple[int, int, int, float]],
    edges: np.ndarray,
    lengths: np.ndarray,
    frames: np.ndarray,
    compliance: np.ndarray,
    half_natural: np.ndarray,
    natural: dict[int, np.ndarray],
    overrides: dict[int, tuple[np.ndarray, np.ndarray]],
) -> Springs:
    """Build the springs of ``pairs`` (edge1, edge2, node, weight).

    Parameters
    ----------
    edges, lengths, frames : ndarray, shapes (E, 2), (E,) and (E, 3, 3)
        Edge nodes, natural lengths [m] and initial material frames.
    compliance : ndarray, shape (E, 3)
        Half-edge compliances about m1, m2, t [rad/(N m)].
    half_natural : ndarray, shape (E, 3, 3)
        Natural rotation over half of each edge; the identity where the initial shape is natural.
    natural : dict
        Natural rotation (3, 3) of the springs (by position in ``pairs``) whose natural shape is not
        the one that is drawn.
    overrides : dict
        Other compliances of the first and second half edge, by position in ``pairs``.
    """
    count = len(pairs)
    table = np.array([p[:3] for p in pairs], dtype=np.int64).reshape(count, 3)
    e1, e2, node = table[:, 0], table[:, 1], table[:, 2]
    sign1 = np.where(edges[e1, 1] == node, 1.0, -1.0)
    sign2 = np.where(edges[e2, 0] == node, 1.0, -1.0)
    flip1, flip2 = (np.where((sign > 0)[:, None, None], np.eye(3), FLIP) for sign in (sign1, sign2))
    V, W = frames[e1] @ flip1, frames[e2] @ flip2
    # what is drawn lies between the ends of the edges; their natural shape adds their other halves
    rest = _along(half_natural[e1], sign1) @ np.swapaxes(V, 1, 2) @ W @ _along(half_natural[e2], sign2)
    for index, rotation_matrix in natural.items():
        rest[index] = rotation_matrix
    half1, half2 = half_rotations(rest)
    c1, c2 = compliance[e1].copy(), compliance[e2].copy()
    for index, (first, second) in overrides.items():
        c1[index], c2[index] = first, second
    weight = np.array([p[3] for p in pairs])
    return Springs(
        e1,
        e2,
        node,
        sign1,
        sign2,
        flip1 @ half1,
        flip2 @ half2,
        c1,
        c2,
        weight,
        0.5 * (lengths[e1] + lengths[e2]),
    )


def _along(half: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Rotations over half edges in the direction of the stencil."""
    return np.where((sign > 0)[:, None, None], half, FLIP @ np.swapaxes(half, 1, 2) @ FLIP)


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
