"""Compiled vector work of a Newton step for robots with rigid bodies: each in one call, for calls cost time.

The formulas are derived in ``docs/theory/rigid-bodies.md``.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack
from rodnet.solve import newton_kernels as newton_work
from rodnet.solve.body_force_kernels import reduce
from rodnet.solve.body_kernels import BODIES, HALF_TURN, chart, cross, dot, orient, place, spread, times

# degrees of freedom that are free and that bodies carry, room for updates of all and of these; of every node the
# body next to it, or -1 if it is held or carried, or there is none
ROOM = "free:i1 carried:i1 full:d1 extended:d1 owner:i1"
# [rad^2] a turn's square whose arc and tangent are as one to round-off
NOISE = 64.0 * np.finfo(np.float64).eps
STRAIGHT = 8.0 * np.finfo(np.float64).eps

NEWTON, _measure, _residual = newton_work.NEWTON, newton_work.measure, newton_work.residual


@kernel
def predict(bodies, room, q, v, guess):
    """Let nodes that go round with a body do so in a first guess: extrapolated points leave their circles.

    The points that a body carries tell how extrapolation errs, by D arm, as its rotation is extrapolated as a
    matrix; the nodes that go round with it are put back by as much. Else bodies and rods would strain their
    joints, which may be stiff.

    Parameters
    ----------
    q, v, guess : ndarray, shape (dof_count,)
        Accepted state, its rates, and the guess, which is changed.
    """
    (
        base, turn, node_ptr, _, _, _, _, _, _, _, _, _, node_dof, _, arms, _, _, _, _, _, _, _, _, _, _, _,
    ) = unpack(bodies, BODIES)  # fmt: skip
    _, _, _, _, owner = unpack(room, ROOM)
    T, A, D = np.empty((3, 3)), np.empty((3, 3)), np.zeros((base.size, 3, 3))
    R, own, still = np.empty((base.size, 3, 3)), np.empty(3), np.empty(3)
    for b in range(base.size):
        E = R[b]
        chart(guess[turn[b] : turn[b] + 3], E, T)
        A[:] = 0.0
        T[:] = 0.0
        P = guess[base[b] : base[b] + 3]
        for k in range(node_ptr[b], node_ptr[b + 1]):
            r, x = times(E, arms[k]), guess[node_dof[k] : node_dof[k] + 3]
            for i in range(3):
                for j in range(3):
                    A[i, j] += arms[k, i] * arms[k, j]
                    T[i, j] += (x[i] - P[i] - r[i]) * arms[k, j]
        # D = T / A, by Cramer's rule
        c0, c1, c2 = cross(A[1], A[2]), cross(A[2], A[0]), cross(A[0], A[1])
        volume = dot(A[0], c0)
        if volume > 1e-12 * (A[0, 0] + A[1, 1] + A[2, 2]) ** 3:
            for i in range(3):
                for j in range(3):
                    D[b, i, j] = (T[i, 0] * c0[j] + T[i, 1] * c1[j] + T[i, 2] * c2[j]) / volume
    for n in range(owner.size):
        b = owner[n]
        if b < 0:
            continue
        P, omega = base[b], v[turn[b] : turn[b] + 3]
        arm = (q[3 * n] - q[P], q[3 * n + 1] - q[P + 1], q[3 * n + 2] - q[P + 2])
        swept = cross(omega, arm)
        apart = 0.0
        for i in range(3):
            apart += (v[3 * n + i] - v[P + i] - swept[i]) ** 2
        if apart < 0.25 * dot(swept, swept):
            off, turned = times(D[b], arm), times(R[b], arm)
            largest = 0.0
            for i in range(3):
                new = guess[P + i] + turned[i]
                own[i] = guess[3 * n + i] - off[i]
                largest = max(largest, abs(own[i] - new))
                still[i] = new
            noise = NOISE * (
                abs(own[0]) + abs(own[1]) + abs(own[2]) + abs(arm[0]) + abs(arm[1]) + abs(arm[2])
            )
            for i in range(3):
                guess[3 * n + i] = still[i] if largest < noise else own[i]


@kernel
def begin(bodies, drawn, room, twist0, q, v, guess):
    """Take the orientations of an accepted state ``q`` with rates ``v``, and improve a first guess."""
    orient(bodies, drawn, twist0, q)
    predict(bodies, room, q, v, guess)


@kernel
def swing(bodies, room, base, q):
    """Move nodes that go round with a body on arcs, as it does: an update's straight way leaves the circle.

    Parameters
    ----------
    base : ndarray, shape (dof_count,)
        Where the update began.
    q : ndarray, shape (dof_count,)
        Where it ends, with bodies in their places; changed in place.
    """
    at, turn, _, _, _, E, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _ = unpack(bodies, BODIES)
    _, _, _, _, owner = unpack(room, ROOM)
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
def move(newton, bodies, room, twist0, arcs, update, scale, q_old, cv, ca, v0, a0):
    """Move free degrees of freedom, and what bodies carry; return whether a body has turned too far.

    With ``arcs``, nodes that go round with a body move on arcs.
    """
    free, q, v, a, base, _, _, _, _, _, _, _, _ = unpack(newton, NEWTON)
    for i in range(base.shape[0]):
        q[i] = base[i]
    for k in range(update.shape[0]):
        q[free[k]] += scale * update[k]
    largest = place(bodies, twist0)
    if arcs and update.shape[0]:
        swing(bodies, room, base, q)
    for i in range(base.shape[0]):
        d = q[i] - q_old[i]
        v[i] = cv * d + (v0[i] if v0.shape[0] else 0.0)
        a[i] = ca * d + a0[i]
    return not largest < HALF_TURN


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


@kernel
def advance(newton, bodies, room, twist0, arcs, size, update, q_old, cv, ca, v0, a0):
    """Begin an update here (`measure`) and go along it as far as is sensible (`move`)."""
    length, scale = measure(newton, bodies, room, twist0, size, update, True)
    return length, scale, move(newton, bodies, room, twist0, arcs, update, -scale, q_old, cv, ca, v0, a0)


@kernel
def residual(newton, bodies, fold, twist0, shortest, data, cv, ca, force, moment, with_jac):
    """Residual of forces that are still on what bodies carry; these are moved to the bodies."""
    own_force, own_moment = reduce(bodies, fold, twist0, cv, ca, data, with_jac)
    force, moment = max(force, own_force), max(moment, own_moment)
    return _residual(newton, twist0, shortest, data, cv, ca, force, moment, with_jac)
