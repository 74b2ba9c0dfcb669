"""Compiled kernels of rigid bodies: forces and stiffness on them, and their inertia.

The formulas are derived in ``docs/theory/rigid-bodies.md``. Derivatives by the rotation vectors of all that does
not come from terms are complex steps, exact to round-off.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack
from rodnet.solve.body_kernels import BODIES, bias, chart, cross, dot, times, transposed_times

# side entries of the Jacobian, in groups: `rodnet.solve.bodies.FoldPlan`
FOLD = "row:i1 column:i1 start:i1 entry:i1 target:i1 target_ptr:i1"
STEP = 1e-30  # of complex differences


@kernel
def moment_of_held_forces(S, Q, source, E):
    """Moment of forces that stay while their arms turn; S is the sum of arm x force^T at the source."""
    m0 = dot(E[1], S[:, 2]) - dot(E[2], S[:, 1])
    m1 = dot(E[2], S[:, 0]) - dot(E[0], S[:, 2])
    m2 = dot(E[0], S[:, 1]) - dot(E[1], S[:, 0])
    for e in range(Q.size):
        t = times(E, source[e])
        weight = Q[e] / (1.0 + dot(t, source[e]))
        m0 += weight * (t[0] + source[e, 0])
        m1 += weight * (t[1] + source[e, 1])
        m2 += weight * (t[2] + source[e, 2])
    return m0, m1, m2


@kernel
def momentum_rate(phi, rate, second, held, at, mass, centre, inertia, E, T, c, db, dc):
    """What the acceleration of a body takes: force, and moment about the base; real or complex.

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
def reduce(bodies, fold, twist0, side, cv, ca, data, with_jac):
    """Move forces and stiffness from what bodies carry to the bodies, and take off what their inertia needs.

    Carried forces become zero. With a negative ``ca`` there is no inertia. Returns the largest force and moment
    of the inertia.
    """
    (
        base, turn, node_ptr, edge_ptr, own, E, T, mass, floating, middle, centre, inertias, node_dof, _, arms, rho,
        edges, _, _, z, C, q, v, a, F, ts,
    ) = unpack(bodies, BODIES)  # fmt: skip
    m, S, phi = np.empty(3), np.empty((3, 3)), np.empty(3, np.complex128)
    rate, second = np.empty(3, np.complex128), np.empty(3, np.complex128)
    Ec, Tc = np.empty((3, 3), np.complex128), np.empty((3, 3), np.complex128)
    widest = 0
    for b in range(base.size):
        widest = max(widest, edge_ptr[b + 1] - edge_ptr[b])
    Q, source = np.empty(widest), np.empty((widest, 3))
    force, moment = 0.0, 0.0
    for b in range(base.size):
        p, r = base[b], turn[b]
        m[:] = 0.0
        S[:] = 0.0
        for k in range(node_ptr[b], node_ptr[b + 1]):
            at = node_dof[k]
            f = (F[at], F[at + 1], F[at + 2])
            if f[0] == 0.0 and f[1] == 0.0 and f[2] == 0.0:
                continue
            about = cross(rho[k], f)
            for i in range(3):
                F[at + i] = 0.0
                F[p + i] += f[i]
                m[i] += about[i]
                for j in range(3):
                    S[i, j] += arms[k, i] * f[j]
        count = edge_ptr[b + 1] - edge_ptr[b]
        for n in range(count):
            k = edge_ptr[b] + n
            e = edges[k]
            Q[n] = F[twist0 + e]
            F[twist0 + e] = 0.0
            for i in range(3):
                m[i] += Q[n] * z[k, i]
                source[n, i] = ts[e, i]
        held, moves = floating[b] == 0, ca >= 0.0
        k = p if held else middle[b]
        if moves:
            c, db, dc = chart(q[r : r + 3], E[b], T[b])
            g, n, largest = momentum_rate(
                q[r : r + 3], v[r : r + 3], a[r : r + 3], held, a[k : k + 3], mass[b], centre[b], inertias[b],
                E[b], T[b], c, db, dc,
            )  # fmt: skip
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
        arm = times(E[b], centre[b])
        for j in range(3):
            for i in range(3):
                h = STEP if i == j else 0.0
                phi[i], rate[i] = complex(q[r + i], h), complex(v[r + i], cv * h)
                second[i] = complex(a[r + i], ca * h)
            cc, dbc, dcc = chart(phi, Ec, Tc)
            w = moment_of_held_forces(S, Q[:count], source[:count], Ec)
            if moves:
                # a centre that is free moves with its arm
                moved, h = cross((T[b, 0, j], T[b, 1, j], T[b, 2, j]), arm), 0.0 if held else ca * STEP
                at_c = (
                    complex(a[k], h * moved[0]),
                    complex(a[k + 1], h * moved[1]),
                    complex(a[k + 2], h * moved[2]),
                )
                gc, nc, _ = momentum_rate(
                    phi, rate, second, held, at_c, mass[b], centre[b], inertias[b], Ec, Tc, cc, dbc, dcc
                )
                w = (w[0] - nc[0], w[1] - nc[1], w[2] - nc[2])
                for i in range(3):
                    data[own[b, i, 3 + j]] += gc[i].imag / STEP
            change = transposed_times(Tc, w)
            for i in range(3):
                data[own[b, 3 + i, 3 + j]] -= change[i].imag / STEP
        if moves:
            weight = ca * mass[b]
            for j in range(3):
                data[own[b, j, j]] += weight
                unit = (weight if j == 0 else 0.0, weight if j == 1 else 0.0, weight if j == 2 else 0.0)
                n = transposed_times(T[b], cross(arm, unit))
                for i in range(3):
                    data[own[b, 3 + i, j]] += n[i]
    if with_jac:
        _fold(fold, C, data, side)
    return force, moment


@kernel
def _fold(fold, C, data, side):
    """Add C^T J C: from the side entries of the Jacobian to those of the bodies."""
    row, column, start, entry, target, target_ptr = unpack(fold, FOLD)
    w, block, place = np.empty(6), np.zeros((6, 6)), -1
    for g in range(start.size - 1):
        at, first, last = target_ptr[g], start[g], start[g + 1]
        w[:] = 0.0
        if column[entry[first]] < 0:  # carried rows, a column of its own
            for n in range(first, last):
                k = entry[n]
                value = data[side + k]
                for i in range(6):
                    w[i] += C[row[k], i] * value
        else:
            for n in range(first, last):
                k = entry[n]
                value = data[side + k]
                for i in range(6):
                    w[i] += value * C[column[k], i]
        r = row[entry[first]]
        if r < 0 or column[entry[first]] < 0:  # a row or a column of its own
            for i in range(6):
                data[target[at + i]] += w[i]
            continue
        if at != place:
            _write(block, target, place, data)
            place = at
        for i in range(6):
            for j in range(6):
                block[i, j] += C[r, i] * w[j]
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
