"""Hinges: what they transmit and what not, against statics and kinematics on paper."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.kinematics.frames import rotation
from tests.mechanics.beams import EI, GJ, L, R, elastic, end, rest
from tests.mechanics.linkages import BARS, beams, four_bar, turned

Z, Y, X = np.eye(3)[::-1]


def test_a_hinge_transmits_moments_but_that_about_its_axis():
    """A beam clamped at both ends, with a hinge in the middle, loaded there across and along its axis."""
    P = 1e-5 * EI / L**2
    hinged, welded = (P / 2) * (L / 2) ** 3 / (3 * EI), P * L**3 / (192 * EI)
    errors = []
    for n in (16, 32):
        for kind in (None, "hinge"):
            joint = {"axis": Y} if kind else {}
            loads = [rn.Clamp(at="two.end"), rn.PointForce(at="one.end", force=P * (Y + Z))]
            traj = rest(beams(n, kind, loads, **joint))
            _, y, z = end(traj, "one.end")
            if kind:
                errors.append((y / welded - 1.0, z / hinged - 1.0))
                moments = traj.internal.along("one")
                assert abs(moments.moment[-1, -1] @ Y) < 1e-9 * P * L
                assert abs(moments.moment[-1, -1] @ Z) == pytest.approx(P * L / 8, rel=1e-6)
            else:
                assert y == pytest.approx(z, rel=1e-9)
                plain = y
        assert errors[-1][0] == pytest.approx(plain / welded - 1.0, abs=1e-8)
    coarse, fine = np.array(errors)
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.05)


def test_a_swivel_transmits_bending_but_no_torque():
    """A hinge about the beam itself; the part beyond turns freely and bends with the rest."""
    P = 1e-4 * EI / L**2
    torque = 0.3 * GJ / L
    loads = [rn.PointForce(at="two.end", force=P * Z), rn.PointTorque(on="two.end", torque=torque * X)]
    swivel = beams(40, "hinge", loads[:1], axis=X)
    assert end(rest(swivel), "two.end")[2] == pytest.approx(P * L**3 / (3 * EI), rel=2e-3)
    held = rest(beams(40, "hinge", loads[1:], axis=X, stiffness=GJ / L))
    twist = held.theta[-1]
    graph = held.robot.graph
    one, two = graph.rods["one"].edges, graph.rods["two"].edges
    assert twist[one[-1]] == pytest.approx(torque * (L / 2 - L / 80) / GJ, rel=1e-9)
    assert held.joint_angle("one.end")[-1] == pytest.approx(torque / (GJ / L), rel=1e-9)
    assert twist[two[0]] == pytest.approx(torque * (L / 2 + L / 80) / GJ + 0.3, rel=1e-9)


def test_a_hinge_with_a_spring_turns_by_moment_over_stiffness():
    """By more than a turn, exactly."""
    k, axis = 1e-3 * EI / L, np.array([0.0, 0.6, 0.8])
    # in series: the half edge of "two", and "one" with its two edges, turned at an end that is held in place
    half_edges = (1 / 8 + 1 / 6) * L / EI
    for n, traj in enumerate(turned(beams(4, "hinge", [], axis=axis, stiffness=k), axis, 8.0)):
        angle, moment = traj.joint_angle("one.end")[-1], traj.reactions["motion"].moment[-1]
        assert moment == pytest.approx(k * angle * axis, rel=1e-6, abs=1e-9 * k)
        assert angle * (1.0 + half_edges * k) == pytest.approx(8.0 * (n + 1) / 6, rel=1e-6)


def test_a_motor_turns_a_hinge():
    """A servo: the shaft's angle follows the command, its reaction is on the other body."""
    k = 0.2 * EI / L
    loads = [
        rn.Motor(at="one.end", angle=lambda t: 0.8 * min(t, 1.0) ** 2),
        rn.ResistiveForce(eta_t=0.1, eta_n=0.2),
    ]
    robot = beams(8, "hinge", loads, axis=Z, stiffness=k)
    sim = rn.Simulation(robot, 0.02, stepper="sdirk2")
    traj = sim.run(8.0)
    assert sim.observe().joint_angle("one.end") == traj.joint_angle("one.end")[-1]
    assert traj.joint_angle("one.end")[-1] == pytest.approx(0.8, abs=1e-4)
    powers = traj.powers
    kinetic = powers.pop("kinetic")
    assert np.abs(sum(powers.values()) - kinetic).max() < 1e-6 * np.abs(powers["motor"]).max()
    with pytest.raises(rn.TermError, match="a hinge that has a stiffness"):
        beams(8, "hinge", [rn.Motor(at="one.end", rpm=3.0)], axis=Z)


def pendulum(*terms, **hinge):
    """Two stiff rods, welded where a hinge about y holds them."""
    figure = rn.StickFigure()
    stiff = {"material": rn.Material(E=1e13, rho=1000.0), "radius": R}
    figure.rod("long", [(0, 0, 0), (0.02, 0, -0.2)], edges=4, **stiff)
    figure.rod("short", [(-0.05, 0, 0.03), "long.start"], edges=2, **stiff)
    pin = rn.Hinge(at="long.start", axis=Y, **hinge)
    return rn.Robot(figure.build(), [*elastic(), pin, *terms])


def about_the_pin(robot):
    """Moment of inertia about y [kg m^2], and moment of the weights [N m], of the lumped masses."""
    x, m = robot.graph.x0, robot.graph.node_mass
    return m @ (x[:, 0] ** 2 + x[:, 2] ** 2), 9.81 * m @ x[:, 0]


def test_a_hinge_on_the_surroundings_is_a_spring_about_its_axis():
    """Oscillations of (k / I)^(1/2) about the rest angle; its reaction is the spring's moment about the axis."""
    k, angle = 2e-3, 0.1
    robot = pendulum(stiffness=k, angle=angle)
    inertia, _ = about_the_pin(robot)
    omega = np.sqrt(k / inertia)
    traj = rn.Simulation(robot, 0.01 / omega, stepper="sdirk2").run(2 * np.pi / omega)
    assert traj.joint_angle("long.start") == pytest.approx(
        angle * (1 - np.cos(omega * traj.t)), abs=1e-3 * angle
    )
    moment = traj.reactions["hinge"].moment
    assert moment[:, 1] == pytest.approx(k * (angle - traj.joint_angle("long.start")), abs=1e-6 * k)


def test_a_hinge_on_the_surroundings_carries_what_is_across():
    """A side force on a pendulum: moments about x and z at the pin, none about y; and a motor there."""
    F = 1e-3
    robot = pendulum(rn.PointForce(at="long.end", force=F * Y), rn.Gravity(g=1e-9))
    traj = rn.Simulation(robot, 1.0).run(5.0)
    arm = traj.at("long.end")[-1]
    assert traj.reactions["hinge"].moment[-1] == pytest.approx(-np.cross(arm, F * Y), abs=1e-6 * F)
    driven = pendulum(rn.Motor(at="long.start", angle=lambda t: 3.0 * t), stiffness=10.0)
    turned = rn.Simulation(driven, 0.02).run(3.0)
    assert turned.joint_angle("long.start")[-1] == pytest.approx(9.0, abs=1e-3)
    assert turned.at("long.end")[-1] == pytest.approx(rotation(9.0 * Y) @ turned.at("long.end")[0], abs=1e-3)


def test_hinges_on_the_surroundings_keep_the_contract_of_terms():
    rn.testing.check_term(rn.Hinge(at="rod.start", axis=(1, 2, 0)))
    rn.testing.check_term(rn.Hinge(at="rod:2", axis=(1, 2, 0), stiffness=0.1, angle=0.2))
    with pytest.raises(rn.TermError, match="needs the axis"):
        rn.Hinge(at="rod.start", stiffness=1.0)
    with pytest.raises(rn.GraphError, match="two joints at 'one:4'"):
        beams(8, "hinge", [rn.Hinge(at="one.end", axis=Y)], axis=Z)


def test_four_bar_linkage_follows_its_kinematics():
    """A crank that is turned all round; the coupler and rocker angles are those of rigid bars."""
    stiff = {"material": rn.Material(E=1e11), "radius": 3e-3}
    start = four_bar(0.5, *BARS)
    figure = rn.StickFigure()
    figure.rod("ground", [(0, 0, 0), (BARS[3], 0, 0)], edges=2, **stiff)
    figure.rod("crank", ["ground.start", start[0]], edges=2, **stiff)
    figure.rod("coupler", ["crank.end", start[1]], edges=2, **stiff)
    figure.rod("rocker", ["coupler.end", "ground.end"], edges=2, **stiff)
    figure.joint("ground.start", kind="hinge", axis=Z, stiffness=1e3, of="crank")
    for node in ("crank.end", "coupler.end", "rocker.end"):
        figure.joint(node, kind="hinge", axis=Z)
    motor = rn.Motor(at="ground.start", angle=lambda t: t)
    robot = rn.Robot(figure.build(), [*elastic(), motor, rn.Clamp(at=["ground:0-1", "ground:1-2"])])
    traj = rn.Simulation(robot, 0.05).run(2.0 * np.pi + 0.5)
    for k in range(len(traj)):
        wanted = four_bar(0.5 + traj.t[k], *BARS)
        found = [traj.at(name)[k] for name in ("crank.end", "coupler.end")]
        assert found == pytest.approx(np.array(wanted), abs=2e-6)
    assert traj.joint_angle("ground.start")[-1] == pytest.approx(traj.t[-1], abs=1e-5)  # more than a turn
