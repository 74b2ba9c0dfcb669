"""The linear solver on the Jacobians of random robots, and what happens near a fold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rodnet as rn
from rodnet.kinematics.kernels import FOLD
from rodnet.solve.newton import Status
from rodnet.testing import Probe
from rodnet.testing.strategies import generators, robots

few = settings(deadline=None, max_examples=30)


def terms():
    return [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.ResistiveForce(viscosity=5.0), rn.Gravity()]


def newton_matrix(model, probe, dt):
    """Values of the matrix of an implicit Euler step, and the same matrix, dense."""
    probe.evaluate(cv=1.0 / dt, jac=True)
    data = model.data.copy()
    data[model.diagonal] += model.mass[model.free] / dt**2
    return data, model.solver.matrix(data).toarray()


def check_against_dense(model, probe, rng, dt):
    data, A = newton_matrix(model, probe, dt)
    b = rng.normal(size=(len(A), 2))
    model.solver.factor(data)
    x, expected = model.solver.solve(b), np.linalg.solve(A, b)
    assert np.abs(A @ x - b).max() <= 1e-9 * (np.abs(A) @ np.abs(x) + np.abs(b)).max()
    # in units that make rows alike the condition number is fair
    scale = 1.0 / np.sqrt(np.abs(np.diag(A)))
    allowed = 1e-11 + 2e-14 * np.linalg.cond(scale[:, None] * A * scale)
    assert (np.abs(x - expected) / scale[:, None]).max() <= allowed * (
        np.abs(expected) / scale[:, None]
    ).max()


@given(robot=robots(terms, loops=0), rng=generators(), calm=st.booleans())
@few
def test_tree_lu_equals_a_dense_solve(robot, rng, calm):
    """Without a fallback near equilibrium, where the matrix is positive definite."""
    kinds = {"turn": 0.2, "stretch": (0.98, 1.02), "source_turn": 0.2} if calm else {}
    probe = Probe(robot, rng, **kinds)
    model = probe.model
    assert model.solver._tree is not None
    check_against_dense(model, probe, rng, 1e-3)
    assert not calm or model.solver.fallbacks == 0


@given(robot=robots(terms, loops=3, rods=(3, 5)), rng=generators())
@few
def test_few_loops_are_solved_like_trees(robot, rng):
    probe = Probe(robot, rng)
    model = probe.model
    assert model.solver._tree is not None
    check_against_dense(model, probe, rng, 1e-3)


# -- folds ---------------------------------------------------------------------------------
LIMIT = np.arccos(FOLD - 1.0)  # 171.9 degrees


def folding_rod(angle):
    """Two edges that meet at a hinge, the second turned by an angle [rad] when built."""
    points = [(0, 0, 0), (0.05, 0, 0), (0.05 + 0.04 * np.cos(angle), 0.04 * np.sin(angle), 0)]
    fig = rn.StickFigure()
    return fig.rod("rod", points, material=rn.Material(E=1e6), radius=2e-3, natural="straight").build()


@given(turn=st.floats(0.0, np.pi), azimuth=st.floats(-np.pi, np.pi))
@settings(deadline=None, max_examples=100)
def test_any_turn_gives_finite_forces_or_is_called_folded(turn, azimuth):
    model = rn.Simulation(rn.Robot(folding_rod(0.0), terms())).model
    ev, x = rn.solve.evaluation.Evaluation(model), model.x0.copy()
    arm = [np.cos(turn), np.sin(turn) * np.cos(azimuth), np.sin(turn) * np.sin(azimuth)]
    x[2] = x[1] + 0.04 * np.array(arm)
    fine = ev.update(np.concatenate([x.ravel(), np.zeros(2)]), np.ones(model.dof_count), 0.0, 1e-2, 1.0, True)
    if abs(turn - LIMIT) > 1e-6:
        assert fine == (turn < LIMIT)
    if fine:
        assert np.all(np.isfinite(ev.F)) and np.all(np.isfinite(model.data[:-1]))


def test_a_folded_initial_shape_is_a_named_error():
    with pytest.raises((rn.FoldedStateError, rn.GraphError), match="fold"):
        rn.Simulation(rn.Robot(folding_rod(np.pi - 0.1), terms()))
    with pytest.raises(rn.GraphError, match="folds back"):
        folding_rod(np.pi)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_motion_into_a_fold_fails_by_name_and_keeps_the_last_state(stepper, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the debug recording goes

    def turning(t):
        angle = 2.0 * t
        return 0.04 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])

    held = [rn.Hinge(at="rod:0-1"), rn.PrescribedMotion(at="rod:2", position=turning)]
    sim = rn.Simulation(rn.Robot(folding_rod(0.0), [*terms(), *held]), 0.02, stepper=stepper)
    while (result := sim.step()).ok:
        assert sim.t < 2.0
    assert result.status is Status.FOLDED
    assert 2.0 * sim.t == pytest.approx(LIMIT, abs=0.05)
    assert all(np.all(np.isfinite(part)) for part in (sim.state.q, sim.state.v, sim.state.a))
    with pytest.raises(rn.FoldedStateError, match="rod") as error:
        sim.run(0.1)
    assert error.value.trajectory is not None and error.value.time == pytest.approx(sim.t)
