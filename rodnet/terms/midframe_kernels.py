"""Compiled derivatives of the bending energy in the frame half way between two edges."""

import math

import numpy as np

from rodnet.compiled import kernel


@kernel
def midframe_stress(springs, stiffness, eps, eps0, stress, modulus):
    """Add the two derivatives of 1/2 d.K d, d = c kappa - kappa0, c = 1 / cos(tau / 2), by (kappa, tau).

    With c' = c tan(tau/2) / 2 and c'' = c (2 tan^2 + 1) / 4 they are (c K d, c' kappa.K d), and for the second
    c^2 K, c' (K d + c K kappa) and c'' kappa.K d + c'^2 kappa.K kappa.
    """
    Kd, Kk = np.empty(2), np.empty(2)
    for n in range(springs.shape[0]):
        s = springs[n]
        tan = math.tan(0.5 * eps[s, 2])
        c = 1.0 / math.cos(0.5 * eps[s, 2])
        c1, c2 = 0.5 * c * tan, 0.25 * c * (2.0 * tan * tan + 1.0)
        kd, kk = 0.0, 0.0
        for i in range(2):
            Kd[i], Kk[i] = 0.0, 0.0
            for j in range(2):
                Kd[i] += stiffness[s, i, j] * (c * eps[s, j] - eps0[s, j])
                Kk[i] += stiffness[s, i, j] * eps[s, j]
            kd += eps[s, i] * Kd[i]
            kk += eps[s, i] * Kk[i]
        for i in range(2):
            stress[s, i] += c * Kd[i]
            mixed = c1 * (Kd[i] + c * Kk[i])
            modulus[s, i, 2] += mixed
            modulus[s, 2, i] += mixed
            for j in range(2):
                modulus[s, i, j] += c * c * stiffness[s, i, j]
        stress[s, 2] += c1 * kd
        modulus[s, 2, 2] += c2 * kd + c1 * c1 * kk
