"""Compiled vector work of a Newton iteration for robots with rigid bodies: each in one call, for calls cost time."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack
from rodnet.solve import newton_kernels as newton_work
from rodnet.solve.body_kernels import BODIES, chart, cross, dot, place, spread, times

# degrees of freedom that are free and that bodies carry, room for updates of all and of these, and of every node
# the body that it goes round with, or -1
ROOM = "free:i1 carried:i1 full:d1 extended:d1 owner:i1"
# [rad^2] a turn's square whose arc and tangent are as one to round-off
STRAIGHT = 8.0 * np.finfo(np.float64).eps

NEWTON, _measure = newton_work.NEWTON, newton_work.measure


@kernel
def swing(bodies, owner, base, q):
    """Move nodes that go round with a body on arcs, as it does: an update's straight way leaves the circle.

    Parameters
    ----------
    owner : ndarray of int32, shape (node_count,)
        The body next to each node that is free and that no body carries, or -1.
    base : ndarray, shape (dof_count,)
        Where the update began.
    q : ndarray, shape (dof_count,)
        Where it ends, with bodies in their places; changed in place.
    """
    at, turn, _, _, _, E, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _ = unpack(bodies, BODIES)
    E0, T0, bend = np.empty((3, 3)), np.empty((3, 3)), np.zeros((at.size, 3, 3))
    sigma, moved, curved = np.zeros((at.size, 3)), np.empty((at.size, 3)), False
    for b in range(at.size):
        r = turn[b]
        d = (q[r] - base[r], q[r + 1] - base[r + 1], q[r + 2] - base[r + 2])
        for i in range(3):
            moved[b, i] = q[at[b] + i] - base[at[b] + i]
        if not dot(d, d) > STRAIGHT:
            continue
        curved = True
        chart(base[r : r + 3], E0, T0)
        sigma[b, 0], sigma[b, 1], sigma[b, 2] = times(T0, d)
        # the turn from there to here, without its linear part
        for i in range(3):
            for j in range(3):
                bend[b, i, j] = E[b, i, 0] * E0[j, 0] + E[b, i, 1] * E0[j, 1] + E[b, i, 2] * E0[j, 2]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            bend[b, i, i] -= 1.0
            bend[b, j, k] += sigma[b, i]
            bend[b, k, j] -= sigma[b, i]
    if not curved:
        return
    for n in range(owner.size):
        b = owner[n]
        if b < 0:
            continue
        p, x = at[b], 3 * n
        arm = (base[x] - base[p], base[x + 1] - base[p + 1], base[x + 2] - base[p + 2])
        swept = cross(sigma[b], arm)
        apart = 0.0
        for i in range(3):
            apart += (q[x + i] - base[x + i] - moved[b, i] - swept[i]) ** 2
        if apart < 0.25 * dot(swept, swept):
            off = times(bend[b], arm)
            for i in range(3):
                q[x + i] += off[i]


@kernel
def move(newton, bodies, room, twist0, update, scale, q_old, cv, ca, v0, a0):
    """Move free degrees of freedom, and what bodies carry; return the largest square of a rotation vector."""
    free, q, v, a, base, _, _, _, _, _, _, _, _ = unpack(newton, NEWTON)
    _, _, _, _, owner = unpack(room, ROOM)
    for i in range(base.shape[0]):
        q[i] = base[i]
    for k in range(update.shape[0]):
        q[free[k]] += scale * update[k]
    largest = place(bodies, twist0)
    if update.shape[0]:
        swing(bodies, owner, base, q)
    for i in range(base.shape[0]):
        d = q[i] - q_old[i]
        v[i] = cv * d + (v0[i] if v0.shape[0] else 0.0)
        a[i] = ca * d + a0[i]
    return largest


@kernel
def measure(newton, bodies, room, twist0, size, update, begins):
    """Size of an update and the largest factor on it, that of what bodies carry included."""
    free, carried, full, extended, _ = unpack(room, ROOM)
    full[:] = 0.0
    for k in range(free.shape[0]):
        full[free[k]] = extended[k] = update[k]
    spread(bodies, twist0, full)
    for k in range(carried.shape[0]):
        extended[free.shape[0] + k] = full[carried[k]]
    return _measure(newton, twist0, size, extended, begins)
