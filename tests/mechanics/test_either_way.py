"""What is drawn the other way round, posed, or held at another end behaves the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from tests.mechanics.test_drives import FREE, LOAD, MU, RPM, STALL, motor, shaft, spin

ELASTIC = rn.Stretching, rn.Bending, rn.Twisting
RUBBER = rn.Material(E=1e6, nu=0.5, rho=1000.0)


def straight(*terms, **rod):
    fig = rn.StickFigure()
    options = {"edges": 8, "material": RUBBER, "radius": 3e-3, **rod}
    fig.rod("rod", [(0, 0, 0), (0.2, 0, 0)], **options)
    return rn.Robot(fig.build(), [*(law() for law in ELASTIC), *terms])


# -- motors -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("first", [True, False])
def test_a_motor_may_make_more_than_a_quarter_turn_in_a_step_whichever_body_is_named_first(first):
    """The rotor has gone as far as it was told, and nothing twists."""
    drag = rn.ResistiveForce(viscosity=MU, axial_torque=True, on="rotor")

    def make(between):
        return rn.Motor(between=between if first else between[::-1], rpm=60.0)

    robot = shaft(make, drag, rho=1.0)
    rotor = robot.graph.rods["rotor"].edges
    ends = [rn.Simulation(robot, dt).run(3.0).theta[-1, rotor].mean() for dt in (0.05, 0.3)]
    assert abs(ends[0]) == pytest.approx(6.0 * np.pi, abs=0.2)
    assert ends[1] == pytest.approx(ends[0], abs=0.02)


@pytest.mark.parametrize(
    "more", [rn.JointCompliance(at="stator.end", length=3e-3), rn.StiffnessGradient(on="rotor", slope=0.4)]
)
def test_a_motor_that_gives_way_does_so_against_all_that_makes_its_joint_stiff(more):
    """It settles on its line, however soft the mount: the joint's stiffness says how fast, not where."""
    drag = rn.ResistiveForce(viscosity=MU, axial_torque=True, on="rotor")
    robot = shaft(motor(rpm=90.0, stall_torque=STALL, no_load_rpm=FREE), drag, more, rho=1.0)
    speed, _ = spin(robot)
    assert speed[-1] == pytest.approx(90.0 / (1.0 + LOAD * FREE * RPM / STALL), rel=1e-5)


@pytest.mark.parametrize("of", ["stator", "rotor"])
def test_a_motor_that_gives_way_turns_a_hinge_whichever_body_is_its_first(of):
    figure, material = rn.StickFigure(), rn.Material(E=1e9, rho=1.0)
    figure.rod("stator", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=material, radius=3e-3)
    figure.rod("rotor", ["stator.end", (0.2, 0, 0)], edges=4, material=material, radius=3e-3)
    figure.joint("stator.end", kind="hinge", axis=(1, 0, 0), stiffness=50.0, of=of)
    drag = rn.ResistiveForce(viscosity=MU, axial_torque=True, on="rotor")
    drive = rn.DCMotor(between=("stator:3-4", "rotor:0-1"), rpm=90.0, stall_torque=STALL, no_load_rpm=FREE)
    terms = [*(law() for law in ELASTIC), rn.JointElasticity(), rn.Clamp(at="stator.start"), drag, drive]
    robot = rn.Robot(figure.build(), terms)
    traj = rn.Simulation(robot, 0.01).run(0.8)
    speed = np.abs(traj.w[-1, robot.graph.rods["rotor"].edges].mean()) / RPM
    torque = np.abs(traj.internal.torque[-1]).max()
    assert speed == pytest.approx(90.0 - torque / STALL * FREE, rel=1e-4) and torque > 1e-5


# -- poses ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "law", [rn.EarlierSet(share=0.5), rn.DryFriction(moment=1e-3), rn.PlasticSet(share=0.5, time=0.1)]
)
def test_rods_that_are_straight_beside_a_turned_hinge_have_been_through_nothing(law):
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=RUBBER, radius=3e-3)
    figure.rod("b", ["a.end", (0.2, 0, 0)], edges=4, material=RUBBER, radius=3e-3)
    figure.joint("a.end", kind="hinge", axis=(0, 1, 0))
    graph = figure.build()
    x, turn = graph.x0.copy(), Rotation.from_euler("y", 60, degrees=True)
    moved = graph.rods["b"].nodes
    x[moved] = x[moved[0]] + turn.apply(x[moved] - x[moved[0]])
    terms = [*(make() for make in ELASTIC), rn.JointElasticity(), rn.Clamp(at="a.start"), law]
    traj = rn.Simulation(rn.Robot(graph.with_positions(x), terms), 0.01).run(0.1)
    np.testing.assert_allclose(traj.x[-1], traj.x[0], atol=1e-9)


def test_a_change_of_material_and_a_finer_mesh_keep_a_twist_at_the_start():
    robot = straight(rn.Clamp(at="rod.start"), rn.Clamp(at="rod.end"))
    graph = robot.graph.twisted(np.linspace(0.0, 0.8, robot.graph.edge_count))
    twisted = rn.Robot(graph, robot.terms)
    same = twisted.with_parameters({"rod.E": 1e6})
    np.testing.assert_allclose(same.graph.d1, graph.d1, atol=1e-15)
    energies = [
        rn.Simulation(r, 0.01).run(0.01).energies["twisting"][0] for r in (twisted, same, twisted.refined())
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-12) and energies[0] > 1e-6
    assert energies[2] == pytest.approx(energies[0], rel=0.1)


def test_the_shape_of_a_head_turns_with_the_robot():
    """Told in the axes of the figure as it is drawn; it is as slow along its long axis, wherever that points."""
    R = np.diag([1.0, 5.0, 5.0, 1.0, 1.0, 1.0])
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.05, 0, 0)], edges=2, material=RUBBER, radius=3e-3)
    graph = fig.build()
    turn = Rotation.from_euler("z", 90, degrees=True)
    ends = []
    for posed, back in (
        (graph, Rotation.identity()),
        (graph.with_positions(turn.apply(graph.x0.copy())), turn.inv()),
    ):
        head = rn.StokesHead(at="rod.start", edge="rod:0-1", shape=R, viscosity=1e-3)
        robot = rn.Robot(posed, [*(law() for law in ELASTIC), head])
        v = back.inv().apply(np.tile([0.1, 0.05, 0.0], (posed.node_count, 1)))
        traj = rn.Simulation(robot, 0.01, velocity=v).run(0.2)
        ends.append(back.apply(traj.x[-1] - traj.x[0]))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


# -- ends -------------------------------------------------------------------------------------------
def test_a_coupled_section_is_the_same_at_both_ends():
    """A rod between two clamps sags aside symmetrically."""
    robot = straight(
        rn.Clamp(at="rod.start"), rn.Clamp(at="rod.end"), rn.SectionStiffness(skew=0.6), rn.Gravity()
    )
    sag = rn.equilibrium(robot).x[-1] - robot.graph.x0
    assert np.abs(sag[:, 1]).max() > 0.02 * np.abs(sag[:, 2]).max()
    np.testing.assert_allclose(sag[:, 1:], sag[::-1, 1:], atol=1e-3 * np.abs(sag).max())


def test_an_eyelet_on_a_shared_clamp_is_beside_its_own_rod():
    """Where a wall holds another rod, too: what it pulls at is beside the rod, not along it."""
    ends = []
    for both in (True, False):
        fig = rn.StickFigure()
        if both:
            fig.rod("a", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=RUBBER, radius=3e-3)
        fig.rod("b", ["a.start" if both else (0, 0, 0), (0, 0.1, 0)], edges=4, material=RUBBER, radius=3e-3)
        tendon = rn.Tendon(route=[(f"b:{k}", (0.01, 0.0)) for k in range(5)], tension=0.02)
        terms = [*(law() for law in ELASTIC), rn.Clamp(at="b.start"), tendon]
        robot = rn.Robot(fig.build(), terms)
        ends.append(rn.equilibrium(robot).x[-1, robot.graph.node("b.end")])
    assert np.linalg.norm(ends[0] - [0, 0.1, 0]) > 0.01
    np.testing.assert_allclose(np.abs(ends[0]), np.abs(ends[1]), atol=1e-8)  # directors may be turned by pi


@pytest.mark.parametrize("held", [rn.Clamp(at="rod.start"), rn.Hinge(at="rod.start", axis=(0, 0, 1))])
def test_a_rigid_root_is_stiff_at_a_wall_too(held):
    """The half edge there does not give; the rest of the rod does."""
    sag = []
    for root in ("clamped", "rigid"):
        robot = straight(held, rn.PointForce(at="rod.end", force=(0, 0, -1e-3)), root=root, edges=3)
        if isinstance(held, rn.Hinge):  # which turns aside, not down
            robot = robot.with_terms(rn.Tether(on="rod", point=(0.2, 0, 0), stiffness=1e-3, place=1.0))
        sag.append(-rn.equilibrium(robot).x[-1, -1, 2])
    assert sag[1] < sag[0]


def test_one_radius_for_one_contact():
    wall = rn.PlaneContact(normal=(0, 0, 1), point=(0, 0, -0.01), rod_radius=np.linspace(1e-3, 3e-3, 8))
    with pytest.raises(rn.TermError, match="rod_radius is one number"):
        straight(wall)


@pytest.mark.parametrize("held", [False, True])
def test_a_support_in_the_middle_of_a_bent_rod_makes_no_bend_of_its_own(held):
    """A rod that is straight by nature straightens on a hinge as it does without one."""
    s = np.linspace(-1.0, 1.0, 9)
    fig = rn.StickFigure()
    points = 0.1 * np.stack([s, 0.0 * s, 0.4 * s**2], axis=1)
    fig.rod("rod", list(points), material=RUBBER, radius=3e-3, natural="straight")
    support = [rn.Hinge(at="rod:4", axis=(0, 1, 0))] if held else []
    robot = rn.Robot(fig.build(), [*(law() for law in ELASTIC), rn.MassDamping(rate=20.0), *support])
    d = np.diff(rn.Simulation(robot, 0.01).run(2.0).x[-1], axis=0)
    d /= np.linalg.norm(d, axis=1)[:, None]
    assert np.degrees(np.arccos(np.clip((d[1:] * d[:-1]).sum(axis=1), -1.0, 1.0))).max() < 0.1
