"""Joints that turn: what they transmit and what not, against statics and kinematics on paper."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.kinematics.frames import rotation
from rodnet.solve.ordering import elimination_blocks
from rodnet.testing.states import Probe, random_rotation
from tests.mechanics.beams import EI, L, R, elastic, end, rest
from tests.mechanics.linkages import ROD, beams, turned

Z, Y, X = np.eye(3)[::-1]


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
