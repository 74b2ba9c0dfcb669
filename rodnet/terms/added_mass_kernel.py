"""The compiled forces of added mass, one edge after the other."""

import math

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import unpack

# half of the added mass per length [kg/m] of the edges, their degrees of freedom, and slots
HALVES = "half:d1 dofs:i2 slots:i3"


@kernel
def added_mass(halves, q, rates, acc, cv, ca, F, data, with_jac):
    """Forces of Lagrange's equations for T = 1/2 c (l |v|^2 - (v.e)^2 / l) of both halves of edges e.

    With s = v.e its momentum is c (l v - s e / l), whose rate is c N, and dT/de = c G. Returns the largest force.
    """
    half, dofs, slots = unpack(halves, HALVES)
    e, de, v, a, N, G = np.empty((6, 3))
    by_own, by_edge, G_own, G_edge = np.empty((4, 3, 3))
    largest = 0.0
    for n in range(half.shape[0]):
        c = half[n]
        square = 0.0
        for i in range(3):
            e[i] = q[dofs[n, 3 + i]] - q[dofs[n, i]]
            de[i] = rates[dofs[n, 3 + i]] - rates[dofs[n, i]]
            square += e[i] * e[i]
        l = math.sqrt(square)
        k = (e[0] * de[0] + e[1] * de[1] + e[2] * de[2]) / l
        for side in range(2):
            own = 3 * side
            s, u, vv = 0.0, 0.0, 0.0
            for i in range(3):
                v[i], a[i] = rates[dofs[n, own + i]], acc[dofs[n, own + i]]
                s += v[i] * e[i]
                u += a[i] * e[i] + v[i] * de[i]
                vv += v[i] * v[i]
            l3 = l * l * l
            for i in range(3):
                N[i] = l * a[i] + k * v[i] - u * e[i] / l - s * de[i] / l + s * k * e[i] / square
                G[i] = 0.5 * (vv * e[i] / l - 2.0 * s * v[i] / l + s * s * e[i] / l3)
                F[dofs[n, own + i]] -= c * N[i]
                F[dofs[n, 3 + i]] += c * G[i]
                F[dofs[n, i]] -= c * G[i]
                largest = max(largest, c * abs(N[i]), c * abs(G[i]))
            if not with_jac:
                continue
            for i in range(3):
                for j in range(3):
                    one = 1.0 if i == j else 0.0
                    ee = e[i] * e[j]
                    # N by velocity, acceleration, de, e
                    Nv = k * one - (e[i] * de[j] + de[i] * e[j]) / l + k * ee / square
                    Na = l * one - ee / l
                    Nr = (v[i] * e[j] - e[i] * v[j] - s * one) / l + s * ee / l3
                    dk = de[j] / l - k * e[j] / square
                    Ne = a[i] * e[j] / l + v[i] * dk
                    Ne -= (e[i] * a[j] + u * one) / l - u * ee / l3
                    Ne -= de[i] * v[j] / l - s * de[i] * e[j] / l3
                    Ne += (k * e[i] * v[j] + s * e[i] * dk + s * k * one) / square
                    Ne -= 2.0 * s * k * ee / (square * square)
                    by_own[i, j] = cv * Nv + ca * Na
                    by_edge[i, j] = cv * Nr + Ne
                    G_own[i, j] = cv * ((e[i] * v[j] - v[i] * e[j] - s * one) / l + s * ee / l3)
                    Ge = vv * (one / l - ee / l3) - 2.0 * v[i] * v[j] / l
                    Ge += 2.0 * s * (v[i] * e[j] + e[i] * v[j]) / l3
                    Ge += s * s * (one / l3 - 3.0 * ee / (l3 * square))
                    G_edge[i, j] = 0.5 * Ge
            for i in range(3):
                for j in range(3):
                    data[slots[n, own + i, own + j]] += c * by_own[i, j]
                    data[slots[n, own + i, 3 + j]] += c * by_edge[i, j]
                    data[slots[n, own + i, j]] -= c * by_edge[i, j]
                    for end in range(2):
                        sign = 1.0 - 2.0 * end
                        data[slots[n, 3 * end + i, own + j]] += sign * c * G_own[i, j]
                        data[slots[n, 3 * end + i, 3 + j]] += sign * c * G_edge[i, j]
                        data[slots[n, 3 * end + i, j]] -= sign * c * G_edge[i, j]
    return largest
