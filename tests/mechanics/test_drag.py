"""Bodies that sink, spin and steer in a viscous medium against closed formulas."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.terms.drag.resistive import gray_hancock
from tests.mechanics.beams import MATERIAL, WEIGHT, L, R, beam, elastic

G, MU = 9.81, 3.0


def settle(robot, duration=0.5, dt=0.01, **options):
    """Run long enough that the start is forgotten."""
    tight = rn.Tolerance(residual=1e-11, update=1e-14)
    return rn.Simulation(robot, dt, tolerance=tight, **options).run(duration)


def sinking(direction, **options):
    points = [(0, 0, 0), tuple(L * np.array(direction) / np.linalg.norm(direction))]
    return settle(beam(10, rn.Gravity(g=G), rn.ResistiveForce(viscosity=MU, **options), points=points))


@pytest.mark.parametrize("tangent", ["edge", "node"])
def test_a_straight_rod_sinks_by_its_coefficients(tangent):
    """v = w / eta: eta_n across, eta_t along; an inclined rod drifts sideways."""
    eta_t, eta_n = gray_hancock(MU, L, R)
    assert (eta_t, eta_n) == pytest.approx(
        (2 * np.pi * MU / (np.log(200.0) - 0.5), 4 * np.pi * MU / (np.log(200.0) + 0.5))
    )
    flat, upright = (sinking(d, tangent=tangent).v[-1] for d in ((1.0, 0, 0), (0, 0, 1.0)))
    assert flat == pytest.approx(np.tile((0, 0, -WEIGHT * G / eta_n), (11, 1)), abs=1e-9 * G)
    assert upright == pytest.approx(np.tile((0, 0, -WEIGHT * G / eta_t), (11, 1)), abs=1e-9 * G)
    traj = sinking((1.0, 0, 1.0), tangent=tangent)
    along, across = WEIGHT * G * np.sqrt(0.5) / eta_t, WEIGHT * G * np.sqrt(0.5) / eta_n
    t, n = np.array((1.0, 0, 1.0)) * np.sqrt(0.5), np.array((1.0, 0, -1.0)) * np.sqrt(0.5)
    assert traj.v[-1] == pytest.approx(np.tile(-along * t + across * n, (11, 1)), abs=1e-9 * G)
    assert np.diff(traj.x[-1], axis=0) == pytest.approx(np.diff(traj.x[0], axis=0), abs=1e-9)


def test_splitting_a_rod_does_not_change_its_drag():
    """L of Gray and Hancock is the length of the smooth chain; half edges do not see the split."""
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.08, 0, 0)], edges=4, material=MATERIAL, radius=R)
    figure.rod("two", [(L, 0, 0), "one.end"], edges=6, material=MATERIAL, radius=R)
    terms = [*elastic(), rn.Gravity(g=G), rn.ResistiveForce(viscosity=MU)]
    split = settle(rn.Robot(figure.build(), terms))
    whole = sinking((1.0, 0, 0))
    assert split.v[-1][:, 2] == pytest.approx(whole.v[-1, 0, 2], rel=1e-9)


def test_axial_torque_of_a_spinning_rod():
    """omega = T / (4 pi mu r^2 L), without a start or end effect."""
    T = 1e-6
    robot = beam(
        8, rn.ResistiveForce(viscosity=MU, axial_torque=True), rn.PointTorque(on="beam.end", torque=(T, 0, 0))
    )
    traj = settle(robot)
    assert traj.w[-1] == pytest.approx(T / (4 * np.pi * MU * R**2 * L), rel=1e-6)
    assert traj.powers["drag"][-1] == pytest.approx(-T * traj.w[-1, 0], rel=1e-6)


def test_rod_that_rotates_about_its_middle():
    """Torque of the drag across a rotating rod, eta_n L^3 / 12 omega, by half edges: 1 + 1/(2 n^2)."""
    n, omega = 10, 0.7
    _, eta_n = gray_hancock(MU, L, R)
    rod = beam(n, rn.ResistiveForce(viscosity=MU), points=[(-L / 2, 0, 0), (L / 2, 0, 0)])
    velocity = omega * np.cross((0, 0, 1.0), rod.graph.x0)
    traj = rn.Simulation(rod, 1e-4, velocity=velocity).run(1e-4)
    torque = np.cross(traj.x[0], traj.term_forces("drag")[0]).sum(axis=0)
    assert torque[2] == pytest.approx(-eta_n * omega * L**3 / 12 * (1 + 2 / n**2), rel=1e-9)


# -- heads ---------------------------------------------------------------------------------------
def head(*terms):
    """An almost massless stiff rod, whose first edge is the head."""
    figure = rn.StickFigure()
    light = rn.Material(E=1e7, rho=1e-3)
    figure.rod("head", [(0, 0, 0), (0.02, 0, 0), (0.04, 0, 0)], material=light, radius=2e-3)
    return rn.Robot(figure.build(), [*elastic(), *terms])


def test_stokes_head_pulled_and_turned():
    a, C1, C2 = 0.02, 2.4, 0.04
    drag = rn.StokesHead(viscosity=MU, radius=a, C1=C1, C2=C2, at="head:1", name="sphere")
    pull, turn = (1e-2, 2e-2, -3e-2), 1e-5
    traj = settle(head(drag, rn.PointForce(at="head:1", force=pull)))
    assert traj.v[-1, 1] == pytest.approx(np.array(pull) / (6 * np.pi * MU * a * C1), rel=1e-6)
    assert traj.powers["sphere"][-1] == pytest.approx(-np.dot(pull, traj.v[-1, 1]), rel=1e-6)
    traj = settle(head(drag, rn.PointTorque(on="head:1-2", torque=(turn, 0, 0))))
    assert traj.w[-1] == pytest.approx(turn / (8 * np.pi * MU * a**3 * C2), rel=1e-6)
    assert np.abs(traj.x[-1] - traj.x[0]).max() < 1e-12


def test_a_weight_sinks_at_stokes_speed():
    a, mass = 0.02, 0.035
    figure = rn.StickFigure()
    figure.rigid("ball", [(0, 0, -0.01), (0, 0, 0), (0, 0, 0.01)], mass=mass, radius=a)
    figure.rod(
        "thread", ["ball.end", (0, 0, 0.05)], edges=2, material=rn.Material(E=1e6, rho=1e-3), radius=1e-4
    )
    terms = [*elastic(), rn.Gravity(g=G), rn.StokesHead(viscosity=MU, radius=a, at="ball:1")]
    robot = rn.Robot(figure.build(), terms)
    assert robot.graph.node_mass.sum() == pytest.approx(mass, rel=1e-6)
    traj = settle(robot, 1.0)
    assert traj.v[-1, 1, 2] == pytest.approx(-mass * G / (6 * np.pi * MU * a), rel=1e-6)


def screw():
    """A resistance whose translation and rotation along the axis are coupled, as of a helix."""
    resistance = np.diag([0.3, 0.3, 0.2, 4e-5, 4e-5, 2e-5])
    resistance[2, 5] = resistance[5, 2] = 1e-3
    return resistance


def test_a_screw_that_is_pulled_turns_and_one_that_is_turned_advances():
    mobility = np.linalg.inv(screw()[np.ix_([2, 5], [2, 5])])
    drag = rn.StokesHead(resistance=screw(), at="head:1")
    force, torque = 1e-3, 2e-6
    pulled = settle(head(drag, rn.PointForce(at="head:1", force=(force, 0, 0))))
    assert (pulled.v[-1, 1, 0], pulled.w[-1, 0]) == pytest.approx(mobility @ (force, 0.0), rel=1e-6)
    turned = settle(head(drag, rn.PointTorque(on="head:0-1", torque=(torque, 0, 0))))
    assert (turned.v[-1, 1, 0], turned.w[-1, 0]) == pytest.approx(mobility @ (0.0, torque), rel=1e-6)
    assert turned.powers["head"][-1] == pytest.approx(-torque * turned.w[-1, 0], rel=1e-6)


def test_full_resistance_in_the_body_frame():
    """A head led on a known rigid motion: the gripper feels R (v, omega) in the head's own frame."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(6, 6))
    resistance = (A @ A.T + rng.normal(size=(6, 6)) * 0.0) * np.outer(
        [1, 1, 1, 0.01, 0.01, 0.01], [1, 1, 1, 0.01, 0.01, 0.01]
    )
    omega = np.array([0.4, -0.7, 1.1])

    def turn(t):
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(omega * t).as_matrix()

    def shift(t):
        return np.array([0.02 * t, 0.01 * t * t, -0.03 * np.sin(t)])

    led = rn.PrescribedMotion(at="head:0-1", position=shift, orientation=turn)
    robot = head(led, rn.StokesHead(resistance=resistance, at="head:1"))
    traj = rn.Simulation(robot, 1e-3, stepper="sdirk2").run(0.5)
    t = traj.t[-1]
    frame = turn(t) @ np.stack(
        [robot.graph.d1[0], np.cross((1.0, 0, 0), robot.graph.d1[0]), (1.0, 0, 0)], axis=1
    )
    arm = turn(t) @ np.array([0.02, 0, 0])
    v = np.array([0.02, 0.02 * t, -0.03 * np.cos(t)]) + np.cross(omega, arm)
    load = resistance @ np.concatenate([frame.T @ v, frame.T @ omega])
    grip = traj.reactions["motion"]
    assert grip.force[-1] == pytest.approx(frame @ load[:3], rel=1e-5, abs=1e-7)
    moment = frame @ load[3:] + np.cross(arm, frame @ load[:3])  # about the first held node
    assert grip.moment[-1] == pytest.approx(moment, rel=1e-4, abs=1e-8)


def test_a_passive_head_may_not_give_energy():
    with pytest.raises(rn.TermError, match="positive semi-definite"):
        rn.StokesHead(resistance=-np.eye(6), at="head:1")
