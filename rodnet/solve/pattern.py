"""The sparsity pattern of the Jacobian, and where its entries are stored.

The graph is fixed, hence so is the pattern: both are found once. What remains for every Newton
iteration is to add small dense stencil matrices at precomputed places of one array of values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

TRASH = 3  # values behind the entries, for up to three columns of one row that are eliminated


@dataclass(frozen=True, eq=False)
class Pattern:
    """Sparsity pattern of a square matrix in CSR form, and where its entries are stored.

    The pattern is structurally symmetric, has its whole diagonal, and its column indices are sorted
    within each row. An array of values that goes with it has ``size + TRASH`` elements: the last ones
    collect what falls on eliminated degrees of freedom and are never read.

    Attributes
    ----------
    n : int
        Number of degrees of freedom (DOFs).
    indptr : ndarray of int32, shape (n + 1,)
        Start of each row in `indices`.
    indices : ndarray of int32, shape (nnz,)
        Column of each entry.
    storage : ndarray of int32, shape (nnz + 1,)
        Place of each entry among the values, then that of the first trash element: in CSR order as
        `build_pattern` leaves it, in another one where a solver stores them so.
    """

    n: int
    indptr: np.ndarray
    indices: np.ndarray
    storage: np.ndarray

    @property
    def nnz(self) -> int:
        """Number of entries."""
        return self.indices.size

    @property
    def size(self) -> int:
        """Number of values, without trash."""
        return int(self.storage[-1])

    @property
    def diagonal(self) -> np.ndarray:
        """Places of the diagonal entries, shape (n,)."""
        return self.places(np.arange(self.n, dtype=np.int32)[:, None])[:, 0, 0]

    def places(self, stencil: np.ndarray, columns: np.ndarray | None = None) -> np.ndarray:
        """Find where the dense matrices of a stencil go in the values.

        Parameters
        ----------
        stencil : ndarray of int, shape (m, k)
            DOFs that each matrix couples, -1 where eliminated; one of those that made the pattern.
        columns : ndarray of int, shape (m, j), optional
            Only these of its columns.

        Returns
        -------
        ndarray of int32, shape (m, k, j)
            Place of the entry (row ``stencil[i, a]``, column ``columns[i, b]``), or the trash if either is
            eliminated.
        """
        from rodnet.solve.pattern_kernels import find_places

        rows = np.ascontiguousarray(stencil, dtype=np.int32)
        columns = rows if columns is None else np.ascontiguousarray(columns, dtype=np.int32)
        return find_places(self.indptr, self.indices, self.storage, rows, columns)

    def triple_places(
        self, stencil: np.ndarray, triples: Sequence[int], rows: int | None = None
    ) -> np.ndarray:
        """Find the places of columns that are the three positions of a node by the first of them.

        Positions of a node are numbered in sequence or eliminated together, and stored next to each
        other in every row, so one number stands for three.

        Parameters
        ----------
        stencil : ndarray of int, shape (m, k)
            As for `places`.
        triples : sequence of int
            Which columns of `stencil` are the first position of a node.
        rows : int, optional
            Only so many of its first rows.

        Returns
        -------
        ndarray of int32, shape (m, rows, len(triples))
        """
        which = np.asarray(triples)
        first, last = (self.places(stencil[:, :rows], stencil[:, which + k]) for k in (0, 2))
        if np.any((last - first != 2) & ((last != self.size) | (first != self.size))):
            raise ValueError("the positions of a node must be numbered in sequence or eliminated together")
        return first

    def matrix(self, values: np.ndarray) -> csr_matrix:
        """Return the matrix with the given values, shape (n, n)."""
        ordered = values[self.storage[:-1]]
        return csr_matrix((ordered, self.indices.copy(), self.indptr.copy()), shape=(self.n, self.n))


def build_pattern(n: int, stencils: Sequence[np.ndarray]) -> Pattern:
    """Find the pattern of a sum of dense stencil matrices.

    Parameters
    ----------
    n : int
        Number of degrees of freedom.
    stencils : sequence of integer ndarray, each of shape (m, k)
        Each row lists the DOFs, in ``0..n-1``, that one dense k x k matrix couples; -1 marks an
        eliminated (constrained) DOF.

    Returns
    -------
    Pattern
    """
    from rodnet.solve.pattern_kernels import find_columns, find_touching

    sizes, flat = [np.zeros(1, dtype=np.int64)], [np.zeros(0, dtype=np.int32)]
    for stencil in stencils:
        stencil = np.asarray(stencil)
        if stencil.ndim != 2:
            raise ValueError(f"a stencil must have shape (m, k), not {stencil.shape}")
        if stencil.size and not (-1 <= stencil.min() and stencil.max() < n):
            raise ValueError(f"a stencil refers to a degree of freedom outside -1..{n - 1}")
        sizes.append(np.full(len(stencil), stencil.shape[1], dtype=np.int64))
        flat.append(stencil.astype(np.int32).ravel())
    stencil_ptr, dofs = np.cumsum(np.concatenate(sizes)), np.concatenate(flat)
    touch_ptr, touching = find_touching(stencil_ptr, dofs, n)
    indptr, indices = find_columns(stencil_ptr, dofs, touch_ptr, touching, n)
    return Pattern(n, indptr, indices, np.arange(indices.size + 1, dtype=np.int32))
