"""Compiled sums of damped springs."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel


@kernel
def damp(B, H, v, natural, C, cv, sigma, slots, data, with_jac):
    """Moments ``sigma = C (B v - natural)``; with ``with_jac`` add ``B^T C (cv B + H v)`` to the data.

    ``B`` (n, 3, 11) are the gradients of the strains, ``H`` (n, 3, 11, 11) their second derivatives, ``v`` (n, 11)
    rates and ``C`` (n, 3, 3) viscosities; ``slots`` (n, 11, 11).
    """
    rate, W, R = np.empty(3), np.empty((3, 11)), np.empty((3, 11))
    for s in range(B.shape[0]):
        for k in range(3):
            rate[k] = -natural[s, k]
            for i in range(11):
                rate[k] += B[s, k, i] * v[s, i]
        for k in range(3):
            sigma[s, k] = C[s, k, 0] * rate[0] + C[s, k, 1] * rate[1] + C[s, k, 2] * rate[2]
        if not with_jac:
            continue
        for k in range(3):
            for i in range(11):
                total = cv * B[s, k, i]
                for j in range(11):
                    total += H[s, k, i, j] * v[s, j]
                W[k, i] = total
        for k in range(3):
            for i in range(11):
                R[k, i] = C[s, k, 0] * W[0, i] + C[s, k, 1] * W[1, i] + C[s, k, 2] * W[2, i]
        for i in range(11):
            for j in range(11):
                data[slots[s, i, j]] += B[s, 0, i] * R[0, j] + B[s, 1, i] * R[1, j] + B[s, 2, i] * R[2, j]
