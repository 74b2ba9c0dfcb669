"""Joints in another initial position than the one that is drawn."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.kinematics.frames import rotation
from tests.mechanics.beams import elastic
from tests.mechanics.linkages import BARS, four_bar

ROD = {"material": rn.Material(E=1e6), "radius": 2e-3, "edges": 4}
BENDS = {"straight": [(0.2, 0, 0)], "bent": [(0.2, 0, 0), (0.2, 0.06, 0.02)]}


def arm(bend="straight", kind="hinge", **joint):
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.05, 0.04, 0), (0.1, 0, 0)], **ROD)
    figure.rod("b", ["a.end", *BENDS[bend]], **ROD)
    figure.joint("a.end", kind=kind, **joint)
    return figure.build()


def turned(graph, axis, angle):
    """The graph with "b" turned about an axis through the joint."""
    x, pivot = graph.x0.copy(), graph.x0[graph.node("a.end")]
    axis = np.array(axis) / np.linalg.norm(axis)
    beyond = graph.rods["b"].nodes[1:]
    x[beyond] = pivot + (x[beyond] - pivot) @ rotation(angle * axis).T
    return graph.with_positions(x)


def simulation(graph, **options):
    return rn.Simulation(rn.Robot(graph, [*elastic(), rn.Clamp(at="a.start")]), 1e-3, **options)


@pytest.mark.parametrize("angle", [0.5, -2.0, 3.1, -3.1])
@pytest.mark.parametrize(
    ("bend", "axis"),
    [("straight", (0, 1, 0)), ("straight", (1, 1, 0)), ("bent", (0.3, -1, 2)), ("bent", (1, 0, 0))],
)
def test_a_hinge_is_posed_at_any_angle(bend, axis, angle):
    """No strain but that of the hinge's own spring, at once and later; with the angle at once, too."""
    for stepper in ("sdirk2", "alpha"):
        free = simulation(turned(arm(bend, axis=axis), axis, angle), stepper=stepper)
        assert free.observe().joint_angle("a.end") == pytest.approx(angle, abs=1e-9)
        traj = free.run(0.01)
        assert max(np.abs(e).max() for e in traj.energies.values()) < 1e-15
        assert traj.joint_angle("a.end") == pytest.approx(angle, abs=1e-9)
    k, rest = 1e-6, 2.0
    graph = arm(bend, axis=axis, stiffness=k, angle=rest)
    held = simulation(turned(graph, axis, angle)).run(1e-3)
    assert held.energies["joints"][0] == pytest.approx(0.5 * k * (angle - rest) ** 2, rel=1e-9)
    twice = turned(turned(graph, axis, 0.5 * angle), axis, 0.5 * angle)
    assert simulation(twice).observe().joint_angle("a.end") == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_wound_up_hinge_is_let_go(stepper):
    """Its frames jump to where the half edges balance the spring; nothing may extrapolate that, to another turn."""
    axis = (0.3, -1, 2)
    graph = turned(arm("bent", axis=axis, stiffness=1e-4, angle=0.7), axis, -3.0)
    for seen in simulation(graph, stepper=stepper).iterate(0.01):
        angle = seen.joint_angle("a.end")
        assert -3.0 < angle < 0.0
        assert angle - 0.7 == pytest.approx(seen.state.tau[-1], abs=1e-9)


def test_an_elastic_joint_is_posed_at_any_angle():
    k, axis = np.array([1.0, 2.0, 3.0]) * 1e-6, np.array([0.0, 0.6, 0.8])
    for angle in (0.5, 3.0):
        traj = simulation(turned(arm(kind="elastic", stiffness=k, axes=np.eye(3)), axis, angle)).run(1e-3)
        assert traj.energies["joints"][0] == pytest.approx(0.5 * k @ (angle * axis) ** 2, rel=1e-9)
        assert traj.energies["bending"][0] < 1e-15 and traj.energies["twisting"][0] < 1e-15


def test_a_posed_hinge_falls_as_one_that_is_drawn_there():
    """The two differ in nothing but the angle that counts as zero."""
    angle = 2.0
    posed = turned(arm("bent", axis=(1, 1, 0)), (1, 1, 0), angle)
    x = posed.x0
    figure = rn.StickFigure()
    for name in "ab":
        rod = posed.rods[name].nodes
        start = x[rod[0]] if name == "a" else "a.end"
        figure.rod(name, [start, *x[rod[1:]]], material=ROD["material"], radius=2e-3)
    axis = np.array([1.0, 1.0, 0.0])
    figure.joint("a.end", kind="hinge", axis=axis)
    ends = []
    for graph in (posed, figure.build()):
        robot = rn.Robot(graph, [*elastic(), rn.Clamp(at="a.start"), rn.Gravity()])
        traj = rn.Simulation(robot, 1e-3, stepper="sdirk2", tolerance=rn.Tolerance(residual=1e-12)).run(0.05)
        ends.append((traj.x[-1], traj.joint_angle("a.end")[-1]))
    (x1, angle1), (x2, angle2) = ends
    assert x1 == pytest.approx(x2, abs=1e-9)
    assert angle1 == pytest.approx(angle2 + angle, abs=1e-7)


def test_a_linkage_is_posed(tmp_path):
    """A loop of four hinges, moved to where its crank has turned by one radian; from a file as well."""
    stiff = {"material": rn.Material(E=1e9), "radius": 3e-3, "edges": 2}
    (a0, b0), (a1, b1) = four_bar(0.5, *BARS), four_bar(1.5, *BARS)
    o, c = np.zeros(3), np.array([BARS[3], 0.0, 0.0])
    figure = rn.StickFigure()
    figure.rod("ground", [o, c], **stiff)
    figure.rod("crank", ["ground.start", a0], **stiff)
    figure.rod("coupler", ["crank.end", b0], **stiff)
    figure.rod("rocker", ["coupler.end", "ground.end"], **stiff)
    for node in ("ground.start", "crank.end", "coupler.end", "rocker.end"):
        figure.joint(node, kind="hinge", axis=(0, 0, 1))
    drawn = figure.build()
    x = drawn.x0.copy()
    for name, start, end in (("crank", o, a1), ("coupler", a1, b1), ("rocker", b1, c)):
        x[drawn.rods[name].nodes] = np.linspace(start, end, 3)
    robot = rn.Robot(drawn.with_positions(x), [*elastic(), rn.Clamp(at=["ground:0-1", "ground:1-2"])])
    sim = rn.Simulation(robot, 1e-3, stepper="sdirk2")
    assert sim.observe().joint_angle("ground.start") == pytest.approx(1.0, abs=1e-12)
    traj = sim.run(0.01)
    assert max(np.abs(e).max() for e in traj.energies.values()) < 1e-15
    again = rn.Simulation(rn.Robot.load(robot.save(tmp_path / "robot.toml")), 1e-3, stepper="sdirk2")
    assert np.array_equal(again.state.q, traj.state(0).q)


def test_poses_that_tilt_an_axis_are_refused():
    graph = arm(axis=(0, 1, 0))
    with pytest.raises(rn.GraphError, match=r"tilt the axis of the hinge at 'a.end' by 40 degrees"):
        turned(graph, (0, 0, 1), np.radians(40.0))
