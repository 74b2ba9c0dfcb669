"""Modes and critical loads: what vibrates, decays and is free; what they are told when asked badly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eig

import rodnet as rn
from rodnet.solve.modes import Linearised, _solve, linearised
from rodnet.solve.statics import stiffness_matrix
from tests.mechanics.beams import EA, EI, MATERIAL, WEIGHT, L, R, beam, elastic

CLAMP = rn.Clamp(at="beam.start")


def test_a_free_robot_has_six_rigid_modes():
    """A bent free rod; its elastic modes come after, in order, with shapes scaled to one."""
    robot = beam(12, points=((0, 0, 0), (0.1, 0, 0), (0.15, 0.05, 0.02)))
    modes = rn.modes(robot, count=9)
    assert modes.free.tolist() == [True] * 6 + [False] * 3
    assert modes.stable and np.all(np.diff(np.abs(modes.rate)) > -1e-9)
    # its spin about itself is no rigid mode of a bent rod
    assert modes.frequency[6] > 1.0
    assert np.abs(modes.x[6:]).max(axis=(1, 2)) == pytest.approx(1.0)
    for shape in modes.x[6:].real:  # momentum of a vibration is zero
        assert robot.graph.node_mass @ shape == pytest.approx(0.0, abs=1e-6 * WEIGHT * L)


@pytest.mark.parametrize("edges", [4, 24])
def test_modes_of_all_sizes_agree_with_a_dense_solution(edges):
    law = rn.ResistiveForce(viscosity=0.02)
    robot = beam(edges, CLAMP, law, rn.KelvinVoigt(bend=1e-3, twist=1e-3))
    sim = rn.Simulation(robot)
    K, C, M, _ = (a.toarray() if hasattr(a, "toarray") else a for a in linearised(sim, sim.state))
    n = len(K)
    eye, none = np.eye(n), np.zeros((n, n))
    values = eig(np.block([[none, eye], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]]), right=False)
    values = values[values.imag >= 0.0]
    expected = values[np.argsort(np.abs(values))][:8]
    assert np.abs(rn.modes(robot, count=8).rate) == pytest.approx(np.abs(expected), rel=1e-4)


def test_two_planes_of_a_round_rod_are_real():
    """Also where round-off makes the two equal rates a conjugate pair, whichever way it falls."""
    sim = rn.Simulation(beam(24, CLAMP))
    K, C, M, free = linearised(sim, sim.state)
    size = abs(K).max()
    for skew in 1e-14 * size * np.array([0.0, 1.0, -3.0]):
        turned = sparse.diags([np.full(len(free) - 1, skew), np.full(len(free) - 1, -skew)], [1, -1])
        rate, shapes = _solve(Linearised((K + turned).tocsc(), C, M, free), 2.0, 6)
        assert np.all(rate.real == pytest.approx(0.0, abs=1e-6 * abs(rate[0]))) and np.isrealobj(shapes)
        assert rate.imag[::2] == pytest.approx(rate.imag[1::2], rel=1e-6)
        for k in (0, 2, 4):
            pair = shapes[:, k : k + 2] / np.linalg.norm(shapes[:, k : k + 2], axis=0)
            assert np.linalg.cond(pair) < 1e3
            assert K @ pair == pytest.approx(M @ pair * rate[k].imag ** 2, abs=1e-9 * size)


def test_overdamped_motion_only_decays():
    """A rod in honey: its slowest motion goes at the slowest rate of the hyperdiffusion, EI beta^4 / (eta L^4)."""
    eta = 5.0
    modes = rn.modes(beam(32, CLAMP, rn.ResistiveForce(eta_t=eta, eta_n=eta)), count=2)
    assert modes.frequency == pytest.approx(0.0)
    # a little inertia makes it rate + m rate^2 / eta = expected
    rate = modes.decay[0]
    expected = EI * 1.875104069**4 / (eta * L**4)
    assert rate - WEIGHT * rate**2 / eta == pytest.approx(expected, rel=5e-3)


def test_added_mass_and_rigid_bodies_weigh():
    """A rod in water rings slower by the root of 1 + rho_f / rho; a body on a light rod is a mass on a spring."""
    dry, wet = (
        rn.modes(beam(16, CLAMP, *extra), count=1).frequency[0]
        for extra in ([], [rn.AddedMass(density=1000.0)])
    )
    assert wet / dry == pytest.approx(np.sqrt(0.5), rel=1e-6)
    figure = rn.StickFigure()
    light = rn.Material(E=MATERIAL.E, rho=1e-3)
    figure.rod("rod", [(0, 0, 0), (L, 0, 0)], edges=32, material=light, radius=R)
    figure.rigid("ball", ["rod.end", (L + 1e-3, 0, 0)], radius=R)
    figure.body("ball", mass=0.1, com=(L, 0, 0), inertia=(1e-9, 1e-9, 1e-9))
    robot = rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="rod.start")])
    found = rn.modes(robot, count=2)
    assert found.frequency == pytest.approx(np.sqrt(3 * EI / L**3 / 0.1) / 2 / np.pi, rel=2e-3)
    assert np.abs(found.x[0, robot.graph.node("rod.end")]).max() == pytest.approx(1.0, abs=0.02)


def test_beck_s_column_flutters():
    """Under a force that follows its end a column does not buckle but flutters at 20.05 EI / L^2 (Beck 1952)."""

    def held(load):  # straight: too slender here to shorten by much
        follow = rn.FollowerForce(at="beam.end", force=(0, 0, -load * EI / L**2))
        robot = beam(32, CLAMP, follow)
        sim = rn.Simulation(robot)
        q = sim.state.q.copy()
        q[: sim.model.twist0 : 3] *= 1.0 - load * EI / L**2 / EA
        return rn.modes(robot, replace(sim.state, q=q), count=4)

    below, above = held(19.5), held(20.6)
    assert below.stable and not above.stable
    assert above.frequency[0] > 1.0  # it swings as it grows


def test_critical_load_of_a_column():
    """The mode is the column's; a load that is stable throughout, or unstable from the start, is refused."""
    euler = np.pi**2 / 4.0 * EI / L**2

    def column(load):
        return beam(16, CLAMP, rn.PointForce(at="beam.end", force=(-load, 0, 0)))

    found = rn.critical_load(column, 0.2 * euler, 1.6 * euler, steps=3)
    assert found.load * (1 - found.load / EA) == pytest.approx(euler, rel=2e-3)
    shape = found.mode.x[0].real
    side = shape[:, 1:] @ np.linalg.svd(shape[:, 1:], full_matrices=False)[2][0]
    bent = 1.0 - np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, 17))
    assert side / side[-1] == pytest.approx(bent, abs=5e-3) and np.abs(shape[:, 0]).max() < 1e-3
    first = rn.modes(column(0.0), count=1).frequency[0]
    assert len(found.mode) == 1 and found.mode.frequency[0] < 0.2 * first
    with pytest.raises(rn.EquilibriumError, match="still stable"):
        rn.critical_load(column, 0.1 * euler, 0.5 * euler)
    with pytest.raises(rn.ParameterError, match="two finite loads"):
        rn.critical_load(column, 1.0, 1.0)
    with pytest.raises(rn.ParameterError, match="positive integer"):
        rn.modes(column(0.0), count=0)


def test_a_motor_stands_still_in_small_motions():
    """However fast it turns otherwise: no time passes."""
    slow, fast = (rn.modes(rn.robots.flagellated(2, rpm=rpm), count=12).rate for rpm in (0.0, 300.0))
    np.testing.assert_allclose(fast, slow, rtol=1e-6, atol=1e-6 * np.abs(slow).max())


@pytest.mark.parametrize("time", [1e-2, 1e3])
def test_a_set_that_takes_longer_than_a_vibration_stays(time):
    """It takes part in a slow motion, not in one of a thousandth of its time; statics leave it as it is."""
    plain, soft = beam(12, CLAMP), beam(12, CLAMP, rn.PlasticSet(share=0.5, time=time))
    f = [rn.modes(robot, count=1).frequency[0] for robot in (plain, soft)]
    assert f[0] * time > 30.0 or f[0] * time < 1.0
    K = [stiffness_matrix(robot)[0].toarray() for robot in (plain, soft)]
    np.testing.assert_allclose(K[1], K[0], rtol=1e-12)
    if f[0] * time > 30.0:
        assert f[1] == pytest.approx(f[0], rel=1e-2)
    else:
        assert f[1] < 0.95 * f[0]
