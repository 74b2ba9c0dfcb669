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

from rodnet.compiled import kernel

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


@kernel
def eliminate(front, n_pivots, swaps):
    """LU of the pivots of one front in place, with row exchanges among the pivots only.

    Parameters
    ----------
    front : ndarray, shape (size, size)
    n_pivots : int
    swaps : ndarray of int64, shape (n_pivots,)
        Output: the row exchanged with each pivot row.

    Returns
    -------
    float
        Largest multiplier, infinite if a pivot is zero or not finite. (A NaN anywhere in the matrix
        spreads along its row or column and ends up as a pivot, so looking at the pivots is enough.)
    """
    size = front.shape[0]
    growth = 0.0
    for k in range(n_pivots):
        best = k
        for i in range(k + 1, n_pivots):
            if abs(front[i, k]) > abs(front[best, k]):
                best = i
        swaps[k] = best
        if best != k:
            for j in range(size):
                front[k, j], front[best, j] = front[best, j], front[k, j]
        if not 0.0 < abs(front[k, k]) < np.inf:
            return np.inf
        reciprocal = 1.0 / front[k, k]
        front[k, k] = reciprocal
        for i in range(k + 1, size):
            multiplier = front[i, k] * reciprocal
            front[i, k] = multiplier
            growth = max(growth, abs(multiplier))
            for j in range(k + 1, size):
                front[i, j] -= multiplier * front[k, j]
    return growth


@kernel
def factor(values, place, block_ptr, boundary_ptr, row_in_parent, parent, front_ptr, fronts, swaps):
    """Numeric factorisation: fills `fronts` and `swaps`, returns the growth as `eliminate` does.

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
        first, last = block_ptr[b], block_ptr[b + 1]
        start, end = boundary_ptr[b], boundary_ptr[b + 1]
        n_pivots = last - first
        front = front_of(b, block_ptr, boundary_ptr, front_ptr, fronts)
        growth = max(growth, eliminate(front, n_pivots, swaps[first:last]))
        if growth == np.inf:
            return growth
        if end == start:
            continue
        target = front_of(parent[b], block_ptr, boundary_ptr, front_ptr, fronts)
        for i in range(end - start):
            target_row = target[row_in_parent[start + i]]
            for j in range(end - start):
                target_row[row_in_parent[start + j]] += front[n_pivots + i, n_pivots + j]
    return growth


@kernel
def solve_vector(b, order, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps, y, x):
    """Solve for one right-hand side `b`, shape (n,), into `x`, with the workspace `y`, shape (n,)."""
    for p in range(order.size):
        y[p] = b[order[p]]
    n_blocks = block_ptr.size - 1
    for block in range(n_blocks):
        first, n_pivots = block_ptr[block], block_ptr[block + 1] - block_ptr[block]
        start, n_boundary = boundary_ptr[block], boundary_ptr[block + 1] - boundary_ptr[block]
        front = front_of(block, block_ptr, boundary_ptr, front_ptr, fronts)
        for k in range(n_pivots):
            other = first + swaps[first + k]
            y[first + k], y[other] = y[other], y[first + k]
        for i in range(1, n_pivots):
            for k in range(i):
                y[first + i] -= front[i, k] * y[first + k]
        for i in range(n_boundary):
            passed_on = 0.0
            for k in range(n_pivots):
                passed_on += front[n_pivots + i, k] * y[first + k]
            y[boundary[start + i]] -= passed_on
    for block in range(n_blocks - 1, -1, -1):
        first, n_pivots = block_ptr[block], block_ptr[block + 1] - block_ptr[block]
        start, n_boundary = boundary_ptr[block], boundary_ptr[block + 1] - boundary_ptr[block]
        front = front_of(block, block_ptr, boundary_ptr, front_ptr, fronts)
        for k in range(n_pivots - 1, -1, -1):
            known = 0.0
            for j in range(n_boundary):
                known += front[k, n_pivots + j] * y[boundary[start + j]]
            for j in range(k + 1, n_pivots):
                known += front[k, j] * y[first + j]
            y[first + k] = (y[first + k] - known) * front[k, k]
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
            if n_columns == 1:  # the common case, at half the cost of a loop over one column
                product = values[entry] * x[j, 0]
                residual[i, 0] -= product
                scale[i, 0] += abs(product)
            else:
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
