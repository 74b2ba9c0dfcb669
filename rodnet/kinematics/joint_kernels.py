"""Compiled law of joints: energy of the rotation vector between two frames, and its derivatives by the strains."""

import math

import numpy as np

from rodnet.compiled import inlined, kernel

SERIES = 0.03  # squared half-angle tangent below which the series is used


@inlined
def _squared_ratio(s):
    """h(s) = (2 atan(x) / x)^2 with s = x^2, and its first two derivatives by s.

    atan(x)^2 = sum over n of (-1)^n x^(2n+2) / (n+1) (1 + 1/3 + ... + 1/(2n+1)).
    """
    if s > SERIES:
        x = math.sqrt(s)
        a, b = math.atan(x), 1.0 / (1.0 + s)
        # a' = b / (2x), b' = -b^2, by s
        h = 4.0 * a * a / s
        d = 4.0 * a * b / (x * s) - h / s
        dd = (
            2.0 * b * b / (s * s)
            - 4.0 * a * b * b / (x * s)
            - 6.0 * a * b / (x * s * s)
            - d / s
            + h / (s * s)
        )
        return h, d, dd
    h, d, dd, odd, power, power1, power2 = 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0
    sign = 4.0
    for n in range(12):
        odd += 1.0 / (2 * n + 1)
        c = sign * odd / (n + 1)
        h += c * power
        d += c * n * power1
        dd += c * n * (n - 1) * power2
        power2 = power1
        power1 = power
        power *= s
        sign = -sign
    return h, d, dd


@kernel
def joint_law(first, hinge, K, eps, stress, modulus):
    """Add the joints' moments and moduli by the strains (kappa1, kappa2, tau); return the energy [J].

    Parameters
    ----------
    first : int
        The first of the joints' springs.
    hinge : ndarray of bool, shape (n,)
        Joints that turn about their third axis alone, by tau.
    K : ndarray, shape (n, 3)
        Stiffness about the axes [N m/rad].
    eps, stress, modulus : ndarray, shapes (S, 3), (S, 3) and (S, 3, 3)
        Strains, and derivatives of the energy by them, of all springs.
    """
    r, kr, v, slope, curve = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    H, J = np.empty((3, 3)), np.empty((3, 3))
    energy = 0.0
    for m in range(hinge.shape[0]):
        s = first + m
        tau = eps[s, 2]
        if hinge[m]:
            energy += 0.5 * K[m, 2] * tau * tau
            stress[s, 2] += K[m, 2] * tau
            modulus[s, 2, 2] += K[m, 2]
            continue
        # Gibbs vector of the rotation: its length is the tangent of half the angle
        c = 1.0 / (1.0 + math.cos(tau))
        t = math.tan(0.5 * tau)
        half = 0.5 * (1.0 + t * t)
        r[0], r[1], r[2] = -eps[s, 1] * c, eps[s, 0] * c, t
        ss, q = 0.0, 0.0
        for i in range(3):
            kr[i] = K[m, i] * r[i]
            ss += r[i] * r[i]
            q += r[i] * kr[i]
        h, d, dd = _squared_ratio(ss)
        energy += 0.5 * h * q
        for i in range(3):
            v[i] = d * q * r[i] + h * kr[i]
            for j in range(3):
                H[i, j] = 2.0 * dd * q * r[i] * r[j] + 2.0 * d * (r[i] * kr[j] + kr[i] * r[j])
            H[i, i] += d * q + h * K[m, i]
        # r by (kappa1, kappa2, tau)
        slope[0], slope[1], slope[2] = r[0] * t, r[1] * t, half
        curve[0], curve[1], curve[2] = r[0] * (t * t + half), r[1] * (t * t + half), t * half
        for i in range(3):
            J[i, 0], J[i, 1], J[i, 2] = 0.0, 0.0, slope[i]
        J[0, 1], J[1, 0] = -c, c
        for a in range(3):
            for i in range(3):
                stress[s, a] += v[i] * J[i, a]
                for b in range(3):
                    for j in range(3):
                        modulus[s, a, b] += J[i, a] * H[i, j] * J[j, b]
        modulus[s, 2, 2] += v[0] * curve[0] + v[1] * curve[1] + v[2] * curve[2]
        cross0, cross1 = v[1] * c * t, -v[0] * c * t
        modulus[s, 0, 2] += cross0
        modulus[s, 2, 0] += cross0
        modulus[s, 1, 2] += cross1
        modulus[s, 2, 1] += cross1
    return energy
