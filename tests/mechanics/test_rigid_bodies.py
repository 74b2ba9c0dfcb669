"""True rigid bodies alone: free motion, pendulums, grippers, mass properties, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rodnet as rn
from rodnet.kinematics.frames import rotation
from rodnet.testing.states import Probe

ELASTIC = (rn.Stretching, rn.Bending, rn.Twisting)
TIGHT = rn.Tolerance(residual=1e-12, update=1e-14)
RUBBER = rn.Material(E=1e7, rho=1000.0)


def elastic():
    return [term() for term in ELASTIC]


def angle(name="top", **options):
    """A body of two edges at a right angle."""
    figure = rn.StickFigure()
    figure.rigid(name, [(0, 0, 0), (0.1, 0, 0), (0.1, 0.05, 0)], radius=0.01)
    return figure.body(name, **options)


MOMENTS, COM = np.array([1e-3, 2e-3, 2.6e-3]), np.array([0.04, 0.03, 0.02])


def exact_rotation(times, omega):
    """Orientations of a free body with principal axes x, y, z: Euler's equations, to 1e-12."""

    def rate(_, y):
        w, R = y[:3], y[3:].reshape(3, 3)  # in the body
        W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([np.cross(MOMENTS * w, w) / MOMENTS, (R @ W).ravel()])

    start = np.concatenate([omega, np.eye(3).ravel()])
    found = solve_ivp(rate, (0.0, times[-1]), start, t_eval=times, rtol=1e-12, atol=1e-12, method="DOP853")
    return np.moveaxis(found.y[3:].reshape(3, 3, -1), -1, 0)


def free_top(stepper, dt, duration=1.0, omega=(8.0, 0.4, 1.0)):
    """Trajectory of the free top, and its distance from the exact motion at the end."""
    robot = rn.Robot(angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [])
    sim = rn.Simulation(robot, dt, stepper=stepper, spin={"top": omega}, tolerance=TIGHT)
    traj = sim.run(duration)
    R = exact_rotation(traj.t, np.array(omega))
    expected = COM + (robot.graph.x0 - COM) @ np.swapaxes(R, 1, 2)
    return traj, float(np.abs(traj.x - expected)[-1].max())


@pytest.mark.parametrize(("stepper", "order"), [("euler", 1.0), ("sdirk2", 2.0), ("alpha", 2.0)])
def test_a_free_asymmetric_top_tumbles_as_eulers_equations_say(stepper, order):
    errors = [free_top(stepper, dt)[1] for dt in (8e-3, 4e-3, 2e-3)]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert slopes[-1] == pytest.approx(order, abs=0.25)
    assert errors[-1] < (2e-3 if order == 2.0 else 3e-2)


@pytest.mark.parametrize(("stepper", "allowed"), [("sdirk2", 2e-4), ("alpha", 2e-4)])
def test_a_free_top_keeps_its_energy_and_angular_momentum(stepper, allowed):
    """Some 20 turns about an axis next to the unstable one of three."""
    omega = np.array([0.05, 10.0, 0.05])
    robot = rn.Robot(angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [])
    sim = rn.Simulation(robot, 2e-3, stepper=stepper, spin={"top": omega}, tolerance=TIGHT)
    traj = sim.run(4.0, save_every=10)
    energy = traj.energies["kinetic"]
    assert energy[0] == pytest.approx(0.5 * omega @ (MOMENTS * omega), rel=1e-12)
    assert np.abs(energy / energy[0] - 1.0).max() < allowed
    spin = []
    for k, x in enumerate(traj.x):
        t1, t2 = x[1] - x[0], x[2] - x[1]
        R = np.stack([t1 / 0.1, t2 / 0.05, np.cross(t1, t2) / 0.005], axis=1)
        spin.append(R @ (MOMENTS * (R.T @ traj.rates[k, -3:])))
    assert np.abs(np.array(spin) - spin[0]).max() < allowed * np.linalg.norm(spin[0])
    # it turns over, as the intermediate axis theorem says
    assert (traj.x[:, 1] - traj.x[:, 0])[:, 1].std() > 0.005


def test_precession_of_a_symmetric_top():
    """The axis of a free symmetric top goes round its angular momentum at L / I1."""
    moments = np.array([1.2e-3, 2e-3, 2e-3])
    figure = rn.StickFigure()
    figure.rigid("top", [(-0.05, 0, 0), (0.05, 0, 0)], radius=0.01)
    figure.body("top", mass=0.3, inertia=moments)
    omega = np.array([20.0, 1.0, 0.0])
    L = moments * omega
    sim = rn.Simulation(
        rn.Robot(figure.build(), []), 1e-3, stepper="alpha", spin={"top": omega}, tolerance=TIGHT
    )
    traj = sim.run(1.0)
    axis = (traj.x[:, 1] - traj.x[:, 0]) / 0.1
    e = L / np.linalg.norm(L)
    across = axis - (axis @ e)[:, None] * e
    a, b = across[0] / np.linalg.norm(across[0]), np.cross(e, across[0] / np.linalg.norm(across[0]))
    turned = np.unwrap(np.arctan2(across @ b, across @ a))
    assert turned[-1] == pytest.approx(np.linalg.norm(L) / moments[1], rel=2e-4)
    assert np.linalg.norm(across, axis=1) == pytest.approx(np.linalg.norm(across[0]), rel=1e-3)
    # a straight body shows its own spin as the twist of its edges, here about an axis that precesses
    spin = np.gradient(traj.theta[:, 0], traj.t)[1:-1]
    assert spin == pytest.approx(omega[0], rel=1e-4)


@pytest.mark.parametrize("stepper", ["sdirk2", "alpha"])
@pytest.mark.parametrize("node", [0, 2])
def test_period_of_a_compound_pendulum(stepper, node):
    """T = 2 pi sqrt(I / (m g l)) about any of its nodes, which becomes the base of the body."""
    figure = rn.StickFigure()
    figure.rigid("bob", [(0, 0, 0), (0.03, 0, -0.15), (0, 0, -0.3)], radius=0.01)
    figure.body("bob", mass=0.8, com=(0, 0, -0.2), inertia=(3e-3, 2e-3, 4e-3))
    up = -1.0 if node == 0 else 1.0
    robot = rn.Robot(figure.build(), [rn.Gravity(direction=(0, 0, up)), rn.Hinge(at=f"bob:{node}")])
    traj = rn.Simulation(robot, 4e-3, stepper=stepper, spin={"bob": (0.01, 0, 0)}, tolerance=TIGHT).run(3.0)
    y = traj.x[:, 2 - node, 1]
    k = np.flatnonzero(y[1:-1] * y[2:] < 0) + 1
    zeros = traj.t[k] - y[k] * (traj.t[k + 1] - traj.t[k]) / (y[k + 1] - y[k])
    arm = 0.2 if node == 0 else 0.1
    assert 2.0 * np.diff(zeros).mean() == pytest.approx(
        2.0 * np.pi * np.sqrt((3e-3 + 0.8 * arm**2) / (0.8 * 9.81 * arm)), rel=2e-4
    )
    # the hinge carries weight and centrifugal force, and the powers add up
    assert traj.reactions["hinge"].force[0] == pytest.approx((0, 0, -up * 0.8 * 9.81), rel=1e-3, abs=1e-12)
    p = traj.powers
    assert (
        np.abs(p["gravity"] + p["hinge"] + p["elastic"] - p["kinetic"])[1:].max()
        < 1e-9 * np.abs(p["kinetic"]).max()
    )


def test_a_body_hangs_with_its_centre_below_the_hinge():
    robot = rn.Robot(
        angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [rn.Gravity(), rn.Hinge(at="top.start")]
    )
    traj = rn.equilibrium(robot)
    x = traj.x[0]
    t1, t2 = (x[1] - x[0]) / 0.1, (x[2] - x[1]) / 0.05
    centre = np.stack([t1, t2, np.cross(t1, t2)], axis=1) @ COM
    assert centre == pytest.approx((0, 0, -np.linalg.norm(COM)), abs=1e-6)


def test_a_gripper_that_turns_a_body_feels_its_inertia():
    """Force and moment of a body that is turned about a node: m a of the centre, I alpha + w x I w."""
    w, rate = 3.0, lambda t: np.array([0.0, 0.0, 1.5 * t * t])
    robot = rn.Robot(
        angle(mass=0.5, com=COM, inertia=MOMENTS).build(),
        [rn.PrescribedMotion(at="top.start", orientation=lambda t: rotation(rate(t)))],
    )
    traj = rn.Simulation(robot, 1e-3, stepper="sdirk2").run(0.5)
    spin, alpha = w * traj.t[-1], w
    c = rotation(rate(traj.t[-1])) @ COM
    z = np.array([0, 0, 1.0])
    force = 0.5 * (alpha * np.cross(z, c) + spin**2 * np.cross(z, np.cross(z, c)))
    reaction = traj.reactions["motion"]
    assert reaction.force[-1] == pytest.approx(force, rel=1e-3, abs=1e-4)
    inertia = np.diag(MOMENTS) + 0.5 * (COM @ COM * np.eye(3) - np.outer(COM, COM))
    R = rotation(rate(traj.t[-1]))
    inertia = R @ inertia @ R.T
    moment = inertia @ (alpha * z) + np.cross(spin * z, inertia @ (spin * z))
    assert reaction.moment[-1] == pytest.approx(moment, rel=1e-3, abs=1e-5)


def test_masses_of_a_body_are_equivalent_to_four_points():
    body = angle(mass=0.7, com=COM, inertia=MOMENTS).build().bodies[0]
    points = body.mass_points() - COM
    S = 0.7 / 4 * points.T @ points
    assert points.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-15)
    assert np.trace(S) * np.eye(3) - S == pytest.approx(np.diag(MOMENTS), abs=1e-15)


def test_inertia_of_a_straight_part_is_that_of_a_cylinder():
    figure = rn.StickFigure().rigid("bar", [(0, 0, 0), (0.1, 0, 0), (0.3, 0, 0)], mass=0.6, radius=0.02)
    body = figure.body("bar").build().bodies[0]
    across = 0.6 * (0.3**2 / 12 + 0.02**2 / 4)
    assert body.com == pytest.approx((0.15, 0, 0))
    assert body.inertia == pytest.approx(np.diag([0.5 * 0.6 * 0.02**2, across, across]), rel=1e-12)


BAD = {
    "unknown part": (lambda: rn.StickFigure().body("head"), "there is no part 'head'"),
    "soft part": (
        lambda: rn.StickFigure().rod("a", [(0, 0, 0), (1, 0, 0)], material=RUBBER, radius=0.1).body("a"),
        "'a' is a soft rod",
    ),
    "twice": (lambda: angle().body("top"), "already belongs to the body 'top'"),
    "mass": (lambda: angle(mass=-1.0), "mass = -1.0 must be positive"),
    "no mass": (lambda: angle().build(), "give mass="),
    "com": (lambda: angle(mass=1.0, com=(0, 0)), "com must be a finite point"),
    "inertia": (lambda: angle(mass=1.0, inertia=(1.0, 1.0, 3.0)), "no body has the principal moments"),
    "asymmetric": (lambda: angle(mass=1.0, inertia=np.triu(np.ones((3, 3)))), "must be symmetric"),
    "shape": (lambda: angle(mass=1.0, inertia=1.0), r"of shape \(3,\) or \(3, 3\)"),
    "no parts": (lambda: rn.StickFigure().body([]), "at least one stiff part"),
    "shared node": (
        lambda: angle(mass=1.0).rigid("b", ["top.end", (0.2, 0.1, 0)]).body("b", mass=1.0).build(),
        "the bodies 'top' and 'b' share a node",
    ),
    "two nodes held": (
        lambda: rn.Robot(angle(mass=1.0).build(), [rn.Hinge(at=["top:0", "top:2"])]),
        "positions of 2 nodes of the rigid body 'top' are prescribed",
    ),
    "spin": (
        lambda: rn.Simulation(rn.Robot(angle(mass=1.0).build(), []), spin={"to": (0, 0, 1)}),
        "no rigid body 'to' is free to move; there are top",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_bodies(case):
    make, message = BAD[case]
    with pytest.raises(rn.RodnetError, match=message):
        make()


@pytest.mark.parametrize("stepper", ["sdirk2", "alpha"])
def test_mass_damping_takes_momentum_and_spin_of_a_body_alike(stepper):
    """Free flight with v = v0 exp(-r t), and a spin about a principal axis with w = w0 exp(-r t)."""
    robot = rn.Robot(angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [rn.MassDamping(rate=2.0)])
    v0, spin = np.array([0.1, 0.05, -0.02]), np.array([0.0, 0.0, 1.5])
    x0 = robot.graph.x0
    velocity = np.tile(v0, (len(x0), 1))  # of the centre, as the spin is given
    sim = rn.Simulation(robot, 5e-3, stepper=stepper, velocity=velocity, spin={"top": spin}, tolerance=TIGHT)
    traj = sim.run(1.0)
    gone = (1.0 - np.exp(-2.0 * traj.t)) / 2.0
    R = np.array([rotation(spin * s) for s in gone])
    expected = COM + v0 * gone[:, None, None] + (x0 - COM) @ np.swapaxes(R, 1, 2)
    assert np.abs(traj.x - expected).max() < 2e-5 * np.ptp(x0[:, 0])
    end = traj.x[-1] - traj.x[-1, 0]
    swept = traj.v[-1] - traj.v[-1, 0]
    omega = spin * np.exp(-2.0 * traj.t[-1])
    assert swept == pytest.approx(np.cross(omega, end), abs=1e-4 * 0.1)
    kinetic = traj.energies["kinetic"]
    assert kinetic[-1] / kinetic[0] == pytest.approx(np.exp(-4.0 * traj.t[-1]), rel=1e-4)


def test_derivatives_of_mass_damping_on_a_body():
    robot = rn.Robot(angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [rn.MassDamping(rate=2.0)])
    probe = Probe(robot, np.random.default_rng(2), turn=0.6, source_turn=0.5)
    for by, (error, where) in probe.jacobian_errors().items():
        assert error < 2e-6, f"{by}: {where}"
