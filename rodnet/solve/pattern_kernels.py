"""Compiled search for the sparsity pattern of a sum of stencil matrices."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel


@kernel
def find_touching(stencil_ptr, dofs, n):
    """For every degree of freedom (DOF) the stencils that hold it, as ``(ptr, stencils)``.

    ``dofs[stencil_ptr[s]:stencil_ptr[s + 1]]`` are those of stencil s; negative ones do not count.
    """
    ptr = np.zeros(n + 1, np.int64)
    for k in range(dofs.size):
        if dofs[k] >= 0:
            ptr[dofs[k] + 1] += 1
    for i in range(n):
        ptr[i + 1] += ptr[i]
    stencils = np.empty(ptr[n], np.int32)
    end = ptr[:n].copy()
    for s in range(stencil_ptr.size - 1):
        for k in range(stencil_ptr[s], stencil_ptr[s + 1]):
            if dofs[k] >= 0:
                stencils[end[dofs[k]]] = s
                end[dofs[k]] += 1
    return ptr, stencils


@kernel
def find_columns(stencil_ptr, dofs, touch_ptr, touching, n):
    """Sorted distinct rows of every column, the diagonal included, as CSC or, the pattern being symmetric, CSR."""
    indptr = np.zeros(n + 1, np.int32)
    indices = np.empty(0, np.int32)
    for filling in range(2):
        seen = np.full(n, -1, np.int32)
        end = 0
        for c in range(n):
            start = end
            seen[c] = c
            if filling:
                indices[end] = c
            end += 1
            for t in range(touch_ptr[c], touch_ptr[c + 1]):
                s = touching[t]
                for k in range(stencil_ptr[s], stencil_ptr[s + 1]):
                    r = dofs[k]
                    if r >= 0 and seen[r] != c:
                        seen[r] = c
                        if filling:
                            indices[end] = r
                        end += 1
            if filling:
                indices[start:end].sort()
            indptr[c + 1] = end
        if not filling:
            indices = np.empty(end, np.int32)
    return indptr, indices


@kernel
def find_sorted(values, low, high, value):
    """Index of the first of ``values[low:high]``, which rise, that is not below ``value``."""
    while low < high:
        middle = (low + high) // 2
        if values[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def find_places(indptr, indices, storage, rows, columns):
    """Places of the entries (rows[m, a], columns[m, b]), shape (m, a, b).

    ``storage`` gives the place of each entry of the CSR pattern, and of what is eliminated (negative
    rows or columns) as its last element. Every entry must be in the pattern.
    """
    places = np.empty((rows.shape[0], rows.shape[1], columns.shape[1]), np.int32)
    for m in range(rows.shape[0]):
        for a in range(rows.shape[1]):
            r = rows[m, a]
            for b in range(columns.shape[1]):
                c = columns[m, b]
                if r < 0 or c < 0:
                    places[m, a, b] = storage[-1]
                    continue
                places[m, a, b] = storage[find_sorted(indices, indptr[r], indptr[r + 1], c)]
    return places
