"""Compiled internal forces of one state: moments at the springs and shear forces of the edges."""

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.kinematics.kernels import _carried, _dot


@inlined
def _cross(a, b, c):
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def spring_moments(edge1, edge2, Q1, Q2, T, M1, M2, stress, moment):
    """Moment m of each spring [N m], dE = m . (rotation of edge 2 - rotation of edge 1).

    With the frames v_k and w_k that the two edges carry, and chi = 1 + v_3 . w_3, the strains turn by
    d kappa_k = (w_3 x v_k - w_k x v_3 - kappa_k w_3 x v_3) / chi and d tau = (v_3 + w_3) / chi.
    """
    v, w = np.empty((3, 3)), np.empty((3, 3))
    n, a, b = np.empty(3), np.empty(3), np.empty(3)
    for s in range(edge1.shape[0]):
        _carried(edge1[s], Q1, s, T, M1, M2, v)
        _carried(edge2[s], Q2, s, T, M1, M2, w)
        chi = 1.0 + _dot(v[2], w[2])
        _cross(w[2], v[2], n)
        for i in range(3):
            moment[s, i] = stress[s, 2] * (v[2, i] + w[2, i]) / chi
        for k in range(2):
            kappa = (_dot(v[k], w[2]) - _dot(v[2], w[k])) / chi
            _cross(w[2], v[k], a)
            _cross(w[k], v[2], b)
            for i in range(3):
                moment[s, i] += stress[s, k] * (a[i] - b[i] - kappa * n[i]) / chi


@kernel
def shear_forces(edge1, edge2, T, S, L, moment, force):
    """Force [N] across each edge by which the moments at its two springs are in balance.

    It is conjugate to the edge vector: (m x t - (m . t) s) / l with the holonomy vector s, summed over
    the moments m on the edge.
    """
    couple = np.empty(3)
    force[:] = 0.0
    for s in range(edge1.shape[0]):
        for side in range(2):
            e = edge1[s] if side == 0 else edge2[s]
            sign = -1.0 if side == 0 else 1.0
            _cross(moment[s], T[e], couple)
            axial = _dot(moment[s], T[e])
            for i in range(3):
                force[e, i] += sign * (couple[i] - axial * S[e, i]) / L[e]
