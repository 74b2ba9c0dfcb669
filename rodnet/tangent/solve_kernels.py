"""Compiled solution for many right-hand sides with the factors of a `TreeLU`, eight columns at a time.

Eight columns of a row fit into registers: each coefficient is loaded once for them, and what they are
multiplied with is not stored in between. Numbers without a sign spare the test whether an index counts
from the end, which would keep the compiler from using vector instructions.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import inlined, kernel

U = np.uint64
WIDTH = 8  # columns that are done together
_1, _2, _3, _4, _5, _6, _7 = (U(k) for k in range(1, 8))


@inlined
def _row(fronts, row, count, index, start, consecutive, y, wide, c, i):
    """Subtract from row ``i`` of y the products of coefficients with ``count`` other rows, times a factor."""
    b = U(i) * wide + c
    a0, a1, a2, a3 = y[b], y[b + _1], y[b + _2], y[b + _3]
    a4, a5, a6, a7 = y[b + _4], y[b + _5], y[b + _6], y[b + _7]
    for j in range(count):
        f = fronts[U(row + j)]
        o = U(start + j) if consecutive else U(index[U(start + j)])
        o = o * wide + c
        a0 -= f * y[o]
        a1 -= f * y[o + _1]
        a2 -= f * y[o + _2]
        a3 -= f * y[o + _3]
        a4 -= f * y[o + _4]
        a5 -= f * y[o + _5]
        a6 -= f * y[o + _6]
        a7 -= f * y[o + _7]
    return a0, a1, a2, a3, a4, a5, a6, a7


@inlined
def _store(y, wide, c, i, a, s):
    b = U(i) * wide + c
    y[b], y[b + _1], y[b + _2], y[b + _3] = s * a[0], s * a[1], s * a[2], s * a[3]
    y[b + _4], y[b + _5], y[b + _6], y[b + _7] = s * a[4], s * a[5], s * a[6], s * a[7]


@kernel
def solve_wide(y, columns, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps):
    """Solve in place for all columns of ``y``, shape (n * columns,), rows in the order of elimination.

    The number of columns must be a multiple of eight.
    """
    n_blocks, wide = block_ptr.size - 1, U(columns)
    for panel in range(columns // 8):
        c = U(8 * panel)
        for block in range(n_blocks):
            first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
            n_pivots = block_ptr[block + 1] - first
            n_boundary = boundary_ptr[block + 1] - start
            size = n_pivots + n_boundary
            for k in range(n_pivots):
                if swaps[first + k] != k:
                    one, other = U(first + k) * wide + c, U(first + swaps[first + k]) * wide + c
                    for j in range(8):
                        y[one + U(j)], y[other + U(j)] = y[other + U(j)], y[one + U(j)]
            for i in range(1, n_pivots):
                a = _row(fronts, base + i * size, i, boundary, first, True, y, wide, c, first + i)
                _store(y, wide, c, first + i, a, 1.0)
            low = base + n_pivots * size
            for i in range(n_boundary):
                o = boundary[start + i]
                a = _row(fronts, low + i * n_pivots, n_pivots, boundary, first, True, y, wide, c, o)
                _store(y, wide, c, o, a, 1.0)
        for block in range(n_blocks - 1, -1, -1):
            first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
            n_pivots = block_ptr[block + 1] - first
            n_boundary = boundary_ptr[block + 1] - start
            size = n_pivots + n_boundary
            for k in range(n_pivots - 1, -1, -1):
                row = base + k * size
                a = _row(fronts, row + n_pivots, n_boundary, boundary, start, False, y, wide, c, first + k)
                _store(y, wide, c, first + k, a, 1.0)
                left = n_pivots - k - 1
                a = _row(fronts, row + k + 1, left, boundary, first + k + 1, True, y, wide, c, first + k)
                _store(y, wide, c, first + k, a, fronts[row + k])
