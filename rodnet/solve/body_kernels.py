"""Compiled kernels of rigid bodies: rotations, what bodies carry, and charts.

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
# degree of freedom, row in C (derivatives by all six), and ``arms``, ``theta0`` at the source
BODIES = (
    "base:i1 turn:i1 node_ptr:i1 edge_ptr:i1 own:i3 E:d3 T:d3 mass:d1 floating:i1 middle:i1 centre:d2 inertia:d3 "
    "node_dof:i1 node_row:i1 arms:d2 rho:d2 edges:i1 edge_row:i1 theta0:d1 z:d2 C:d2 q:d1 v:d1 a:d1 F:d1 ts:d2"
)
# of the source's orientation: as drawn, seen from the base
DRAWN = "first:i1 frames0:d3 arms0:d2 centre0:d2 inertia0:d3 d1s:d2"
HALF_TURN = (0.97 * math.pi) ** 2

_K = np.arange(20)
_SIGNS = (-1.0) ** _K
SIN, COS, THIRD = (np.array([s / math.factorial(2 * k + n) for k, s in enumerate(_SIGNS)]) for n in (1, 2, 3))


@kernel
def series(s):
    """Coefficients a, b, c of a rotation by the vector of square length s, and db/ds, dc/ds."""
    a, b, c, db, dc = 0.0 * s, 0.0 * s, 0.0 * s, 0.0 * s, 0.0 * s
    for k in range(7 if abs(s) < 0.3 else 19, -1, -1):
        db = db * s + b
        dc = dc * s + c
        a = a * s + SIN[k]
        b = b * s + COS[k]
        c = c * s + THIRD[k]
    return a, b, c, db, dc


@kernel
def second_series(s):
    """Second derivatives of the coefficients b and c by s."""
    b, c, db, dc, ddb, ddc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(7 if abs(s) < 0.3 else 19, -1, -1):
        ddb = ddb * s + 2.0 * db
        ddc = ddc * s + 2.0 * dc
        db = db * s + b
        dc = dc * s + c
        b = b * s + COS[k]
        c = c * s + THIRD[k]
    return ddb, ddc


@kernel
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a, b):
    """Scalar product, without conjugation."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def times(A, x):
    """Product of a matrix (3, 3) and a vector."""
    return (
        A[0, 0] * x[0] + A[0, 1] * x[1] + A[0, 2] * x[2],
        A[1, 0] * x[0] + A[1, 1] * x[1] + A[1, 2] * x[2],
        A[2, 0] * x[0] + A[2, 1] * x[1] + A[2, 2] * x[2],
    )


@kernel
def transposed_times(A, x):
    """Product of the transpose of a matrix (3, 3) and a vector."""
    return (
        A[0, 0] * x[0] + A[1, 0] * x[1] + A[2, 0] * x[2],
        A[0, 1] * x[0] + A[1, 1] * x[1] + A[2, 1] * x[2],
        A[0, 2] * x[0] + A[1, 2] * x[1] + A[2, 2] * x[2],
    )


@kernel
def chart(phi, E, T):
    """Rotation E and tangent map T of a rotation vector, real or complex; returns c, db/ds, dc/ds."""
    x, y, z = phi[0], phi[1], phi[2]
    s = x * x + y * y + z * z
    a, b, c, db, dc = series(s)
    E[0, 0], E[1, 1], E[2, 2] = (
        1.0 - b * (y * y + z * z),
        1.0 - b * (z * z + x * x),
        1.0 - b * (x * x + y * y),
    )
    T[0, 0], T[1, 1], T[2, 2] = (
        1.0 - c * (y * y + z * z),
        1.0 - c * (z * z + x * x),
        1.0 - c * (x * x + y * y),
    )
    E[0, 1], E[1, 0] = b * x * y - a * z, b * x * y + a * z
    E[1, 2], E[2, 1] = b * y * z - a * x, b * y * z + a * x
    E[2, 0], E[0, 2] = b * z * x - a * y, b * z * x + a * y
    T[0, 1], T[1, 0] = c * x * y - b * z, c * x * y + b * z
    T[1, 2], T[2, 1] = c * y * z - b * x, c * y * z + b * x
    T[2, 0], T[0, 2] = c * z * x - b * y, c * z * x + b * y
    return c, db, dc


@kernel
def bias(phi, rate, c, db, dc):
    """Part of the angular acceleration that is quadratic in the rate of phi."""
    ds = 2.0 * dot(phi, rate)
    once = cross(phi, rate)
    twice, other = cross(phi, once), cross(rate, once)
    return (
        ds * (db * once[0] + dc * twice[0]) + c * other[0],
        ds * (db * once[1] + dc * twice[1]) + c * other[1],
        ds * (db * once[2] + dc * twice[2]) + c * other[2],
    )


@kernel
def axial_turn(phi, s, source):
    """Turn about the direction ``source`` of a rotation by the vector phi of square length s."""
    half, versed, _, _, _ = series(0.25 * s)
    return 2.0 * math.atan2(0.5 * dot(phi, source) * half, 1.0 - 0.25 * s * versed)


@kernel
def orient(bodies, drawn, twist0, q):
    """Take the orientation of an accepted state ``q`` from the source frames of each body's first edge."""
    (
        _, _, node_ptr, edge_ptr, _, _, _, _, _, _, centre, inertia, _, _, arms, _, edges, _, theta0, _, _, _, _, _, _,
        ts,
    ) = unpack(bodies, BODIES)  # fmt: skip
    first, frames0, arms0, centre0, inertia0, d1s = unpack(drawn, DRAWN)
    R, half = np.empty((3, 3)), np.empty((3, 3))
    for b in range(first.size):
        e, F0 = first[b], frames0[b]
        c, s = math.cos(q[twist0 + e]), math.sin(q[twist0 + e])
        t, d1 = ts[e], d1s[e]
        d2 = cross(t, d1)
        m1 = (c * d1[0] + s * d2[0], c * d1[1] + s * d2[1], c * d1[2] + s * d2[2])
        m2 = cross(t, m1)
        for i in range(3):
            for j in range(3):
                R[i, j] = m1[i] * F0[j, 0] + m2[i] * F0[j, 1] + t[i] * F0[j, 2]
        for k in range(node_ptr[b], node_ptr[b + 1]):
            arms[k, 0], arms[k, 1], arms[k, 2] = times(R, arms0[k])
        centre[b, 0], centre[b, 1], centre[b, 2] = times(R, centre0[b])
        for i in range(3):
            half[i, 0], half[i, 1], half[i, 2] = times(R, inertia0[b, i])
        for j in range(3):
            inertia[b, j, 0], inertia[b, j, 1], inertia[b, j, 2] = times(R, half[:, j])
        for k in range(edge_ptr[b], edge_ptr[b + 1]):
            theta0[k] = q[twist0 + edges[k]]


@kernel
def place(bodies, twist0):
    """Put what bodies carry in its place; return the largest square of a rotation vector."""
    (
        base, turn, node_ptr, edge_ptr, _, E, T, _, _, _, _, _, node_dof, node_row, arms, rho, edges, edge_row, theta0,
        z, C, q, _, _, _, ts,
    ) = unpack(bodies, BODIES)  # fmt: skip
    largest = 0.0
    for b in range(base.size):
        phi = q[turn[b] : turn[b] + 3]
        s = dot(phi, phi)
        largest = max(largest, s) if s == s else math.inf
        chart(phi, E[b], T[b])
        for k in range(node_ptr[b], node_ptr[b + 1]):
            r, at = times(E[b], arms[k]), node_row[k]
            for i in range(3):
                rho[k, i] = r[i]
                q[node_dof[k] + i] = q[base[b] + i] + r[i]
            for j in range(3):  # -[rho] T, column by column
                C[at, 3 + j] = r[2] * T[b, 1, j] - r[1] * T[b, 2, j]
                C[at + 1, 3 + j] = r[0] * T[b, 2, j] - r[2] * T[b, 0, j]
                C[at + 2, 3 + j] = r[1] * T[b, 0, j] - r[0] * T[b, 1, j]
        for k in range(edge_ptr[b], edge_ptr[b + 1]):
            source = ts[edges[k]]
            q[twist0 + edges[k]] = theta0[k] + axial_turn(phi, s, source)
            t = times(E[b], source)
            chi = 1.0 + dot(t, source)
            for i in range(3):
                z[k, i] = (t[i] + source[i]) / chi
            at = edge_row[k]
            C[at, 3], C[at, 4], C[at, 5] = transposed_times(T[b], z[k])
    return largest


@kernel
def spread(bodies, twist0, full):
    """Changes of what is carried, for given changes of the bodies: ``full[carried] = C full[body]``."""
    (
        base, turn, node_ptr, edge_ptr, _, _, _, _, _, _, _, _, node_dof, node_row, _, _, edges, edge_row, _, _, C,
        _, _, _, _, _,
    ) = unpack(bodies, BODIES)  # fmt: skip
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
def rebase(bodies, v):
    """Rates of the bases of free bodies that go with those of their centres, at an accepted state."""
    (
        base, turn, _, _, _, _, _, _, floating, middle, centre, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _,
    ) = unpack(bodies, BODIES)  # fmt: skip
    for b in range(base.size):
        if floating[b]:
            swept = cross(v[turn[b] : turn[b] + 3], centre[b])
            for i in range(3):
                v[base[b] + i] = v[middle[b] + i] - swept[i]


@kernel
def accept(bodies, q, v, a, acc):
    """Change to the chart of the state that has been reached: its rotation vectors are zero."""
    _, turn, _, _, _, E, T, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _ = unpack(bodies, BODIES)
    for b in range(turn.size):
        r = turn[b]
        extra = bias(q[r : r + 3], v[r : r + 3], *chart(q[r : r + 3], E[b], T[b]))
        omega, alpha, other = (
            times(T[b], v[r : r + 3]),
            times(T[b], a[r : r + 3]),
            times(T[b], acc[r : r + 3]),
        )
        for i in range(3):
            q[r + i], v[r + i] = 0.0, omega[i]
            a[r + i], acc[r + i] = alpha[i] + extra[i], other[i] + extra[i]
