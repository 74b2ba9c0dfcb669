"""Internal damping of rods whose natural curvature is driven, and beside rigid bodies."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import rodnet as rn

ELASTIC = [rn.Stretching(), rn.Bending(), rn.Twisting()]


def arm(*terms):
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=6, material=rn.Material(E=2e6, rho=1100.0), radius=2e-3)
    return rn.Robot(
        fig.build(), [*ELASTIC, rn.Clamp(at="arm.start"), rn.ResistiveForce(viscosity=1.0), *terms]
    )


@pytest.mark.parametrize(
    "drive",
    [
        rn.SlowCurvature(curvature=8.0, time_constant=0.15),
        rn.CurvatureWave("arm", amplitude=6.0, wavelength=0.2, frequency=2.0),
    ],
    ids=lambda d: d.name,
)
def test_damping_of_a_driven_rod_is_of_second_order(drive):
    """The natural rate is that at the end of a step, not its mean."""
    tips = []
    for dt in (4e-3, 2e-3, 1e-3, 5e-4):
        robot = arm(rn.KelvinVoigt(bend=0.05), drive)
        tips.append(rn.Simulation(robot, dt, stepper="sdirk2").run(0.16).x[-1, -1])
    change = [np.linalg.norm(b - a) for a, b in pairwise(tips)]
    assert change[0] > 3.0 * change[1] > 9.0 * change[2]


def test_damping_of_all_rods_of_a_robot_with_a_body():
    """Edges of rigid bodies, whose stiffness is infinite, have no part in it."""
    found = []
    for on in ("*", "arm"):
        fig = rn.StickFigure()
        fig.rigid("hub", [(0, 0, 0), (0.03, 0, 0)], mass=0.05, radius=6e-3).body("hub")
        fig.rod(
            "arm", ["hub.end", (0.13, 0, 0)], edges=6, material=rn.Material(E=5e6, rho=1100.0), radius=2e-3
        )
        damping = rn.KelvinVoigt(on, stretch=0.01, bend=0.02, twist=0.01)
        push = rn.PointForce(at="arm.end", force=(0, 0, 1e-2))
        found.append(rn.Simulation(rn.Robot(fig.build(), [*ELASTIC, damping, push]), 5e-3).run(0.05).x)
    # the springs at the hub belong to all of it only
    assert np.ptp(found[0][-1, :, 2]) > 1e-2
    assert np.abs(found[0] - found[1]).max() < 0.05 * np.ptp(found[0][-1, :, 2])


def test_a_slow_curvature_goes_through_zero_with_one_time_constant_and_on_with_the_other():
    """Whatever the time step: released to zero, then filled the other way."""
    found = []
    for dt in (0.01, 0.05, 0.2):
        muscle = rn.SlowCurvature(
            curvature=20.0,
            time_constant=0.01,
            release=1.0,
            schedule=lambda t: 1.0 if t <= 0.2 + 1e-9 else -0.5,
        )
        traj = rn.Simulation(arm(muscle), dt).run(2.0)
        number = [t.name for t in traj.robot.terms].index("muscle")
        kappa = [traj.state(k).memories[number][0][2, 0] for k in range(len(traj))]
        found.append(np.interp([0.2, 1.0, 1.2, 1.6], traj.t, kappa))
    found = np.array(found) / found[0][0] * 20.0 * (1 - np.exp(-20))
    crossing = 0.2 + np.log(3.0)  # from 20 towards -10 with 1 s
    assert np.allclose(found[:, 1], -10.0 + 30.0 * np.exp(-0.8), rtol=1e-6)
    assert np.allclose(found[:, 3], -10.0, rtol=1e-6)
    assert crossing > 1.2 and (found[:, 2] > 0.0).all()


@pytest.mark.parametrize("stepper", ["euler", "alpha"])
def test_a_yielding_motor_restarts_bit_equal(stepper):
    def robot():
        fig = rn.StickFigure()
        made = rn.Material(E=5e6, rho=1100.0)
        fig.rigid("head", [(0.04, 0, 0), (0.02, 0, 0), (0, 0, 0)], mass=0.035)
        fig.rod("tail", ["head.end", (0, 0.02, 0), (-0.1, 0.02, 0)], edges=8, material=made, radius=2e-3)
        motor = rn.DCMotor(at="head:1", rpm=80.0, no_load_rpm=120.0, stall_torque=2e-3, lag=0.02)
        return rn.Robot(fig.build(), [*ELASTIC, rn.ResistiveForce(viscosity=2.0, on="tail"), motor])

    one, other = (rn.Simulation(robot(), 4e-3, stepper=stepper) for _ in range(2))
    one.run(0.06)
    other.restore(one.state)
    assert np.array_equal(one.run(0.06).x, other.run(0.06).x)
