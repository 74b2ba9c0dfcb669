"""Compiled kernels of rigid bodies: what they carry, what acts on them, and their inertia.

The formulas are derived in ``docs/theory/rigid-bodies.md``. *Carried* degrees of freedom, positions and
twist angles, follow from the six of their body; they are numbered body by body, positions first.
"""

from __future__ import annotations

import math

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack

# the arrays of an evaluation's bodies. Of each body: degrees of freedom ``base`` and ``turn``, first of its
# carried nodes and edges (``node_ptr``, ``edge_ptr``), places in the Jacobian (``own``); of what it carries:
# degree of freedom, row in C, and ``arms``, ``theta0`` at the source
BODIES = (
    "base:i1 turn:i1 node_ptr:i1 edge_ptr:i1 own:i3 E:d3 T:d3 mass:d1 centre:d2 inertia:d3 "
    "node_dof:i1 node_row:i1 arms:d2 rho:d2 edges:i1 edge_row:i1 theta0:d1 z:d2 C:d2 q:d1 v:d1 F:d1 ts:d2"
)
# of the source's orientation: as drawn, seen from the base
DRAWN = "first:i1 frames0:d3 arms0:d2 centre0:d2 inertia0:d3 d1s:d2"
# side entries of the Jacobian, in segments of one row: `rodnet.solve.bodies.FoldPlan`
FOLD = "row:i1 start:i1 column:i1 target:i1 target_ptr:i1"
STEP = 1e-30  # of complex differences
HALF_TURN = (0.97 * math.pi) ** 2

_K = np.arange(20)
_SIGNS = (-1.0) ** _K
SIN, COS, THIRD = (np.array([s / math.factorial(2 * k + n) for k, s in enumerate(_SIGNS)]) for n in (1, 2, 3))


@kernel
def series(s):
    """Coefficients a, b, c of a rotation by the vector of square length s, and db/ds, dc/ds."""
    a, b, c, db, dc = 0.0 * s, 0.0 * s, 0.0 * s, 0.0 * s, 0.0 * s
    for k in range(SIN.size - 1, -1, -1):
        db = db * s + b
        dc = dc * s + c
        a = a * s + SIN[k]
        b = b * s + COS[k]
        c = c * s + THIRD[k]
    return a, b, c, db, dc


@kernel
def cross(a, b, out):
    """Vector product."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    out[0], out[1], out[2] = x, y, z


@kernel
def multiply(A, x, transposed, out):
    """Product of a matrix (3, 3), or its transpose, and a vector."""
    for i in range(3):
        if transposed:
            out[i] = A[0, i] * x[0] + A[1, i] * x[1] + A[2, i] * x[2]
        else:
            out[i] = A[i, 0] * x[0] + A[i, 1] * x[1] + A[i, 2] * x[2]


@kernel
def chart(phi, E, T):
    """Rotation E and tangent map T of a rotation vector, real or complex."""
    s = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    a, b, c, _, _ = series(s)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        E[i, i] = 1.0 - b * (s - phi[i] * phi[i])
        T[i, i] = 1.0 - c * (s - phi[i] * phi[i])
        E[i, j] = b * phi[i] * phi[j] - a * phi[k]
        E[j, i] = b * phi[i] * phi[j] + a * phi[k]
        T[i, j] = c * phi[i] * phi[j] - b * phi[k]
        T[j, i] = c * phi[i] * phi[j] + b * phi[k]


@kernel
def bias(phi, rate, out):
    """Part of the angular acceleration that is quadratic in the rate of phi."""
    s = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    ds = 2.0 * (phi[0] * rate[0] + phi[1] * rate[1] + phi[2] * rate[2])
    _, _, c, db, dc = series(s)
    once, twice, other = np.empty_like(out), np.empty_like(out), np.empty_like(out)
    cross(phi, rate, once)
    cross(phi, once, twice)
    cross(rate, once, other)
    for i in range(3):
        out[i] = ds * (db * once[i] + dc * twice[i]) + c * other[i]


@kernel
def orient(bodies, drawn, twist0, q):
    """Take the orientation of an accepted state ``q`` from the source frames of each body's first edge."""
    (_, _, node_ptr, edge_ptr, _, _, _, _, centre, inertia, _, _, arms, _, edges, _, theta0, _, _, _, _, _, ts) = (
        unpack(bodies, BODIES)
    )
    first, frames0, arms0, centre0, inertia0, d1s = unpack(drawn, DRAWN)
    R, half, m1, m2 = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    for b in range(first.size):
        e = first[b]
        c, s = math.cos(q[twist0 + e]), math.sin(q[twist0 + e])
        cross(ts[e], d1s[e], m2)
        for i in range(3):
            m1[i] = c * d1s[e, i] + s * m2[i]
        cross(ts[e], m1, m2)
        for i in range(3):
            for j in range(3):
                F0 = frames0[b, j]
                R[i, j] = m1[i] * F0[0] + m2[i] * F0[1] + ts[e, i] * F0[2]
        for k in range(node_ptr[b], node_ptr[b + 1]):
            multiply(R, arms0[k], False, arms[k])
        multiply(R, centre0[b], False, centre[b])
        for i in range(3):
            multiply(R, inertia0[b, i], False, half[i])
        for j in range(3):
            multiply(R, half[:, j], False, m1)
            for i in range(3):
                inertia[b, i, j] = m1[i]
        for k in range(edge_ptr[b], edge_ptr[b + 1]):
            theta0[k] = q[twist0 + edges[k]]


@kernel
def place(bodies, twist0):
    """Put what bodies carry in its place; return the largest square of a rotation vector."""
    (
        base, turn, node_ptr, edge_ptr, _, E, T, _, _, _, node_dof, node_row, arms, rho, edges, edge_row, theta0,
        z, C, q, _, _, ts,
    ) = unpack(bodies, BODIES)  # fmt: skip
    largest, t = 0.0, np.empty(3)
    for b in range(base.size):
        phi = q[turn[b] : turn[b] + 3]
        s = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
        largest = max(largest, s) if s == s else math.inf
        chart(phi, E[b], T[b])
        for k in range(node_ptr[b], node_ptr[b + 1]):
            multiply(E[b], arms[k], False, rho[k])
            r, at = rho[k], node_row[k]
            for i in range(3):
                q[node_dof[k] + i] = q[base[b] + i] + r[i]
            for j in range(3):  # -[rho] T, column by column
                C[at, 3 + j] = r[2] * T[b, 1, j] - r[1] * T[b, 2, j]
                C[at + 1, 3 + j] = r[0] * T[b, 2, j] - r[2] * T[b, 0, j]
                C[at + 2, 3 + j] = r[1] * T[b, 0, j] - r[0] * T[b, 1, j]
        half, versed, _, _, _ = series(0.25 * s)
        for k in range(edge_ptr[b], edge_ptr[b + 1]):
            source = ts[edges[k]]
            along = phi[0] * source[0] + phi[1] * source[1] + phi[2] * source[2]
            turned = 2.0 * math.atan2(0.5 * along * half, 1.0 - 0.25 * s * versed)
            q[twist0 + edges[k]] = theta0[k] + turned
            multiply(E[b], source, False, t)
            chi = 1.0 + t[0] * source[0] + t[1] * source[1] + t[2] * source[2]
            for i in range(3):
                z[k, i] = (t[i] + source[i]) / chi
            multiply(T[b], z[k], True, C[edge_row[k], 3:])
    return largest


@kernel
def follow(bodies, twist0, q_old, cv, ca, v0, a0, a):
    """Call `place`, and give what is carried the stepper's rates; an empty ``v0`` stands for zeros."""
    (_, _, _, _, _, _, _, _, _, _, node_dof, _, _, _, edges, _, _, _, _, q, v, _, _) = unpack(bodies, BODIES)
    largest = place(bodies, twist0)
    for k in range(node_dof.size):
        for d in range(node_dof[k], node_dof[k] + 3):
            v[d] = cv * (q[d] - q_old[d]) + (v0[d] if v0.shape[0] else 0.0)
            a[d] = ca * (q[d] - q_old[d]) + a0[d]
    for k in range(edges.size):
        d = twist0 + edges[k]
        v[d] = cv * (q[d] - q_old[d]) + (v0[d] if v0.shape[0] else 0.0)
        a[d] = ca * (q[d] - q_old[d]) + a0[d]
    return largest


@kernel
def spread(bodies, twist0, full):
    """Changes of what is carried, for given changes of the bodies: ``full[carried] = C full[body]``."""
    base, turn, node_ptr, edge_ptr, _, _, _, _, _, _, node_dof, node_row, _, _, edges, edge_row, _, _, C, _, _, _, _ = (
        unpack(bodies, BODIES)
    )
    for b in range(base.size):
        p, r = base[b], turn[b]
        for k in range(node_ptr[b], node_ptr[b + 1]):
            for i in range(3):
                row = C[node_row[k] + i]
                turned = row[3] * full[r] + row[4] * full[r + 1] + row[5] * full[r + 2]
                full[node_dof[k] + i] = full[p + i] + turned
        for k in range(edge_ptr[b], edge_ptr[b + 1]):
            row = C[edge_row[k]]
            full[twist0 + edges[k]] = row[3] * full[r] + row[4] * full[r + 1] + row[5] * full[r + 2]


@kernel
def moment_of_held_forces(phi, S, Q, source, E, T, out):
    """T^T m: moment of forces that stay while their arms turn; S = sum of arm x force^T at the source."""
    chart(phi, E, T)
    m, t = np.zeros_like(out), np.empty_like(out)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for n in range(3):
            m[i] += E[j, n] * S[n, k] - E[k, n] * S[n, j]
    for e in range(Q.size):
        multiply(E, source[e], False, t)
        chi = 1.0 + t[0] * source[e, 0] + t[1] * source[e, 1] + t[2] * source[e, 2]
        for i in range(3):
            m[i] += Q[e] * (t[i] + source[e, i]) / chi
    multiply(T, m, True, out)


@kernel
def reduce(bodies, fold, twist0, side, data, with_jac):
    """Move forces and stiffness from what bodies carry to the bodies; carried forces become zero."""
    (
        base, turn, node_ptr, edge_ptr, own, _, T, _, _, _, node_dof, _, arms, rho, edges, _, _, z, C, q, _, F, ts,
    ) = unpack(bodies, BODIES)  # fmt: skip
    m, S, f = np.empty(3), np.empty((3, 3)), np.empty(3)
    phi, out = np.empty(3, np.complex128), np.empty(3, np.complex128)
    Ec, Tc = np.empty((3, 3), np.complex128), np.empty((3, 3), np.complex128)
    widest = 0
    for b in range(base.size):
        widest = max(widest, edge_ptr[b + 1] - edge_ptr[b])
    Q, source = np.empty(widest), np.empty((widest, 3))
    for b in range(base.size):
        m[:] = 0.0
        S[:] = 0.0
        for k in range(node_ptr[b], node_ptr[b + 1]):
            for i in range(3):
                f[i] = F[node_dof[k] + i]
                F[node_dof[k] + i] = 0.0
                F[base[b] + i] += f[i]
            r = rho[k]
            m[0] += r[1] * f[2] - r[2] * f[1]
            m[1] += r[2] * f[0] - r[0] * f[2]
            m[2] += r[0] * f[1] - r[1] * f[0]
            for i in range(3):
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
        multiply(T[b], m, True, f)
        for i in range(3):
            F[turn[b] + i] += f[i]
        if with_jac:
            for j in range(3):
                for i in range(3):
                    phi[i] = complex(q[turn[b] + i], STEP if i == j else 0.0)
                moment_of_held_forces(phi, S, Q[:count], source[:count], Ec, Tc, out)
                for i in range(3):
                    data[own[b, 3 + i, 3 + j]] -= out[i].imag / STEP
    if with_jac:
        _fold(fold, C, data, side)


@kernel
def _fold(fold, C, data, side):
    """Add C^T J C: from the side entries of the Jacobian to those of the bodies."""
    row, start, column, target, target_ptr = unpack(fold, FOLD)
    w = np.empty(6)
    for g in range(row.size):
        at, r = target_ptr[g], row[g]
        if column[start[g]] < 0:  # a carried row, a column of its own
            value = data[side + start[g]]
            for i in range(6):
                data[target[at + i]] += C[r, i] * value
            continue
        w[:] = 0.0
        for k in range(start[g], start[g + 1]):
            value = data[side + k]
            for i in range(6):
                w[i] += value * C[column[k], i]
        if r < 0:  # a row of its own, carried columns
            for i in range(6):
                data[target[at + i]] += w[i]
        else:
            for i in range(6):
                for j in range(6):
                    data[target[at + 6 * i + j]] += C[r, i] * w[j]


@kernel
def momentum_rate(phi, rate, second, acceleration, mass, centre, inertia, E, T, f, n):
    """What the acceleration of a body takes: force, and T^T moment about the base; real or complex.

    Returns the largest part of the moment.
    """
    chart(phi, E, T)
    w, alpha, rho = np.empty_like(f), np.empty_like(f), np.empty_like(f)
    multiply(T, rate, False, w)
    bias(phi, rate, alpha)
    multiply(T, second, False, rho)
    for i in range(3):
        alpha[i] += rho[i]
    multiply(E, centre, False, rho)
    local, about, spun, swept = np.empty_like(f), np.empty_like(f), np.empty_like(f), np.empty_like(f)
    multiply(E, alpha, True, local)
    multiply(inertia, local, False, about)
    multiply(E, about, False, n)  # I alpha
    multiply(E, w, True, local)
    multiply(inertia, local, False, about)
    multiply(E, about, False, local)  # I w
    cross(w, local, spun)
    cross(alpha, rho, f)
    cross(w, rho, about)
    cross(w, about, swept)
    cross(rho, acceleration, about)
    largest = 0.0
    for i in range(3):
        f[i] = mass * (acceleration[i] + f[i] + swept[i])
        largest = max(largest, abs(n[i]), abs(spun[i]), abs(mass * about[i]))
        local[i] = n[i] + spun[i] + mass * about[i]
    multiply(T, local, True, n)
    return largest


@kernel
def inertia(bodies, a, ca, cv, force, moment, data, with_jac):
    """Take from F what the bodies' acceleration needs, and add its derivative; return the scales."""
    base, turn, _, _, own, _, T, mass, centre, inertias, _, _, _, _, _, _, _, _, _, q, v, F, _ = unpack(bodies, BODIES)
    E0, T0, f0, n0 = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    E1, T1 = np.empty((3, 3), np.complex128), np.empty((3, 3), np.complex128)
    f1, n1, acceleration = np.empty(3, np.complex128), np.empty(3, np.complex128), np.empty(3, np.complex128)
    phi, rate, second = np.empty(3, np.complex128), np.empty(3, np.complex128), np.empty(3, np.complex128)
    for b in range(base.size):
        p, r = base[b], turn[b]
        moment = max(
            moment,
            momentum_rate(
                q[r : r + 3], v[r : r + 3], a[r : r + 3], a[p : p + 3], mass[b], centre[b], inertias[b], E0, T0, f0, n0
            ),
        )
        for i in range(3):
            F[p + i] -= f0[i]
            F[r + i] -= n0[i]
            force = max(force, abs(f0[i]))
        if not with_jac:
            continue
        for j in range(3):
            for i in range(3):
                h = STEP if i == j else 0.0
                phi[i], rate[i] = complex(q[r + i], h), complex(v[r + i], cv * h)
                second[i], acceleration[i] = complex(a[r + i], ca * h), a[p + i]
            momentum_rate(phi, rate, second, acceleration, mass[b], centre[b], inertias[b], E1, T1, f1, n1)
            for i in range(3):
                data[own[b, i, 3 + j]] += f1[i].imag / STEP
                data[own[b, 3 + i, 3 + j]] += n1[i].imag / STEP
        multiply(E0, centre[b], False, f0)
        for j in range(3):
            data[own[b, j, j]] += ca * mass[b]
            n0[:] = 0.0
            n0[j] = ca * mass[b]
            cross(f0, n0, n0)
            for i in range(3):
                data[own[b, 3 + i, j]] += T[b, 0, i] * n0[0] + T[b, 1, i] * n0[1] + T[b, 2, i] * n0[2]
    return force, moment


@kernel
def accept(bodies, q, v, a, acc):
    """Change to the chart of the state that has been reached: its rotation vectors are zero."""
    _, turn, _, _, _, _, T, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _ = unpack(bodies, BODIES)
    extra, new = np.empty(3), np.empty(3)
    for b in range(turn.size):
        part = slice(turn[b], turn[b] + 3)
        bias(q[part], v[part], extra)
        multiply(T[b], a[part], False, new)
        a[part] = new + extra
        multiply(T[b], acc[part], False, new)
        acc[part] = new + extra
        multiply(T[b], v[part], False, new)
        v[part] = new
        q[part] = 0.0
