"""Compiled vector work of a Newton iteration: arrays only, one pass each."""

from __future__ import annotations

import math

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack

# the arrays of one Newton solver; ``base`` is where an update begins, ``least`` holds the smallest scales of
# force and moment, ``reduced`` numbers the free degrees of freedom, then what rigid bodies carry, -1 elsewhere
NEWTON = "free:i1 q:d1 v:d1 a:d1 base:d1 mass:d1 F:d1 diagonal:i1 least:d1 r:d1 edges:l2 L:d1 reduced:i1"


@kernel
def move(newton, update, scale, q_old, cv, ca, v0, a0):
    """Move the free degrees of freedom from ``base`` by ``scale * update``, with the stepper's rates.

    An empty ``v0`` stands for zeros. Returns False: nothing can have turned too far.
    """
    free, q, v, a, base, _, _, _, _, _, _, _, _ = unpack(newton, NEWTON)
    for i in range(base.shape[0]):
        q[i] = base[i]
    for k in range(update.shape[0]):
        q[free[k]] += scale * update[k]
    for i in range(base.shape[0]):
        d = q[i] - q_old[i]
        v[i] = cv * d + (v0[i] if v0.shape[0] else 0.0)
        a[i] = ca * d + a0[i]
    return False


@kernel
def residual(newton, twist0, shortest, data, cv, ca, force, moment, with_jac):
    """Residual r = M a - F over the free degrees of freedom, and how large it is.

    Degrees of freedom before ``twist0`` are positions, the others angles. ``force`` and ``moment`` are the
    largest ones of the terms. With ``with_jac`` the inertia is added to the Jacobian's data.

    Returns
    -------
    error : float
        Largest entry against its scale; not finite if any entry is not.
    worst : int
        Where.
    merit : float
        Root of the sum of squares of the scaled entries.
    force, moment : float
        The scales.
    """
    free, _, _, a, _, mass, F, diagonal, least, r, _, _, _ = unpack(newton, NEWTON)
    for i in range(twist0):
        force = max(force, abs(mass[i] * a[i]))
    force = max(force, least[0])
    moment = max(moment, force * shortest, least[1])
    error, merit, worst = 0.0, 0.0, -1
    for k in range(free.shape[0]):
        i = free[k]
        value = mass[i] * a[i] - F[i]
        r[k] = value
        scaled = abs(value) / (force if i < twist0 else moment)
        merit += scaled * scaled
        if not scaled <= error:  # a NaN too
            worst = i
            error = scaled
            if not scaled < np.inf:
                return error, worst, merit, force, moment
    if with_jac:
        for k in range(free.shape[0]):
            data[diagonal[k]] += ca * mass[free[k]]
    return error, worst, math.sqrt(merit), force, moment


@kernel
def measure(newton, twist0, size, update, begins):
    """Size of an update, and the largest factor for which no edge turns or stretches by more than half.

    ``size`` is the robot's length, the unit of positions; twists count in radian. If an update
    ``begins`` here, the present position becomes its base.
    """
    free, q, _, _, base, _, _, _, _, _, edges, L, reduced = unpack(newton, NEWTON)
    if begins:
        for i in range(q.shape[0]):
            base[i] = q[i]
    shift, twist = 0.0, 0.0
    for k in range(free.shape[0]):
        if free[k] < twist0:
            shift = max(shift, abs(update[k]))
        else:
            twist = max(twist, abs(update[k]))
    change = 0.0
    for e in range(edges.shape[0]):
        square = 0.0
        for axis in range(3):
            i, j = reduced[3 * edges[e, 0] + axis], reduced[3 * edges[e, 1] + axis]
            step = (update[j] if j >= 0 else 0.0) - (update[i] if i >= 0 else 0.0)
            square += step * step
        change = max(change, math.sqrt(square) / L[e])
    return max(shift / size, twist), 1.0 / max(1.0, 2.0 * change, twist / 3.0)


@kernel
def advance(newton, twist0, size, update, q_old, cv, ca, v0, a0):
    """Begin an update here (`measure`) and go along it as far as is sensible (`move`).

    Returns its size, the factor that was taken on it, and False: nothing can have turned too far.
    """
    length, scale = measure(newton, twist0, size, update, True)
    return length, scale, move(newton, update, -scale, q_old, cv, ca, v0, a0)


@kernel
def accept(q, theta, T, M1, M2, eps, tangents, directors, tau, turned):
    """Frames of an accepted state; full turns are taken out of the twist angles of ``q``.

    The transported reference directors are recovered from the material ones.
    """
    twist0 = q.shape[0] - theta.shape[0]
    for e in range(theta.shape[0]):
        c, s = math.cos(theta[e]), math.sin(theta[e])
        turns = math.floor(theta[e] / (2.0 * math.pi) + 0.5)
        turned[e] += int(turns)
        q[twist0 + e] = theta[e] - 2.0 * math.pi * turns
        for i in range(3):
            tangents[e, i] = T[e, i]
            directors[e, i] = c * M1[e, i] - s * M2[e, i]
    for s in range(tau.shape[0]):
        tau[s] = eps[s, 2]
