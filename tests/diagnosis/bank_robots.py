"""Robots that between them can have every candidate explanation."""

import functools

import numpy as np

import rodnet as rn

T = np.linspace(0.0, 1.0, 41)
SOFT = rn.Material(E=3e6, nu=0.4, rho=1100.0)
ELASTIC = rn.Stretching, rn.Bending, rn.Twisting


def path(*amplitudes):
    """A smooth motion from rest."""
    return rn.smooth_motion(T, np.array([a * np.sin(4.0 * T) ** 2 for a in amplitudes]).T, 0.0)


@functools.cache
def cable():
    """Shaken at its clamped end, in air, with gravity; of an elliptic section, so that it twists as it bends."""
    fig = rn.StickFigure()
    fig.rod(
        "cable", [(0, 0, 0), (0.3, 0.0, 0.05)], edges=7, material=SOFT, section=rn.elliptic(5e-3, 3e-3),
        director=(0.1, 1.0, 0.3),
    )  # fmt: skip
    turns = np.array([[0.0, 0.0, np.sin(0.2 * s), np.cos(0.2 * s)] for s in np.sin(3.0 * T) ** 2])
    shaker = rn.PrescribedMotion(
        at="cable.start",
        position=path(0.0, 0.02, 0.03),
        orientation=rn.smooth_rotation(T, turns, 1e-9),
        name="shaker",
    )
    strands = rn.DryFriction(name="strands", pull={"cable": (0.9, -0.4)}, rubs=False)
    robot = rn.Robot(fig.build(), [*(law() for law in ELASTIC), rn.Gravity(), shaker, strands])
    return robot, {"dt": 1e-2, "stepper": "sdirk2"}


@functools.cache
def held():
    """A cable in the hand of a gripper that is known from two markers."""
    fig = rn.StickFigure()
    points = [(0.0, 0.0, 0.0), (0.04, 0.0, 0.0), (0.1, 0.02, 0.0), (0.15, 0.05, 0.01), (0.2, 0.06, 0.04)]
    fig.rod("cable", points, material=SOFT, section=rn.elliptic(5e-3, 3e-3), natural="straight")
    lean = rn.smooth_motion(T, np.stack([np.ones_like(T), 0.1 * np.sin(3.0 * T), 0.0 * T], axis=1), 0.0)
    grip = rn.Grasp(
        at="cable:0-1", position=path(0.0, 0.02, 0.03), tangent=lean, twist="no-spin", duration=1.0
    )
    robot = rn.Robot(fig.build(), [*(law() for law in ELASTIC), rn.Gravity(), grip])
    return robot, {"dt": 1e-2, "stepper": "sdirk2"}


@functools.cache
def swimmer():
    """The paper's, with two tails."""
    return rn.robots.flagellated(n_tails=2, rpm=150.0), {"dt": 1e-2, "stepper": "euler"}


@functools.cache
def arm():
    """Two links on an elastic joint, pulled by a tendon, with a muscle, in a viscous fluid."""
    fig = rn.StickFigure()
    fig.rod("upper", [(0, 0, 0), (0.1, 0.0, 0.0)], edges=4, material=SOFT, radius=4e-3, director=(0, 1, 0))
    fig.rod("fore", ["upper.end", (0.19, 0.01, 0.02)], edges=4, material=SOFT, radius=3e-3)
    fig.joint("upper.end", kind="elastic", stiffness=2e-3)
    terms = [
        *(law() for law in ELASTIC), rn.Clamp(at="upper.start"), rn.Gravity(),
        rn.ResistiveForce(viscosity=0.5),
        rn.Tendon(route=[("upper", (8e-3, 0.0))], tension=0.4),
        rn.CurvatureWave(on="fore", amplitude=5.0, wavelength=0.1, frequency=1.5, axis=2),
    ]  # fmt: skip
    return rn.Robot(fig.build(), terms), {"dt": 1e-2, "stepper": "sdirk2"}


ROBOTS = {"cable": cable, "held": held, "swimmer": swimmer, "arm": arm}


def instruments(robot):
    """A camera that sees three points of a robot's last rod."""
    rod = list(robot.graph.rods)[-1]
    return [rn.Markers(robot, {"a": f"{rod}@30%", "b": f"{rod}@70%", "tip": f"{rod}.end"}, offset1=0.0)]
