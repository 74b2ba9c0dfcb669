"""Compiled analysis of a matrix's pattern for the tree LU: fill, and where every number goes.

The conventions are those of `rodnet.solve.tree_lu_kernels`.
"""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.solve.pattern_kernels import find_sorted


@kernel
def find_boundaries(indptr, indices, block_ptr, order, position, block_of):
    """Boundary of every block, fill included, and the elimination tree.

    Parameters
    ----------
    indptr, indices : ndarray of int32, shapes (n + 1,), (nnz,)
        Structurally symmetric pattern.
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
    start = boundary_ptr[b]
    return last - first + find_sorted(boundary, start, boundary_ptr[b + 1], q) - start


@kernel
def place_entry(p, q, block_of, block_ptr, boundary_ptr, boundary, front_ptr):
    """Place in ``fronts`` of the entry in row position `p` and column position `q`."""
    b = block_of[min(p, q)]
    n_pivots = block_ptr[b + 1] - block_ptr[b]
    size = n_pivots + boundary_ptr[b + 1] - boundary_ptr[b]
    i = place_in_front(p, b, block_ptr, boundary_ptr, boundary)
    j = place_in_front(q, b, block_ptr, boundary_ptr, boundary)
    if i < n_pivots:
        return front_ptr[b] + i * size + j
    return front_ptr[b] + n_pivots * size + (i - n_pivots) * n_pivots + j


@kernel
def place_entries(indptr, indices, position, block_of, block_ptr, boundary_ptr, boundary, front_ptr, place):
    """Find the place in ``fronts`` of every matrix entry, shape (nnz,): in the front that eliminates it."""
    for row in range(indptr.size - 1):
        p = position[row]
        for entry in range(indptr[row], indptr[row + 1]):
            q = position[indices[entry]]
            place[entry] = place_entry(p, q, block_of, block_ptr, boundary_ptr, boundary, front_ptr)


@kernel
def find_regular(block_of, block_ptr, boundary_ptr, boundary):
    """Find the blocks inside rods: the next two blocks of each, shape (m, 2), or -1 for any other.

    The four pivots of such a block are coupled to the four of the next one and to the first three, the
    position, of the one after, which come first in the next one's boundary. So what is left goes to
    rows without gaps.
    """
    ahead = np.full((block_ptr.size - 1, 2), -1, np.int32)
    for b in range(block_ptr.size - 1):
        start = boundary_ptr[b]
        if block_ptr[b + 1] - block_ptr[b] != 4 or boundary_ptr[b + 1] - start != 7:
            continue
        first, second = block_of[boundary[start]], block_of[boundary[start + 4]]
        following = boundary_ptr[first]
        if block_ptr[first + 1] - block_ptr[first] != 4 or boundary_ptr[first + 1] - following < 3:
            continue
        regular = second > first
        for i in range(4):
            regular = regular and boundary[start + i] == block_ptr[first] + i
        for i in range(3):
            q = block_ptr[second] + i
            regular = regular and boundary[start + 4 + i] == q and boundary[following + i] == q
        if regular and block_ptr[second + 1] - block_ptr[second] >= 3:
            ahead[b, 0], ahead[b, 1] = first, second
    return ahead


@kernel
def place_remainders(rest_ptr, block_of, block_ptr, boundary_ptr, boundary, front_ptr, place):
    """Find the place of what each block leaves over boundary x boundary, row-major from ``rest_ptr[b]``.

    Blocks without room in ``place`` are skipped.
    """
    for b in range(block_ptr.size - 1):
        at = rest_ptr[b]
        if rest_ptr[b + 1] == at:
            continue
        for i in range(boundary_ptr[b], boundary_ptr[b + 1]):
            for j in range(boundary_ptr[b], boundary_ptr[b + 1]):
                place[at] = place_entry(
                    boundary[i], boundary[j], block_of, block_ptr, boundary_ptr, boundary, front_ptr
                )
                at += 1


@kernel
def list_entries(order, block_ptr, boundary_ptr, boundary):
    """Row and column of everything that fronts store, in the order of storage."""
    size = 0
    for b in range(block_ptr.size - 1):
        n_pivots, n_boundary = block_ptr[b + 1] - block_ptr[b], boundary_ptr[b + 1] - boundary_ptr[b]
        size += n_pivots * (n_pivots + 2 * n_boundary)
    rows, columns = np.empty(size, np.int32), np.empty(size, np.int32)
    at = 0
    for b in range(block_ptr.size - 1):
        first, last = block_ptr[b], block_ptr[b + 1]
        start, end = boundary_ptr[b], boundary_ptr[b + 1]
        for p in range(first, last):
            for q in range(first, last):
                rows[at], columns[at] = order[p], order[q]
                at += 1
            for j in range(start, end):
                rows[at], columns[at] = order[p], order[boundary[j]]
                at += 1
        for i in range(start, end):
            for q in range(first, last):
                rows[at], columns[at] = order[boundary[i]], order[q]
                at += 1
    return rows, columns
