"""Compiled viscous damping of stretching, bending and twisting (docs, theory: dissipation)."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.kinematics.kernels import (
    QUADRATIC,
    STATE,
    _carried,
    _dot,
    _rotation_map,
    spring_forces,
)
from rodnet.packed import unpack

# ``pull`` and ``length`` (n,) are the edges' viscosities [N s] and natural lengths; ``Q1_all`` and ``Q2_all`` the
# frames of all springs, ``e1 .. s2`` what belongs to those that are damped; ``turned`` are rates of natural frames,
# ``natural`` of natural strains, which actuators drive
DAMPED = (
    "edge:l1 ends:i2 end_slots:i3 pull:d1 length:d1 spring:l1 Q1_all:d3 Q2_all:d3 dofs:i2 slots:i3 loose:l1 roots:d1 "
    "turned:d2 natural:d2 e1:l1 e2:l1 s1:d1 s2:d1"
)


@inlined
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inlined
def _turn(A, de, dtheta, out):
    """Rotation rate of an edge's frame from its map (`_rotation_map`)."""
    for i in range(3):
        out[i] = A[i, 0] * de[0] + A[i, 1] * de[1] + A[i, 2] * de[2] + A[i, 3] * dtheta


@inlined
def _map_rate(t, ts, S, l, de, out):
    """Rate (3, 4) of an edge's rotation map as the edge vector changes at the rate ``de``."""
    il = 1.0 / l
    stretching = _dot(t, de)
    ics = 1.0 / (1.0 + _dot(t, ts))
    d0, d1, d2 = (
        (de[0] - stretching * t[0]) * il,
        (de[1] - stretching * t[1]) * il,
        (de[2] - stretching * t[2]) * il,
    )
    along = ts[0] * d0 + ts[1] * d1 + ts[2] * d2
    r0 = (ts[1] * d2 - ts[2] * d1 - S[0] * along) * ics
    r1 = (ts[2] * d0 - ts[0] * d2 - S[1] * along) * ics
    r2 = (ts[0] * d1 - ts[1] * d0 - S[2] * along) * ics
    # A de = (t x de - t (S.de)) / l
    shrink = -stretching * il
    out[0, 0] = (-d0 * S[0] - t[0] * r0 + shrink * -t[0] * S[0]) * il
    out[0, 1] = (-d2 - d0 * S[1] - t[0] * r1 + shrink * (-t[2] - t[0] * S[1])) * il
    out[0, 2] = (d1 - d0 * S[2] - t[0] * r2 + shrink * (t[1] - t[0] * S[2])) * il
    out[1, 0] = (d2 - d1 * S[0] - t[1] * r0 + shrink * (t[2] - t[1] * S[0])) * il
    out[1, 1] = (-d1 * S[1] - t[1] * r1 + shrink * -t[1] * S[1]) * il
    out[1, 2] = (-d0 - d1 * S[2] - t[1] * r2 + shrink * (-t[0] - t[1] * S[2])) * il
    out[2, 0] = (-d1 - d2 * S[0] - t[2] * r0 + shrink * (-t[1] - t[2] * S[0])) * il
    out[2, 1] = (d0 - d2 * S[1] - t[2] * r1 + shrink * (t[0] - t[2] * S[1])) * il
    out[2, 2] = (-d2 * S[2] - t[2] * r2 + shrink * -t[2] * S[2]) * il
    out[0, 3], out[1, 3], out[2, 3] = d0, d1, d2


@inlined
def _expand(y, out):
    """From derivatives by (e1, theta1, e2, theta2) to those by (x0, theta1, x1, theta2, x2)."""
    for j in range(3):
        out[j], out[4 + j], out[8 + j] = -y[j], y[j] - y[4 + j], y[4 + j]
    out[3], out[7] = y[3], y[7]


@kernel
def damp(damped, quadratic, state, K, cv, F, data, with_jac):
    """Add the forces of viscous edges and springs, and with ``with_jac`` minus their derivatives.

    A spring's moments are sigma = C B v, with the gradient B of its strains and C = sqrt(time_i time_j) K_ij.
    Minus the derivative of the force -B^T sigma is B^T C (cv B + dB/dt) + sum sigma_k d2 eps_k: all but
    the rate of B is the Hessian of an elastic spring of stress sigma and modulus cv C.

    Parameters
    ----------
    damped, quadratic, state : int
        `Packed` arrays of the term (`DAMPED`) and of an evaluation.
    K : ndarray, shape (spring_count, 3, 3)
        Stiffnesses [N m].
    cv : float
        Derivative of the rates by the positions [1/s].
    F, data : ndarray
        Forces and the Jacobian's values, to which is added.

    Returns
    -------
    float
        Largest force [N].
    """
    (
        edge, ends, end_slots, pull, length, spring, Q1_all, Q2_all, dofs, slots, loose, roots, turned, natural, e1, e2,
        s1, s2,
    ) = unpack(damped, DAMPED)  # fmt: skip
    (
        _, _, _, L, T, M1, M2, S, _, _, _, _, _, _, eps, _, _, _, _, _, _, _, _, _, _, _, _, _, ts, _, _, _, _, _, _,
    ) = unpack(quadratic, QUADRATIC)  # fmt: skip
    _, v, _, w, edges, _, _, _, _ = unpack(state, STATE)
    largest = 0.0
    for k in range(edge.shape[0]):
        e = edge[k]
        i, j = edges[e, 0], edges[e, 1]
        t, il, c = T[e], 1.0 / L[e], pull[k] / length[k]
        a0, a1, a2 = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
        rate = t[0] * a0 + t[1] * a1 + t[2] * a2
        tension = c * rate
        across = ((a0 - rate * t[0]) * il, (a1 - rate * t[1]) * il, (a2 - rate * t[2]) * il)
        for m in range(3):
            force = tension * t[m]
            largest = max(largest, abs(force))
            F[ends[k, m]] += force
            F[ends[k, 3 + m]] -= force
            if with_jac:
                for o in range(3):
                    h = c * t[m] * (cv * t[o] + across[o]) - tension * il * t[m] * t[o]
                    if m == o:
                        h += tension * il
                    data[end_slots[k, m, o]] += h
                    data[end_slots[k, m, 3 + o]] -= h
                    data[end_slots[k, 3 + m, o]] -= h
                    data[end_slots[k, 3 + m, 3 + o]] += h
    if not (roots[0] != 0.0 or roots[1] != 0.0 or roots[2] != 0.0):
        return largest
    V, W, A1, A2, Z = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 4)), np.empty((3, 4)), np.empty((3, 4))
    G, dG, dV, dW = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    y, rows, rates, R = np.empty(8), np.empty((3, 11)), np.empty((3, 11)), np.empty((3, 11))
    count = spring.shape[0]
    Q1, Q2, sigma, modulus = (
        np.empty((count, 3, 3)),
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
    )
    de1, de2, o1, o2 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    n, dn, one, two, C, rate = (
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty((3, 3)),
        np.empty(3),
    )
    for s in range(count):
        now, ea, eb = spring[s], e1[s], e2[s]
        for i in range(3):
            for j in range(3):
                Q1[s, i, j], Q2[s, i, j] = Q1_all[now, i, j], Q2_all[now, i, j]
                C[i, j] = roots[i] * K[now, i, j] * roots[j] if loose[s] == 0 else 0.0
                modulus[s, i, j] = cv * C[i, j]
        _carried(ea, Q1, s, T, M1, M2, V)
        _carried(eb, Q2, s, T, M1, M2, W)
        f1, f2 = s1[s], s2[s]
        # rates of the edge vectors along the edges, rotation rates
        for i in range(3):
            de1[i] = v[edges[ea, 1], i] - v[edges[ea, 0], i]
            de2[i] = v[edges[eb, 1], i] - v[edges[eb, 0], i]
        _rotation_map(T[ea], S[ea], L[ea], A1)
        _rotation_map(T[eb], S[eb], L[eb], A2)
        _turn(A1, de1, w[ea] - turned[s, 0], o1)
        _turn(A2, de2, w[eb] - turned[s, 1], o2)
        a3, b3 = V[2], W[2]
        c33 = _dot(a3, b3)
        ic = 1.0 / (1.0 + c33)
        _cross(b3, a3, n)
        for k in range(2):
            a, b = V[k], W[k]
            kappa = (_dot(a, b3) - _dot(a3, b)) * ic
            _cross(b3, a, one)
            _cross(b, a3, two)
            for i in range(3):
                G[k, i] = (one[i] - two[i] - kappa * n[i]) * ic
        for i in range(3):
            G[2, i] = (a3[i] + b3[i]) * ic
        for k in range(3):
            rate[k] = -natural[s, k]
            for i in range(3):
                rate[k] += G[k, i] * (o2[i] - o1[i])
        for k in range(3):
            sigma[s, k] = C[k, 0] * rate[0] + C[k, 1] * rate[1] + C[k, 2] * rate[2]
        if not with_jac:
            continue
        # rates of the frames, of the strains' rotation gradients and of the maps
        for k in range(3):
            _cross(o1, V[k], dV[k])
            _cross(o2, W[k], dW[k])
        dc33 = _dot(dV[2], b3) + _dot(a3, dW[2])
        _cross(dW[2], a3, dn)
        _cross(b3, dV[2], one)
        for i in range(3):
            dn[i] += one[i]
        for k in range(2):
            a, b = V[k], W[k]
            kappa = (_dot(a, b3) - _dot(a3, b)) * ic
            dkappa = rate[k] + natural[s, k]
            for i in range(3):
                dG[k, i] = -dkappa * n[i] - kappa * dn[i] - dc33 * G[k, i]
            _cross(dW[2], a, one)
            _cross(b3, dV[k], two)
            for i in range(3):
                dG[k, i] += one[i] + two[i]
            _cross(dW[k], a3, one)
            _cross(b, dV[2], two)
            for i in range(3):
                dG[k, i] = (dG[k, i] - one[i] - two[i]) * ic
        for i in range(3):
            dG[2, i] = (dV[2, i] + dW[2, i] - dc33 * G[2, i]) * ic
        for k in range(3):
            for j in range(4):
                one1, one2 = f1 if j < 3 else 1.0, f2 if j < 3 else 1.0
                y[j] = -one1 * (G[k, 0] * A1[0, j] + G[k, 1] * A1[1, j] + G[k, 2] * A1[2, j])
                y[4 + j] = one2 * (G[k, 0] * A2[0, j] + G[k, 1] * A2[1, j] + G[k, 2] * A2[2, j])
            _expand(y, rows[k])
        _map_rate(T[ea], ts[ea], S[ea], L[ea], de1, Z)
        for k in range(3):
            for j in range(4):
                total = 0.0
                for i in range(3):
                    total += dG[k, i] * A1[i, j] + G[k, i] * Z[i, j]
                rates[k, j] = -total * (f1 if j < 3 else 1.0)
        _map_rate(T[eb], ts[eb], S[eb], L[eb], de2, Z)
        for k in range(3):
            for j in range(4):
                total = 0.0
                for i in range(3):
                    total += dG[k, i] * A2[i, j] + G[k, i] * Z[i, j]
                rates[k, 4 + j] = total * (f2 if j < 3 else 1.0)
        for k in range(3):
            for j in range(8):
                y[j] = C[k, 0] * rates[0, j] + C[k, 1] * rates[1, j] + C[k, 2] * rates[2, j]
            _expand(y, R[k])
        for i in range(11):
            first, inner, last = slots[s, i, 0], slots[s, i, 2], slots[s, i, 4]
            p0, p1, p2 = rows[0, i], rows[1, i], rows[2, i]
            for j in range(3):
                data[first + j] += p0 * R[0, j] + p1 * R[1, j] + p2 * R[2, j]
                data[inner + j] += p0 * R[0, 4 + j] + p1 * R[1, 4 + j] + p2 * R[2, 4 + j]
                data[last + j] += p0 * R[0, 8 + j] + p1 * R[1, 8 + j] + p2 * R[2, 8 + j]
            data[slots[s, i, 1]] += p0 * R[0, 3] + p1 * R[1, 3] + p2 * R[2, 3]
            data[slots[s, i, 3]] += p0 * R[0, 7] + p1 * R[1, 7] + p2 * R[2, 7]
    force, _ = spring_forces(
        e1, e2, Q1, Q2, s1, s2, dofs, L, T, M1, M2, S, ts, eps, sigma, modulus, F, slots, data, with_jac
    )
    return max(largest, force)


@kernel
def resist(weight, dofs, diagonal, rates, cv, F, data, with_jac):
    """Add -weight times the rate to the force of each degree of freedom; return the largest force [N]."""
    largest = 0.0
    for k in range(dofs.shape[0]):
        force = weight[k] * rates[dofs[k]]
        F[dofs[k]] -= force
        largest = max(largest, abs(force))
        if with_jac:
            data[diagonal[k]] += cv * weight[k]
    return largest
