"""Tree LU, and the checked linear solver."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rodnet.errors import SingularMatrixError
from rodnet.solve.linear import LinearSolver
from rodnet.solve.pattern import build_pattern
from rodnet.solve.tree_lu import TreeLU
from tests.random_rods import Rods, chain, dense, forests, rows_of, stored


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
