"""Compiled loops over the cells around sites: the interpolation of a field that is fixed in space.

Cells are known by a code, one whole number for their three indices, and kept in order of it. A site's cells
are the 27 around it, weighted by quadratic B-splines.
"""

import math

import numpy as np

from rodnet.compiled import inlined, kernel

BITS = 21  # of each of the three indices
HALF = 1 << (BITS - 1)


@inlined
def _weights(s, w, dw):
    """Fill the three weights of a coordinate, in cells, and their derivatives; return the middle cell."""
    i = math.floor(s + 0.5)
    d = s - i
    w[0], w[1], w[2] = 0.5 * (0.5 - d) ** 2, 0.75 - d * d, 0.5 * (0.5 + d) ** 2
    dw[0], dw[1], dw[2] = d - 0.5, -2.0 * d, d + 0.5
    return i


@kernel
def gather(x, cell, codes, change, value, slope):
    """Interpolate at ``x`` (n, 3) what cells hold, ``change`` (c, k); add to ``value`` (n, k).

    ``slope`` (n, k, 3) receives the derivative by x, if it has rows. Positions that are no numbers give none.
    """
    w, dw = np.empty((3, 3)), np.empty((3, 3))
    middle = np.empty(3, np.int64)
    for s in range(x.shape[0]):
        inside = True
        for a in range(3):
            inside = inside and abs(x[s, a]) < cell * (HALF - 2)
        if not inside:  # false for NaN, too
            value[s] = np.nan
            continue
        for a in range(3):
            middle[a] = _weights(x[s, a] / cell, w[a], dw[a])
        for i in range(3):
            for j in range(3):
                row = (((middle[0] + i - 1 + HALF) << BITS) + middle[1] + j - 1 + HALF) << BITS
                first = row + middle[2] - 1 + HALF
                at = np.searchsorted(codes, first)
                while at < codes.shape[0] and codes[at] <= first + 2:
                    k = codes[at] - first
                    weight = w[0, i] * w[1, j] * w[2, k]
                    for c in range(value.shape[1]):
                        value[s, c] += weight * change[at, c]
                    for c in range(slope.shape[1] if slope.shape[0] else 0):
                        slope[s, c, 0] += dw[0, i] * w[1, j] * w[2, k] * change[at, c] / cell
                        slope[s, c, 1] += w[0, i] * dw[1, j] * w[2, k] * change[at, c] / cell
                        slope[s, c, 2] += w[0, i] * w[1, j] * dw[2, k] * change[at, c] / cell
                    at += 1


@kernel
def stencils(x, cell, codes, weights):
    """Fill the codes (n, 27) and the weights (n, 27) of the cells around the points ``x`` (n, 3)."""
    w, dw = np.empty((3, 3)), np.empty((3, 3))
    middle = np.empty(3, np.int64)
    for s in range(x.shape[0]):
        for a in range(3):
            middle[a] = _weights(x[s, a] / cell, w[a], dw[a])
        for i in range(3):
            for j in range(3):
                row = (((middle[0] + i - 1 + HALF) << BITS) + middle[1] + j - 1 + HALF) << BITS
                for k in range(3):
                    codes[s, 9 * i + 3 * j + k] = row + middle[2] + k - 1 + HALF
                    weights[s, 9 * i + 3 * j + k] = w[0, i] * w[1, j] * w[2, k]


@kernel
def deposit(at, weights, amount, values):
    """Add ``amount`` (n, k) to the rows ``at`` (n, 27) of ``values``, with weights (n, 27)."""
    for s in range(at.shape[0]):
        for i in range(at.shape[1]):
            for c in range(values.shape[1]):
                values[at[s, i], c] += weights[s, i] * amount[s, c]
