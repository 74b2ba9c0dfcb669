"""Compiled change of elastic and viscous forces with stiffnesses and natural strains: linear in the stresses."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.kinematics.kernels import STATE, _carried, _dot, _rotation_map
from rodnet.packed import unpack

# an evaluation's geometry and springs
ELASTIC = (
    "edges:l2 L:d1 T:d2 M1:d2 M2:d2 S:d2 l0:d1 stretch:d1 e1:l1 e2:l1 Q1:d3 Q2:d3 s1:d1 s2:d1 dofs:i2 eps:d2 "
    "eps0:d2 EA:d1"
)
# of the columns that change them: which columns, and the derivatives of axial stiffness, rest length,
# spring stiffness and natural strains, columns innermost; then those of the viscosities of edges, over their lengths,
# and of springs, both of no edge and spring where there are none
CHANGES = "which:l1 axial:d2 lengths:d2 stiffness:d4 offset:d3 pull:d2 viscosity:d4"


@kernel
def elastic_changes(table, changes, K, state, out):
    """Add the change of the residual, minus that of the forces, to ``out`` (dof_count, columns)."""
    edges, L, T, M1, M2, S, l0, stretch, e1, e2, Q1, Q2, s1, s2, dofs, eps, eps0, EA = unpack(table, ELASTIC)
    which, axial, lengths, stiffness, offset, pull, viscosity = unpack(changes, CHANGES)
    _, v, _, w, _, _, _, _, _ = unpack(state, STATE)
    count, viscous = which.shape[0], viscosity.shape[0] > 0
    rate = np.zeros(3)
    for e in range(edges.shape[0]):
        i, j = 3 * edges[e, 0], 3 * edges[e, 1]
        rate[0] = 0.0
        if viscous:
            for b in range(3):
                rate[0] += T[e, b] * (v[edges[e, 1], b] - v[edges[e, 0], b])
        for m in range(count):
            n = axial[e, m] * stretch[e] - EA[e] * L[e] / (l0[e] * l0[e]) * lengths[e, m]
            if viscous:
                n += pull[e, m] * rate[0]
            if n != 0.0:
                c = which[m]
                for b in range(3):
                    out[i + b, c] -= n * T[e, b]
                    out[j + b, c] += n * T[e, b]
    V, W, G = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    A1, A2, B = np.empty((3, 4)), np.empty((3, 4)), np.empty((3, 8))
    moments = np.empty((count, 3))
    for s in range(e1.shape[0]):
        some = False
        for m in range(count):
            for a in range(3):
                moment = 0.0
                for b in range(3):
                    moment += stiffness[s, a, b, m] * (eps[s, b] - eps0[s, b]) - K[s, a, b] * offset[s, b, m]
                moments[m, a] = moment
                some = some or moment != 0.0
        if not some and not viscous:
            continue
        ea, eb = e1[s], e2[s]
        _carried(ea, Q1, s, T, M1, M2, V)
        _carried(eb, Q2, s, T, M1, M2, W)
        ic = 1.0 / (1.0 + _dot(V[2], W[2]))
        n0, n1, n2 = (
            W[2, 1] * V[2, 2] - W[2, 2] * V[2, 1],
            W[2, 2] * V[2, 0] - W[2, 0] * V[2, 2],
            W[2, 0] * V[2, 1] - W[2, 1] * V[2, 0],
        )
        for a in range(2):
            k = (_dot(V[a], W[2]) - _dot(V[2], W[a])) * ic
            G[a, 0] = (
                W[2, 1] * V[a, 2] - W[2, 2] * V[a, 1] - W[a, 1] * V[2, 2] + W[a, 2] * V[2, 1] - k * n0
            ) * ic
            G[a, 1] = (
                W[2, 2] * V[a, 0] - W[2, 0] * V[a, 2] - W[a, 2] * V[2, 0] + W[a, 0] * V[2, 2] - k * n1
            ) * ic
            G[a, 2] = (
                W[2, 0] * V[a, 1] - W[2, 1] * V[a, 0] - W[a, 0] * V[2, 1] + W[a, 1] * V[2, 0] - k * n2
            ) * ic
        for i in range(3):
            G[2, i] = (V[2, i] + W[2, i]) * ic
        _rotation_map(T[ea], S[ea], L[ea], A1)
        _rotation_map(T[eb], S[eb], L[eb], A2)
        for k in range(4):
            w1 = s1[s] if k < 3 else 1.0
            w2 = s2[s] if k < 3 else 1.0
            for a in range(3):
                B[a, k] = -w1 * (G[a, 0] * A1[0, k] + G[a, 1] * A1[1, k] + G[a, 2] * A1[2, k])
                B[a, 4 + k] = w2 * (G[a, 0] * A2[0, k] + G[a, 1] * A2[1, k] + G[a, 2] * A2[2, k])
        if viscous:
            for a in range(3):
                rate[a] = B[a, 3] * w[ea] + B[a, 7] * w[eb]
                for b in range(3):
                    rate[a] += B[a, b] * s1[s] * (v[edges[ea, 1], b] - v[edges[ea, 0], b])
                    rate[a] += B[a, 4 + b] * s2[s] * (v[edges[eb, 1], b] - v[edges[eb, 0], b])
            for m in range(count):
                for a in range(3):
                    for b in range(3):
                        moments[m, a] += viscosity[s, a, b, m] * rate[b]
        for m in range(count):
            c = which[m]
            p0, p1, p2 = moments[m, 0], moments[m, 1], moments[m, 2]
            if p0 == 0.0 and p1 == 0.0 and p2 == 0.0:
                continue
            for i in range(3):
                first = p0 * B[0, i] + p1 * B[1, i] + p2 * B[2, i]
                second = p0 * B[0, 4 + i] + p1 * B[1, 4 + i] + p2 * B[2, 4 + i]
                out[dofs[s, i], c] -= first
                out[dofs[s, 4 + i], c] += first - second
                out[dofs[s, 8 + i], c] += second
            out[dofs[s, 3], c] += p0 * B[0, 3] + p1 * B[1, 3] + p2 * B[2, 3]
            out[dofs[s, 7], c] += p0 * B[0, 7] + p1 * B[1, 7] + p2 * B[2, 7]
