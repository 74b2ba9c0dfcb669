"""Motors that slow down under load, and late: the derivative of a run follows them without whole evaluations."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.tangent.fast import Fast
from rodnet.tangent.memories import followed
from tests.tangent.whole_runs import at_end, by_one, by_parameter, error, last, parts

PATHS = [
    "motor.no_load_rpm",
    "motor.stall_torque",
    "motor.lag",
    "motor.rpm",
    "rod.E",
    "shape.kappa1",
    "drag.eta_n",
]
LAWS = [
    rn.DryFriction(name="law", moment=3e-4, torque=2e-4, curvature=2.0, twist=1.5),
    rn.PlasticSet(name="law", share=0.6, time=0.2),
]
OPTIONS = {"dt": 0.01, "stepper": "sdirk2"}


def spun(late=0.05, way="on"):
    """A curved rod that a weak motor spins in a fluid, drawn on from the motor, back to it, or as its first part."""
    fig = rn.StickFigure()
    material = rn.Material(E=1e6, rho=1100.0)
    bow = [(0.2 * s, 0.02 * s**2, 0.0) for s in np.linspace(0.0, 1.0, 8)]
    if way == "first":
        fig.rod("rod", [*bow[::-1], (-0.02, 0, 0)], material=material, radius=4e-3)
        held, between = "rod:7-8", ("rod:7-8", "rod:6-7")
    else:
        fig.rod("stub", [(-0.02, 0, 0), (0, 0, 0)], edges=1, material=material, radius=4e-3)
        rotor = ["stub.end", *bow[1:]]
        fig.rod("rod", rotor if way == "on" else rotor[::-1], material=material, radius=4e-3)
        held, between = "stub", ("stub:0-1", "rod:0-1" if way == "on" else "rod:6-7")
    drive = rn.DCMotor(between=between, rpm=90.0, stall_torque=3e-4, no_load_rpm=120.0, lag=late)
    shape = rn.NaturalCurvature(name="shape", kappa1=0.5)
    elastic = rn.Stretching(), rn.Bending(), rn.Twisting()
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0, name="drag")
    return rn.Robot(fig.build(), [*elastic, drag, shape, rn.Clamp(at=held), drive])


@pytest.mark.parametrize(("late", "way"), [(0.05, "on"), (0.0, "back"), (0.05, "first")])
def test_derivatives_are_those_of_whole_runs(late, way):
    robot = spun(late, way)
    paths = [p for p in PATHS if late or p != "motor.lag"]
    found = rn.sensitivities(robot, 0.3, parameters=paths, **OPTIONS)
    for k, path in enumerate(paths):
        expected = by_parameter(robot, [path], 0.3, **OPTIONS)
        assert error(at_end(found)[:, k], expected, parts(robot)) < 1e-5, path


@pytest.mark.parametrize(
    "more",
    [
        rn.JointCompliance(at="stub.end", length=3e-3, name="more"),
        rn.StiffnessGradient(on="rod", slope=0.4, name="more"),
        rn.SectionStiffness(on=["stub", "rod"], twist=0.3, first=0.2, name="more"),
    ],
)
def test_whatever_makes_the_motors_joint_soft_is_felt_by_what_it_gives(more):
    path = next(p for p in ("more.length", "more.slope", "more.twist") if p.split(".")[1] in more.declared())
    robot = spun().with_terms(more)
    found = rn.sensitivities(robot, 0.3, parameters=[path, "motor.rpm"], **OPTIONS)
    for k, name in enumerate((path, "motor.rpm")):
        expected = by_parameter(robot, [name], 0.3, **OPTIONS)
        assert error(at_end(found)[:, k], expected, parts(robot)) < 1e-5, name


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("way", ["back", "first"])
def test_laws_that_remember_strains_hear_of_the_motor(law, way):
    """The spring that it turns remembers, too."""
    robot = spun(0.05, way).with_terms(law)
    own = "law.moment" if isinstance(law, rn.DryFriction) else "law.share"
    paths = ["motor.no_load_rpm", "motor.rpm", "rod.E", own]
    sim = rn.Simulation(robot, **OPTIONS)
    assert {k for k, b in enumerate(sim.model.bound) if b.memory is not None} == followed(sim.model)
    found = rn.sensitivities(robot, 0.3, parameters=paths, **OPTIONS)
    for k, path in enumerate(paths):
        expected = by_parameter(robot, [path], 0.3, relative=1e-5, **OPTIONS)
        assert error(at_end(found)[:, k], expected, parts(robot)) < 2e-5, path


@pytest.mark.parametrize("path", ["motor.no_load_rpm", "motor.lag", "rod.E"])
def test_a_motor_that_gives_way_to_nothing_yet(path):
    """Derivatives to the one side that there is: of these a diagnosis begins with."""
    robot = spun(0.0).with_parameters({"motor.no_load_rpm": 0.0})
    found = rn.sensitivities(robot, 0.3, parameters=[path], **OPTIONS)
    run = lambda r: last(r, 0.3, **OPTIONS)  # noqa: E731
    expected, allowed = by_one(robot, path, run, run(robot), parts(robot), limit=2e-5)
    assert np.all(np.abs(at_end(found)[:, 0] - expected) <= allowed)


def test_the_motor_does_slow_down():
    free, loaded = spun(0.0), spun(0.0).with_parameters({"motor.no_load_rpm": 0.0})
    turns = [rn.Simulation(r, **OPTIONS).run(0.3).state(-1).memories for r in (free, loaded)]
    angle = [next(m for m in some if m is not None and len(m) == 8)[0] for some in turns]
    assert angle[0] < 0.9 * angle[1]


def test_nothing_of_it_takes_whole_evaluations():
    robot = spun()
    sim = rn.Simulation(robot, **OPTIONS)
    remembering = {k for k, b in enumerate(sim.model.bound) if b.memory is not None}
    assert remembering == followed(sim.model)
    assert remembering == set(Fast(sim.model, sim.newton, []).memories)
