"""Whole turns of hinges, whatever the time step: no force tells them, so they are counted."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.kinematics.frames import rotation
from tests.mechanics.beams import elastic

Y = np.array([0.0, 1.0, 0.0])


def flail(dt, stepper, speed, *terms, held="a.start", E=1e6, rough=0.0, seed=1, kind="hinge", **joint):
    """An arm on a hinge about y, thrown round [rad/s], with a rough velocity to begin with [m/s]."""
    figure, rod = rn.StickFigure(), {"material": rn.Material(E=E), "radius": 2e-3, "edges": 6}
    figure.rod("a", [(0, 0, 0), (0.1, 0, 0)], **rod)
    figure.rod("b", ["a.end", (0.2, 0, 0)], **rod)
    if kind:
        figure.joint("a.end", kind=kind, **(joint if kind != "hinge" else {"axis": Y, **joint}))
    graph = figure.build()
    arm = graph.x0 - [0.1, 0, 0]
    velocity = np.cross(speed * Y, arm) + rough * np.random.default_rng(seed).normal(size=arm.shape)
    velocity[arm[:, 0] <= 0.0] = 0.0
    robot = rn.Robot(graph, [*elastic(), rn.Clamp(at=held), *terms])
    return rn.Simulation(robot, dt, stepper=stepper, velocity=velocity)


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


@pytest.mark.parametrize("kind", [None, "rigid", "hinge", "ball"])
def test_no_step_is_too_rough_for_a_joint(kind):
    """Random velocities of 2 m/s, by more than two edges a step: no edge may make turns that cost nothing."""
    for seed in range(3):
        sim = flail(0.02, "sdirk2", 25.0, rough=2.0, seed=seed, kind=kind)
        assert all(sim.step().ok for _ in range(15))
        assert np.abs(sim.state.tau).max() < 2.0


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
@pytest.mark.parametrize("stiffness", [None, 1e-6])
def test_a_hinge_counts_the_turns_that_positions_make(stepper, stiffness):
    """Free and with a spring."""
    E = 1e7 if stepper == "alpha" else 1e9  # alpha does not damp what dt does not resolve
    sim = flail(2e-3, stepper, 100.0, held="a", E=E, stiffness=stiffness)
    turned = last = 0.0
    for _ in range(100):
        assert sim.step().ok
        x, _, z = sim.observe().position("b.end") - [0.1, 0.0, 0.0]
        now = np.arctan2(-z, x)
        turned += np.remainder(now - last + np.pi, 2 * np.pi) - np.pi
        last = now
        assert sim.observe().joint_angle("a.end") == pytest.approx(turned, abs=0.1)
    assert turned > 2.0 * np.pi


@pytest.mark.parametrize("turn", [2.4, -2.4])
def test_a_hinge_is_turned_by_far_in_one_step(turn):
    """By less than half a turn each; a step of nearly half a turn is halved, as both sides are as near."""
    motion = rn.PrescribedMotion(at="b", orientation=lambda t: rotation(turn * t * Y))
    for stiffness in (None, 1e-6):
        sim = flail(1.0, "euler", 0.0, motion, held="a:0-1", E=1e9, stiffness=stiffness)
        sim.run(10.0)
        assert sim.observe().joint_angle("a.end") == pytest.approx(10.0 * turn, abs=1e-3)
        far = flail(1.25, "euler", 0.0, motion, held="a:0-1", E=1e9, stiffness=stiffness)
        assert far.step().substeps == 2
        assert far.observe().joint_angle("a.end") == pytest.approx(1.25 * turn, abs=1e-3)


def test_a_motor_on_a_hinge_counts_its_turns():
    """Against the drag of a medium, by a third of a turn per step; the other way round, too."""
    for rate, between in ((2.0, ("a:5-6", "b:0-1")), (-2.0, ("b:0-1", "a:5-6"))):
        drag = rn.ResistiveForce(eta_t=1e-4, eta_n=2e-4)
        motor = rn.Motor(between=between, angle=lambda t, rate=rate: rate * t)
        sim = flail(1.0, "euler", 0.0, drag, motor, stiffness=1e-3)
        sim.run(10.0)
        assert sim.observe().joint_angle("a.end") == pytest.approx(20.0, abs=0.05)
