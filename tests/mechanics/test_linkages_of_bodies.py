"""Linkages of rigid bodies: joints at their nodes, against the equations of motion of rigid bodies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rodnet as rn

G = 9.81
M1, M2, I1, I2, L, C1, C2 = 0.1, 0.06, 1e-4, 6e-5, 0.1, 0.05, 0.055


def draw(kind, mass=1e-7, **options):
    """Two bodies, the second on a short stiff part that turns about the end of the first; a whisker to refer to."""
    figure = rn.StickFigure()
    figure.rigid("upper", [(0, 0, 0), (L, 0, 0)], radius=5e-3)
    figure.rigid("pin", ["upper.end", (L + 5e-3, 0, 0)], radius=5e-3, mass=mass)
    figure.rigid("lower", ["pin.end", (2 * L, 0, 0)], radius=5e-3)
    thin = rn.Material(E=2e8, rho=1e-3)
    figure.rod("whisker", ["lower.end", (2 * L + 0.02, 0, 0)], edges=2, material=thin, radius=2e-3)
    figure.body("upper", mass=M1, com=(C1, 0, 0), inertia=(1e-6, I1, I1))
    figure.body("lower", mass=M2, com=(L + C2, 0, 0), inertia=(1e-6, I2, I2))
    figure.joint("upper.end", kind=kind, **options)
    return figure.build()


def double_pendulum(t, stiffness=0.0):
    """Angles below the horizontal of two rigid bodies on hinges, released at rest."""

    def rates(_, y):
        a, b, da, db = y
        c, s = M2 * L * C2 * np.cos(a - b), M2 * L * C2 * np.sin(a - b)
        mass = np.array([[I1 + M1 * C1**2 + M2 * L**2, c], [c, I2 + M2 * C2**2]])
        spring = stiffness * (b - a)
        load = [
            -s * db**2 + G * (M1 * C1 + M2 * L) * np.cos(a) + spring,
            s * da**2 + G * M2 * C2 * np.cos(b) - spring,
        ]
        return np.concatenate([[da, db], np.linalg.solve(mass, load)])

    return solve_ivp(rates, (0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-10, atol=1e-12).y[:2].T


@pytest.mark.parametrize(
    ("kind", "options", "stiffness"),
    [
        ("hinge", {"axis": (0, 1, 0)}, 0.0),
        ("hinge", {"axis": (0, 1, 0), "stiffness": 0.05}, 0.05),
        ("ball", {}, 0.0),
        ("elastic", {"stiffness": 0.05}, 0.05),
    ],
)
def test_a_double_pendulum_of_two_bodies(kind, options, stiffness):
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Hinge(at="upper.start")]
    if stiffness:
        terms.append(rn.JointElasticity())
    robot = rn.Robot(draw(kind, **options), terms)
    traj = rn.Simulation(robot, 1e-3, stepper="sdirk2").run(0.2)
    upper, lower = (
        traj.at(f"{name}.end") - traj.at("upper.start" if name == "upper" else "upper.end")
        for name in ("upper", "lower")
    )
    angles = np.stack([np.unwrap(np.arctan2(-v[:, 2], v[:, 0])) for v in (upper, lower)], axis=1)
    assert angles == pytest.approx(double_pendulum(traj.t, stiffness), abs=1e-2)
    assert np.abs(traj.x[..., 1]).max() < 1e-9


def test_a_hinge_on_the_surroundings_holds_a_body_to_its_axis():
    """A body thrown about another axis turns about that of its hinge only; a motor there turns it."""
    figure = rn.StickFigure()
    figure.rigid("door", [(0, 0, 0), (0.1, 0, 0), (0.1, 0, 0.05)], radius=5e-3)
    figure.rod(
        "knob", ["door.end", (0.1, 0.02, 0.05)], edges=2, material=rn.Material(E=1e8, rho=1000.0), radius=2e-3
    )
    figure.body("door", mass=0.1)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Hinge(at="door.start", axis=(0, 0, 1))]
    robot = rn.Robot(figure.build(), [*terms, rn.Gravity()])
    traj = rn.Simulation(robot, 1e-3, stepper="sdirk2", spin={"door": (0, 0, 5.0)}).run(0.2)
    assert np.abs(traj.at("door:1")[:, 2]).max() < 1e-3  # the bearing yields a little
    turned = np.unwrap(np.arctan2(*traj.at("door:1")[:, 1::-1].T))
    assert turned[-1] == pytest.approx(1.0, rel=0.02)
