"""LU factorisation of matrices whose graph is a tree or has few loops, analysed once, refactored often."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix

from rodnet.solve.pattern import Pattern


class TreeLU:
    """Multifrontal LU of a structurally symmetric matrix in a given block order.

    Blocks of degrees of freedom (DOFs) are eliminated in order. Eliminating a block works on its *front*,
    a small dense matrix over the block and the later DOFs it is coupled to; what remains is added to
    the fronts of the later blocks that will eliminate it. On a rod a front has 4 pivots and
    7 others and nothing fills in, so the cost is linear in the number of nodes. Any order and any
    pattern is allowed: fill is found by the analysis.

    Rows are exchanged inside a block only. That is safe where the symmetric part of the matrix is
    positive definite enough; otherwise the growth returned by `factor` is large and the solution has
    to be checked (`rodnet.solve.linear.LinearSolver` does).

    Parameters
    ----------
    pattern : Pattern
        Pattern of the matrix.
    block_ptr : ndarray of int, shape (m + 1,)
        Start of each block in `block_dofs`.
    block_dofs : ndarray of int, shape (n,)
        The DOFs in elimination order, each exactly once.

    Attributes
    ----------
    n, n_blocks : int
        Numbers of DOFs and of blocks.
    front_sizes : ndarray of int, shape (m,)
        Rows of each front.
    factor_nnz : int
        Entries of L + U, zeros inside the fronts included.
    pattern : Pattern or None
        The pattern, with the places of its entries in the order of storage, that of the fronts.
    """

    def __init__(self, pattern: Pattern, block_ptr: np.ndarray, block_dofs: np.ndarray) -> None:
        from rodnet.packed import Packed
        from rodnet.solve import tree_lu_analysis as analysis
        from rodnet.solve import tree_lu_kernels as kernels

        block_ptr, order, position, block_of = _placed(pattern, block_ptr, block_dofs)
        n_pivots = np.diff(block_ptr)
        boundary_ptr, boundary, _ = analysis.find_boundaries(
            pattern.indptr, pattern.indices, block_ptr, order, position, block_of
        )
        n_boundary = np.diff(boundary_ptr)
        self.n, self.n_blocks = pattern.n, n_pivots.size
        self.front_sizes = n_pivots + n_boundary
        self.factor_nnz = int(np.sum(n_pivots * (n_pivots + 2 * n_boundary)))

        small = lambda a: a.astype(np.int32)  # noqa: E731
        front_ptr = np.concatenate([[0], np.cumsum(n_pivots * (n_pivots + 2 * n_boundary))])
        blocks = small(block_of), small(block_ptr), small(boundary_ptr), small(boundary), front_ptr
        ahead = analysis.find_regular(*blocks[:4])
        rest_ptr = np.concatenate([[0], np.cumsum(np.where(ahead[:, 0] < 0, n_boundary**2, 0))])
        storage, remainder = np.empty(pattern.nnz + 1, np.int32), np.empty(rest_ptr[-1], np.int32)
        analysis.place_entries(pattern.indptr, pattern.indices, small(position), *blocks, storage)
        storage[-1] = front_ptr[-1]
        self.pattern: Pattern | None = replace(pattern, storage=storage)
        analysis.place_remainders(rest_ptr, *blocks, remainder)
        self._fronts, self._swaps = np.zeros(front_ptr[-1]), np.zeros(pattern.n, dtype=np.int32)
        self._workspace = self._vector = np.empty(pattern.n)
        self._residual, self._scale = np.empty(pattern.n), np.empty(pattern.n)
        self._factors = small(order), *blocks[1:], self._fronts, self._swaps
        self._packed = Packed(
            kernels.FACTORS, *self._factors[:5], ahead, rest_ptr, remainder, self._fronts, self._swaps
        )
        self._table = self._packed.table
        self._factor, self._solve_only = kernels.factor, kernels.solve_only
        self._solve_and_check, self._solve_columns = kernels.solve_and_check, kernels.solve_columns
        self._vectors = Packed(kernels.VECTORS, self._vector, self._residual, self._scale)
        self._factor_and_solve = partial(kernels.factor_and_solve, self._table, self._vectors.table)

    def __repr__(self) -> str:
        return f"<TreeLU: {self.n} DOFs in {self.n_blocks} blocks, L + U has {self.factor_nnz} entries>"

    def factor(self, data: np.ndarray) -> float:
        """Factorise the matrix with the given values; the arrays of the last factorisation are reused.

        Parameters
        ----------
        data : ndarray, shape (factor_nnz,) or longer
            Values in the order of storage; trash, if present, is not read.

        Returns
        -------
        float
            Largest multiplier of the elimination. Infinite if a pivot is zero or not finite: `solve`
            must then not be called.
        """
        return self._factor(self._table, data)

    def factor_and_solve(
        self, values: np.ndarray, b: np.ndarray, x: np.ndarray
    ) -> tuple[float, float, float]:
        """`factor`, then `solve_and_check` unless the growth is infinite; growth and what the check says."""
        return self._factor_and_solve(values, b, x)

    def solve_and_check(self, b: np.ndarray, x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
        """Solve for one right-hand side into ``x`` and check the solution.

        Parameters
        ----------
        b, x : ndarray, shape (n,)
            Right-hand side and solution; contiguous floats.
        values : ndarray
            What was factorised.

        Returns
        -------
        tuple of float
            Backward error and significance (`rodnet.solve.tree_lu_kernels.check_vector`).
        """
        return self._solve_and_check(self._table, self._vectors.table, b, x, values)

    def refine(self, b: np.ndarray, x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
        """Improve the solution that `solve_and_check` has found and checked just before, with its arguments.

        Returns
        -------
        tuple of float
            Backward error and significance of the new one.
        """
        from rodnet.solve.tree_lu_kernels import check_vector

        order, remaining = self._factors[0], np.empty_like(b)
        remaining[order] = self._residual
        x += self.solve(remaining)
        return check_vector(b, *self._factors[:5], values, x[order], self._residual, self._scale)

    def matrix(self, data: np.ndarray) -> csr_matrix:
        """Return the matrix with the given values in the order of storage, shape (n, n)."""
        from rodnet.solve import tree_lu_analysis as analysis

        entries = analysis.list_entries(*self._factors[:4])
        return csr_matrix((data[: self.factor_nnz], entries), shape=(self.n, self.n))

    def solve(self, b: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Solve A x = b with the last factorisation.

        Parameters
        ----------
        b : ndarray, shape (n,) or (n, k)
            Right-hand sides; k columns together are much cheaper than one by one.
        out : ndarray of float, C-contiguous, the shape of `b`, optional
            Where to put the solution; may be `b` itself.

        Returns
        -------
        ndarray, the shape of `b`
        """
        b = np.ascontiguousarray(b, dtype=np.float64)
        if b.ndim not in (1, 2) or len(b) != self.n:
            raise ValueError(f"b must have shape ({self.n},) or ({self.n}, k), not {b.shape}")
        x = np.empty_like(b) if out is None else out
        if x.shape != b.shape:
            raise ValueError(f"out must have the shape of b, {b.shape}, not {x.shape}")
        if self._workspace.shape != b.shape:
            self._workspace = np.empty_like(b)
        if b.ndim == 1:
            self._solve_only(self._table, b, self._workspace, x)
        else:
            self._solve_columns(b, *self._factors, self._workspace, x)
        return x


def elimination_work(pattern: Pattern, block_ptr: np.ndarray, block_dofs: np.ndarray) -> float:
    """Multiplications, about, of a factorisation in the given block order (see `TreeLU`)."""
    from rodnet.solve.tree_lu_analysis import find_boundaries

    block_ptr, *order = _placed(pattern, block_ptr, block_dofs)
    boundary_ptr, _, _ = find_boundaries(pattern.indptr, pattern.indices, block_ptr, *order)
    n_pivots = np.diff(block_ptr)
    return float(np.sum(n_pivots * (n_pivots + np.diff(boundary_ptr)) ** 2.0))


def _placed(pattern: Pattern, block_ptr, block_dofs) -> tuple[np.ndarray, ...]:
    """Checked ``block_ptr`` and order, with the position and the block of each DOF and position."""
    block_ptr, order = np.array(block_ptr, dtype=np.int64), np.array(block_dofs, dtype=np.int64)
    n_pivots = np.diff(block_ptr)
    if not np.array_equal(np.sort(order), np.arange(pattern.n)):
        raise ValueError("the blocks must hold every degree of freedom exactly once")
    if block_ptr[0] != 0 or block_ptr[-1] != pattern.n or np.any(n_pivots <= 0):
        raise ValueError("block_ptr must rise strictly from 0 to the number of degrees of freedom")
    position = np.empty_like(order)
    position[order] = np.arange(pattern.n)
    return block_ptr, order, position, np.repeat(np.arange(n_pivots.size), n_pivots)
