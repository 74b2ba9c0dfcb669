"""Compiled solution for many right-hand sides with the factors of a `TreeLU`: each is read once for eight."""

from __future__ import annotations

from rodnet.tangent.wide_kernels import U, add, at, load, store, times, wide


@wide
def solve_wide(y, columns, block_ptr, boundary_ptr, boundary, front_ptr, fronts, swaps):
    """Solve in place for all columns of ``y``, shape (n * columns,), rows in the order of elimination.

    The number of columns must be a multiple of eight.
    """
    n_blocks, stride = block_ptr.size - 1, U(columns)
    for panel in range(columns // 8):
        c = U(8 * panel)
        for block in range(n_blocks):
            first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
            n_pivots = block_ptr[block + 1] - first
            n_boundary = boundary_ptr[block + 1] - start
            size = n_pivots + n_boundary
            for k in range(n_pivots):
                if swaps[first + k] != k:
                    one, other = at(first + k, stride, c), at(first + swaps[first + k], stride, c)
                    a = load(y, one)
                    store(y, one, load(y, other))
                    store(y, other, a)
            if n_pivots == 4:  # inside a rod: four rows stay in registers
                p = at(first, stride, c)
                y0, y1 = load(y, p), load(y, p + stride)
                y2, y3 = load(y, p + stride + stride), load(y, p + stride + stride + stride)
                row = base + size
                y1 = add(y1, -fronts[U(row)], y0)
                row += size
                y2 = add(add(y2, -fronts[U(row)], y0), -fronts[U(row + 1)], y1)
                row += size
                y3 = add(y3, -fronts[U(row)], y0)
                y3 = add(add(y3, -fronts[U(row + 1)], y1), -fronts[U(row + 2)], y2)
                store(y, p + stride, y1)
                store(y, p + stride + stride, y2)
                store(y, p + stride + stride + stride, y3)
                low = base + 4 * size
                for i in range(n_boundary):
                    o = at(boundary[U(start + i)], stride, c)
                    a = add(add(load(y, o), -fronts[U(low)], y0), -fronts[U(low + 1)], y1)
                    store(y, o, add(add(a, -fronts[U(low + 2)], y2), -fronts[U(low + 3)], y3))
                    low += 4
                continue
            for i in range(1, n_pivots):
                o = at(first + i, stride, c)
                a = load(y, o)
                for k in range(i):
                    a = add(a, -fronts[U(base + i * size + k)], load(y, at(first + k, stride, c)))
                store(y, o, a)
            low = base + n_pivots * size
            for i in range(n_boundary):
                o = at(boundary[U(start + i)], stride, c)
                a = load(y, o)
                for k in range(n_pivots):
                    a = add(a, -fronts[U(low + i * n_pivots + k)], load(y, at(first + k, stride, c)))
                store(y, o, a)
        for block in range(n_blocks - 1, -1, -1):
            first, start, base = block_ptr[block], boundary_ptr[block], front_ptr[block]
            n_pivots = block_ptr[block + 1] - first
            n_boundary = boundary_ptr[block + 1] - start
            if n_pivots == 4:
                size = 4 + n_boundary
                p = at(first, stride, c)
                y0, y1 = load(y, p), load(y, p + stride)
                y2, y3 = load(y, p + stride + stride), load(y, p + stride + stride + stride)
                for j in range(n_boundary):
                    a, row = load(y, at(boundary[U(start + j)], stride, c)), base + 4 + j
                    y0 = add(y0, -fronts[U(row)], a)
                    y1 = add(y1, -fronts[U(row + size)], a)
                    y2 = add(y2, -fronts[U(row + 2 * size)], a)
                    y3 = add(y3, -fronts[U(row + 3 * size)], a)
                row = base + 3 * size
                y3 = times(fronts[U(row + 3)], y3)
                row -= size
                y2 = times(fronts[U(row + 2)], add(y2, -fronts[U(row + 3)], y3))
                row -= size
                y1 = add(add(y1, -fronts[U(row + 2)], y2), -fronts[U(row + 3)], y3)
                y1 = times(fronts[U(row + 1)], y1)
                y0 = add(add(y0, -fronts[U(base + 1)], y1), -fronts[U(base + 2)], y2)
                store(y, p, times(fronts[U(base)], add(y0, -fronts[U(base + 3)], y3)))
                store(y, p + stride, y1)
                store(y, p + stride + stride, y2)
                store(y, p + stride + stride + stride, y3)
                continue
            for k in range(n_pivots - 1, -1, -1):
                row = base + k * (n_pivots + n_boundary)
                o = at(first + k, stride, c)
                a = load(y, o)
                for j in range(n_boundary):
                    f = fronts[U(row + n_pivots + j)]
                    a = add(a, -f, load(y, at(boundary[U(start + j)], stride, c)))
                for j in range(k + 1, n_pivots):
                    a = add(a, -fronts[U(row + j)], load(y, at(first + j, stride, c)))
                store(y, o, times(fronts[U(row + k)], a))
