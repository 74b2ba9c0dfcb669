"""Where contacts are, and with what force: one by one, where the terms themselves add them up over nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.terms.contact.rods import _BoundRods
from rodnet.terms.contact.walls import _BoundWall

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.terms.base import BoundTerm


def contact_points(bound: BoundTerm, ev: Evaluation) -> tuple[np.ndarray, np.ndarray] | None:
    """Points of contact and forces on the robot there, of a contact term at an evaluated state.

    Between rods, each contact counts once: the point is on the surface of the second edge, and the force is that
    on the second edge; the first feels the opposite. None for other terms, whose forces are known by node only.

    Returns
    -------
    points : ndarray, shape (n, 3)
        On the surfaces of the rods [m].
    forces : ndarray, shape (n, 3)
        Normal force and friction [N].
    """
    if isinstance(bound, _BoundWall):
        return _wall_points(bound, ev)
    if isinstance(bound, _BoundRods):
        return _pair_points(bound, ev)
    return None


def _wall_points(wall: _BoundWall, ev: Evaluation) -> tuple[np.ndarray, np.ndarray]:
    from rodnet.packed import Packed

    kernels, n = wall.kernels, len(wall.edge)
    own = np.arange(7 * n, dtype=np.int32).reshape(n, 7)  # every site writes to a place of its own
    packed = Packed(
        kernels.WALL, wall.law, wall.edge, wall.place, wall.radius, wall.point, wall.axis, own,
        np.zeros((0, 7, 7), dtype=np.int32),
    )  # fmt: skip
    flat = np.zeros(7 * n)
    grip = 0.0 if wall.at_rest else 1.0
    kernels.wall_forces(
        wall.kind, wall.size, grip, packed.table, ev.state, ev.cv, flat, ev.model.scrap, False
    )
    F = flat.reshape(n, 7)
    forces = F[:, :3] + F[:, 3:6]  # couples are pairs of opposite forces on the edge's ends
    active = np.flatnonzero(forces.any(axis=1))
    points, m, normal = np.empty((len(active), 3)), np.empty(3), np.empty(3)
    for row, k in enumerate(active):
        x0, x1 = ev.x[wall.edges[wall.edge[k]]]
        _, s, _, _ = kernels.wall_gap(
            wall.kind, wall.size, wall.radius[k], wall.place[k], wall.point, wall.axis, x0, x1, m, normal
        )
        points[row] = (1.0 - s) * x0 + s * x1 - wall.radius[k] * normal
    if wall.kind == kernels.OUTSIDE:
        return points, forces[active]
    # the edges that meet at a node touch with it side by side: one contact
    nodes = wall.edges[wall.edge[active], wall.place[active].astype(int)]
    _, first, which = np.unique(nodes, return_index=True, return_inverse=True)
    together = np.zeros((len(first), 3))
    np.add.at(together, which, forces[active])
    return points[first], together


def _pair_points(rods: _BoundRods, ev: Evaluation) -> tuple[np.ndarray, np.ndarray]:
    pairs, sizes, law, _ = rods._within_reach(ev.x)
    shares, kernels = rods.radius[pairs] / sizes[:, :1], rods.kernels
    points, forces, keep = np.empty((len(pairs), 3)), np.empty((len(pairs), 3)), np.ones(len(pairs), bool)
    F, J, grip = np.zeros(ev.model.dof_count), np.empty((0, 14, 14)), 0.0 if rods.at_rest else 1.0
    delta, soft = np.empty(3), np.empty(3)
    for k, (e, f) in enumerate(pairs):
        one = slice(k, k + 1)
        F[:] = 0.0
        kernels.pair_forces(
            pairs[one], sizes[one], shares[one], law[one], grip, rods.edges, ev.model.twist0, ev.state, ev.cv,
            F, J, False,
        )  # fmt: skip
        forces[k] = F[: ev.model.twist0].reshape(-1, 3)[rods.edges[f]].sum(axis=0)
        ends = np.concatenate([ev.x[rods.edges[e]], ev.x[rods.edges[f]]])
        _, t, _ = kernels.closest(*ends, sizes[k, 1], delta, soft)
        points[k] = (1.0 - t) * ends[2] + t * ends[3]
        points[k] += rods.radius[f] * delta / max(float(np.linalg.norm(delta)), 1e-300)
        keep[k] = forces[k].any()
    return points[keep], forces[keep]
