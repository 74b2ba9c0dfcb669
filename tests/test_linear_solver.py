"""Sparsity pattern, elimination order, tree LU and the checked linear solver."""

import subprocess
import sys
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix

from rodnet.errors import SingularMatrixError
from rodnet.solve.linear import LinearSolver
from rodnet.solve.ordering import elimination_blocks, loop_blocks
from rodnet.solve.pattern import TRASH, build_pattern
from rodnet.solve.tree_lu import TreeLU


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


# -- sparsity pattern ----------------------------------------------------------------------------------


@given(forests(), st.integers(0, 1000))
@settings(deadline=None, max_examples=40)
def test_slots_assemble_the_dense_matrix(rods, seed):
    pattern = rods.pattern
    data = rods.values(pattern, np.random.default_rng(seed))
    expected = np.eye(rods.n + 1)
    for stencil, matrices in zip(
        rods.stencils, rods.stencil_matrices(np.random.default_rng(seed)), strict=True
    ):
        np.add.at(expected, (stencil[:, :, None], stencil[:, None, :]), matrices)  # -1 is the last row
    np.testing.assert_allclose(dense(pattern, data), expected[:-1, :-1], rtol=1e-13, atol=1e-13)


@given(forests())
@settings(deadline=None, max_examples=40)
def test_pattern_is_canonical(rods):
    pattern = rods.pattern
    matrix = csr_matrix((np.ones(pattern.nnz), pattern.indices, pattern.indptr), shape=(rods.n, rods.n))
    matrix.check_format(full_check=True)
    assert matrix.has_canonical_format
    assert (matrix != matrix.T).nnz == 0
    assert np.array_equal(pattern.indices[pattern.diagonal], np.arange(rods.n))
    assert all(s.dtype == np.int32 and s.min(initial=0) >= 0 for s in map(pattern.places, rods.stencils))
    for stencil in rods.stencils:
        slots = pattern.places(stencil)
        out = (stencil < 0)[:, :, None] | (stencil < 0)[:, None, :]
        assert np.array_equal(slots == pattern.nnz, out)


def test_pattern_of_nothing_and_of_repeated_dofs():
    assert build_pattern(0, [np.full((2, 3), -1)]).nnz == 0
    lonely = build_pattern(3, [])
    assert np.array_equal(lonely.indices, [0, 1, 2])
    seen = np.array([[1, 1]])  # one DOF seen twice, as of two ends welded together
    assert np.array_equal(build_pattern(2, [seen]).places(seen), np.ones((1, 2, 2)))
    with pytest.raises(ValueError, match="outside"):
        build_pattern(2, [np.array([[0, 2]])])


# -- elimination order ------------------------------------------------------------------------


@given(forests())
@settings(deadline=None, max_examples=60)
def test_blocks_partition_the_dofs_from_tips_to_root(rods):
    ptr, dofs = rods.blocks
    assert np.array_equal(np.sort(dofs), np.arange(rods.n))
    assert ptr[0] == 0 and ptr[-1] == rods.n and np.all(np.diff(ptr) > 0)
    block_of = np.empty(rods.n, dtype=int)
    block_of[dofs] = np.repeat(np.arange(len(ptr) - 1), np.diff(ptr))
    for (a, b), edge in zip(rods.edges, rods.edge_dofs, strict=True):
        if edge >= 0:  # the twist goes with the end that is eliminated first
            ends = [block_of[rods.node_dofs[x, 0]] for x in (a, b)]
            assert block_of[edge] == min(ends)


@pytest.mark.parametrize("extra", [(0, 4), (2, 2), (1, 3)])
def test_loops_have_no_blocks(extra):
    rods = chain(5)
    edges = np.vstack([rods.edges, extra])
    edge_dofs = np.append(rods.edge_dofs, rods.n)
    assert elimination_blocks(edges, rods.node_dofs, edge_dofs) is None
    # a loop in one component and a second component must not cancel in the count
    node_dofs = np.vstack([rods.node_dofs, rods.n + 1 + np.arange(3)])
    assert elimination_blocks(edges, node_dofs, edge_dofs) is None


def test_parallel_edges_are_no_loop():
    """As the bodies of a hinge: both twists go with the end that is eliminated first."""
    rods = chain(5)
    ptr, dofs = elimination_blocks(
        np.vstack([rods.edges, (1, 2)]), rods.node_dofs, np.append(rods.edge_dofs, rods.n)
    )
    assert np.array_equal(np.sort(dofs), np.arange(rods.n + 1))
    blocks = [set(block) for block in np.split(dofs, ptr[1:-1])]
    assert next(b for b in blocks if rods.n in b) == next(b for b in blocks if rods.edge_dofs[1] in b)


@st.composite
def looped(draw):
    n = draw(st.integers(3, 12))
    parents = [-1] + [draw(st.integers(0, i - 1)) for i in range(1, n)]
    taken = {frozenset(pair) for pair in enumerate(parents)}
    pairs = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1))
    loops = {frozenset(pair) for pair in draw(st.lists(pairs, min_size=1, max_size=4))}
    closed = [tuple(sorted(pair)) for pair in sorted(loops - taken, key=sorted) if len(pair) == 2]
    held = draw(st.sets(st.integers(0, n - 1), max_size=3))
    return Rods(parents, draw(st.one_of(st.none(), st.integers(0, 99))), tuple(held), closed)


@given(looped(), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_loops_are_solved_in_blocks_too(rods, seed):
    rng = np.random.default_rng(seed)
    pattern, blocks = rods.pattern, rods.loop_blocks
    assert np.array_equal(np.sort(blocks[1]), np.arange(rods.n))
    tree = TreeLU(pattern, *blocks)
    values, b = rods.values(pattern, rng), rng.normal(size=rods.n)
    A = dense(pattern, values)
    assert tree.factor(stored(tree, values)) < np.inf
    assert np.allclose(tree.solve(b), np.linalg.solve(A, b), rtol=1e-8, atol=1e-10)


def test_a_ring_is_as_cheap_per_node_however_long_but_a_grid_is_left_to_others():
    widths = []
    for n in (50, 500):
        ring = Rods([*range(-1, n - 1)], loops=[(0, n - 1)])
        widths.append(TreeLU(ring.pattern, *ring.loop_blocks).front_sizes.max())
    assert widths[0] == widths[1]
    k = 30
    rows = [
        [-1 if i == j == 0 else (k * i + j - 1 if j else k * (i - 1)) for j in range(k)] for i in range(k)
    ]
    across = [(k * i + j, k * (i + 1) + j) for i in range(k - 1) for j in range(1, k)]
    assert Rods([p for row in rows for p in row], loops=across).loop_blocks is None


def test_many_components_and_long_chains():
    n = 20_000
    dofs = np.arange(3 * n).reshape(n, 3)
    ptr, _ = elimination_blocks(np.empty((0, 2), dtype=int), dofs, np.empty(0, dtype=int))
    assert len(ptr) == n + 1
    rods = chain(n)
    ptr, order = rods.blocks
    assert len(ptr) == n + 1 and np.array_equal(order[-3:], [0, 1, 2])


# -- tree LU ----------------------------------------------------------------------------------


@given(forests(), st.integers(0, 1000))
@settings(deadline=None, max_examples=80)
def test_tree_lu_equals_dense_solve(rods, seed):
    rng = np.random.default_rng(seed)
    pattern = rods.pattern
    lu = TreeLU(pattern, *rods.blocks)
    for _ in range(2):  # the second time over used arrays
        data = rods.values(pattern, rng)
        data[-1] = np.nan  # the trash entry is not read
        assert lu.factor(stored(lu, data)) < 1e8
        a = dense(pattern, data)
        for b in (rng.normal(size=rods.n), rng.normal(size=(rods.n, 1)), rng.normal(size=(rods.n, 7))):
            expected = np.linalg.solve(a, b)
            assert np.abs(lu.solve(b) - expected).max() <= 1e-10 * np.abs(expected).max()


@given(forests())
@settings(deadline=None, max_examples=60)
def test_trees_have_no_fill(rods):
    assert TreeLU(rods.pattern, *rods.blocks).factor_nnz == rods.pattern.nnz


@pytest.mark.parametrize("hub_degree", [3, 4, 8])
@pytest.mark.parametrize("hub_edge", ["to the root", "to the first child"])
def test_declared_hub_edge_causes_no_fill(hub_degree, hub_edge):
    arms = np.arange(2, hub_degree + 1)
    rods = Rods([-1, 0, *np.ones(len(arms), dtype=int), *arms])
    bend = rods.stencils[1]
    hub = rods.edge_dofs[0 if hub_edge == "to the root" else 1]
    at_hub = (bend[:, 4:7] == rods.node_dofs[1]).all(axis=1)
    declared = bend[~at_hub | (bend[:, 3] == hub) | (bend[:, 7] == hub)]
    pattern = build_pattern(rods.n, [rods.stencils[0], declared, rods.node_dofs])
    assert pattern.nnz < rods.pattern.nnz
    assert TreeLU(pattern, *rods.blocks).factor_nnz == pattern.nnz


def test_fill_is_found_for_any_pattern_and_order():
    rng = np.random.default_rng(5)
    for n in (1, 2, 17, 40):
        stencils = rng.integers(0, n, size=(3 * n, 2))
        pattern = build_pattern(n, [stencils])
        data = rng.normal(size=pattern.nnz + 1)
        data[pattern.diagonal] += 20.0
        cuts = np.flatnonzero(np.append(True, rng.random(n - 1) < 0.5))
        lu = TreeLU(pattern, np.append(cuts, n), rng.permutation(n))
        lu.factor(stored(lu, data))
        b = rng.normal(size=n)
        np.testing.assert_allclose(lu.solve(b), np.linalg.solve(dense(pattern, data), b), rtol=1e-10)


def test_front_storage_is_linear():
    small, large = (TreeLU(r.pattern, *r.blocks) for r in (chain(500), chain(1000)))
    assert large.front_sizes.max() == 11
    assert np.sum(large.front_sizes**2) - np.sum(small.front_sizes**2) == 500 * 11**2


def test_solve_into_a_given_array():
    rods = chain(6)
    lu = TreeLU(rods.pattern, *rods.blocks)
    rng = np.random.default_rng(0)
    lu.factor(stored(lu, rods.values(rods.pattern, rng)))
    for shape in (rods.n, (rods.n, 3)):
        b = rng.normal(size=shape)
        x, kept = lu.solve(b), b.copy()
        assert np.array_equal(b, kept)
        assert lu.solve(b, b) is b and np.array_equal(b, x)
        assert np.array_equal(lu.solve(kept[::-1][::-1]), x)
    assert lu.solve(np.empty((rods.n, 0))).shape == (rods.n, 0)
    with pytest.raises(ValueError, match="shape"):
        lu.solve(np.zeros(rods.n + 1))


def test_blocks_must_be_a_partition():
    pattern = build_pattern(3, [])
    with pytest.raises(ValueError, match="exactly once"):
        TreeLU(pattern, [0, 3], [0, 1, 1])
    with pytest.raises(ValueError, match="strictly"):
        TreeLU(pattern, [0, 0, 3], [0, 1, 2])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_values_are_flagged(value):
    rods = Rods([-1, 0, 1, 1, 2, 3])
    pattern = rods.pattern
    lu = TreeLU(pattern, *rods.blocks)
    for entry in range(0, pattern.nnz, 7):
        data = rods.values(pattern, np.random.default_rng(entry))
        data[entry] = value
        growth = lu.factor(stored(lu, data))
        assert growth == np.inf or not np.isfinite(lu.solve(np.ones(rods.n))).all()


# -- linear solver ----------------------------------------------------------------------------


@given(forests(), st.integers(0, 1000), st.booleans())
@settings(deadline=None, max_examples=40)
def test_linear_solver_equals_dense_solve(rods, seed, as_tree):
    rng = np.random.default_rng(seed)
    pattern = rods.pattern
    solver = LinearSolver(pattern, rods.blocks if as_tree else None)
    for k in range(3):
        data = rods.values(pattern, rng)
        values = stored(solver, data)
        solver.factor(values)
        a = dense(pattern, data)
        for b in (rng.normal(size=rods.n), rng.normal(size=(rods.n, 4)), np.zeros(rods.n)):
            expected = np.linalg.solve(a, b)
            kept = values.copy()
            for check in (True, False):
                x = solver.solve(b, check=check)
                assert x.shape == b.shape and np.abs(x - expected).max() <= 1e-10 * np.abs(expected).max()
                values[:] = np.nan  # the factors do not depend on the values any more, only the check does
            values[:] = kept
        assert (solver.factorizations, solver.solves) == (k + 1, 6 * k + 6)
    assert solver.fallbacks == 0


def two_blocks(pivot):
    """Two DOFs in two blocks, [[pivot, 1], [1, pivot]], with the rows in units 1e12 apart."""
    pattern = build_pattern(2, [np.array([[0, 1]])])
    data = np.array([pivot, 1.0, 1e12, 1e12 * pivot])
    return LinearSolver(pattern, (np.array([0, 1, 2]), np.array([0, 1]))), data


@pytest.mark.parametrize("pivot", [0.0, 1e-300])
def test_pivot_outside_its_block_is_a_counted_fallback(pivot):
    solver, data = two_blocks(pivot)
    for count in (1, 2):
        solver.factor(stored(solver, data))
        for _ in range(2):  # counted per matrix, not per right-hand side
            np.testing.assert_allclose(solver.solve(np.array([2.0, 3e12])), [3.0, 2.0], rtol=1e-14)
        assert solver.fallbacks == count
    solver.factor(stored(solver, np.array([1.0, 0.0, 0.0, 1.0])))  # the next matrix gets its chance again
    np.testing.assert_allclose(solver.solve(np.ones(2)), 1.0)
    assert solver.fallbacks == 2


@pytest.mark.parametrize("pivot", [3e-8, 1e-10])
def test_refinement_saves_a_doubtful_factorisation(pivot):
    solver, data = two_blocks(pivot)
    data[2], data[3] = 1.0, pivot  # multiplier 3e7 or 1e10: eight or six digits left before refinement
    solver.factor(stored(solver, data))
    x = solver.solve(np.array([2.0, 3.0]))
    np.testing.assert_allclose(x, np.linalg.solve([[pivot, 1.0], [1.0, pivot]], [2.0, 3.0]), rtol=1e-11)
    assert solver.fallbacks == 0


@pytest.mark.parametrize("size", [0.0, 1e-20, 1e-13])
def test_rod_with_a_vanishing_diagonal_block_falls_back(size):
    rods = chain(8)
    pattern = rods.pattern
    rng = np.random.default_rng(1)
    data = rods.values(pattern, rng)
    tip = rods.blocks[1][:4]
    data[:-1][np.isin(rows_of(pattern), tip) & np.isin(pattern.indices, tip)] *= size
    solver = LinearSolver(pattern, rods.blocks)
    solver.factor(stored(solver, data))
    b = rng.normal(size=(rods.n, 2))
    np.testing.assert_allclose(solver.solve(b), np.linalg.solve(dense(pattern, data), b), rtol=1e-9)
    assert solver.fallbacks == 1


@pytest.mark.parametrize("as_tree", [True, False])
def test_singular_matrix_names_the_free_motion(as_tree):
    rods = chain(6, scramble=3)
    pattern = rods.pattern
    data = rods.values(pattern, np.random.default_rng(2))
    dof = int(rods.edge_dofs[3])
    data[:-1][(rows_of(pattern) == dof) | (pattern.indices == dof)] = 0.0
    solver = LinearSolver(pattern, rods.blocks if as_tree else None)
    with pytest.raises(SingularMatrixError, match="no resistance") as error:
        solver.factor(stored(solver, data))
    assert error.value.dof == dof


@pytest.mark.parametrize("as_tree", [True, False])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_rigid_motion_of_a_free_body_is_singular(as_tree, unit):
    """Springs in a row, held by nothing: round-off makes an inverse, which is no answer."""
    n = 40
    stencil = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    pattern = build_pattern(n, [stencil])
    k = unit * np.random.default_rng(0).uniform(0.1, 10.0, n - 1)
    data = np.zeros(pattern.nnz + 1)
    np.add.at(data, pattern.places(stencil), k[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]]))
    blocks = (np.arange(n + 1), np.arange(n))
    solver = LinearSolver(pattern, blocks if as_tree else None)
    with pytest.raises(SingularMatrixError):
        solver.factor(stored(solver, data))
        solver.solve(np.full(n, 1e-3))
    data[pattern.diagonal[0]] += 1e-9 * unit  # the faintest hold makes it a good problem
    solver.factor(stored(solver, data))
    assert solver.solve(np.full(n, unit)) == pytest.approx(n * 1e9, rel=1e-4)


def test_non_finite_matrix_raises():
    rods = chain(4)
    pattern = rods.pattern
    for blocks in (rods.blocks, None):
        solver = LinearSolver(pattern, blocks)
        data = rods.values(pattern, np.random.default_rng(0))
        data[pattern.diagonal[5]] = np.nan
        with pytest.raises(SingularMatrixError, match="not finite") as error:
            solver.factor(stored(solver, data))
        assert error.value.dof == 5


def test_everything_constrained():
    solver = LinearSolver(build_pattern(0, []), (np.array([0]), np.empty(0, dtype=int)))
    solver.factor(np.zeros(1))
    assert solver.solve(np.empty(0)).shape == (0,)


def test_import_is_light():
    code = "import sys, rodnet.solve.linear; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
