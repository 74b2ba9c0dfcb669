"""Compiled kernels of rigid bodies: forces and stiffness on them, and their inertia.

The formulas are derived in ``docs/theory/rigid-bodies.md``.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack
from rodnet.solve.body_kernels import (
    BODIES,
    bias,
    chart,
    cross,
    dot,
    second_series,
    series,
    times,
    transposed_times,
)

# side entries of the Jacobian, in groups: `rodnet.solve.bodies.FoldPlan`
FOLD = "start:i1 entry:i1 member:i1 whole:i1 target:i1 target_ptr:i1"


@kernel
def momentum_rate(phi, rate, second, held, at, mass, centre, inertia, E, T, c, db, dc):
    """What the acceleration of a body takes: force, and moment about the base.

    Parameters
    ----------
    held : bool
        Whether the base is held: ``at`` is then its acceleration, and otherwise that of the centre. Moments of
        inertia are about the same point.
    E, T, c, db, dc : ndarray and float
        From `chart`.

    Returns
    -------
    tuple
        Force, moment, and the largest part of the moment.
    """
    quadratic = bias(phi, rate, c, db, dc)
    w, linear, rho = times(T, rate), times(T, second), times(E, centre)
    alpha = (linear[0] + quadratic[0], linear[1] + quadratic[1], linear[2] + quadratic[2])
    turned = times(E, times(inertia, transposed_times(E, alpha)))
    spun = cross(w, times(E, times(inertia, transposed_times(E, w))))
    weight = mass if held else 0.0
    swept, tangential = cross(w, cross(w, rho)), cross(alpha, rho)
    f = (
        mass * at[0] + weight * (tangential[0] + swept[0]),
        mass * at[1] + weight * (tangential[1] + swept[1]),
        mass * at[2] + weight * (tangential[2] + swept[2]),
    )
    moved = cross(rho, (mass * at[0], mass * at[1], mass * at[2]))
    n = (turned[0] + spun[0] + moved[0], turned[1] + spun[1] + moved[1], turned[2] + spun[2] + moved[2])
    largest = 0.0
    for i in range(3):
        largest = max(largest, abs(turned[i]), abs(spun[i]), abs(moved[i]))
    return f, n, largest


@kernel
def sum2(a, x, b, y):
    """Sum of two multiples of vectors."""
    return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]


@kernel
def tangent_rate(phi, e, ds, u, sign, b, c, db, dc):
    """Derivative along e of T u, or with ``sign`` -1 of the transpose's product with u; ds is that of s."""
    once = cross(phi, u)
    linear = sum2(sign * db * ds, once, sign * b, cross(e, u))
    square = sum2(1.0, cross(e, once), 1.0, cross(phi, cross(e, u)))
    return sum2(1.0, linear, 1.0, sum2(dc * ds, cross(phi, once), c, square))


@kernel
def bias_rate(phi, rate, e, ds, cv, b, c, db, dc, ddb, ddc):
    """Derivative of `bias` along phi in the direction e, where the rate changes by cv e."""
    k, dk = 2.0 * dot(phi, rate), 2.0 * (dot(e, rate) + cv * dot(phi, e))
    once = cross(phi, rate)
    twice, other = cross(phi, once), cross(rate, once)
    d_once = sum2(1.0, cross(e, rate), cv, cross(phi, e))
    d_twice = sum2(1.0, cross(e, once), 1.0, cross(phi, d_once))
    d_other = sum2(cv, cross(e, once), 1.0, cross(rate, d_once))
    first = sum2(dk * db + k * ddb * ds, once, k * db, d_once)
    second = sum2(dk * dc + k * ddc * ds, twice, k * dc, d_twice)
    return sum2(1.0, sum2(1.0, first, 1.0, second), 1.0, sum2(dc * ds, other, c, d_other))


@kernel
def turn_stiffness(A, Q, source, z, E, T, j, out):
    """Take from ``out`` the change of the moment of forces that stay while a body turns by the column j of T.

    A is the sum of arm x force^T.
    """
    sigma = (T[0, j], T[1, j], T[2, j])
    trace = A[0, 0] + A[1, 1] + A[2, 2]
    m = times(A, sigma)
    for i in range(3):
        out[i] += m[i] - trace * sigma[i]
    for e in range(Q.size):
        t = times(E, source[e])
        dt = cross(sigma, t)
        chi, along = 1.0 + dot(t, source[e]), dot(dt, source[e])
        for i in range(3):
            out[i] += Q[e] * (dt[i] - z[e, i] * along) / chi


@kernel
def inertia_stiffness(
    phi, rate, second, held, at, mass, centre, inertia, E, T, b, c, db, dc, cv, ca, force, out
):
    """Add to columns of ``force`` and ``out`` (3, 3) the derivatives of `momentum_rate` by phi, minus in ``out``.

    Rates and their rates follow from phi by the factors cv and ca; a centre that is free by ca as well.
    """
    ddb, ddc = second_series(dot(phi, phi))
    quadratic = bias(phi, rate, c, db, dc)
    w, rho = times(T, rate), times(E, centre)
    alpha = sum2(1.0, times(T, second), 1.0, quadratic)
    Ia = times(E, times(inertia, transposed_times(E, alpha)))
    Iw = times(E, times(inertia, transposed_times(E, w)))
    f = (mass * at[0], mass * at[1], mass * at[2])
    for j in range(3):
        e = (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0)
        sigma, ds = (T[0, j], T[1, j], T[2, j]), 2.0 * phi[j]
        dw = sum2(cv, sigma, 1.0, tangent_rate(phi, e, ds, rate, 1.0, b, c, db, dc))
        da = sum2(ca, sigma, 1.0, tangent_rate(phi, e, ds, second, 1.0, b, c, db, dc))
        da = sum2(1.0, da, 1.0, bias_rate(phi, rate, e, ds, cv, b, c, db, dc, ddb, ddc))
        # the inertia turns: d(I u) = sigma x I u + I (du - sigma x u)
        du = sum2(1.0, da, -1.0, cross(sigma, alpha))
        dn = sum2(1.0, cross(sigma, Ia), 1.0, times(E, times(inertia, transposed_times(E, du))))
        du = sum2(1.0, dw, -1.0, cross(sigma, w))
        dIw = sum2(1.0, cross(sigma, Iw), 1.0, times(E, times(inertia, transposed_times(E, du))))
        dn = sum2(1.0, dn, 1.0, sum2(1.0, cross(dw, Iw), 1.0, cross(w, dIw)))
        drho = cross(sigma, rho)
        dn = sum2(1.0, dn, 1.0, cross(drho, f))
        if not held:
            dn = sum2(1.0, dn, ca * mass, cross(rho, drho))
        for i in range(3):
            out[i, j] -= dn[i]
            force[i, j] += ca * mass * drho[i]


@kernel
def reduce(bodies, fold, twist0, cv, ca, data, with_jac):
    """Move forces and stiffness from what bodies carry to the bodies, and take off what their inertia needs.

    Carried forces become zero. With a negative ``ca`` there is no inertia. Returns the largest force and moment
    of the inertia.
    """
    (
        base, turn, node_ptr, edge_ptr, own, E, T, mass, floating, middle, centre, inertias, node_dof, _, _, rho,
        edges, _, _, z, C, q, v, a, F, ts,
    ) = unpack(bodies, BODIES)  # fmt: skip
    m, A, change, by_turn = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    column = np.empty(3)
    widest = 0
    for b in range(base.size):
        widest = max(widest, edge_ptr[b + 1] - edge_ptr[b])
    Q, source = np.empty(widest), np.empty((widest, 3))
    force, moment = 0.0, 0.0
    for b in range(base.size):
        p, r = base[b], turn[b]
        m[:] = 0.0
        A[:] = 0.0
        for k in range(node_ptr[b], node_ptr[b + 1]):
            at = node_dof[k]
            f = (F[at], F[at + 1], F[at + 2])
            if f[0] == 0.0 and f[1] == 0.0 and f[2] == 0.0:
                continue
            for i in range(3):
                F[at + i] = 0.0
                F[p + i] += f[i]
                for j in range(3):
                    A[i, j] += rho[k, i] * f[j]
        m[0], m[1], m[2] = A[1, 2] - A[2, 1], A[2, 0] - A[0, 2], A[0, 1] - A[1, 0]
        first = edge_ptr[b]
        count = edge_ptr[b + 1] - first
        for n in range(count):
            e = edges[first + n]
            Q[n] = F[twist0 + e]
            F[twist0 + e] = 0.0
            for i in range(3):
                m[i] += Q[n] * z[first + n, i]
                source[n, i] = ts[e, i]
        held, moves = floating[b] == 0, ca >= 0.0
        k = p if held else middle[b]
        phi, rate, second, at_k = q[r : r + 3], v[r : r + 3], a[r : r + 3], a[k : k + 3]
        c, db, dc = 0.0, 0.0, 0.0
        if moves or with_jac:
            c, db, dc = chart(phi, E[b], T[b])
        if moves:
            g, n, largest = momentum_rate(
                phi, rate, second, held, at_k, mass[b], centre[b], inertias[b], E[b], T[b], c, db, dc
            )
            moment = max(moment, largest)
            for i in range(3):
                F[p + i] -= g[i]
                m[i] -= n[i]
                force = max(force, abs(g[i]))
        f = transposed_times(T[b], m)
        for i in range(3):
            F[r + i] += f[i]
        if not with_jac:
            continue
        # rows: components; columns: the rotation vector's
        change[:] = 0.0
        by_turn[:] = 0.0
        for j in range(3):
            column[:] = 0.0
            turn_stiffness(A, Q[:count], source[:count], z[first : first + count], E[b], T[b], j, column)
            change[0, j], change[1, j], change[2, j] = column[0], column[1], column[2]
        versed = _versed(phi)
        if moves:
            inertia_stiffness(
                phi, rate, second, held, at_k, mass[b], centre[b], inertias[b], E[b], T[b], versed, c, db, dc, cv, ca,
                by_turn, change,
            )  # fmt: skip
        for j in range(3):
            e = (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0)
            turned = transposed_times(T[b], change[:, j])
            bent = tangent_rate(phi, e, 2.0 * phi[j], m, -1.0, versed, c, db, dc)
            for i in range(3):
                data[own[b, i, 3 + j]] += by_turn[i, j]
                data[own[b, 3 + i, 3 + j]] -= turned[i] + bent[i]
        if moves:
            weight, arm = ca * mass[b], times(E[b], centre[b])
            for j in range(3):
                data[own[b, j, j]] += weight
                unit = (weight if j == 0 else 0.0, weight if j == 1 else 0.0, weight if j == 2 else 0.0)
                n = transposed_times(T[b], cross(arm, unit))
                for i in range(3):
                    data[own[b, 3 + i, j]] += n[i]
    if with_jac:
        _fold(fold, C, data)
    return force, moment


@kernel
def _versed(phi):
    """The coefficient b of a rotation vector."""
    _, b, _, _, _ = series(dot(phi, phi))
    return b


@kernel
def _fold(fold, C, data):
    """Add C^T J C: from the side entries of the Jacobian to those of the bodies."""
    start, entry, member, whole, target, target_ptr = unpack(fold, FOLD)
    block, place = np.zeros((6, 6)), -1
    for g in range(whole.size):
        at, r = target_ptr[g], whole[g]
        x, y, z, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(start[g], start[g + 1]):
            value, c = data[entry[n]], member[n]
            x += C[c, 0] * value
            y += C[c, 1] * value
            z += C[c, 2] * value
            u += C[c, 3] * value
            v += C[c, 4] * value
            w += C[c, 5] * value
        if r < 0:  # a row or a column of its own
            data[target[at]] += x
            data[target[at + 1]] += y
            data[target[at + 2]] += z
            data[target[at + 3]] += u
            data[target[at + 4]] += v
            data[target[at + 5]] += w
            continue
        if at != place:
            _write(block, target, place, data)
            place = at
        for i in range(6):
            c = C[r, i]
            block[i, 0] += c * x
            block[i, 1] += c * y
            block[i, 2] += c * z
            block[i, 3] += c * u
            block[i, 4] += c * v
            block[i, 5] += c * w
    _write(block, target, place, data)


@kernel
def _write(block, target, place, data):
    """Add a block to the Jacobian and clear it."""
    if place < 0:
        return
    for i in range(6):
        for j in range(6):
            data[target[place + 6 * i + j]] += block[i, j]
            block[i, j] = 0.0


@kernel
def resist(bodies, a):
    """Take from the bodies' forces what accelerations ``a`` need, at an accepted state."""
    (
        base, turn, _, _, _, E, T, mass, floating, middle, centre, inertias, _, _, _, _, _, _, _, _, _, q, v, _, F, _,
    ) = unpack(bodies, BODIES)  # fmt: skip
    for b in range(base.size):
        p, r, held = base[b], turn[b], floating[b] == 0
        k = p if held else middle[b]
        c, db, dc = chart(q[r : r + 3], E[b], T[b])
        f, n, _ = momentum_rate(
            q[r : r + 3], v[r : r + 3], a[r : r + 3], held, a[k : k + 3], mass[b], centre[b], inertias[b],
            E[b], T[b], c, db, dc,
        )  # fmt: skip
        n = transposed_times(T[b], n)
        for i in range(3):
            F[p + i] -= f[i]
            F[r + i] -= n[i]
