"""A rod with a soft spot in a medium that weighs it down, as its case has it, and what might be missing."""

import pytest

import rodnet as rn
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


@pytest.fixture(scope="module")
def two():
    return Workbench.of(shaken.CASE, shaken.soft_and_heavy(), Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def base(two):
    return two.fit()


@pytest.fixture(scope="module")
def scores(two, base):
    robot = shaken.build(two.recordings[0])
    return screen(two, base, rn.candidates(robot, [], ["stiffness-defect", "gravity", "kelvin-voigt"]))
