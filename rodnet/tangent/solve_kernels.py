"""Compiled solution for many right-hand sides with the factors of a `TreeLU`: each is read once for eight."""

from __future__ import annotations

from rodnet.compiled import kernel
from rodnet.tangent.wide_kernels import U, add, at, load, store, times


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
                    one, other = at(first + k, wide, c), at(first + swaps[first + k], wide, c)
                    a = load(y, one)
                    store(y, one, load(y, other))
                    store(y, other, a)
            for i in range(1, n_pivots):
                o = at(first + i, wide, c)
                a = load(y, o)
                for k in range(i):
                    a = add(a, -fronts[U(base + i * size + k)], load(y, at(first + k, wide, c)))
                store(y, o, a)
            low = base + n_pivots * size
            for i in range(n_boundary):
                o = at(boundary[U(start + i)], wide, c)
                a = load(y, o)
                for k in range(n_pivots):
                    a = add(a, -fronts[U(low + i * n_pivots + k)], load(y, at(first + k, wide, c)))
                store(y, o, a)
        for block in range(n_blocks - 1, -1, -1):
            first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
            n_pivots = block_ptr[block + 1] - first
            n_boundary = boundary_ptr[block + 1] - start
            for k in range(n_pivots - 1, -1, -1):
                row = base + k * (n_pivots + n_boundary)
                o = at(first + k, wide, c)
                a = load(y, o)
                for j in range(n_boundary):
                    f = fronts[U(row + n_pivots + j)]
                    a = add(a, -f, load(y, at(boundary[U(start + j)], wide, c)))
                for j in range(k + 1, n_pivots):
                    a = add(a, -fronts[U(row + j)], load(y, at(first + j, wide, c)))
                store(y, o, times(fronts[U(row + k)], a))
