"""Compiled kernels of the tree LU: arrays only.

Conventions. *Position* means place in the elimination order; block b holds the positions
``block_ptr[b]`` to ``block_ptr[b + 1]``, its pivots. Its *boundary* is the sorted list of later
positions that its pivots are coupled to once all earlier blocks are eliminated. Its *front* is the dense
square matrix over pivots followed by boundary, row-major, stored in ``fronts`` from ``front_ptr[b]``.
After factorisation the front holds L below the diagonal (unit diagonal not stored), U above it, the
reciprocals of U's diagonal on it, and, over boundary x boundary, what has been passed to the parent.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import inlined, kernel

# A sum of products smaller than this has lost digits to underflow: no relative error is asked of it.
_UNDERFLOW = np.finfo(np.float64).tiny / np.finfo(np.float64).eps


@kernel
def find_boundaries(indptr, indices, block_ptr, order, position, block_of):
    """Boundary of every block, fill included, and the elimination tree.

    Parameters
    ----------
    indptr, indices : ndarray of int32, shapes (n + 1,), (nnz,)
        Structurally symmetric CSC pattern.
    block_ptr : ndarray of int64, shape (m + 1,)
    order, position, block_of : ndarray of int64, shape (n,)
        DOF at each position, position of each DOF, block of each position.

    Returns
    -------
    boundary_ptr : ndarray of int64, shape (m + 1,)
    boundary : ndarray of int64, shape (boundary_ptr[m],)
        Positions, sorted within each block.
    parent : ndarray of int64, shape (m,)
        Block that receives the Schur complement, -1 if the boundary is empty.
    """
    m = block_ptr.size - 1
    boundary_ptr = np.zeros(m + 1, np.int64)
    boundary = np.empty(indices.size, np.int64)
    parent = np.full(m, -1, np.int64)
    youngest_child = np.full(m, -1, np.int64)
    next_sibling = np.full(m, -1, np.int64)
    seen_by = np.full(order.size, -1, np.int64)
    end = 0
    for b in range(m):
        start = end
        first, last = block_ptr[b], block_ptr[b + 1]

        candidates = 0
        for p in range(first, last):
            candidates += indptr[order[p] + 1] - indptr[order[p]]
        child = youngest_child[b]
        while child >= 0:
            candidates += boundary_ptr[child + 1] - boundary_ptr[child]
            child = next_sibling[child]
        if start + candidates > boundary.size:
            larger = np.empty(2 * (start + candidates), np.int64)
            larger[:start] = boundary[:start]
            boundary = larger

        for p in range(first, last):
            for entry in range(indptr[order[p]], indptr[order[p] + 1]):
                q = position[indices[entry]]
                if q >= last and seen_by[q] != b:
                    seen_by[q] = b
                    boundary[end] = q
                    end += 1
        child = youngest_child[b]
        while child >= 0:
            for i in range(boundary_ptr[child], boundary_ptr[child + 1]):
                q = boundary[i]
                if q >= last and seen_by[q] != b:
                    seen_by[q] = b
                    boundary[end] = q
                    end += 1
            child = next_sibling[child]

        boundary_ptr[b + 1] = end
        if end > start:
            boundary[start:end].sort()
            parent[b] = block_of[boundary[start]]
            next_sibling[b] = youngest_child[parent[b]]
            youngest_child[parent[b]] = b
    return boundary_ptr, boundary[:end].copy(), parent


@kernel
def place_in_front(q, b, block_ptr, boundary_ptr, boundary):
    """Row of position `q` in the front of block `b`; `q` is one of its pivots or its boundary."""
    first, last = block_ptr[b], block_ptr[b + 1]
    if q < last:
        return q - first
    low, high = boundary_ptr[b], boundary_ptr[b + 1]
    while low < high:
        middle = (low + high) // 2
        if boundary[middle] < q:
            low = middle + 1
        else:
            high = middle
    return last - first + low - boundary_ptr[b]


@kernel
def place_entries(indptr, indices, position, block_of, block_ptr, boundary_ptr, boundary, front_ptr):
    """Place in ``fronts`` of every matrix entry, shape (nnz,): in the front that eliminates it."""
    place = np.empty(indices.size, np.int64)
    for column in range(indptr.size - 1):
        q = position[column]
        for entry in range(indptr[column], indptr[column + 1]):
            p = position[indices[entry]]
            b = block_of[min(p, q)]
            size = block_ptr[b + 1] - block_ptr[b] + boundary_ptr[b + 1] - boundary_ptr[b]
            i = place_in_front(p, b, block_ptr, boundary_ptr, boundary)
            j = place_in_front(q, b, block_ptr, boundary_ptr, boundary)
            place[entry] = front_ptr[b] + i * size + j
    return place


@kernel
def place_boundaries(parent, block_ptr, boundary_ptr, boundary):
    """Row in the parent's front of every boundary position, shape (len(boundary),)."""
    row = np.empty(boundary.size, np.int64)
    for b in range(parent.size):
        for i in range(boundary_ptr[b], boundary_ptr[b + 1]):
            row[i] = place_in_front(boundary[i], parent[b], block_ptr, boundary_ptr, boundary)
    return row


@kernel
def front_of(b, block_ptr, boundary_ptr, front_ptr, fronts):
    """Front of block `b`, a view of shape (size, size)."""
    size = block_ptr[b + 1] - block_ptr[b] + boundary_ptr[b + 1] - boundary_ptr[b]
    return fronts[front_ptr[b] : front_ptr[b + 1]].reshape(size, size)


@inlined
def _eliminate(fronts, base, size, n_pivots, swaps, first):
    """LU of the pivots of one front in place, with row exchanges among the pivots only.

    The front has ``size`` rows and starts at ``base``; the row exchanged with pivot k goes to
    ``swaps[first + k]``. Returns the largest multiplier, infinite if a pivot is zero or not finite. (A
    NaN anywhere in the matrix spreads along its row or column and ends up as a pivot, so looking at the
    pivots is enough.)
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
        pivot = fronts[row + k]
        if not 0.0 < abs(pivot) < np.inf:
            return np.inf
        reciprocal = 1.0 / pivot
        fronts[row + k] = reciprocal
        for i in range(k + 1, size):
            target = base + i * size
            multiplier = fronts[target + k] * reciprocal
            fronts[target + k] = multiplier
            growth = max(growth, abs(multiplier))
            for j in range(k + 1, size):
                fronts[target + j] -= multiplier * fronts[row + j]
    return growth


@inlined
def _eliminate_four(fronts, base, size, swaps, first):
    """Do what `_eliminate` does with four pivots: a node and the twist of its edge.

    All four columns of a row of the boundary are eliminated in one pass over it.
    """
    growth = 0.0
    r0, r1, r2 = base, base + size, base + 2 * size
    r3 = base + 3 * size
    for k in range(4):
        row = base + k * size
        best, largest = k, abs(fronts[row + k])
        for i in range(k + 1, 4):
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
        for i in range(k + 1, 4):
            target = base + i * size
            multiplier = fronts[target + k] * reciprocal
            fronts[target + k] = multiplier
            growth = max(growth, abs(multiplier))
            for j in range(k + 1, size):
                fronts[target + j] -= multiplier * fronts[row + j]
    d0, d1, d2, d3 = fronts[r0], fronts[r1 + 1], fronts[r2 + 2], fronts[r3 + 3]
    u01, u02, u03 = fronts[r0 + 1], fronts[r0 + 2], fronts[r0 + 3]
    u12, u13, u23 = fronts[r1 + 2], fronts[r1 + 3], fronts[r2 + 3]
    for i in range(4, size):
        row = base + i * size
        l0 = fronts[row] * d0
        l1 = (fronts[row + 1] - l0 * u01) * d1
        l2 = (fronts[row + 2] - l0 * u02 - l1 * u12) * d2
        l3 = (fronts[row + 3] - l0 * u03 - l1 * u13 - l2 * u23) * d3
        fronts[row], fronts[row + 1], fronts[row + 2], fronts[row + 3] = l0, l1, l2, l3
        growth = max(growth, abs(l0), abs(l1), abs(l2), abs(l3))
        for j in range(4, size):
            fronts[row + j] -= (
                l0 * fronts[r0 + j] + l1 * fronts[r1 + j] + l2 * fronts[r2 + j] + l3 * fronts[r3 + j]
            )
    return growth


@kernel
def factor(values, place, block_ptr, boundary_ptr, row_in_parent, parent, front_ptr, fronts, swaps):
    """Numeric factorisation: fills `fronts` and `swaps`, returns the growth (see `_eliminate`).

    Parameters
    ----------
    values : ndarray, shape (nnz,) or longer
        CSC values of the matrix.
    fronts : ndarray, shape (front_ptr[m],)
    swaps : ndarray of int64, shape (n,)
    """
    fronts[:] = 0.0
    for entry in range(place.size):
        fronts[place[entry]] = values[entry]
    growth = 0.0
    for b in range(parent.size):
        first, start = block_ptr[b], boundary_ptr[b]
        n_pivots, n_boundary = block_ptr[b + 1] - first, boundary_ptr[b + 1] - start
        base, size = front_ptr[b], n_pivots + n_boundary
        if n_pivots == 4 and size == 11:  # inside a rod; constants let the compiler unroll
            growth = max(growth, _eliminate_four(fronts, base, 11, swaps, first))
        else:
            growth = max(growth, _eliminate(fronts, base, size, n_pivots, swaps, first))
        if growth == np.inf:
            return growth
        if n_boundary == 0:
            continue
        above = parent[b]
        target, width = front_ptr[above], block_ptr[above + 1] - block_ptr[above]
        width += boundary_ptr[above + 1] - boundary_ptr[above]
        for i in range(n_boundary):
            to, source = target + row_in_parent[start + i] * width, base + (n_pivots + i) * size + n_pivots
            for j in range(n_boundary):
                fronts[to + row_in_parent[start + j]] += fronts[source + j]
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
            passed_on += fronts[base + (n_pivots + i) * size + k] * y[first + k]
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
        front = front_of(block, block_ptr, boundary_ptr, front_ptr, fronts)
        for k in range(n_pivots):
            if swaps[first + k] != k:
                other = y[first + swaps[first + k]]
                for column in range(y.shape[1]):
                    y[first + k, column], other[column] = other[column], y[first + k, column]
        for k in range(n_pivots):
            for i in range(k + 1, n_pivots):
                subtract_multiple(y[first + i], front[i, k], y[first + k])
            for i in range(n_boundary):
                subtract_multiple(y[boundary[start + i]], front[n_pivots + i, k], y[first + k])
    for block in range(n_blocks - 1, -1, -1):
        first, n_pivots = block_ptr[block], block_ptr[block + 1] - block_ptr[block]
        start, n_boundary = boundary_ptr[block], boundary_ptr[block + 1] - boundary_ptr[block]
        front = front_of(block, block_ptr, boundary_ptr, front_ptr, fronts)
        for k in range(n_pivots - 1, -1, -1):
            for j in range(n_boundary):
                subtract_multiple(y[first + k], front[k, n_pivots + j], y[boundary[start + j]])
            for j in range(k + 1, n_pivots):
                subtract_multiple(y[first + k], front[k, j], y[first + j])
            for column in range(y.shape[1]):
                y[first + k, column] *= front[k, k]
    for p in range(order.size):
        x[order[p]] = y[p]


@kernel
def subtract_multiple(target, factor, source):
    """``target -= factor * source``, all of shape (k,)."""
    for column in range(target.size):
        target[column] -= factor * source[column]


@kernel
def check_vector(indptr, indices, values, x, b, residual, scale):
    """Do what `check_solution` does for one right-hand side, all of shape (n,)."""
    n = b.size
    for i in range(n):
        residual[i] = b[i]
        scale[i] = 0.0
    for j in range(n):
        factor = x[j]
        for entry in range(indptr[j], indptr[j + 1]):
            product = values[entry] * factor
            residual[indices[entry]] -= product
            scale[indices[entry]] += abs(product)
    backward_error, largest_share = 0.0, 0.0
    for i in range(n):
        load = abs(b[i])
        error = abs(residual[i]) / max(scale[i] + load, _UNDERFLOW)
        if not error < np.inf:
            return np.inf, 0.0
        backward_error = max(backward_error, error)
        largest_share = max(largest_share, load / max(scale[i], _UNDERFLOW))
    return backward_error, largest_share if largest_share > 0.0 else np.inf


@kernel
def solve_and_check(
    b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x, indptr, indices, values,
    residual, scale,
):  # fmt: skip
    """Call `solve_vector`, then `check_vector`."""
    solve_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x)
    return check_vector(indptr, indices, values, x, b, residual, scale)


@kernel
def check_solution(indptr, indices, values, x, b, residual, scale):
    """How well `x` solves A x = b, row by row, hence whatever the units of the rows.

    Parameters
    ----------
    indptr, indices, values : ndarray, shapes (n + 1,), (nnz,), (nnz,)
        A in CSC form.
    x, b : ndarray, shape (n, k)
    residual, scale : ndarray, shape (n, k)
        Outputs: ``b - A x`` and ``|A| |x|``.

    Returns
    -------
    backward_error : float
        max |A x - b| / (|A| |x| + |b|) over rows and columns: the relative change of the
        coefficients of A and b that makes `x` exact (Oettli and Prager); infinite if not finite.
    significance : float
        Smallest over columns of max |b| / (|A| |x|) over rows. Where it is round-off, b has
        drowned in the cancellations of A x: x is a null vector of A to working precision.
    """
    n, n_columns = b.shape
    residual[:] = b
    scale[:] = 0.0
    for j in range(n):
        for entry in range(indptr[j], indptr[j + 1]):
            i = indices[entry]
            for column in range(n_columns):
                product = values[entry] * x[j, column]
                residual[i, column] -= product
                scale[i, column] += abs(product)
    backward_error, significance = 0.0, np.inf
    for column in range(n_columns):
        largest_share = 0.0
        for i in range(n):
            load, size = abs(b[i, column]), scale[i, column]
            error = abs(residual[i, column]) / max(size + load, _UNDERFLOW)
            if not error < np.inf:
                return np.inf, 0.0
            backward_error = max(backward_error, error)
            largest_share = max(largest_share, load / max(size, _UNDERFLOW))
        if largest_share > 0.0:
            significance = min(significance, largest_share)
    return backward_error, significance
