"""A search that may not take longer ends after the first effect, and says so."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.patience import CLOSING, Patience
from rodnet.errors import ParameterError
from rodnet.report.sentences import summary
from tests.diagnosis import shaken

BANK = ["stiffness-defect", "kelvin-voigt"]


@pytest.fixture(scope="module")
def trials():
    """A rod with a soft spot, and with damping of its own."""

    def both(robot):
        damped = shaken.with_effect(robot, "kelvin-voigt", {"bend": 0.04})
        return shaken.with_effect(damped, "stiffness-defect", {"loss": 0.6, "place": 0.4, "width": 0.06})

    return [shaken.record(k, change=both) for k in range(3)]


@pytest.mark.parametrize(("minutes", "count"), [(1e-3, 1), pytest.param(60.0, 2, marks=pytest.mark.slow)])
def test_what_would_take_too_long_is_not_begun(trials, minutes, count):
    found = rn.diagnose(shaken.CASE, trials, candidates=BANK, noise=shaken.SIGMA, minutes=minutes, workers=0)
    assert len(found.findings) == count
    assert found.to_dict()["hurried"] is (count == 1)
    assert ("The time was up" in summary(found)) is (count == 1)


def test_as_long_as_the_rest_leaves():
    now = [0.0]
    patience = Patience(lambda: now[0], 10.0)
    assert patience.allows(599.0 * (1.0 - CLOSING)) and not patience.allows(601.0 * (1.0 - CLOSING))
    now[0] = 600.0
    assert not patience.allows() and Patience().allows(1e12)


def test_no_time_is_refused(trials):
    for minutes in (0.0, np.nan):
        with pytest.raises(ParameterError, match="minutes"):
            rn.diagnose(shaken.CASE, trials, minutes=minutes)
