"""Sparsity pattern and elimination order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix

from rodnet.solve.ordering import elimination_blocks
from rodnet.solve.pattern import build_pattern
from rodnet.solve.tree_lu import TreeLU
from tests.random_rods import Rods, chain, dense, forests, stored


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
    edges, edge_dofs = np.vstack([rods.edges, (1, 2)]), np.append(rods.edge_dofs, rods.n)
    ptr, dofs = elimination_blocks(edges, rods.node_dofs, edge_dofs)
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
