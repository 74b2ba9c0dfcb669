"""The sparsity pattern of the Jacobian, and the order in which a tree is eliminated.

The graph is fixed, hence so is the pattern: both are found once. What remains for every Newton
iteration is to add small dense stencil matrices at precomputed places of one array of values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

TRASH = 3  # values behind the entries, for up to three rows of one column that are eliminated


@dataclass(frozen=True, eq=False)
class Pattern:
    """Sparsity pattern of a square matrix in CSC form.

    The pattern is structurally symmetric, has its whole diagonal, and its row indices are sorted
    within each column. An array of values that goes with it has ``nnz + TRASH`` entries: the last ones
    collect what falls on eliminated degrees of freedom and are never read.

    Attributes
    ----------
    n : int
        Number of degrees of freedom (DOFs).
    indptr : ndarray of int32, shape (n + 1,)
        Start of each column in `indices`.
    indices : ndarray of int32, shape (nnz,)
        Row of each entry.
    """

    n: int
    indptr: np.ndarray
    indices: np.ndarray

    @property
    def nnz(self) -> int:
        """Number of entries, and the first trash entry."""
        return self.indices.size

    @property
    def diagonal(self) -> np.ndarray:
        """Places of the diagonal entries, shape (n,)."""
        dofs = np.arange(self.n, dtype=np.int32)[:, None]
        return self.places(dofs)[:, 0, 0]

    def places(self, stencil: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
        """Find where the dense matrices of a stencil go in the values.

        Parameters
        ----------
        stencil : ndarray of int, shape (m, k)
            DOFs that each matrix couples, -1 where eliminated; one of those that made the pattern.
        rows : ndarray of int, shape (m, j), optional
            Only these of its rows.

        Returns
        -------
        ndarray of int32, shape (m, j, k)
            Place of the entry (row ``rows[i, a]``, column ``stencil[i, b]``), or `nnz` if either is eliminated.
        """
        from rodnet.solve.pattern_kernels import find_places

        columns = np.ascontiguousarray(stencil, dtype=np.int32)
        rows = columns if rows is None else np.ascontiguousarray(rows, dtype=np.int32)
        return find_places(self.indptr, self.indices, rows, columns, self.nnz)

    def triple_places(self, stencil: np.ndarray, triples: Sequence[int]) -> np.ndarray:
        """Find the places of rows that are the three positions of a node by the first of them.

        Positions of a node are numbered in sequence, or eliminated together. So their entries in one
        column follow each other, and one number stands for three.

        Parameters
        ----------
        stencil : ndarray of int, shape (m, k)
            As for `places`.
        triples : sequence of int
            Which columns of `stencil` are the first position of a node.

        Returns
        -------
        ndarray of int32, shape (m, len(triples), k)
        """
        for first in triples:
            x, y, z = stencil[:, first], stencil[:, first + 1], stencil[:, first + 2]
            together = np.where(x < 0, (y < 0) & (z < 0), (y == x + 1) & (z == x + 2))
            if not np.all(together):
                raise ValueError(
                    "the positions of a node must be numbered in sequence or eliminated together"
                )
        return self.places(stencil, stencil[:, list(triples)])


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
    return Pattern(n, *find_columns(stencil_ptr, dofs, touch_ptr, touching, n))


def elimination_blocks(
    edges: np.ndarray, node_dofs: np.ndarray, edge_dofs: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Order the degrees of freedom of a forest of rods from the tips to the roots.

    The block of a node holds its position and the twist of the edge towards the root: together
    these couple to nothing beyond the next two nodes on the way to the root, so eliminating them in
    this order causes no fill. Among the edges at a joint, the one towards the root and then those
    towards nodes of low number are eliminated last. A declared hub edge should therefore be one of
    these: if it goes before its siblings they fill in among themselves.

    Each tree is rooted at its terminal node of the lowest number. A robot is drawn from its body
    outwards, so this is as a rule the far end of the body, and its hub edges point to the root.

    Parameters
    ----------
    edges : ndarray of int, shape (E, 2)
        Nodes of each edge.
    node_dofs : ndarray of int, shape (N, 3)
        Position DOFs of each node, -1 where eliminated.
    edge_dofs : ndarray of int, shape (E,)
        Twist DOF of each edge, -1 where eliminated.

    Returns
    -------
    tuple of ndarray or None
        ``(block_ptr, block_dofs)``: block i is ``block_dofs[block_ptr[i]:block_ptr[i + 1]]``; no block is
        empty. None if the graph has a cycle.
    """
    edges = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    node_dofs = np.asarray(node_dofs, dtype=np.int64).reshape(-1, 3)
    edge_dofs = np.asarray(edge_dofs, dtype=np.int64)
    n_nodes, n_edges = len(node_dofs), len(edges)

    n_trees, tree = connected_components(_adjacency(n_nodes, edges), directed=False)
    if n_edges != n_nodes - n_trees:
        return None

    # One extra node, tied to the root of every tree, makes the forest a tree: one traversal for all.
    degree = np.bincount(edges.ravel(), minlength=n_nodes)
    terminals = np.flatnonzero(degree <= 1)
    roots = terminals[np.unique(tree[terminals], return_index=True)[1]]
    ties = np.column_stack([np.full(n_trees, n_nodes), roots])
    forest = _adjacency(n_nodes + 1, np.vstack([edges, ties]))
    order, towards_root = breadth_first_order(forest, n_nodes, directed=True)

    start, end = edges.T
    child = np.where(towards_root[start] == end, start, end)
    twist = np.full(n_nodes, -1, dtype=np.int64)
    twist[child] = edge_dofs

    dofs = np.column_stack([node_dofs, twist])[order[:0:-1]]
    kept = dofs >= 0
    sizes = kept.sum(axis=1)
    return np.concatenate([[0], np.cumsum(sizes[sizes > 0])]), dofs[kept]


def _adjacency(n_nodes: int, edges: np.ndarray) -> coo_array:
    """Symmetric adjacency matrix, shape (n_nodes, n_nodes), as a CSR array with sorted neighbours."""
    start, end = edges.T
    rows, columns = np.concatenate([start, end]), np.concatenate([end, start])
    adjacency = coo_array((np.ones(rows.size), (rows, columns)), shape=(n_nodes, n_nodes)).tocsr()
    adjacency.sort_indices()
    return adjacency
