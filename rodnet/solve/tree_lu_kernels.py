"""Compiled kernels of the tree LU: arrays only.

Conventions. *Position* means place in the elimination order; block b holds the positions
``block_ptr[b]`` to ``block_ptr[b + 1]``, its pivots. Its *boundary* is the sorted list of later
positions that its pivots are coupled to once all earlier blocks are eliminated. Its *front* is the
matrix over pivots and boundary, as far as it has a pivot's row or column, stored in ``fronts`` from
``front_ptr[b]``: first the pivots' rows over pivots and boundary, then the boundary's rows over pivots,
row-major. After factorisation it holds L below the diagonal (unit diagonal not stored), U above it, and
the reciprocals of U's diagonal on it. What elimination leaves over boundary x boundary goes to the
fronts that eliminate it.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.packed import unpack

# A sum of products smaller than this has lost digits to underflow: no relative error is asked of it.
UNDERFLOW = np.finfo(np.float64).tiny / np.finfo(np.float64).eps


@inlined
def _pivot_rows(fronts, base, size, n_pivots, swaps, first):
    """Eliminate among the pivots' rows, with row exchanges; the largest multiplier, or infinity.

    The row exchanged with pivot k goes to ``swaps[first + k]``. Infinity means that a pivot is zero or
    not finite. (A NaN anywhere in the matrix spreads along its row or column and ends up as a pivot, so
    looking at the pivots is enough.)
    """
    growth = 0.0
    for k in range(n_pivots):
        row = base + k * size
        best, largest = k, abs(fronts[row + k])
        for i in range(k + 1, n_pivots):
            candidate = abs(fronts[base + i * size + k])
            if candidate > largest:
                best, largest = i, candidate
        swaps[first + k] = best
        if best != k:
            other = base + best * size
            for j in range(size):
                fronts[row + j], fronts[other + j] = fronts[other + j], fronts[row + j]
        if not 0.0 < largest < np.inf:
            return np.inf
        reciprocal = 1.0 / fronts[row + k]
        fronts[row + k] = reciprocal
        for i in range(k + 1, n_pivots):
            target = base + i * size
            multiplier = fronts[target + k] * reciprocal
            fronts[target + k] = multiplier
            growth = max(growth, abs(multiplier))
            for j in range(k + 1, size):
                fronts[target + j] -= multiplier * fronts[row + j]
    return growth


@inlined
def _boundary_rows(fronts, base, size, n_pivots, rest, remainder, left):
    """Eliminate the boundary's rows and pass on what is left; the largest multiplier. ``left`` is scratch."""
    growth = 0.0
    n_boundary = size - n_pivots
    for i in range(n_boundary):
        row = base + n_pivots * size + i * n_pivots
        left[:n_boundary] = 0.0
        for k in range(n_pivots):
            multiplier = fronts[row + k]
            for m in range(k):
                multiplier -= fronts[row + m] * fronts[base + m * size + k]
            multiplier *= fronts[base + k * size + k]
            fronts[row + k] = multiplier
            growth = max(growth, abs(multiplier))
            upper = base + k * size + n_pivots
            for j in range(n_boundary):
                left[j] += multiplier * fronts[upper + j]
        for j in range(n_boundary):
            fronts[remainder[rest + j]] -= left[j]
        rest += n_boundary
    return growth


@inlined
def _inside_a_rod(fronts, base, own, lower, beyond, own_size, beyond_size):
    """Do what `_boundary_rows` does with four pivots and seven others, a node and the twist of its edge.

    What is left goes to rows without gaps, of ``own_size`` and ``beyond_size``: four of the next block from
    ``own`` and three of its boundary from ``lower``, and three of the block after from ``beyond``.
    """
    growth = 0.0
    r1, r2, r3, low = base + 11, base + 22, base + 33, base + 44
    d0, d1, d2, d3 = fronts[base], fronts[r1 + 1], fronts[r2 + 2], fronts[r3 + 3]
    u01, u02, u03 = fronts[base + 1], fronts[base + 2], fronts[base + 3]
    u12, u13, u23 = fronts[r1 + 2], fronts[r1 + 3], fronts[r2 + 3]
    for i in range(7):
        row = low + 4 * i
        l0 = fronts[row] * d0
        l1 = (fronts[row + 1] - l0 * u01) * d1
        l2 = (fronts[row + 2] - l0 * u02 - l1 * u12) * d2
        l3 = (fronts[row + 3] - l0 * u03 - l1 * u13 - l2 * u23) * d3
        fronts[row], fronts[row + 1], fronts[row + 2], fronts[row + 3] = l0, l1, l2, l3
        growth = max(growth, abs(l0), abs(l1), abs(l2), abs(l3))
        left = own + i * own_size if i < 4 else lower + 4 * (i - 4)
        right = left + 4 if i < 4 else beyond + (i - 4) * beyond_size
        for j in range(4):
            at = j + 4
            fronts[left + j] -= (
                l0 * fronts[base + at] + l1 * fronts[r1 + at] + l2 * fronts[r2 + at] + l3 * fronts[r3 + at]
            )
        for j in range(3):
            at = j + 8
            fronts[right + j] -= (
                l0 * fronts[base + at] + l1 * fronts[r1 + at] + l2 * fronts[r2 + at] + l3 * fronts[r3 + at]
            )
    return growth


# the arrays of one factorisation; ahead, rest_ptr and remainder are the places of what each block passes on
# (`find_regular`, `place_remainders`)
FACTORS = (
    "order:i1 block_ptr:i1 boundary_ptr:i1 boundary:i1 front_ptr:l1 ahead:i2 rest_ptr:l1 remainder:i1 "
    "fronts:d1 swaps:i1"
)
VECTORS = "y:d1 residual:d1 scale:d1"


@kernel
def factor(factors, values):
    """Numeric factorisation: fills `fronts` and `swaps`.

    Parameters
    ----------
    factors : int
        The `Packed` arrays.
    values : ndarray, shape (front_ptr[m],) or longer
        The matrix, stored as `fronts` are.

    Returns
    -------
    float
        Largest multiplier, infinite if a pivot is zero or not finite.
    """
    _, block_ptr, boundary_ptr, _, front_ptr, ahead, rest_ptr, remainder, fronts, swaps = unpack(
        factors, FACTORS
    )
    for k in range(fronts.size):
        fronts[k] = values[k]
    growth = 0.0
    widest = 0
    for b in range(block_ptr.size - 1):
        widest = max(widest, boundary_ptr[b + 1] - boundary_ptr[b])
    left = np.empty(widest)
    for b in range(block_ptr.size - 1):
        first, base, rest = block_ptr[b], front_ptr[b], rest_ptr[b]
        n_pivots = block_ptr[b + 1] - first
        size = n_pivots + boundary_ptr[b + 1] - boundary_ptr[b]
        following, beyond = ahead[b]
        if following >= 0:  # inside a rod; constants let the compiler unroll
            growth = max(growth, _pivot_rows(fronts, base, 11, 4, swaps, first))
            if growth < np.inf:
                own, own_size = (
                    front_ptr[following],
                    4 + boundary_ptr[following + 1] - boundary_ptr[following],
                )
                beyond_size = block_ptr[beyond + 1] - block_ptr[beyond]
                beyond_size += boundary_ptr[beyond + 1] - boundary_ptr[beyond]
                lower, other = own + 4 * own_size, front_ptr[beyond]
                growth = max(growth, _inside_a_rod(fronts, base, own, lower, other, own_size, beyond_size))
        else:
            growth = max(growth, _pivot_rows(fronts, base, size, n_pivots, swaps, first))
            if growth < np.inf:
                growth = max(growth, _boundary_rows(fronts, base, size, n_pivots, rest, remainder, left))
        if growth == np.inf:
            return growth
    return growth


@inlined
def _forward(fronts, base, size, n_pivots, swaps, first, boundary, start, y):
    for k in range(n_pivots):
        other = first + swaps[first + k]
        y[first + k], y[other] = y[other], y[first + k]
    for i in range(1, n_pivots):
        for k in range(i):
            y[first + i] -= fronts[base + i * size + k] * y[first + k]
    for i in range(size - n_pivots):
        passed_on = 0.0
        for k in range(n_pivots):
            passed_on += fronts[base + n_pivots * size + i * n_pivots + k] * y[first + k]
        y[boundary[start + i]] -= passed_on


@inlined
def _backward(fronts, base, size, n_pivots, first, boundary, start, y):
    for k in range(n_pivots - 1, -1, -1):
        known, row = 0.0, base + k * size
        for j in range(size - n_pivots):
            known += fronts[row + n_pivots + j] * y[boundary[start + j]]
        for j in range(k + 1, n_pivots):
            known += fronts[row + j] * y[first + j]
        y[first + k] = (y[first + k] - known) * fronts[row + k]


@kernel
def solve_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x):
    """Solve for one right-hand side `b`, shape (n,), into `x`, with the workspace `y`, shape (n,)."""
    for p in range(order.size):
        y[p] = b[order[p]]
    n_blocks = block_ptr.size - 1
    for block in range(n_blocks):
        first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
        n_pivots = block_ptr[block + 1] - first
        size = n_pivots + boundary_ptr[block + 1] - start
        if n_pivots == 4 and size == 11:
            _forward(fronts, base, 11, 4, swaps, first, boundary, start, y)
        else:
            _forward(fronts, base, size, n_pivots, swaps, first, boundary, start, y)
    for block in range(n_blocks - 1, -1, -1):
        first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
        n_pivots = block_ptr[block + 1] - first
        size = n_pivots + boundary_ptr[block + 1] - start
        if n_pivots == 4 and size == 11:
            _backward(fronts, base, 11, 4, first, boundary, start, y)
        else:
            _backward(fronts, base, size, n_pivots, first, boundary, start, y)
    for p in range(order.size):
        x[order[p]] = y[p]


@kernel
def solve_columns(b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x):
    """Solve for all columns of `b`, shape (n, k), into `x`, with the workspace `y`, shape (n, k).

    The columns are innermost: each coefficient is read once for all of them.
    """
    for p in range(order.size):
        y[p] = b[order[p]]
    n_blocks = block_ptr.size - 1
    for block in range(n_blocks):
        first, n_pivots = block_ptr[block], block_ptr[block + 1] - block_ptr[block]
        start, n_boundary = boundary_ptr[block], boundary_ptr[block + 1] - boundary_ptr[block]
        base, size = front_ptr[block], n_pivots + n_boundary
        for k in range(n_pivots):
            if swaps[first + k] != k:
                other = y[first + swaps[first + k]]
                for column in range(y.shape[1]):
                    y[first + k, column], other[column] = other[column], y[first + k, column]
        for k in range(n_pivots):
            for i in range(k + 1, n_pivots):
                subtract_multiple(y[first + i], fronts[base + i * size + k], y[first + k])
            for i in range(n_boundary):
                low = base + n_pivots * size + i * n_pivots
                subtract_multiple(y[boundary[start + i]], fronts[low + k], y[first + k])
    for block in range(n_blocks - 1, -1, -1):
        first, n_pivots = block_ptr[block], block_ptr[block + 1] - block_ptr[block]
        start, n_boundary = boundary_ptr[block], boundary_ptr[block + 1] - boundary_ptr[block]
        for k in range(n_pivots - 1, -1, -1):
            row = front_ptr[block] + k * (n_pivots + n_boundary)
            for j in range(n_boundary):
                subtract_multiple(y[first + k], fronts[row + n_pivots + j], y[boundary[start + j]])
            for j in range(k + 1, n_pivots):
                subtract_multiple(y[first + k], fronts[row + j], y[first + j])
            for column in range(y.shape[1]):
                y[first + k, column] *= fronts[row + k]
    for p in range(order.size):
        x[order[p]] = y[p]


@kernel
def subtract_multiple(target, factor, source):
    """``target -= factor * source``, all of shape (k,)."""
    for column in range(target.size):
        target[column] -= factor * source[column]


@kernel
def check_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, values, y, residual, scale):
    """How well the solution `y`, in the order of elimination, solves A x = b, row by row.

    So it does not depend on the units of the rows. ``values`` holds A as `fronts` do. ``residual`` and
    ``scale``, of shape (n,), are scratch.

    Returns
    -------
    backward_error : float
        max |A x - b| / (|A| |x| + |b|) over rows: the relative change of the coefficients of A and b
        that makes `x` exact (Oettli and Prager); infinite if not finite.
    significance : float
        max |b| / (|A| |x|) over rows. Where it is round-off, b has drowned in the cancellations of
        A x: x is a null vector of A to working precision.
    """
    for p in range(order.size):
        residual[p] = b[order[p]]
        scale[p] = 0.0
    for block in range(block_ptr.size - 1):
        first, start, at = block_ptr[block], boundary_ptr[block], front_ptr[block]
        n_pivots, n_boundary = block_ptr[block + 1] - first, boundary_ptr[block + 1] - start
        for i in range(n_pivots):
            row, size = 0.0, 0.0
            for j in range(n_pivots):
                product = values[at + j] * y[first + j]
                row += product
                size += abs(product)
            at += n_pivots
            for j in range(n_boundary):
                product = values[at + j] * y[boundary[start + j]]
                row += product
                size += abs(product)
            at += n_boundary
            residual[first + i] -= row
            scale[first + i] += size
        for i in range(n_boundary):
            row, size = 0.0, 0.0
            for j in range(n_pivots):
                product = values[at + j] * y[first + j]
                row += product
                size += abs(product)
            at += n_pivots
            residual[boundary[start + i]] -= row
            scale[boundary[start + i]] += size
    backward_error, largest_share = 0.0, 0.0
    for p in range(order.size):
        load = abs(b[order[p]])
        error = abs(residual[p]) / max(scale[p] + load, UNDERFLOW)
        if not error < np.inf:
            return np.inf, 0.0
        backward_error = max(backward_error, error)
        largest_share = max(largest_share, load / max(scale[p], UNDERFLOW))
    return backward_error, largest_share if largest_share > 0.0 else np.inf


@kernel
def solve_only(factors, b, y, x):
    """Call `solve_vector`."""
    order, block_ptr, boundary_ptr, boundary, front_ptr, _, _, _, fronts, swaps = unpack(factors, FACTORS)
    solve_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x)


@kernel
def solve_and_check(factors, vectors, b, x, values):
    """Call `solve_vector`, then `check_vector`, with the workspaces in ``vectors``."""
    order, block_ptr, boundary_ptr, boundary, front_ptr, _, _, _, fronts, swaps = unpack(factors, FACTORS)
    y, residual, scale = unpack(vectors, VECTORS)
    solve_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x)
    return check_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, values, y, residual, scale)


@kernel
def factor_and_solve(factors, vectors, values, b, x):
    """Call `factor`, then `solve_and_check`.

    Returns
    -------
    growth, backward_error, significance : float
        As they do; where the growth is infinite nothing is solved.
    """
    growth = factor(factors, values)
    if growth == np.inf:
        return growth, np.inf, 0.0
    error, significance = solve_and_check(factors, vectors, b, x, values)
    return growth, error, significance
