"""Mass along the edges: bars that swing, waves, momentum."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix
from tests.mechanics.beams import EA, MATERIAL, WEIGHT, L, R, beam, order

G = 9.81


def test_contract():
    rn.testing.check_term(rn.ConsistentMass)
    rn.testing.check_term(rn.ConsistentMass(share=0.5))


@pytest.mark.parametrize(("share", "inertia"), [(1.0, 1 / 3), (0.0, 1 / 2)])
def test_one_edge_swings_as_a_bar(share, inertia):
    """Period 2 pi sqrt(I / (m g l / 2)), with I = m l^2 / 3 about its end; lumped it would be m l^2 / 2."""
    fig = rn.StickFigure()
    fig.rod("bar", [(0, 0, 0), (L * np.sin(0.01), 0, -L * np.cos(0.01))], material=MATERIAL, radius=R)
    terms = [rn.Stretching(), rn.Gravity(g=G), rn.Hinge(at="bar.start"), rn.ConsistentMass(share=share)]
    robot = rn.Robot(fig.build(), terms)
    traj = rn.Simulation(robot, 2e-3, stepper="sdirk2").run(2.0)
    x = traj.at("bar.end")[:, 0]
    back = np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))
    zeros = traj.t[back] - x[back] * traj.dt / (x[back + 1] - x[back])
    period = 2.0 * np.pi * np.sqrt(inertia * L / (0.5 * G))
    assert np.diff(zeros).mean() == pytest.approx(period, rel=1e-3)


@pytest.mark.parametrize(("share", "expected"), [(0.0, 2.0), (1.0, 2.0), (0.5, 4.0)])
def test_waves_along_a_rod(share, expected):
    """The lowest frequency of a bar held at one end is pi c / (2 L), to second order, or to fourth."""
    sizes, errors = (4, 8, 16), []
    for n in sizes:
        robot = beam(n, rn.Hinge(at="beam.start"), rn.ConsistentMass(share=share))
        sim = rn.Simulation(robot, 1.0)
        K = stiffness_matrix(robot)[0].toarray()[0 : 3 * n : 3, 0 : 3 * n : 3]
        bound, ev = sim.model.bound[-1], sim.newton.ev
        ev.ca = 1.0
        data = sim.model.data
        data[:] = 0.0
        bound.add(ev, np.zeros(sim.model.dof_count), data, True)
        M = sim.model.jacobian().toarray()[0 : 3 * n : 3, 0 : 3 * n : 3]
        M += np.diag(robot.graph.node_mass[1:])
        lowest = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.min())
        errors.append(lowest / (0.5 * np.pi / L * np.sqrt(EA / WEIGHT)) - 1.0)
    assert order(sizes, errors) == pytest.approx(expected, abs=0.1)
    assert np.sign(errors[-1]) == (1.0 if share == 1.0 else -1.0)


def test_momentum_is_kept_and_energy_counted():
    """Thrown and spinning: the momentum is constant, and kinetic, elastic and spread energy sum up."""
    robot = beam(6, rn.ConsistentMass())
    rng = np.random.default_rng(1)
    velocity = 0.3 * rng.normal(size=robot.graph.x0.shape)
    traj = rn.Simulation(robot, 2e-5, stepper=rn.GeneralizedAlpha(1.0), velocity=velocity).run(2e-3)
    momentum = np.einsum("n,tnk->tk", robot.graph.node_mass, traj.v)
    assert momentum[-1] == pytest.approx(momentum[0], abs=1e-9 * np.abs(momentum).max())
    sim = rn.Simulation(robot, 1.0)
    spread = []
    for k in (0, -1):
        ev = sim.newton.ev
        state = traj.state(k)
        ev.set_source(state.tangents, state.directors, state.tau, state.q)
        ev.update(state.q, state.v, 0.0, 1.0, 0.0, False)
        spread.append(sim.model.bound[-1].energy(ev))
    total = sum(traj.energies.values())[[0, -1]] + spread
    assert spread[0] < 0.0
    assert total[1] == pytest.approx(total[0], rel=2e-3)
