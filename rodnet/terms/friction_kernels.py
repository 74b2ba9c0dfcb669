"""Compiled steps of Dahl's friction (docs, theory: friction inside a rod)."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import inlined, kernel

STILL = 1e-9  # of a pre-sliding scale: a step that has no direction


@inlined
def _shares(s):
    """exp(-s), (1 - exp(-s)) / s and the derivative of the latter."""
    left = np.exp(-s)
    if s > STILL:
        share = -np.expm1(-s) / s
        return left, share, (left - share) / s
    return left, 1.0 - 0.5 * s, -0.5


@kernel
def dahl(z, step):
    """State after straight steps, shape (n, 3): bending is of the first two components, twist of the third.

    dz/ds = n - z along the direction n of the step has the solution z exp(-s) + n (1 - exp(-s)).

    Parameters
    ----------
    z, step : ndarray, shape (n, 3)
        State before, at most 1 long, and step of the strain over its pre-sliding scale.
    """
    out = np.empty_like(step)
    for i in range(len(step)):
        left, share, _ = _shares(np.hypot(step[i, 0], step[i, 1]))
        for k in range(2):
            out[i, k] = left * z[i, k] + share * step[i, k]
        left, share, _ = _shares(abs(step[i, 2]))
        out[i, 2] = left * z[i, 2] + share * step[i, 2]
    return out


@kernel
def dahl_slope(z, step):
    """Derivatives of the state after a step by the step, (n, 3, 3), and by the state before it, (n, 3).

    Without a step, at a corner, that of pre-sliding.
    """
    slope, lefts = np.zeros((len(step), 3, 3)), np.empty_like(step)
    for i in range(len(step)):
        s = np.hypot(step[i, 0], step[i, 1])
        left, share, bend = _shares(s)
        for k in range(2):
            lefts[i, k] = left
            for j in range(2):
                along = step[i, j] / s if s > STILL else 0.0
                slope[i, k, j] = (bend * step[i, k] - left * z[i, k]) * along
            slope[i, k, k] += share
        s = abs(step[i, 2])
        left, share, bend = _shares(s)
        along = step[i, 2] / s if s > STILL else 0.0
        slope[i, 2, 2] = (bend * step[i, 2] - left * z[i, 2]) * along + share
        lefts[i, 2] = left
    return slope, lefts
