"""Laws that remember strains of springs: derivatives of runs that turn back often, corners and all."""

import numpy as np
import pytest

import rodnet as rn
from tests.tangent.test_whole_runs import cable, check

FRICTION = rn.DryFriction(moment=3e-3, torque=2e-3, curvature=2.0, twist=1.5)
HELD = rn.DryFriction(moment=3e-3, curvature=2.0, twist=1.5, pull={"stem": (0.8, -1.2)})
SET = rn.PlasticSet(share=0.6, time=0.2)


def shaken(law):
    """A branched cable with a natural shape, under the law, that is let go and swings."""
    robot = cable(law)
    shape = rn.NaturalCurvature(on="stem", name="shape", kappa1=0.7, kappa2=0.4)
    return rn.Robot(robot.graph, [*robot.terms, shape])


def bending(robot):
    """Velocities that bend every spring from the first step on."""
    x = robot.graph.x0
    return x[:, :1] ** 2 * np.array([0.0, 6.0, 5.0])


@pytest.mark.parametrize(
    ("law", "stepper"),
    [(FRICTION, "euler"), (FRICTION, "sdirk2"), (FRICTION, "alpha"), (HELD, "sdirk2"), (SET, "sdirk2")],
)
def test_swings_that_turn_back_have_the_derivative_of_the_whole_run(law, stepper):
    """The run passes many reversals in all springs; its derivative is that of the sides its steps took."""
    robot = shaken(law)
    own = {"friction": ("moment", "curvature"), "set": ("share", "time")}[law.name]
    paths = ["stem.length", "shape.kappa1", *[f"{law.name}.{p}" for p in own]]
    options = {"dt": 0.02, "stepper": stepper, "velocity": bending(robot)}
    check(robot, 0.4, {p: [p] for p in paths}, 2e-5, relative=1e-5, **options)


def test_a_set_follows_the_stiffness_of_a_rod_that_softens():
    """What a spot or a section takes off the stiffness it takes off the set."""
    robot = shaken(SET)
    spot = rn.StiffnessDefect(on="stem", name="spot", loss=0.5, place=0.4, width=0.2)
    section = rn.SectionStiffness(on="left", name="section", first=0.3, first_twist=0.2)
    soft = rn.Robot(robot.graph, [*robot.terms, spot, section])
    paths = ["spot.loss", "spot.place", "section.skew", "stem.E", "set.share"]
    options = {"dt": 0.02, "stepper": "sdirk2", "velocity": bending(soft)}
    check(soft, 0.4, {p: [p] for p in paths}, 2e-5, relative=1e-5, **options)


def test_the_swings_do_turn_back():
    robot = shaken(FRICTION)
    traj = rn.Simulation(robot, 0.02, stepper="sdirk2", velocity=bending(robot)).run(0.4)
    number = next(k for k, term in enumerate(robot.terms) if isinstance(term, rn.DryFriction))
    strain = np.array([traj.state(k).memories[number][:, 3:5] for k in range(len(traj))])
    steps = np.diff(strain, axis=0)
    turned = np.sum(np.sum(steps[1:] * steps[:-1], axis=2) < 0.0, axis=0)
    assert turned.sum() > 20
