"""Compiled kinematics of tendons: where eyelets are, what tensions do, and the exact derivatives.

An eyelet sits on a node with an arm in the frames of up to two edges. Its seventeen degrees of freedom
are those of the node (3) and, for each edge, of its start, its end and its twist (7); missing ones
have no weight. Formulas: docs, theory, tendons.
"""

from __future__ import annotations

import math

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.kinematics.kernels import _rotation_map, _rotation_map_derivative

EYELET = 17


@inlined
def _cross(a, b, c):
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@inlined
def _arm(k, a, edges, offsets, M1, M2, T, r):
    """Arm of eyelet ``k`` in the frame of its edge ``a``, with its share."""
    e = edges[k, a]
    for i in range(3):
        r[i] = offsets[k, a, 0] * M1[e, i] + offsets[k, a, 1] * M2[e, i] + offsets[k, a, 2] * T[e, i]


@kernel
def place_eyelets(nodes, edges, offsets, fixed, x, M1, M2, T, S, L, p, P):
    """Positions p (K, 3) of the eyelets and their derivatives P (K, 3, 17)."""
    r, w = np.empty(3), np.empty(3)
    for k in range(nodes.shape[0]):
        P[k] = 0.0
        if nodes[k] < 0:
            for i in range(3):
                p[k, i] = fixed[k, i]
            continue
        for i in range(3):
            p[k, i] = x[nodes[k], i]
            P[k, i, i] = 1.0
        for a in range(2):
            e, at = edges[k, a], 3 + 7 * a
            if e < 0:
                continue
            _arm(k, a, edges, offsets, M1, M2, T, r)
            _cross(T[e], r, w)
            along = T[e, 0] * r[0] + T[e, 1] * r[1] + T[e, 2] * r[2]
            for i in range(3):
                p[k, i] += r[i]
                for j in range(3):
                    d = (-T[e, i] * r[j] - w[i] * S[e, j]) / L[e]
                    if i == j:
                        d += along / L[e]
                    P[k, i, at + j] = -d
                    P[k, i, at + 3 + j] = d
                P[k, i, at + 6] = w[i]


@kernel
def segments(p, length, u):
    """Lengths and directions of the straight segments between eyelets; returns the shortest length."""
    shortest = math.inf
    for k in range(length.shape[0]):
        square = 0.0
        for i in range(3):
            u[k, i] = p[k + 1, i] - p[k, i]
            square += u[k, i] ** 2
        length[k] = math.sqrt(square)
        shortest = min(shortest, length[k])
        for i in range(3):
            u[k, i] /= length[k]
    return shortest


@kernel
def pull(nodes, edges, offsets, dofs, M1, M2, T, S, ts, L, P, length, u, tension, F, slots, data, with_jac):
    """Forces of given tensions, and minus their derivative at constant tension.

    ``slots`` (segments, 34, 34) are those of the degrees of freedom of each segment's two eyelets.
    Returns the largest force.
    """
    count = nodes.shape[0]
    f, r, m, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    A, N, H = np.empty((3, 4)), np.empty((4, 4)), np.empty((4, 4))
    block, turn = np.empty((2, 3, EYELET)), np.empty(3)
    largest = 0.0
    for k in range(count):
        for i in range(3):
            f[i] = 0.0
            if k < count - 1:
                f[i] += tension[k] * u[k, i]
            if k > 0:
                f[i] -= tension[k - 1] * u[k - 1, i]
            largest = max(largest, abs(f[i]))
        for j in range(EYELET):
            for i in range(3):
                F[dofs[k, j]] += P[k, i, j] * f[i]
        if not with_jac or nodes[k] < 0:
            continue
        # minus f . d2p: the arms turn
        s, first = (k, 0) if k < count - 1 else (k - 1, EYELET)
        for a in range(2):
            e = edges[k, a]
            if e < 0:
                continue
            _arm(k, a, edges, offsets, M1, M2, T, r)
            _cross(r, f, m)
            _rotation_map(T[e], S[e], L[e], A)
            _rotation_map_derivative(m, T[e], ts[e], S[e], L[e], N)
            for i in range(4):
                _cross(A[:, i], r, w)
                _cross(w, f, turn)
                for j in range(i, 4):
                    H[i, j] = N[i, j] + turn[0] * A[0, j] + turn[1] * A[1, j] + turn[2] * A[2, j]
                    H[j, i] = H[i, j]
            at = first + 3 + 7 * a
            for i in range(7):
                si = -1.0 if i < 3 else 1.0
                hi = i if i < 3 else i - 3
                for j in range(7):
                    sj = -1.0 if j < 3 else 1.0
                    hj = j if j < 3 else j - 3
                    data[slots[s, at + i, at + j]] -= si * sj * H[hi, hj]
    if not with_jac:
        return largest
    for s in range(count - 1):
        c = tension[s] / length[s]
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            for j in range(EYELET):
                along = 0.0
                for i in range(3):
                    along += u[s, i] * P[s + side, i, j]
                for i in range(3):
                    block[side, i, j] = sign * (P[s + side, i, j] - along * u[s, i])
        for one in range(2):
            for i in range(EYELET):
                for two in range(2):
                    for j in range(EYELET):
                        h = 0.0
                        for a in range(3):
                            h += block[one, a, i] * block[two, a, j]
                        if h != 0.0:
                            data[slots[s, EYELET * one + i, EYELET * two + j]] += c * h
    return largest


@kernel
def couple(place, P, length, u, across, back, by_length, by_turn, rows, slots, data):
    """Add what the tensions' own changes do: the gradient of each length times the change of its tension.

    ``place`` (K, 17) are the eyelets' degrees of freedom among those of the tendon; ``across`` and ``back``
    are minus the derivatives of the turn at each inner eyelet by the directions before and after it;
    ``rows`` is for work, the change of each tension by each degree of freedom.
    """
    count = length.shape[0]
    rows[:] = 0.0
    for m in range(count):
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            for j in range(EYELET):
                at = place[m + side, j]
                stretch = before = after = 0.0
                for i in range(3):
                    stretch += u[m, i] * P[m + side, i, j]
                    if m < count - 1:
                        before += across[m, i] * P[m + side, i, j]
                    if m > 0:
                        after += back[m - 1, i] * P[m + side, i, j]
                stretch *= sign
                before *= -sign / length[m]
                after *= -sign / length[m]
                if stretch == 0.0 and before == 0.0 and after == 0.0:
                    continue
                for k in range(count):
                    change = by_length[k, m] * stretch
                    if m < count - 1:
                        change += by_turn[k, m] * before
                    if m > 0:
                        change += by_turn[k, m - 1] * after
                    rows[k, at] += change
    for k in range(count):
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            for j in range(EYELET):
                stretch = 0.0
                for i in range(3):
                    stretch += u[k, i] * P[k + side, i, j]
                if stretch == 0.0:
                    continue
                at = place[k + side, j]
                for d in range(rows.shape[1]):
                    data[slots[at, d]] += sign * stretch * rows[k, d]
