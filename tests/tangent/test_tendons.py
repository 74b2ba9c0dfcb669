"""Tendons with friction: derivatives of runs, their own parameters' and those of all else."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.tangent.fast import Fast
from rodnet.tangent.memories import followed
from tests.tangent import whole_runs as wr
from tests.tangent.test_whole_runs import STEPPERS, check

DRIVES = {
    "tension": {"tension": 0.8},
    "pull": {"pull": 2e-3, "stiffness": 40.0},
}


def arm(drive, friction=0.3, *laws):
    """A finger with a branch that a tendon along it bends to and fro, in a fluid."""
    fig = rn.StickFigure()
    soft = rn.Material(E=1e6, nu=0.5, rho=1100.0)
    fig.rod("arm", [(0, 0, 0), (0.2, 0, 0)], edges=8, material=soft, radius=4e-3, director=(0, 0, 1.0))
    fig.rod("hook", ["arm.end", (0.24, 0.05, 0.01)], edges=3, material=soft, radius=3e-3)
    tendon = rn.Tendon(
        route=[("arm", (4e-3, 1e-3)), ("hook:1", (2e-3, 0.0))], friction=friction, reach=2e-4,
        schedule=lambda t: 0.2 + np.sin(np.pi * t / 0.4) ** 2, **DRIVES[drive],
    )  # fmt: skip
    drag = rn.ResistiveForce(eta_t=2.0, eta_n=4.0, name="drag")
    elastic = rn.Stretching(), rn.Bending(), rn.Twisting(), rn.KelvinVoigt(bend=0.01, twist=0.01)
    return rn.Robot(fig.build(), [*elastic, drag, rn.Clamp(at="arm:0-1"), tendon, *laws])


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("drive", DRIVES)
def test_an_arm_that_is_bent_to_and_fro(drive, stepper):
    robot = arm(drive)
    paths = [f"tendon.{drive}", "tendon.friction", "tendon.reach", "arm.E", "arm.length", "drag.eta_n"]
    paths += ["tendon.stiffness"] if drive == "pull" else []
    lift = {"x": np.outer(np.maximum(robot.graph.x0[:, 0] - 0.05, 0.0) ** 2, [0.0, 0.3, 0.2])}
    # at round-off one run of ten cannot end a step, and halves it: that is another run
    near = rn.Tolerance(residual=1e-12, update=1e-14, iterations=60)
    check(robot, 0.6, {p: [p] for p in paths}, 1e-4, {"lift": lift}, 1e-6, near, dt=0.01, stepper=stepper)


def test_its_memory_is_followed_and_not_differenced():
    law = rn.DryFriction(name="law", moment=3e-4, torque=2e-4, curvature=2.0, twist=1.5)
    robot = arm("tension", 0.3, law)
    sim = rn.Simulation(robot, dt=0.01)
    assert {k for k, b in enumerate(sim.model.bound) if b.memory is not None} == followed(sim.model)
    check(
        robot, 0.3, {p: [p] for p in ("law.moment", "tendon.friction", "arm.E")}, 1e-4, relative=1e-6, dt=0.01
    )


def test_by_a_friction_that_is_not_there():
    """One-sided, and with what a small friction would remember."""
    robot, options = arm("tension", 0.0), {"dt": 0.01, "stepper": "sdirk2"}
    found = wr.at_end(rn.sensitivities(robot, 0.6, parameters=["tendon.friction"], **options))[:, 0]
    run = lambda mu: wr.last(robot.with_parameters({"tendon.friction": mu}), 0.6, **options)  # noqa: E731
    expected = (-3.0 * run(0.0) + 4.0 * run(1e-4) - run(2e-4)) / 2e-4
    assert wr.error(found, expected, wr.parts(robot)) < 1e-3


@pytest.mark.parametrize("drive", DRIVES)
def test_columns_that_take_whole_evaluations_change_the_memory_too(drive, monkeypatch):
    robot, options = arm(drive), {"dt": 0.01, "stepper": "sdirk2"}
    expected = wr.at_end(rn.sensitivities(robot, 0.3, parameters=["arm.E", "tendon.friction"], **options))
    known = Fast._part
    monkeypatch.setattr(
        Fast, "_part", lambda self, column: None if "friction" in column.name else known(self, column)
    )
    found = wr.at_end(rn.sensitivities(robot, 0.3, parameters=["arm.E", "tendon.friction"], **options))
    for k in range(2):
        assert wr.error(found[:, k], expected[:, k], wr.parts(robot)) < 1e-4
