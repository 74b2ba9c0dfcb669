"""Whole turns of hinges, whatever the time step: no force tells them, so they are counted."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import elastic

Y = np.array([0.0, 1.0, 0.0])
SOFT = {"material": rn.Material(E=1e6), "radius": 2e-3, "edges": 6}


def flail(dt, stepper, speed, *terms, stiffness=None, angle=0.0, rough=0.0):
    """A soft arm on a hinge about y, thrown round [rad/s], with a rough velocity to begin with [m/s]."""
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.1, 0, 0)], **SOFT)
    figure.rod("b", ["a.end", (0.2, 0, 0)], **SOFT)
    figure.joint("a.end", kind="hinge", axis=Y, stiffness=stiffness, angle=angle)
    graph = figure.build()
    arm = graph.x0 - [0.1, 0, 0]
    velocity = np.cross(speed * Y, arm) + rough * np.random.default_rng(1).normal(size=arm.shape)
    velocity[arm[:, 0] <= 0.0] = 0.0
    robot = rn.Robot(graph, [*elastic(), rn.Clamp(at="a.start"), *terms])
    return rn.Simulation(robot, dt, stepper=stepper, velocity=velocity)


def seen(sim):
    """Angle between the rods at the hinge up to whole turns, from the positions beside it."""
    figure = sim.observe()
    before, at, after = (figure.position(name) for name in ("a:5", "a.end", "b:1"))
    return np.arctan2(np.cross(at - before, after - at) @ Y, (at - before) @ (after - at))


@pytest.mark.parametrize(
    ("stepper", "dt", "speed"),
    [("euler", 1e-2, 10.0), ("euler", 3e-2, 25.0), ("sdirk2", 2e-2, 25.0), ("alpha", 1e-3, 10.0)],
)
def test_the_angle_of_a_hinge_is_that_of_its_spring(stepper, dt, speed):
    """However rough the motion: or its frames drift off by whole turns that cost nothing, and run away."""
    angle = 0.3
    sim = flail(dt, stepper, speed, rn.Gravity(), stiffness=1e-5, angle=angle, rough=2.0)
    for _ in range(40):
        before = sim.observe().joint_angle("a.end")
        result = sim.step()
        assert result.ok
        now = sim.observe().joint_angle("a.end")
        assert now == pytest.approx(sim.state.tau[-1] + angle, abs=1e-9)
        assert abs(now - before) < np.pi * result.substeps


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_hinge_counts_the_turns_that_positions_make(stepper):
    """Free and with a spring, in steps of up to a quarter of a turn."""
    for stiffness in (None, 1e-6):
        sim = flail(4e-3, stepper, 60.0, stiffness=stiffness)
        turned, last = 0.0, 0.0
        for _ in range(40):
            assert sim.step().ok
            now = seen(sim)
            turned += np.remainder(now - last + np.pi, 2 * np.pi) - np.pi
            last = now
            # half edges bend beside the hinge
            assert sim.observe().joint_angle("a.end") == pytest.approx(turned, abs=1.0)
        assert abs(turned) > 2.0 * np.pi


def test_a_motor_on_a_hinge_counts_its_turns():
    """Against the drag of a medium, by a third of a turn per step; the other way round, too."""
    for rate, between in ((2.0, ("a:5-6", "b:0-1")), (-2.0, ("b:0-1", "a:5-6"))):
        drag = rn.ResistiveForce(eta_t=1e-4, eta_n=2e-4)
        motor = rn.Motor(between=between, angle=lambda t, rate=rate: rate * t)
        sim = flail(1.0, "euler", 0.0, drag, motor, stiffness=1e-3)
        sim.run(10.0)
        assert sim.observe().joint_angle("a.end") == pytest.approx(20.0, abs=0.05)
