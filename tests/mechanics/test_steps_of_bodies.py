"""How Newton's method moves robots with rigid bodies: along arcs, in few iterations, and never what is held."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.testing.states import random_rotation

RUBBER = rn.Material(E=1e8, rho=1000.0)


def hub_with_rods():
    """A body with a rod at either end."""
    figure = rn.StickFigure()
    figure.rigid("hub", [(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0.01)], mass=0.05, radius=6e-3)
    figure.rod("one", ["hub.end", (0.09, 0.03, 0.03)], edges=4, material=RUBBER, radius=3e-3)
    figure.rod("other", ["hub.start", (-0.02, -0.03, 0.05)], edges=3, material=RUBBER, radius=3e-3)
    return figure.body("hub").build()


def moved_along(update, base_turn):
    """Positions before and after a Newton update, from a state whose body has turned by ``base_turn``."""
    sim = rn.Simulation(rn.Robot(hub_with_rods(), [rn.Stretching(), rn.Bending(), rn.Twisting()]))
    m, newton, zero = sim.model, sim.newton, np.zeros(sim.model.dof_count)
    newton.ev.set_source(sim.state.tangents, sim.state.directors, sim.state.tau, sim.state.q)
    newton._base[:] = sim.state.q
    newton._base[m.bodies.own[0, 3:]] = base_turn
    move = newton._move_free
    move(np.zeros(0), 0.0, sim.state.q, 1.0, 1.0, zero, zero)
    newton._base[:] = newton.ev.q
    before = newton.ev.x[: m.graph.node_count].copy()
    full = update(m, before, newton.ev.bodies.T[0])
    move(full[m.free], 1.0, sim.state.q, 1.0, 1.0, zero, zero)
    assert newton.ev.rates == pytest.approx(newton.ev.q - sim.state.q, abs=1e-15)
    return m, before, newton.ev.x[: m.graph.node_count].copy()


@pytest.mark.parametrize("angle", [1e-7, 1e-3, 0.8])
def test_an_update_that_turns_everything_keeps_all_distances(angle):
    """Nodes of rods are given their tangents, delta sigma x arm, and come to where a rigid motion has them."""
    rng = np.random.default_rng(1)
    turn, base_turn = angle * random_rotation(rng)[0], 0.3 * random_rotation(rng)[0]

    def update(m, x, T):
        full, base = np.zeros(m.dof_count), m.bodies.base[0] // 3
        full[: 3 * m.graph.node_count] = (
            np.array([0.01, 0.02, -0.01]) + np.cross(T @ turn, x - x[base])
        ).ravel()
        full[m.bodies.own[0, 3:]] = turn
        return full

    _, before, after = moved_along(update, base_turn)
    apart = lambda x: np.linalg.norm(x[:, None] - x[None], axis=-1)  # noqa: E731
    # base_turn is no motion of the rods: it counts from where the update begins
    assert np.abs(apart(after) - apart(before)).max() < 2e-16
    assert np.abs(after - before).max() > 0.01


def test_an_update_of_nodes_that_stay_is_straight():
    """A body that turns alone takes no node of a rod along."""

    def update(m, x, T):
        full = np.zeros(m.dof_count)
        full[m.bodies.own[0, 3:]] = (0.1, -0.2, 0.3)
        return full

    m, before, after = moved_along(update, np.zeros(3))
    soft = m.bodies.owner[: m.graph.node_count] >= 0
    soft[m.bodies.base // 3] = False
    assert soft.sum() == 7 and np.array_equal(after[soft], before[soft])


@pytest.mark.parametrize("n_tails", [2, 3])
def test_bodies_take_no_more_iterations_than_stiff_parts(n_tails):
    """On the paper's robot, from the motor's jump at the start until its motion is nearly steady."""

    def iterations(rigid):
        sim = rn.Simulation(rn.robots.flagellated(n_tails, 100.0, rigid=rigid))
        counts = []
        for _ in range(100):
            counts.append(sim.step().iterations)
        return np.array(counts)

    stiff, body = iterations("stiff"), iterations("body")
    assert body.sum() <= stiff.sum()
    assert body.max() <= 5 and body[-30:].max() <= 2


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_held_node_stays_though_it_goes_round_with_a_body(stepper):
    """A bob swings on a rod about a hinge: seen from the bob, the hinge goes round with it."""
    figure = rn.StickFigure()
    figure.rod("link", [(0, 0, 0), (0, 0, -0.1)], edges=4, material=RUBBER, radius=5e-3)
    figure.rigid("bob", ["link.end", (0, 0, -0.2), (0.05, 0, -0.2)], radius=0.01)
    figure.body("bob", mass=0.1, com=(0, 0, -0.15), inertia=(1e-4, 1e-4, 1e-4))
    graph = figure.build()
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Hinge(at="link.start")]
    velocity = np.zeros((graph.node_count, 3))
    velocity[:, 1] = 20.0 * graph.x0[:, 2]
    spin = {"bob": (-20.0, 0.0, 0.0)}
    sim = rn.Simulation(rn.Robot(graph, terms), 5e-3, stepper=stepper, velocity=velocity, spin=spin)
    traj = sim.run(0.1)
    assert np.all(traj.x[:, 0] == 0.0)
    assert np.ptp(traj.x[:, -1, 2]) > 0.1
