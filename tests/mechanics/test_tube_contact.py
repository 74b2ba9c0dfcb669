"""Rods in a tube and in a gripper, against paper: weight, friction cone, braking, rolling, grip."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn

G, R, RADIUS, GAP = 9.81, 0.02, 2e-3, 1.99e-4  # tube, rod, where it begins above the wall


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def in_tube(*terms, tilt=0.0, aside=0.0, friction=0.0, edges=6, length=0.1):
    """A rod along the bottom of a tube that falls by ``tilt``, or ``aside`` on its wall [rad]; and the way down."""
    down = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    out = np.array([-np.sin(tilt) * np.cos(aside), np.sin(aside), -np.cos(tilt) * np.cos(aside)])
    start = (R - RADIUS - GAP) * out
    figure = rn.StickFigure()
    points, material = [start, start + length * down], rn.Material(E=1e7, rho=1000.0)
    figure.rod("rod", points, edges=edges, material=material, radius=RADIUS)
    tube = rn.TubeContact(((0, 0, 0), down), R, friction=friction)
    return rn.Robot(figure.build(), [*elastic(), rn.Gravity(g=G), tube, *terms]), down


def test_the_wall_carries_the_weight():
    robot, _ = in_tube(aside=0.4)
    traj = rn.Simulation(rn.Robot(robot.graph, [*robot.terms, rn.MassDamping(rate=60.0)]), 0.01).run(1.5)
    force = traj.term_forces("tube", -1)
    weight = G * robot.graph.node_mass.sum()
    assert force.sum(axis=0) == pytest.approx(
        [0.0, 0.0, weight], abs=1e-5 * weight
    )  # it has come to the bottom
    assert force[:, 2] == pytest.approx(G * robot.graph.node_mass, rel=1e-3)  # each node its own
    assert np.abs(traj.x[-1, :, 1]).max() < 1e-4 * R


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_the_friction_cone_in_a_tube_that_tilts(stepper):
    """It sticks below the angle of friction, and above slides with g (sin a - mu cos a), its force on the cone."""
    tilt, friction = np.radians(25.0), np.tan(np.radians(15.0))
    robot, down = in_tube(tilt=tilt, friction=friction)
    mass = robot.graph.node_mass
    traj = rn.Simulation(robot, 5e-3, stepper=stepper).run(0.3)
    speed, half = (traj.v @ down) @ mass / mass.sum(), len(traj) // 2
    found = (speed[-1] - speed[half]) / (traj.t[-1] - traj.t[half])
    assert found == pytest.approx(G * (np.sin(tilt) - friction * np.cos(tilt)), rel=1e-3)
    force = traj.term_forces("tube", -1).sum(axis=0)
    along = force @ down
    assert -along == pytest.approx(friction * np.linalg.norm(force - along * down), rel=1e-6)
    robot, down = in_tube(tilt=tilt, friction=np.tan(np.radians(35.0)))
    traj = rn.Simulation(robot, 5e-3, stepper=stepper).run(0.3)
    assert np.abs(traj.v[half:] @ down).max() < 1e-3  # the slip speed
    force = traj.term_forces("tube", -1).sum(axis=0)
    along = force @ down
    assert along == pytest.approx(-G * mass.sum() * np.sin(tilt), rel=1e-3)


def test_a_rod_that_slides_along_a_tube_slows_by_mu_g():
    friction, speed = 0.3, 1.0
    robot, _ = in_tube(friction=friction)
    velocity = np.tile([speed, 0.0, 0.0], (robot.graph.node_count, 1))
    traj = rn.Simulation(robot, 1e-3, velocity=velocity).run(0.45)
    v = traj.v[:, :, 0].mean(axis=1)
    early = traj.t < 0.2
    assert np.polyfit(traj.t[early], v[early], 1)[0] == pytest.approx(-friction * G, rel=2e-3)
    assert (traj.x[-1] - traj.x[0])[:, 0].mean() == pytest.approx(speed**2 / (2 * friction * G), rel=5e-3)
    assert np.abs(traj.v[-1]).max() < 1e-4


@pytest.mark.parametrize(("friction", "share"), [(0.0, 1.0), (0.8, 2.0 / 3.0)])
def test_a_rod_swings_in_a_tube_sliding_or_rolling(friction, share):
    """Small swings about the bottom: w^2 = g / (R - r) without friction, two thirds of it for a rolling cylinder."""
    robot, _ = in_tube(aside=0.1, friction=friction, edges=3)
    omega = np.sqrt(share * G / (R - RADIUS))
    traj = rn.Simulation(robot, 5e-4, stepper="sdirk2").run(2.0 * np.pi / omega)
    y = traj.x[:, :, 1].mean(axis=1)
    crossing = np.flatnonzero(np.diff(np.sign(y)))
    zeros = [traj.t[k] - y[k] * (traj.t[k + 1] - traj.t[k]) / (y[k + 1] - y[k]) for k in crossing]
    assert np.diff(zeros)[0] == pytest.approx(np.pi / omega, rel=0.01)


def test_a_gripper_holds_up_to_its_friction():
    """Two fingers bend by what the object is thicker than their opening; it slips at mu times both normal forces."""
    friction, reach, squeeze = 0.5, 0.05, 1e-3
    figure = rn.StickFigure()
    steel = {"material": rn.Material(E=2e9, rho=1000.0), "radius": 2e-3}
    figure.rod("object", [(-0.05, 0, 0), (0.05, 0, 0)], edges=5, material=rn.Material(E=2e9), radius=3e-3)
    apart = 5e-3 + 6e-4  # the fingers' axes from that of the object, out of reach
    for name, side in (("upper", 1.0), ("lower", -1.0)):
        figure.rod(name, [(0, -reach, side * apart), (0, 0.01, side * apart)], edges=12, **steel)
    close = lambda t: min(t / 0.1, 1.0) ** 2 * (3.0 - 2.0 * min(t / 0.1, 1.0)) * (squeeze + 6e-4)  # noqa: E731
    jaws = [
        rn.PrescribedMotion(
            at=f"{name}.start",
            position=lambda t, s=side: np.array([0.0, 0.0, -s * close(t)]),
            orientation=lambda t: np.eye(3),
            name=name,
        )
        for name, side in (("upper", 1.0), ("lower", -1.0))
    ]
    EI = 2e9 * np.pi / 4 * 2e-3**4
    grip = 3.0 * EI * squeeze / reach**3
    pull = lambda t: 2.4 * friction * 2.0 * grip * max(t - 0.15, 0.0) / 0.35  # noqa: E731
    load = rn.PointForce(at="object:2", force=lambda t: (pull(t), 0, 0))
    terms = [*elastic(), rn.MassDamping(rate=300.0), rn.RodContact(friction=friction), *jaws, load]
    traj = rn.Simulation(rn.Robot(figure.build(), terms), 2e-3).run(0.45)
    nodes = traj.rods["object"].nodes
    forces = traj.term_forces("contact")
    normal = np.abs(forces[:, traj.rods["upper"].nodes, 2].sum(axis=1))
    normal += np.abs(forces[:, traj.rods["lower"].nodes, 2].sum(axis=1))
    tangential = -forces[:, nodes, 0].sum(axis=1)
    closed = int(np.argmax(traj.t > 0.14))
    bent = traj.at("upper:10") - traj.at("upper.start")  # where they cross
    assert normal[closed] == pytest.approx(2.0 * 3.0 * EI * bent[closed, 2] / reach**3, rel=0.02)
    assert squeeze < bent[closed, 2] < squeeze + 5e-4  # and the contact's reach
    applied = np.array([pull(t) for t in traj.t])
    speed = traj.v[:, nodes, 0].mean(axis=1)
    limit = friction * normal
    held = (traj.t > 0.15) & (applied < 0.9 * limit)
    gone = applied > 1.15 * limit
    assert np.abs(speed[held]).max() < 0.02 and gone.any()
    assert np.all(tangential <= limit * (1 + 1e-6))
    assert tangential[gone][:10] == pytest.approx(limit[gone][:10], rel=0.02)
    assert speed[gone][-1] > 0.1
