"""Joints that turn: what they transmit and what not, against statics and kinematics on paper."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.kinematics.frames import rotation
from rodnet.solve.ordering import elimination_blocks
from rodnet.testing.states import Probe, random_rotation
from tests.mechanics.beams import EI, GJ, MATERIAL, L, R, elastic, end, rest
from tests.mechanics.linkages import BARS, four_bar

ROD = {"material": MATERIAL, "radius": R}
Z, Y, X = np.eye(3)[::-1]


def beams(n, kind, loads, length=L, **joint):
    """Two beams in line along x, joined in the middle, the first one clamped."""
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (length / 2, 0, 0)], edges=n // 2, **ROD)
    figure.rod("two", ["one.end", (length, 0, 0)], edges=n // 2, **ROD)
    if kind:
        figure.joint("one.end", kind=kind, **joint)
    return rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="one.start"), *loads])


def network(kind, **joint):
    """Three rods that meet, one of them stored towards the joint, and a ring that closes a loop."""
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.1, 0, 0)], edges=4, **ROD)
    figure.rod("b", ["a.end", (0.15, 0.08, 0.02)], edges=4, natural_curvature=(5.0, 2.0), **ROD)
    figure.rod("c", [(0.12, -0.08, 0.02), "a.end"], edges=3, **ROD)
    figure.rod("d", ["c.start", (0.2, 0.0, 0.05), "b.end"], edges=4, **ROD)
    figure.joint("a.end", kind=kind, **joint)
    return figure.build()


JOINTS = [
    ("hinge", {"axis": (0, 0.2, 1)}),
    ("hinge", {"axis": (1, 0, 0), "of": "b", "stiffness": 0.3, "angle": 0.4}),
    ("ball", {}),
    ("ball", {"of": "b"}),
    ("elastic", {"of": ["b", "c"], "stiffness": (0.1, 0.2, 0.3)}),
    ("elastic", {"of": "b", "stiffness": (0.2, 0.1), "axis": (1, 2, 0)}),
    ("rigid", {}),
]


# -- derivatives and invariance ------------------------------------------------------------------
@pytest.mark.parametrize(("kind", "joint"), JOINTS)
def test_jacobians_and_balance_of_a_network_with_a_joint(kind, joint):
    """At states far from rest; internal forces have no resultant, and turn with the robot."""
    rng = np.random.default_rng(5)
    graph = network(kind, **joint)
    soft = [rn.Bending(), rn.Twisting()]  # without the axial stiffness, which would hide errors
    probe = Probe(rn.Robot(graph, soft), rng, turn=1.4, source_turn=1.0)
    for error, where in probe.jacobian_errors().values():
        assert error < 1e-7, where
    F = probe.forces()
    force, moment = probe.resultant(F)
    assert np.abs(force).max() < 1e-10 * np.abs(F).max()
    assert np.abs(moment).max() < 1e-10 * np.abs(F * probe.units).max()
    turn = random_rotation(rng)
    turned = probe.rotated(turn, rng.normal(size=3))
    assert turned.energy() == pytest.approx(probe.energy(), rel=1e-10)
    assert turned.forces() == pytest.approx(probe.turn_vector(F, turn), abs=1e-9 * np.abs(F).max())


def test_the_elasticity_of_joints_keeps_the_contract_of_terms():
    for kind, joint in JOINTS[1], JOINTS[4], JOINTS[5]:
        rn.testing.check_term(rn.JointElasticity(), graph=network(kind, **joint))
    rn.testing.check_term(rn.JointElasticity)


@pytest.mark.parametrize(("kind", "joint"), JOINTS)
def test_neither_numbering_nor_direction_of_rods_matters(kind, joint):
    """The same figure drawn in another order, with rods drawn from end to start."""
    tips = {"a": (0, 0, 0), "b": (0.15, 0.08, 0.02), "c": (0.12, -0.08, 0.02)}

    def shape(names, flipped):
        figure, node = rn.StickFigure(), (0.1, 0, 0)
        inner = {n: n + (".end" if n in flipped else ".start") for n in names}
        outer = {n: n + (".start" if n in flipped else ".end") for n in names}
        for name in names:
            line = [node, tips[name]]
            figure.rod(name, line[::-1] if name in flipped else line, edges=4, **ROD)
            node = inner[name]
        figure.joint(node, kind=kind, **joint)
        loads = [
            rn.PointForce(at=outer["b"], force=(0, 0, 0.02)),
            rn.Gravity(),
            rn.ResistiveForce(eta_t=0.5, eta_n=1.0),
        ]
        robot = rn.Robot(figure.build(), [*elastic(), rn.Clamp(at=outer["a"]), *loads])
        traj = rn.Simulation(robot, 5e-3, tolerance=rn.Tolerance(residual=1e-12)).run(0.05)
        return np.array([traj.at(outer[n])[-1] for n in "bc"])

    reference = shape("abc", "")
    assert np.abs(reference[0] - tips["b"]).max() > 1e-3
    for names, flipped in (("cab", ""), ("bca", "ab"), ("abc", "c")):
        assert shape(names, flipped) == pytest.approx(reference, abs=2e-9)


# -- hinges --------------------------------------------------------------------------------------
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


def turned(robot, direction, angle):
    """Equilibria on the way, while the first edge of "two" is turned about a direction."""
    motion = rn.PrescribedMotion(at="two:0-1", orientation=lambda t: rotation(angle * t * direction))
    robot, state, found = robot.with_terms(motion), None, []
    for t in np.arange(1, 7) / 6:
        found.append(rn.equilibrium(robot, t=t, start=state, residual=1e-10))
        state = found[-1].state()
    return found


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


# -- balls, elastic and rigid joints -------------------------------------------------------------
def test_a_ball_joint_is_a_pendulum_in_every_direction():
    """Small swings of a stiff rod in two planes, with the period of its lumped masses."""
    figure = rn.StickFigure()
    stiff = {"material": rn.Material(E=1e9, rho=1000.0), "radius": R}
    figure.rod("beam", [(0, 0, 0), (0.1, 0, 0)], edges=2, **stiff)
    tilt = rotation(np.array([0.03, 0.02, 0.0]))
    figure.rod("rod", ["beam.end", np.array([0.1, 0, 0]) + tilt @ [0, 0, -0.2]], edges=4, **stiff)
    figure.joint("beam.end", kind="ball")
    graph = figure.build()
    robot = rn.Robot(graph, [*elastic(), rn.Clamp(at=["beam:0-1", "beam:1-2"]), rn.Gravity()])
    mass = graph.node_mass[graph.rods["rod"].nodes[1:]]
    arm = 0.05 * np.arange(1, 5)
    omega = np.sqrt(9.81 * (mass @ arm) / (mass @ arm**2))
    traj = rn.Simulation(robot, 2e-3, stepper="sdirk2").run(2 * np.pi / omega)
    swing = traj.at("rod.end") - traj.at("beam.end")
    assert swing[-1] == pytest.approx(swing[0], abs=1e-4 * 0.2)
    wanted = np.cos(omega * traj.t)[:, None] * swing[0, :2]
    assert swing[:, :2] == pytest.approx(wanted, abs=2e-4 * 0.2)


def test_an_elastic_joint_turns_by_moment_over_stiffness():
    """Large turns about each of three axes, exactly moment / stiffness; half edges of stiff rods in series."""
    k = 1e-5 * np.array([1.0, 2.0, 3.0]) * EI / L
    axes = random_rotation(np.random.default_rng(2))
    for a in range(3):
        for angle in (0.1, 1.5, 3.0):
            traj = turned(beams(4, "elastic", [], axes=axes, stiffness=k), axes[a], angle)[-1]
            moment = traj.reactions["motion"].moment[-1]
            assert moment == pytest.approx(k[a] * angle * axes[a], abs=2e-5 * k[a] * angle)
            assert traj.energies["joints"][-1] == pytest.approx(0.5 * k[a] * angle**2, rel=1e-4)


def test_an_elastic_joint_stops_at_half_a_turn():
    """Beyond it the rotation vector would jump to the other side, and the moment with it."""
    robot = beams(4, "elastic", [], stiffness=1e-5 * EI / L)
    for axis in (X, Z):
        with pytest.raises(rn.FoldedStateError, match=r"turns by more than half a turn|fold back"):
            turned(robot, axis, 4.0)


def test_half_edges_are_in_series_with_the_joint():
    """Deflection of a cantilever with an elastic joint: PL^3/3EI + P (L/2)^2 / k, and softer than either."""
    P, k = 1e-5 * EI / L**2, 3.0 * EI / L
    for direction in (Y, Z):
        traj = rest(beams(40, "elastic", [rn.PointForce(at="two.end", force=P * direction)], stiffness=k))
        bend = end(rest(beams(40, None, [rn.PointForce(at="two.end", force=P * direction)])), "two.end")
        found = (end(traj, "two.end") - bend) @ direction
        assert found == pytest.approx(P * (L / 2) ** 2 / k, rel=1e-8)


def test_a_rigid_joint_of_unlike_stiffnesses_is_exact():
    """A branch that carries no load leaves the beam as it was; welds of all pairs only nearly do."""
    P = 1e-4 * EI / L**2
    tips = []
    for kind in (None, "branch", "rigid"):
        figure = rn.StickFigure()
        figure.rod("one", [(0, 0, 0), (L / 2, 0, 0)], edges=8, **ROD)
        figure.rod("two", ["one.end", (L, 0, 0)], edges=8, **ROD)
        if kind:
            figure.rod("branch", ["one.end", (L / 2, 0.05, 0)], edges=4, **ROD)
        if kind == "rigid":
            figure.joint("one.end", kind="rigid")
        load = rn.PointForce(at="two.end", force=P * Z)
        tips.append(
            end(rest(rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="one.start"), load])), "two.end")[2]
        )
    plain, pairs, rigid = tips
    assert rigid == pytest.approx(plain, rel=1e-9)
    assert abs(pairs / plain - 1.0) > 1e-5


def test_joints_have_factors_of_their_own():
    """A robot completes the terms for the joints that have none."""
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.1, 0, 0)], edges=3, **ROD)
    figure.rod("b", ["a.end", (0.2, 0, 0)], edges=3, **ROD)
    figure.rod("c", ["b.end", (0.3, 0, 0)], edges=3, **ROD)
    for node in ("a.end", "b.end"):
        figure.joint(node, kind="hinge", axis=Y, stiffness=1e-4 * EI / L)
    F = 1e-7 * EI / L / 0.2  # about a.end, hence an angle of a thousandth
    load = rn.PointForce(at="c.end", force=-F * Z)
    elbow = rn.JointElasticity("b.end", scale=0.25, name="elbow")
    robot = rn.Robot(figure.build(), [*elastic(), elbow, load, rn.Clamp(at="a.start")])
    assert [t.name for t in robot.terms][-1] == "joints"
    traj = rest(robot)
    assert traj.joint_angle("a.end")[-1] == pytest.approx(1e-3, rel=1e-3)
    assert traj.joint_angle("b.end")[-1] == pytest.approx(2e-3, rel=1e-3)
    assert traj.energies["elbow"][-1] == pytest.approx(traj.energies["joints"][-1], rel=1e-3)
    stiffer = rest(robot.with_parameters({"elbow.scale": 1.0}))
    assert stiffer.joint_angle("b.end")[-1] == pytest.approx(0.5e-3, rel=1e-3)


# -- runs ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_steppers_and_restart(stepper, tmp_path):
    """A continued run is bit-equal to one in a piece, for every kind of joint at once."""
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0, 0, -0.1)], edges=3, **ROD)
    figure.rod("b", ["a.end", (0.08, 0, -0.1)], edges=3, **ROD)
    figure.rod("c", ["b.end", (0.12, 0.05, -0.1)], edges=3, **ROD)
    figure.rod("d", ["c.end", (0.12, 0.1, -0.15)], edges=3, **ROD)
    figure.joint("a.end", kind="hinge", axis=(0, 1, 0), stiffness=0.01)
    figure.joint("b.end", kind="elastic", stiffness=0.02)
    figure.joint("c.end", kind="ball")
    robot = rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="a.start"), rn.Gravity()])
    sim = rn.Simulation(robot, 2e-3, stepper=stepper)
    whole = sim.run(0.2)
    assert sim.model.solver.fallbacks == 0
    first = rn.Simulation(robot, 2e-3, stepper=stepper)
    first.run(0.1, out=tmp_path / "run.nc")
    again = rn.Simulation(robot, 2e-3, stepper=stepper)
    again.restore(rn.Trajectory.load(tmp_path / "run.nc", robot).state(-1))
    assert np.array_equal(again.run(0.1).x[-1], whole.x[-1])
    kinetic, weight = whole.energies["kinetic"], robot.graph.node_mass @ whole.x[:, :, 2].T * 9.81
    total = sum(whole.energies.values()) + weight
    assert np.ptp(total) < {"euler": 0.2, "sdirk2": 0.02, "alpha": 0.02}[stepper] * kinetic.max()


def test_no_loop_and_a_loop_are_both_eliminated_in_blocks():
    """Hinges make no loops, though the bodies of each lie side by side."""
    tree = rn.Simulation(beams(8, "hinge", [], axis=Z))
    ring = rn.Simulation(rn.Robot(network("hinge", axis=Z), elastic()))
    for sim, is_tree in ((tree, True), (ring, False)):
        sim.run(0.01)
        model = sim.model
        dofs = model.reduced[: model.twist0].reshape(-1, 3), model.reduced[model.twist0 :]
        assert (elimination_blocks(model.edges, *dofs) is not None) == is_tree
        assert model.solver.fallbacks == 0


# -- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ({"kind": "pin"}, "kind must be one of"),
        ({"kind": "hinge"}, "say about which axis"),
        ({"kind": "hinge", "axis": (0, 0, 0)}, "not zero"),
        ({"kind": "hinge", "axis": (0, 0, 1), "stiffness": -1.0}, "not negative"),
        ({"kind": "hinge", "axis": (0, 0, 1), "stiffness": (1.0, 2.0)}, "one number"),
        ({"kind": "hinge", "axis": (0, 0, 1), "angle": 0.3}, "only if it has a stiffness"),
        ({"kind": "hinge", "axis": (0, 0, 1), "stiffness": 1.0}, "say which of them turn"),
        ({"kind": "ball", "stiffness": 1.0}, "has no stiffness"),
        ({"kind": "elastic"}, "needs its stiffness"),
        ({"kind": "elastic", "stiffness": 0.0}, "is a ball joint"),
        ({"kind": "elastic", "stiffness": (1, 1, 1), "axes": np.ones((3, 3)), "of": "two"}, "orthogonal"),
        ({"kind": "hinge", "axis": (0, 0, 1), "of": "four"}, "no rod 'four'"),
        ({"kind": "hinge", "axis": (0, 0, 1), "of": "far"}, "'far' does not end there"),
        ({"kind": "hinge", "axis": (0, 0, 1), "hub": "one:0-1"}, "only a weld has a hub"),
        ({"kind": "weld", "axis": (0, 0, 1)}, "a weld has a hub"),
        ({"kind": "rigid", "of": "two"}, "nothing turns"),
    ],
)
def test_joints_that_make_no_sense(joint, message):
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.1, 0, 0)], edges=2, **ROD)
    figure.rod("two", ["one.end", (0.2, 0, 0)], edges=2, **ROD)
    figure.rod("three", ["one.end", (0.1, 0.1, 0)], edges=2, **ROD)
    figure.rod("far", ["two.end", (0.2, 0.1, 0)], edges=2, **ROD)
    with pytest.raises(rn.GraphError, match=message):
        figure.joint("one.end", **joint)
        figure.build()


def test_joints_in_the_wrong_place():
    with pytest.raises(rn.GraphError, match="is clamped"):
        beams(8, "hinge", [rn.Clamp(at="one.end", name="second")], axis=Z)
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.1, 0, 0)], edges=2, **ROD)
    figure.joint("one.end", kind="ball")
    with pytest.raises(rn.GraphError, match="only one edge ends there"):
        figure.build()
    with pytest.raises(rn.GraphError, match="there is one already"):
        figure.joint("one.end", kind="rigid")
    with pytest.raises(rn.GraphError, match="there is no joint at"):
        rest(beams(8, None, [])).joint_angle("one.end")
