"""The order in which degrees of freedom are eliminated: from the tips to the root, and round loops.

Every order comes as blocks, one per node: its position, and the twists of those of its edges whose other
ends are eliminated later.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, depth_first_order
from scipy.sparse.linalg import splu

from rodnet.solve.pattern import Pattern
from rodnet.solve.tree_lu import elimination_work

# multiplications per degree of freedom, from which on a general solver is faster (121 inside a rod)
COSTLY = 4000.0

Blocks = tuple[np.ndarray, np.ndarray]


def elimination_blocks(edges: np.ndarray, node_dofs: np.ndarray, edge_dofs: np.ndarray) -> Blocks | None:
    """Order the degrees of freedom of a forest of rods from the tips to the roots.

    The block of a node holds its position and the twist of the edge towards the root: together
    these couple to nothing beyond the next two nodes on the way to the root, so eliminating them in
    this order causes no fill. Among the edges at a joint, the one towards the root and then those
    towards nodes of low number are eliminated last. A declared hub edge should therefore be one of
    these: if it goes before its siblings they fill in among themselves. Each branch is one piece of the
    order, hence of memory.

    Each tree is rooted at its terminal node of the lowest number. A robot is drawn from its body
    outwards, so this is as a rule the far end of the body, and its hub edges point to the root.

    Parameters
    ----------
    edges : ndarray of int, shape (E, 2)
        Nodes of each edge.
    node_dofs : ndarray of int, shape (N, 3) or (N, 6)
        Position DOFs of each node, and the rotations of a rigid body that it stands for; -1 where eliminated.
    edge_dofs : ndarray of int, shape (E,)
        Twist DOF of each edge, -1 where eliminated.

    Returns
    -------
    tuple of ndarray or None
        ``(block_ptr, block_dofs)``: block i is ``block_dofs[block_ptr[i]:block_ptr[i + 1]]``; no block is
        empty. None if the graph has a cycle.
    """
    edges, node_dofs, edge_dofs = _as_arrays(edges, node_dofs, edge_dofs)
    n_nodes = len(node_dofs)

    neighbours = _adjacency(n_nodes, edges)
    n_trees, tree = connected_components(neighbours, directed=False)
    if neighbours.nnz != 2 * (n_nodes - n_trees):  # parallel edges, the bodies of a hinge, are no loop
        return None

    # One extra node, tied to the root of every tree, makes the forest a tree: one traversal for all.
    terminals = np.flatnonzero(np.diff(neighbours.indptr) <= 1)  # a hinge's parallel edges count once
    roots = terminals[np.unique(tree[terminals], return_index=True)[1]]
    ties = np.column_stack([np.full(n_trees, n_nodes), roots])
    forest = _adjacency(n_nodes + 1, np.vstack([edges, ties]))
    order, _ = depth_first_order(forest, n_nodes, directed=True)
    return _blocks(order[:0:-1], edges, node_dofs, edge_dofs)


def loop_blocks(
    pattern: Pattern, edges: np.ndarray, node_dofs: np.ndarray, edge_dofs: np.ndarray
) -> Blocks | None:
    """Order the degrees of freedom of any graph of rods by minimum degree of its nodes.

    Branches come first as in a tree, then what is left of loops. Parameters and blocks are those of
    `elimination_blocks`, and the pattern of the matrix. None if fill makes blocks costly: wide grids are for a
    general solver, while rings, ladders and trees with some loops are not.
    """
    edges, node_dofs, edge_dofs = _as_arrays(edges, node_dofs, edge_dofs)
    held = np.all(node_dofs < 0, axis=1)
    free = np.flatnonzero(~held)
    order = np.concatenate(
        [np.flatnonzero(held), free[_minimum_degree(pattern, node_dofs[free].max(axis=1))]]
    )
    blocks = _blocks(order, edges, node_dofs, edge_dofs)
    return blocks if elimination_work(pattern, *blocks) <= COSTLY * pattern.n else None


def _minimum_degree(pattern: Pattern, dofs: np.ndarray) -> np.ndarray:
    """Order of elimination of some of the degrees of freedom by minimum degree, shape (n,)."""
    if len(dofs) < 3:
        return np.arange(len(dofs))
    whole = csr_matrix(
        (np.ones(pattern.nnz), pattern.indices.copy(), pattern.indptr.copy()), shape=(pattern.n, pattern.n)
    )
    couplings = csc_matrix(whole[dofs][:, dofs])
    couplings.sort_indices()
    # the library orders what it factorises: a diagonally dominant matrix of the same pattern
    dominant = csc_matrix(
        couplings + coo_array((1.0 + np.diff(couplings.indptr), [np.arange(len(dofs))] * 2))
    )
    symmetric = {"SymmetricMode": True}
    lu = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    return np.argsort(lu.perm_c)


def _blocks(order: np.ndarray, edges: np.ndarray, node_dofs: np.ndarray, edge_dofs: np.ndarray) -> Blocks:
    """Blocks of the nodes in the given order, each with the twists of edges towards later nodes."""
    n_nodes = len(node_dofs)
    place = np.empty(n_nodes, dtype=np.int64)
    place[order] = np.arange(n_nodes)
    # sort all degrees of freedom by the node that they go with, positions before twists
    owner = np.concatenate([np.repeat(place, node_dofs.shape[1]), place[edges].min(axis=1)])
    dofs = np.concatenate([node_dofs.ravel(), edge_dofs])
    kept = dofs >= 0
    owner, dofs = owner[kept], dofs[kept]
    sizes = np.bincount(owner, minlength=n_nodes)
    return np.concatenate([[0], np.cumsum(sizes[sizes > 0])]), dofs[np.argsort(owner, kind="stable")]


def _as_arrays(edges, node_dofs, edge_dofs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        np.asarray(edges, dtype=np.int64).reshape(-1, 2),
        np.asarray(node_dofs, dtype=np.int64),
        np.asarray(edge_dofs, dtype=np.int64),
    )


def _adjacency(n_nodes: int, edges: np.ndarray) -> coo_array:
    """Symmetric adjacency matrix, shape (n_nodes, n_nodes), as a CSR array with sorted neighbours."""
    start, end = edges.T
    rows, columns = np.concatenate([start, end]), np.concatenate([end, start])
    adjacency = coo_array((np.ones(rows.size), (rows, columns)), shape=(n_nodes, n_nodes)).tocsr()
    adjacency.sort_indices()
    return adjacency
