"""The linear solver of the Newton iteration: fast where that is safe, checked always."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, eye
from scipy.sparse.linalg import SuperLU, splu

from rodnet.errors import SingularMatrixError
from rodnet.solve.pattern import Pattern
from rodnet.solve.tree_lu import TreeLU

# Multipliers this large may have cost half of the digits: refine before believing the residual.
GROWTH_LIMIT = 1e8
# Relative error of the coefficients that a Newton step can bear without losing its convergence.
RESIDUAL_LIMIT = 1e-10
# Coefficients are sums of a few dozen rounded terms: below this, a pivot is round-off.
ROUND_OFF = 100 * np.finfo(np.float64).eps
# A sum of products smaller than this has lost digits to underflow: no relative error is asked of it.
TINY = np.finfo(np.float64).tiny / np.finfo(np.float64).eps


class LinearSolver:
    """Solve A x = b for many matrices of one pattern.

    With blocks (the graph is a tree or has few loops) the compiled `TreeLU` is used, which exchanges rows
    inside blocks only; without (grids), SuperLU in an order for symmetric patterns, which keeps to the
    diagonal. So each solution is checked, row by row and thus whatever the units, and refined once if in
    doubt. A matrix for which that is not enough (buckling, strongly skew drag) is factorised anew with
    full partial pivoting, and counted.

    An instance owns its work arrays: use one per thread.

    Parameters
    ----------
    pattern : Pattern
        Pattern of the matrices.
    blocks : tuple of ndarray or None
        ``(block_ptr, block_dofs)`` of `rodnet.solve.ordering`.

    Attributes
    ----------
    n, size : int
        Numbers of degrees of freedom and of stored values.
    pattern : Pattern or None
        The pattern, with the places of the entries in the order in which this solver wants the values.
        With blocks it may be set to None to save memory, once the places are known.
    extra : csr_matrix or None, shape (n, n)
        What the matrix has beside its pattern for the time being; with it, SuperLU takes over.
    factorizations, solves : int
        Calls of `factor` and of `solve`.
    fallbacks : int
        Matrices that elimination without full pivoting could not be trusted with.
    """

    def __init__(self, pattern: Pattern, blocks: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        self.factorizations = self.solves = self.fallbacks = 0
        self._tree = None if blocks is None else TreeLU(pattern, *blocks)
        self.pattern: Pattern | None = pattern
        if self._tree is not None:
            self.pattern, self._tree.pattern = self._tree.pattern, None
        assert self.pattern is not None
        self.n, self.size = pattern.n, self.pattern.size
        self.extra: csr_matrix | None = None
        self._whole: csr_matrix | None = None  # the matrix that was factorised with it
        self._quick: TreeLU | SuperLU | None = self._tree
        self._general: SuperLU | None = None
        self._growth = 0.0
        self._given = self._values = np.zeros(0)
        self._residual = np.empty((pattern.n, 0))
        self._plain = np.empty(0)  # a right-hand side that has been looked at

    def factor(self, data: np.ndarray) -> None:
        """Factorise the matrix with the given values.

        Parameters
        ----------
        data : ndarray, shape (size,) or longer
            Values at the places of ``pattern``; trash, if present, is not read. They are kept, not copied:
            as long as they stay what they are, solutions are checked against them (see `solve`).

        Raises
        ------
        SingularMatrixError
            The matrix has no inverse. (If it has one on paper only, `solve` raises the error.)
        """
        if data is not self._given:  # as a rule the same array, with new values
            self._given, self._values = data, data[: self.size]
        self.factorizations += 1
        self._general = self._whole = None
        if self._tree is not None and self.extra is None:
            self._quick, self._growth = self._tree, self._tree.factor(self._values)
            if self._growth == np.inf:
                self._fall_back()
            return
        self._growth, whole = 0.0, self.matrix()
        self._whole = whole if self.extra is not None else None
        self._refuse_what_is_not_finite()
        symmetric = {"SymmetricMode": True}
        try:
            self._quick = splu(
                whole.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric
            )
        except RuntimeError:  # a pivot is zero
            self._fall_back()

    def factor_and_solve(self, data: np.ndarray, b: np.ndarray) -> np.ndarray:
        """`factor`, then `solve` for ``b``, shape (n,): as a rule one kernel does it all."""
        tree = self._tree
        if tree is not None and self.extra is None and data is self._given and b is self._plain:
            self._quick, self._general, self._whole, x = tree, None, None, np.empty(self.n)
            self._growth, error, significance = tree.factor_and_solve(self._values, b, x)
            if self._growth <= GROWTH_LIMIT and error <= RESIDUAL_LIMIT and significance > ROUND_OFF:
                self.factorizations += 1
                self.solves += 1
                return x
        self.factor(data)  # the first time, or in doubt
        return self.solve(b)

    def solve(self, b: np.ndarray, check: bool = True) -> np.ndarray:
        """Solve A x = b with the last factorised matrix.

        Parameters
        ----------
        b : ndarray, shape (n,) or (n, k)
            Right-hand sides.
        check : bool
            Check the solution. False where the values given to `factor` have been overwritten since, or
            where the solution is but a guess.

        Returns
        -------
        ndarray, the shape of `b`

        Raises
        ------
        SingularMatrixError
            The matrix is singular to working precision.
        """
        if b is not self._plain:  # as a rule the same array, with new values
            b = self._plain = np.ascontiguousarray(b, dtype=np.float64)
        self.solves += 1
        if not check:
            x = (self._general or self._quick).solve(b)  # type: ignore[union-attr]
            return x if x.flags.c_contiguous else np.ascontiguousarray(x)
        if self._general is None:
            if self._quick is self._tree is not None and b.ndim == 1 and self._growth <= GROWTH_LIMIT:
                x = np.empty_like(b)
                error, significance = self._tree.solve_and_check(b, x, self._values)
                if RESIDUAL_LIMIT < error < np.inf:
                    error, significance = self._tree.refine(b, x, self._values)
                if error <= RESIDUAL_LIMIT and significance > ROUND_OFF:
                    return x
            x, error, significance = self._solve_refined(self._quick, b, self._growth > GROWTH_LIMIT)
            if error <= RESIDUAL_LIMIT and significance > ROUND_OFF:
                return x
            self._fall_back()
        x, error, significance = self._solve_refined(self._general, b)
        if error == np.inf or significance <= ROUND_OFF:
            self._raise_singular()
        return x

    def _solve_refined(
        self, solver: TreeLU | SuperLU, b: np.ndarray, doubtful: bool = False
    ) -> tuple[np.ndarray, float, float]:
        """Solution, backward error and significance, with a step of iterative refinement if in doubt."""
        x = np.ascontiguousarray(solver.solve(b))
        error, significance = self._check(x, b)
        if doubtful or RESIDUAL_LIMIT < error < np.inf:
            x += solver.solve(self._residual.reshape(b.shape))
            error, significance = self._check(x, b)
        return x, error, significance

    def _check(self, x: np.ndarray, b: np.ndarray) -> tuple[float, float]:
        """Backward error and significance of a solution; leaves b - A x in ``_residual``.

        See `rodnet.solve.tree_lu_kernels.check_vector`; over all columns, the worst.
        """
        A, load = self.matrix() if self._whole is None else self._whole, np.abs(b)
        if not np.all(np.isfinite(x)):
            return np.inf, 0.0
        self._residual = b - A @ x
        scale = abs(A) @ np.abs(x)
        error = np.max(np.abs(self._residual) / np.maximum(scale + load, TINY), initial=0.0)
        share = np.max(load / np.maximum(scale, TINY), axis=0, initial=0.0)
        return float(error), float(np.min(share, where=share > 0.0, initial=np.inf))

    def matrix(self, data: np.ndarray | None = None) -> csr_matrix:
        """Return the matrix with the given values, or with those given to `factor`, shape (n, n)."""
        values = self._values if data is None else data[: self.size]
        if self._tree is not None:
            A = self._tree.matrix(values)
        else:
            assert self.pattern is not None
            A = self.pattern.matrix(values)
        return A if self.extra is None else A + self.extra

    def _fall_back(self) -> None:
        """Factorise with full partial pivoting the matrix that the quick elimination failed on."""
        self.fallbacks += 1
        self._refuse_what_is_not_finite()
        try:
            self._general = splu(self.matrix().tocsc(), permc_spec="COLAMD")
        except RuntimeError:  # SuperLU met a column without any pivot
            self._raise_singular()

    def _refuse_what_is_not_finite(self) -> None:
        finite = np.isfinite(self._values)
        if not finite.all():
            A = self.matrix().tocoo()
            dof = int(A.row[np.argmin(np.isfinite(A.data))])
            raise SingularMatrixError(f"the matrix is not finite in the row of degree of freedom {dof}", dof)

    def _raise_singular(self) -> NoReturn:
        dof = self._weakest_dof()
        where = "" if dof is None else f" (degree of freedom {dof} moves most)"
        raise SingularMatrixError(
            f"the matrix is singular to working precision: some motion meets no resistance{where}. "
            "Common causes are a part that nothing holds in a static problem, a part without stiffness, "
            "mass or drag, and a buckling point. Hold or damp it, or take a smaller step.",
            dof,
        )

    def _weakest_dof(self) -> int | None:
        """Largest component of the null vector, found by inverse iteration; None if that fails too."""
        shift = np.finfo(np.float64).eps * np.abs(self._values).max()
        if shift == 0.0:
            return 0
        try:
            nearby = splu(csc_matrix(self.matrix() + shift * eye(self.n)))
        except RuntimeError:
            return None
        x = np.ones(self.n)
        for _ in range(3):  # each gains the ratio of the two smallest singular values, here huge
            x = nearby.solve(x)
            size = np.abs(x).max()
            if not 0.0 < size < np.inf:
                return None
            x /= size
        return int(np.argmax(np.abs(x)))
