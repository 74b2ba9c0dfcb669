"""Compiled parts of the tangent of a step; columns are innermost in all blocks (docs, theory: sensitivities)."""

from __future__ import annotations

import math

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.kinematics.kernels import QUADRATIC, spring_forces, spring_strains
from rodnet.kinematics.turn_kernels import turn_about
from rodnet.packed import unpack

# what an evaluation holds: edges, new tangents, lengths, holonomy vectors, source tangents, rates, forces
EDGES = "edges:l2 L:d1 T:d2 S:d2 ts:d2 v:d2 F:d1"
# the matrix over the free degrees of freedom by rows: entries' places in the stored values, and their columns;
# ``full`` numbers the free degrees of freedom among all, ``position`` in the order of elimination
ROWS = "start:l1 place:l1 column:l1 full:l1 position:l1 mass:d1"


@inlined
def _by_edge(a, t, inverse, out):
    """Derivative by the edge vector of a . t, the edge's tangent: (a - (a.t) t) / l."""
    along = a[0] * t[0] + a[1] * t[1] + a[2] * t[2]
    for i in range(3):
        out[i] = (a[i] - along * t[i]) * inverse


@kernel
def turn_sources(table, twist0, x_old, dq, spin, phi, dv, out):
    """Effect of changed source frames on angles and rates of twist, and on the residual.

    Parameters
    ----------
    table : int
        The `Packed` arrays of an evaluation (`EDGES`).
    twist0 : int
        First twist angle among the degrees of freedom.
    x_old : ndarray, shape (n, 3)
        Positions before the step.
    dq, spin : ndarray, shapes (dof_count, k) and (edge_count, k)
        Changes of the old degrees of freedom and of the old directors.
    phi : ndarray, shape (edge_count, k)
        Angles that the transported directors turn by, set.
    dv, out : ndarray, shape (dof_count, k)
        Changes of the rates and of the residual, added to.
    """
    edges, L, T, S, ts, v, F = unpack(table, EDGES)
    count = dq.shape[1]
    h = np.empty((3, 3))
    a, b, g, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        length = 0.0
        chi = 1.0
        spun = 0.0
        for m in range(3):
            length += (x_old[j, m] - x_old[i, m]) ** 2
            chi += ts[e, m] * T[e, m]
            w[m] = v[j, m] - v[i, m]
            spun += S[e, m] * w[m]
        inverse = 1.0 / math.sqrt(length)
        _by_edge(S[e], ts[e], inverse, g)
        scale = 1.0 / (L[e] * chi)
        t = T[e]
        b[0] = -scale * (t[1] * w[2] - t[2] * w[1] - spun * t[0])
        b[1] = -scale * (t[2] * w[0] - t[0] * w[2] - spun * t[1])
        b[2] = -scale * (t[0] * w[1] - t[1] * w[0] - spun * t[2])
        _by_edge(b, ts[e], inverse, w)
        # rows of the derivative of S by the source tangent, (dts x t - S (dts . t)) / chi
        moment = F[twist0 + e] * scale
        for m in range(3):
            for n in range(3):
                a[n] = -moment * S[e, m] * t[n]
            n1, n2 = (m + 1) % 3, (m + 2) % 3
            a[n1] += moment * t[n2]
            a[n2] -= moment * t[n1]
            _by_edge(a, ts[e], inverse, h[m])
        twist = twist0 + e
        i, j = 3 * i, 3 * j
        g0, g1, g2, w0, w1, w2 = g[0], g[1], g[2], w[0], w[1], w[2]
        for c in range(count):
            d0, d1, d2 = dq[j, c] - dq[i, c], dq[j + 1, c] - dq[i + 1, c], dq[j + 2, c] - dq[i + 2, c]
            phi[e, c] = spin[e, c] - (g0 * d0 + g1 * d1 + g2 * d2)
            dv[twist, c] += w0 * d0 + w1 * d1 + w2 * d2
        if moment != 0.0:
            for m in range(3):
                h0, h1, h2 = h[m, 0], h[m, 1], h[m, 2]
                for c in range(count):
                    f = (
                        h0 * (dq[j, c] - dq[i, c])
                        + h1 * (dq[j + 1, c] - dq[i + 1, c])
                        + h2 * (dq[j + 2, c] - dq[i + 2, c])
                    )
                    out[j + m, c] += f
                    out[i + m, c] -= f


@kernel
def right_sides(rows, twist0, J, D, cv, ca, phi, dv, da, out, y):
    """Right-hand sides of all columns, in the order of elimination: minus the change of the residual.

    Parameters
    ----------
    rows : int
        The `Packed` matrix (`ROWS`).
    twist0 : int
        First twist angle among the degrees of freedom.
    J, D : ndarray
        Values of the Jacobian, and of minus the derivative of the forces by the rates.
    cv, ca : float
        Derivatives of the rates and accelerations by the position.
    phi, dv, da, out : ndarray
        Changes of the frames, rates, accelerations, and of the rest of the residual.
    y : ndarray, shape (free, k)
        Where they go.
    """
    start, place, column, full, position, mass = unpack(rows, ROWS)
    count = y.shape[1]
    for r in range(full.shape[0]):
        i, to = full[r], position[r]
        m = mass[i]
        for c in range(count):
            y[to, c] = -out[i, c] - m * da[i, c]
        for k in range(start[r], start[r + 1]):
            j = full[column[k]]
            d = D[place[k]]
            if d != 0.0:
                for c in range(count):
                    y[to, c] -= d * dv[j, c]
            if j >= twist0:
                stiff = J[place[k]] - cv * d
                if i == j:
                    stiff -= ca * m
                e = j - twist0
                if stiff != 0.0:
                    for c in range(count):
                        y[to, c] -= stiff * phi[e, c]


@kernel
def advance(table, rows, twist0, y, cv, ca, dq_old, dv0, da0, phi, dq, dv, da, spin):
    """Changes of the new degrees of freedom, rates, accelerations and directors, all overwritten.

    ``dq`` of what is held must be there already; so must its rates, which are not touched.
    """
    edges, L, T, S, _, _, _ = unpack(table, EDGES)
    _, _, _, full, position, _ = unpack(rows, ROWS)
    count = y.shape[1]
    for r in range(full.shape[0]):
        i, at = full[r], position[r]
        for c in range(count):
            new = y[at, c]
            d = new - dq_old[i, c]
            dq[i, c] = new
            dv[i, c] = cv * d + dv0[i, c]
            da[i, c] = ca * d + da0[i, c]
    g = np.empty(3)
    for e in range(edges.shape[0]):
        _by_edge(S[e], T[e], 1.0 / L[e], g)
        g0, g1, g2 = g[0], g[1], g[2]
        i, j = 3 * edges[e, 0], 3 * edges[e, 1]
        for c in range(count):
            d0, d1, d2 = dq[j, c] - dq[i, c], dq[j + 1, c] - dq[i + 1, c], dq[j + 2, c] - dq[i + 2, c]
            spin[e, c] = phi[e, c] - (g0 * d0 + g1 * d1 + g2 * d2)


@kernel
def motor_change(quadratic, parts, angle, h, s, second, K, out):
    """Set ``out``, shape (11,), to the change of the residual with the natural angle of one spring's motor."""
    (
        _, _, _, L, T, M1, M2, S, _, _, e1, e2, Q1, Q2, _, _, _, _, eps0, _, _,
        s1, s2, _, _, _, slots, _, ts, _, tau_ref,
    ) = unpack(quadratic, QUADRATIC)  # fmt: skip
    out[:] = 0.0
    eps, sigma, scrap = np.empty((1, 3)), np.empty((1, 3)), np.zeros(1)
    one, two = Q1[s : s + 1].copy(), Q2[s : s + 1].copy()
    dofs = np.empty((1, 11), dtype=np.int32)
    for i in range(11):
        dofs[0, i] = i
    for sign in (1.0, -1.0):
        turn_about(parts, angle + sign * h, 0, two if second else one)
        a, b = e1[s : s + 1], e2[s : s + 1]
        spring_strains(a, b, one, two, T, M1, M2, tau_ref[s : s + 1], eps)
        for i in range(3):
            sigma[0, i] = 0.0
            for j in range(3):
                sigma[0, i] -= sign / (2.0 * h) * K[s, i, j] * (eps[0, j] - eps0[s, j])
        spring_forces(
            a, b, one, two, s1[s : s + 1], s2[s : s + 1], dofs, L, T, M1, M2, S, ts, eps, sigma, K[s : s + 1],
            out, slots[s : s + 1], scrap, False,
        )  # fmt: skip
