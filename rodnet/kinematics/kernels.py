"""Compiled kinematics: edge frames, spring strains, and their exact gradient and Hessian.

The formulas are derived in ``docs/theory``. Arrays in, arrays out; no objects. Signs: kernels
*add* force = -dE/dq to ``F`` and +d2E/dq2 to ``data``. Degrees of freedom are numbered
``3 * node + axis`` for positions and ``twist0 + edge`` for twist angles.
"""

import math

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.packed import unpack

# what an evaluation hands to kernels of terms (`rodnet.packed`)
STATE = "x:d2 v:d2 theta:d1 w:d1 edges:l2 L:d1 T:d2 S:d2 ts:d2"
FOLD = 1e-2  # smallest 1 + cos(turning angle) that is still computed: a turn of 171.9 degrees


@kernel
def edge_frames(x, theta, edges, ts, d1s, L, T, M1, M2, S):
    """Lengths, tangents, material directors and holonomy vectors of all edges.

    The reference director is the parallel transport of ``d1s`` from the source tangent ``ts``;
    S = (ts x t) / (1 + ts.t) is the vector of its spin -S.dt under a change dt of the tangent.
    Returns the smallest length and the smallest 1 + ts.t.
    """
    lmin = math.inf
    cmin = math.inf
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        ex, ey, ez = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        l = math.sqrt(ex * ex + ey * ey + ez * ez)
        lmin = min(lmin, l)
        L[e] = l
        inv = 1.0 / l if l > 0.0 else 0.0
        tx, ty, tz = ex * inv, ey * inv, ez * inv
        ax, ay, az = ts[e, 0], ts[e, 1], ts[e, 2]
        bx, by, bz = ay * tz - az * ty, az * tx - ax * tz, ax * ty - ay * tx
        c = ax * tx + ay * ty + az * tz
        chi = 1.0 + c
        cmin = min(cmin, chi)
        ic = 1.0 / max(chi, 1e-12)
        dx, dy, dz = d1s[e, 0], d1s[e, 1], d1s[e, 2]
        bd = (bx * dx + by * dy + bz * dz) * ic
        ux = c * dx + by * dz - bz * dy + bx * bd
        uy = c * dy + bz * dx - bx * dz + by * bd
        uz = c * dz + bx * dy - by * dx + bz * bd
        wx, wy, wz = ty * uz - tz * uy, tz * ux - tx * uz, tx * uy - ty * ux
        ct, st = math.cos(theta[e]), math.sin(theta[e])
        T[e, 0], T[e, 1], T[e, 2] = tx, ty, tz
        M1[e, 0], M1[e, 1], M1[e, 2] = ct * ux + st * wx, ct * uy + st * wy, ct * uz + st * wz
        M2[e, 0], M2[e, 1], M2[e, 2] = ct * wx - st * ux, ct * wy - st * uy, ct * wz - st * uz
        S[e, 0], S[e, 1], S[e, 2] = bx * ic, by * ic, bz * ic
    return lmin, cmin


@inlined
def _carried(e, Q, s, T, M1, M2, V):
    """Columns of V = F_e Q_s, the frame that edge ``e`` carries for spring ``s``, stored as rows."""
    for k in range(3):
        q0, q1, q2 = Q[s, 0, k], Q[s, 1, k], Q[s, 2, k]
        V[k, 0] = M1[e, 0] * q0 + M2[e, 0] * q1 + T[e, 0] * q2
        V[k, 1] = M1[e, 1] * q0 + M2[e, 1] * q1 + T[e, 1] * q2
        V[k, 2] = M1[e, 2] * q0 + M2[e, 2] * q1 + T[e, 2] * q2


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def spring_strains(e1, e2, Q1, Q2, T, M1, M2, tau_ref, theta, theta_ref, driven, driven_ref, spin, eps):
    """Strains (kappa1, kappa2, tau) of all springs; tau counts full turns.

    It is unwrapped to the turn nearest ``tau_ref`` plus what has been added since, ``spin`` (n, 3) times the
    turns of both edges about themselves and of a motor. Returns the smallest 1 + cos(turning angle).
    """
    V = np.empty((3, 3))
    W = np.empty((3, 3))
    cmin = math.inf
    two_pi = 2.0 * math.pi
    for s in range(e1.shape[0]):
        _carried(e1[s], Q1, s, T, M1, M2, V)
        _carried(e2[s], Q2, s, T, M1, M2, W)
        chi = 1.0 + _dot(V[2], W[2])
        cmin = min(cmin, chi)
        ic = 1.0 / max(chi, 1e-12)
        eps[s, 0] = (_dot(V[0], W[2]) - _dot(V[2], W[0])) * ic
        eps[s, 1] = (_dot(V[1], W[2]) - _dot(V[2], W[1])) * ic
        tau = math.atan2(_dot(V[1], W[0]) - _dot(V[0], W[1]), _dot(V[0], W[0]) + _dot(V[1], W[1]))
        near = tau_ref[s] + spin[s, 2] * (driven[s] - driven_ref[s])
        near += spin[s, 0] * (theta[e1[s]] - theta_ref[e1[s]]) + spin[s, 1] * (
            theta[e2[s]] - theta_ref[e2[s]]
        )
        eps[s, 2] = tau + two_pi * math.floor((near - tau) / two_pi + 0.5)
    return cmin


@inlined
def _linear_law(EA, stretch, n, dn, K, eps, eps0, dpsi, ddpsi):
    """Stresses and moduli of the quadratic energies."""
    for e in range(EA.shape[0]):
        n[e] = EA[e] * stretch[e]
        dn[e] = EA[e]
    for s in range(eps.shape[0]):
        d0, d1, d2 = eps[s, 0] - eps0[s, 0], eps[s, 1] - eps0[s, 1], eps[s, 2] - eps0[s, 2]
        for a in range(3):
            dpsi[s, a] = K[s, a, 0] * d0 + K[s, a, 1] * d1 + K[s, a, 2] * d2
            for b in range(3):
                ddpsi[s, a, b] = K[s, a, b]


@kernel
def configure(
    x, theta, edges, L, T, M1, M2, S, l0, stretch, e1, e2, Q1, Q2, eps, EA, n, dn, eps0, dpsi, ddpsi,
    ts, d1s, tau_ref, theta_ref, driven, driven_ref, spin, K,
):  # fmt: skip
    """Geometry, strains, and the stresses of the quadratic energies with axial stiffness EA and K.

    Returns the smallest 1 + cos of an edge's turn in this step and of a spring's turning angle; 0
    if an edge has no length.
    """
    shortest, turned = edge_frames(x, theta, edges, ts, d1s, L, T, M1, M2, S)
    fold = spring_strains(e1, e2, Q1, Q2, T, M1, M2, tau_ref, theta, theta_ref, driven, driven_ref, spin, eps)
    for e in range(L.shape[0]):
        stretch[e] = L[e] / l0[e] - 1.0
    _linear_law(EA, stretch, n, dn, K, eps, eps0, dpsi, ddpsi)
    if not shortest > 0.0:
        return 0.0
    return min(turned, fold)


@inlined
def _rotation_map(t, sv, l, A):
    """A (3, 4): world rotation of the edge's frame by (de, dtheta); rows are world components."""
    il = 1.0 / l
    A[0, 0], A[0, 1], A[0, 2] = -t[0] * sv[0] * il, (-t[2] - t[0] * sv[1]) * il, (t[1] - t[0] * sv[2]) * il
    A[1, 0], A[1, 1], A[1, 2] = (t[2] - t[1] * sv[0]) * il, -t[1] * sv[1] * il, (-t[0] - t[1] * sv[2]) * il
    A[2, 0], A[2, 1], A[2, 2] = (-t[1] - t[2] * sv[0]) * il, (t[0] - t[2] * sv[1]) * il, -t[2] * sv[2] * il
    A[0, 3], A[1, 3], A[2, 3] = t[0], t[1], t[2]


@inlined
def _rotation_map_derivative(g, t, ts, sv, l, N):
    """Upper triangle of N (4, 4): g . (D_u A) w for unit directions u (row) and w (column)."""
    il = 1.0 / l
    il2 = il * il
    ics = 1.0 / (1.0 + _dot(t, ts))
    gt = _dot(g, t)
    cx, cy, cz = g[1] * t[2] - g[2] * t[1], g[2] * t[0] - g[0] * t[2], g[0] * t[1] - g[1] * t[0]
    c = (cx, cy, cz)
    p = (g[0] - gt * t[0], g[1] - gt * t[1], g[2] - gt * t[2])
    h = ((t[0] + ts[0]) * ics + t[0], (t[1] + ts[1]) * ics + t[1], (t[2] + ts[2]) * ics + t[2])
    for i in range(3):
        for j in range(i, 3):
            N[i, j] = -2.0 * t[i] * c[j] - p[i] * sv[j] + gt * sv[j] * h[i]
        N[i, 3] = p[i] * il
    N[0, 1] += g[2] - gt * ts[2] * ics
    N[0, 2] += -g[1] + gt * ts[1] * ics
    N[1, 2] += g[0] - gt * ts[0] * ics
    for i in range(3):
        for j in range(i, 3):
            N[i, j] *= il2
    N[3, 3] = 0.0


@kernel
def spring_forces(
    e1, e2, Q1, Q2, s1, s2, dofs, L, T, M1, M2, S, TS, eps, dpsi, ddpsi, F, slots, data, with_jac
):
    """Add the forces of all springs to F and their Hessian to the Jacobian's data.

    ``s1, s2`` are +1 where an edge points along the stencil (x0 -> x1 -> x2) and -1 where it is
    flipped; ``dofs`` (n, 11) are those of (x0, theta1, x1, theta2, x2). Returns the largest force
    and moment of one spring, the scales of the convergence test.
    """
    V = np.empty((3, 3))
    W = np.empty((3, 3))
    A1 = np.empty((3, 4))
    A2 = np.empty((3, 4))
    N1 = np.empty((4, 4))
    N2 = np.empty((4, 4))
    B = np.empty((3, 8))
    X1 = np.empty((3, 8))
    X2 = np.empty((3, 8))
    H = np.empty((8, 8))
    M = np.empty((3, 3))
    G = np.empty((3, 3))
    P = np.empty((8, 11))
    R = np.empty((11, 11))
    KG = np.empty((3, 3))
    u = np.empty(3)
    w = np.empty(3)
    y = np.empty(8)
    g = np.empty(3)
    fmax = 0.0
    mmax = 0.0
    for s in range(e1.shape[0]):
        ea, eb = e1[s], e2[s]
        _carried(ea, Q1, s, T, M1, M2, V)
        _carried(eb, Q2, s, T, M1, M2, W)
        a1, a2, a3 = V[0], V[1], V[2]
        b1, b2, b3 = W[0], W[1], W[2]
        c33 = _dot(a3, b3)
        ic = 1.0 / (1.0 + c33)
        k1 = (_dot(a1, b3) - _dot(a3, b1)) * ic
        k2 = (_dot(a2, b3) - _dot(a3, b2)) * ic
        n0, n1, n2 = (
            b3[1] * a3[2] - b3[2] * a3[1],
            b3[2] * a3[0] - b3[0] * a3[2],
            b3[0] * a3[1] - b3[1] * a3[0],
        )
        G[0, 0] = (b3[1] * a1[2] - b3[2] * a1[1] - b1[1] * a3[2] + b1[2] * a3[1] - k1 * n0) * ic
        G[0, 1] = (b3[2] * a1[0] - b3[0] * a1[2] - b1[2] * a3[0] + b1[0] * a3[2] - k1 * n1) * ic
        G[0, 2] = (b3[0] * a1[1] - b3[1] * a1[0] - b1[0] * a3[1] + b1[1] * a3[0] - k1 * n2) * ic
        G[1, 0] = (b3[1] * a2[2] - b3[2] * a2[1] - b2[1] * a3[2] + b2[2] * a3[1] - k2 * n0) * ic
        G[1, 1] = (b3[2] * a2[0] - b3[0] * a2[2] - b2[2] * a3[0] + b2[0] * a3[2] - k2 * n1) * ic
        G[1, 2] = (b3[0] * a2[1] - b3[1] * a2[0] - b2[0] * a3[1] + b2[1] * a3[0] - k2 * n2) * ic
        p0, p1, p2 = dpsi[s, 0], dpsi[s, 1], dpsi[s, 2]
        for i in range(3):
            G[2, i] = (a3[i] + b3[i]) * ic
            g[i] = p0 * G[0, i] + p1 * G[1, i] + p2 * G[2, i]
        _rotation_map(T[ea], S[ea], L[ea], A1)
        _rotation_map(T[eb], S[eb], L[eb], A2)
        f1, f2 = s1[s], s2[s]
        for k in range(4):
            w1 = f1 if k < 3 else 1.0
            w2 = f2 if k < 3 else 1.0
            for i in range(3):
                B[i, k] = -w1 * A1[i, k]
                B[i, 4 + k] = w2 * A2[i, k]
        for k in range(8):
            y[k] = g[0] * B[0, k] + g[1] * B[1, k] + g[2] * B[2, k]
        for i in range(3):
            # the edge vectors are e1 = x1 - x0 and e2 = x2 - x1 up to the signs in B
            F[dofs[s, i]] += y[i]
            F[dofs[s, 4 + i]] += y[4 + i] - y[i]
            F[dofs[s, 8 + i]] -= y[4 + i]
            fmax = max(fmax, abs(y[i]), abs(y[4 + i]))
            mmax = max(mmax, abs(g[i]))
        F[dofs[s, 3]] -= y[3]
        F[dofs[s, 7]] -= y[7]
        if not with_jac:
            continue
        # M = sum psi'_k dg_k/d(rotation of W) + sum psi''_kl g_k g_l^T
        q0, q1, q2 = p0 * ic, p1 * ic, p2 * ic
        kk = p0 * k1 + p1 * k2
        ki = kk * ic
        diag = kk * c33 * ic + q0 * (_dot(a3, b1) - _dot(a1, b3)) + q1 * (_dot(a3, b2) - _dot(a2, b3))
        nn = (n0, n1, n2)
        for j in range(3):
            u[j] = q0 * a1[j] + q1 * a2[j] - ki * a3[j]
            w[j] = (p0 * G[0, j] + p1 * G[1, j]) * ic
            for i in range(3):
                KG[i, j] = ddpsi[s, i, 0] * G[0, j] + ddpsi[s, i, 1] * G[1, j] + ddpsi[s, i, 2] * G[2, j]
        for i in range(3):
            ub, wb, gb = q0 * b1[i] + q1 * b2[i], w[i] + q2 * G[2, i], nn[i]
            for j in range(3):
                M[i, j] = (
                    b3[i] * u[j] - ub * a3[j] - gb * w[j] - wb * nn[j]
                    + G[0, i] * KG[0, j] + G[1, i] * KG[1, j] + G[2, i] * KG[2, j]
                )  # fmt: skip
            M[i, i] += diag
        # [-b3]x-type part of the twist: w -> w x b3
        M[0, 1] += q2 * b3[2]
        M[0, 2] -= q2 * b3[1]
        M[1, 0] -= q2 * b3[2]
        M[1, 2] += q2 * b3[0]
        M[2, 0] += q2 * b3[1]
        M[2, 1] -= q2 * b3[0]
        _rotation_map_derivative(g, T[ea], TS[ea], S[ea], L[ea], N1)
        _rotation_map_derivative(g, T[eb], TS[eb], S[eb], L[eb], N2)
        for k in range(8):
            v0, v1, v2 = B[0, k], B[1, k], B[2, k]
            x0 = M[0, 0] * v0 + M[1, 0] * v1 + M[2, 0] * v2
            x1 = M[0, 1] * v0 + M[1, 1] * v1 + M[2, 1] * v2
            x2 = M[0, 2] * v0 + M[1, 2] * v1 + M[2, 2] * v2
            X2[0, k], X2[1, k], X2[2, k] = x0, x1, x2
            # omega1(u) x g . omega_rel(w); B holds -A1 in its first columns
            X1[0, k], X1[1, k], X1[2, k] = (
                x0 - g[1] * v2 + g[2] * v1,
                x1 - g[2] * v0 + g[0] * v2,
                x2 - g[0] * v1 + g[1] * v0,
            )
        for i in range(4):
            for j in range(8):
                H[i, j] = B[0, i] * X1[0, j] + B[1, i] * X1[1, j] + B[2, i] * X1[2, j]
            for j in range(4):
                H[4 + i, 4 + j] = (
                    B[0, 4 + i] * X2[0, 4 + j] + B[1, 4 + i] * X2[1, 4 + j] + B[2, 4 + i] * X2[2, 4 + j]
                )
        for i in range(4):
            for j in range(i, 4):
                h = H[i, j] - (N1[i, j] if (i < 3) == (j < 3) else f1 * N1[i, j])
                H[i, j] = h
                H[j, i] = h
                h = H[4 + i, 4 + j] + (N2[i, j] if (i < 3) == (j < 3) else f2 * N2[i, j])
                H[4 + i, 4 + j] = h
                H[4 + j, 4 + i] = h
            for j in range(4):
                H[4 + j, i] = H[i, 4 + j]
        # expand (e1, th1, e2, th2) to (x0, th1, x1, th2, x2)
        for i in range(8):
            for j in range(3):
                P[i, j], P[i, 4 + j], P[i, 8 + j] = -H[i, j], H[i, j] - H[i, 4 + j], H[i, 4 + j]
            P[i, 3], P[i, 7] = H[i, 3], H[i, 7]
        for i in range(3):
            for j in range(11):
                R[i, j], R[4 + i, j], R[8 + i, j] = -P[i, j], P[i, j] - P[4 + i, j], P[4 + i, j]
        for j in range(11):
            R[3, j], R[7, j] = P[3, j], P[7, j]
        for i in range(11):
            first, inner, last = slots[s, i, 0], slots[s, i, 2], slots[s, i, 4]
            for j in range(3):
                data[first + j] += R[i, j]
                data[inner + j] += R[i, 4 + j]
                data[last + j] += R[i, 8 + j]
            data[slots[s, i, 1]] += R[i, 3]
            data[slots[s, i, 3]] += R[i, 7]
    return fmax, mmax


@kernel
def stretch_forces(edges, l0, L, T, dpsi, ddpsi, dofs, F, slots, data, with_jac):
    """Add the stretching forces; dpsi [N] and ddpsi [N] are derivatives by the strain of psi [J/m]."""
    fmax = 0.0
    for e in range(edges.shape[0]):
        n = dpsi[e]
        fmax = max(fmax, abs(n))
        for i in range(3):
            F[dofs[e, i]] += n * T[e, i]
            F[dofs[e, 3 + i]] -= n * T[e, i]
        if with_jac:
            k = ddpsi[e] / l0[e]
            p = n / L[e]
            for i in range(3):
                for j in range(3):
                    h = (k - p) * T[e, i] * T[e, j]
                    if i == j:
                        h += p
                    data[slots[e, i, 0] + j] += h
                    data[slots[e, 3 + i, 1] + j] += h
                    data[slots[e, i, 1] + j] -= h
                    data[slots[e, 3 + i, 0] + j] -= h
    return fmax


@kernel
def elastic_forces(
    edges, L, T, M1, M2, S, l0, e1, e2, Q1, Q2, eps, n, dn, dpsi, ddpsi, s1, s2, stretch_dofs, stretch_slots,
    spring_dofs, spring_slots, F, ts, data, with_jac,
):  # fmt: skip
    """Forces of all energies into F, their Hessian into the Jacobian's data; both are overwritten.

    Returns the largest force and the largest moment of one edge or spring.
    """
    F[:] = 0.0
    if with_jac:
        data[:] = 0.0
    tension = stretch_forces(edges, l0, L, T, n, dn, stretch_dofs, F, stretch_slots, data, with_jac)
    force, moment = spring_forces(
        e1, e2, Q1, Q2, s1, s2, spring_dofs, L, T, M1, M2, S, ts, eps, dpsi, ddpsi, F, spring_slots, data,
        with_jac,
    )  # fmt: skip
    return max(tension, force), moment


# the arrays of `quadratic_forces`
QUADRATIC = (
    "x:d2 theta:d1 edges:l2 L:d1 T:d2 M1:d2 M2:d2 S:d2 l0:d1 stretch:d1 e1:l1 e2:l1 Q1:d3 Q2:d3 eps:d2 EA:d1 "
    "n:d1 dn:d1 eps0:d2 dpsi:d2 ddpsi:d3 s1:d1 s2:d1 stretch_dofs:i2 stretch_slots:i3 spring_dofs:i2 "
    "spring_slots:i3 F:d1 ts:d2 d1s:d2 tau_ref:d1 theta_ref:d1 driven:d1 driven_ref:d1 spin:d2"
)


@kernel
def quadratic_forces(table, K, data, with_jac):
    """Call `configure` and, unless the state is folded, `elastic_forces`: all energies are quadratic.

    Returns what both return: the smallest 1 + cos, the largest force and the largest moment.
    """
    (
        x, theta, edges, L, T, M1, M2, S, l0, stretch, e1, e2, Q1, Q2, eps, EA, n, dn, eps0, dpsi, ddpsi,
        s1, s2, stretch_dofs, stretch_slots, spring_dofs, spring_slots, F, ts, d1s, tau_ref, theta_ref,
        driven, driven_ref, spin,
    ) = unpack(table, QUADRATIC)  # fmt: skip
    fold = configure(
        x, theta, edges, L, T, M1, M2, S, l0, stretch, e1, e2, Q1, Q2, eps, EA, n, dn, eps0, dpsi, ddpsi,
        ts, d1s, tau_ref, theta_ref, driven, driven_ref, spin, K,
    )  # fmt: skip
    if not fold > FOLD:
        return fold, 0.0, 0.0
    force, moment = elastic_forces(
        edges, L, T, M1, M2, S, l0, e1, e2, Q1, Q2, eps, n, dn, dpsi, ddpsi, s1, s2, stretch_dofs, stretch_slots,
        spring_dofs, spring_slots, F, ts, data, with_jac,
    )  # fmt: skip
    return fold, force, moment
