"""Contact between rods: derivatives, collisions, friction, knots; nothing ever passes through anything."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.testing import check_term

G, R = 9.81, 2e-3
SOFT = rn.Material(E=1e6, rho=1000.0)
STEPPERS = ("euler", "sdirk2")


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def cross(height, *terms, tilt=0.3, edges=7):
    """Two crossed rods, one above the other by ``height`` between their surfaces."""
    figure = rn.StickFigure()
    z, c, s = 2 * R + height, np.cos(tilt), np.sin(tilt)
    figure.rod("low", [(-0.05, 0.003, 0), (0.05, 0.003, 0)], edges=edges, material=SOFT, radius=R)
    figure.rod(
        "high", [(-0.04 * s, -0.04 * c, z), (0.05 * s, 0.05 * c, z)], edges=edges, material=SOFT, radius=R
    )
    return rn.Robot(figure.build(), [*elastic(), *terms])


def throw(robot, velocity, rods="high"):
    v = np.zeros((robot.graph.node_count, 3))
    v[robot.graph.nodes(rods)] = velocity
    return v


def axis_distances(x, edges, pairs, samples=33):
    """Distance of the axes of pairs of edges by brute force, shape (n,) [m]."""
    s = np.linspace(0.0, 1.0, samples)[:, None]
    a = x[edges[pairs[:, 0], 0]][:, None] * (1 - s) + x[edges[pairs[:, 0], 1]][:, None] * s
    # exact point-segment distances from the samples of one edge to the other
    y0, e = x[edges[pairs[:, 1], 0]][:, None], (x[edges[pairs[:, 1], 1]] - x[edges[pairs[:, 1], 0]])[:, None]
    t = np.clip(np.sum((a - y0) * e, axis=2) / np.sum(e * e, axis=2), 0, 1)[..., None]
    return np.linalg.norm(a - y0 - t * e, axis=2).min(axis=1)


def nearest(traj, apart=3):
    """Least distance of the axes of edges that are not neighbours, over all states, over their diameter."""
    edges, least = traj.edges, np.inf
    first, second = np.triu_indices(len(edges), 1)
    rod = np.empty(len(edges), dtype=int)
    for k, r in enumerate(traj.rods.values()):
        rod[r.edges] = k
    chosen = (rod[first] != rod[second]) | (second - first > apart)
    pairs = np.stack([first[chosen], second[chosen]], axis=1)
    for x in traj.x:
        least = min(least, axis_distances(x, edges, pairs).min())
    return least / (2.0 * traj.robot.graph.radius[0])


def test_contract():
    check_term(rn.RodContact, states=4)


@pytest.mark.parametrize("tilt", [0.0, 0.7, 0.5 * np.pi - 1e-2, 0.5 * np.pi])
def test_derivatives_of_rods_within_reach(tilt):
    """Crossing, nearly parallel and parallel edges, that slide and stick, differenced over a nanometre."""
    robot = cross(2e-3, tilt=tilt)
    robot = rn.Robot(
        robot.graph, [rn.RodContact(reach=3e-3, stiffness=1e3, friction=0.4, slip=0.1, damping=0.5)]
    )
    rng = np.random.default_rng(1)
    model, n = Model(robot), robot.graph.x0.size
    ev, cv = Evaluation(model), 30.0
    q = np.concatenate(
        [robot.graph.x0.ravel() + 2e-5 * rng.normal(size=n), rng.normal(size=model.edge_count)]
    )
    v = 0.1 * rng.normal(size=len(q))
    assert len(model.bound[0].gaps(np.ascontiguousarray(q[:n].reshape(-1, 3)))[0]) >= 1

    def force(q, v, jac=False):
        assert ev.update(q, v, 0.0, 1e-3, cv, jac)
        return ev.F.copy()

    force(q, v, True)
    J = model.jacobian().toarray()
    for _ in range(5):
        d = 1e-9 * rng.normal(size=len(q))
        d[n:] *= 1e3
        difference = 0.5 * (force(q - d, v - cv * d) - force(q + d, v + cv * d))
        assert np.abs(J @ d - difference).max() < 2e-5 * np.abs(difference).max()


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("speed", [0.0, 1.0, 10.0])
def test_crossed_rods_never_penetrate(speed, stepper):
    """Dropped, and thrown at 10 m/s, 0.1 m in one step of 0.01 s, which is 25 diameters."""
    robot = cross(5e-3, rn.Gravity(), rn.Hinge(at=["low.start", "low.end"]), rn.RodContact(friction=0.3))
    traj = rn.Simulation(robot, 1e-2, stepper=stepper, velocity=throw(robot, (0, 0, -speed))).run(0.3)
    assert nearest(traj) > 1.0
    # what was above is still above where they cross, or has slipped off
    assert np.abs(traj.v[-1]).max() < max(5.0, speed)


def momenta(robot, traj):
    m = robot.graph.node_mass[:, None]
    return (m * traj.v).sum(axis=1), np.cross(traj.x, m * traj.v).sum(axis=1)


def test_free_collision_keeps_momentum():
    """Two free rods exchange momentum and angular momentum, friction included, and lose energy."""
    robot = cross(1e-3, rn.RodContact(friction=0.3))
    velocity = throw(robot, (0.3, 0.2, -1.0)) + throw(robot, (0, 0, 0.5), "low")
    traj = rn.Simulation(robot, 2e-4, velocity=velocity).run(0.02)
    linear, angular = momenta(robot, traj)
    scale = robot.graph.node_mass @ np.linalg.norm(velocity, axis=1)
    assert np.abs(linear - linear[0]).max() < 1e-7 * scale
    assert np.abs(traj.v[-1] - velocity).max() > 0.5
    stored = sum(traj.energies[k] for k in traj.energies)
    assert stored[-1] < 0.95 * stored[0]
    # angular momentum is kept to the first order of implicit Euler's own error
    assert np.abs(angular - angular[0]).max() < 2e-2 * scale * 0.05
