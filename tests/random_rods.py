"""Rods whose matrices are made at random: for tests of patterns, elimination orders and linear solvers."""

from itertools import combinations

import numpy as np
from hypothesis import strategies as st
from scipy.sparse import csr_matrix

from rodnet.solve.ordering import elimination_blocks, loop_blocks
from rodnet.solve.pattern import TRASH, build_pattern


class Rods:
    """Rods with springs between all pairs of edges at a node, and numbered free DOFs."""

    def __init__(self, parents, scramble=None, held=(), loops=()):
        """`parents[i]` is the node that node i hangs on, -1 for none; `held` nodes and edges have no DOFs.

        `loops` are edges that close loops.
        """
        self.n_nodes = len(parents)
        tree = [(p, i) for i, p in enumerate(parents) if p >= 0]
        self.edges = np.array([*tree, *loops], dtype=int).reshape(-1, 2)
        n_full = 3 * self.n_nodes + len(self.edges)
        free = np.ones(n_full, dtype=bool)
        for node in held:
            free[3 * node : 3 * node + 3] = False
            free[3 * self.n_nodes :][(self.edges == node).any(axis=1)] = False
        numbers = np.full(n_full, -1)
        self.n = int(free.sum())
        order = np.arange(self.n) if scramble is None else np.random.default_rng(scramble).permutation(self.n)
        numbers[free] = order
        self.node_dofs = numbers[: 3 * self.n_nodes].reshape(-1, 3)
        self.edge_dofs = numbers[3 * self.n_nodes :]
        self.stencils = [self._stretch(), self._bend(), self.node_dofs]

    def _stretch(self):
        a, b = self.edges.T
        return np.column_stack([self.node_dofs[a], self.edge_dofs, self.node_dofs[b]])

    def _bend(self):
        ends = [[] for _ in range(self.n_nodes)]
        for e, (a, b) in enumerate(self.edges):
            ends[a].append((e, b))
            ends[b].append((e, a))
        pairs = [(a, e, x, f, b) for x, at in enumerate(ends) for (e, a), (f, b) in combinations(at, 2)]
        a, e, x, f, b = np.array(pairs, dtype=int).reshape(-1, 5).T
        nodes, edges = self.node_dofs, self.edge_dofs
        return np.column_stack([nodes[a], edges[e], nodes[x], edges[f], nodes[b]])

    @property
    def pattern(self):
        return build_pattern(self.n, self.stencils)

    @property
    def blocks(self):
        return elimination_blocks(self.edges, self.node_dofs, self.edge_dofs)

    @property
    def loop_blocks(self):
        return loop_blocks(self.pattern, self.edges, self.node_dofs, self.edge_dofs)

    def stencil_matrices(self, rng):
        """Positive definite plus skew, one per stencil."""
        for stencil in self.stencils:
            m, k = stencil.shape
            g, s = rng.normal(size=(2, m, k, k))
            yield g @ g.transpose(0, 2, 1) / k + s - s.transpose(0, 2, 1)

    def values(self, pattern, rng):
        data = np.zeros(pattern.nnz + 1)
        for stencil, matrices in zip(self.stencils, self.stencil_matrices(rng), strict=True):
            slots = pattern.places(stencil)
            np.add.at(data, slots, matrices)
        data[pattern.diagonal] += 1.0
        return data


def dense(pattern, data):
    matrix = csr_matrix((data[: pattern.nnz], pattern.indices, pattern.indptr), shape=(pattern.n, pattern.n))
    return matrix.toarray()


def stored(solver, data):
    """Values in the order in which a solver wants them, behind them trash that must not be read."""
    values = np.zeros(solver.pattern.size + TRASH)
    values[solver.pattern.storage[:-1]] = data[: solver.pattern.nnz]
    values[solver.pattern.size :] = np.nan
    return values


def rows_of(pattern):
    return np.repeat(np.arange(pattern.n), np.diff(pattern.indptr))


def chain(n_nodes, **kwargs):
    return Rods(np.arange(n_nodes) - 1, **kwargs)


@st.composite
def forests(draw, max_nodes=30):
    n = draw(st.integers(2, max_nodes))
    reach = draw(st.integers(1, n))  # short: chains; long: bushes
    parents = [-1] + [draw(st.integers(max(0, i - reach), i - 1)) for i in range(1, n)]
    for i in draw(st.sets(st.integers(1, n - 1), max_size=2)):
        parents[i] = -1
    held = draw(st.sets(st.integers(0, n - 1), max_size=min(3, n - 1)))
    return Rods(parents, scramble=draw(st.integers(0, 1000)), held=held)
