"""A medium that remembers: derivatives of runs in it, its own parameters' and those of all else."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.model import Model
from rodnet.tangent.memories import followed
from tests.tangent.test_whole_runs import STEPPERS, cable, check

LAW = rn.MaxwellMedium(modulus=8.0, time=0.12)


@pytest.mark.parametrize("stepper", STEPPERS)
def test_a_cable_that_swings_in_it(stepper):
    robot = cable(LAW)
    paths = ["maxwell.modulus", "maxwell.time", "stem.E", "stem.length", "gravity.g"]
    lift = {"x": np.outer(robot.graph.x0[:, 0] ** 2, [0.0, 0.3, 0.2])}
    check(robot, 0.3, {p: [p] for p in paths}, 1e-5, {"lift": lift}, 3e-4, dt=0.01, stepper=stepper)


def test_its_memory_is_followed_and_not_differenced():
    model = Model(cable(LAW))
    assert all(k in followed(model) for k, b in enumerate(model.bound) if b.memory is not None)
