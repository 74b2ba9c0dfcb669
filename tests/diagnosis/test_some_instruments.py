"""Trials of which some have an instrument that others lack."""

from dataclasses import replace

import numpy as np

import rodnet as rn
from tests.diagnosis import shaken


def tip_height(view):
    """Height of the tip [m]."""
    return float(view.x[-1, 2])


def observe(rec, robot):
    """Markers, and a laser at the tip where there was one."""
    eye = rn.Markers(robot, shaken.POINTS)
    return [eye, rn.Reading(robot, "laser", tip_height, unit="m")] if "laser" in rec.channels else [eye]


CASE = replace(shaken.CASE, observe=observe)


def recorded(k, laser):
    """A trial whose rod is soft in one place, with or without the laser."""
    rec = shaken.record(k, "stiffness-defect", {"loss": 0.6, "place": 0.37, "width": 0.06})
    if not laser:
        return rec
    height = rec.markers[:, -1, 2] + 3e-4 * np.random.default_rng(90 + k).standard_normal(len(rec.t))
    return rec.replace(channels={"laser": height})


def test_an_instrument_that_some_trials_have_counts_where_it_is():
    for first in (True, False):
        trials = [recorded(k, laser=(k % 2 == 0) == first) for k in range(6)]
        found = rn.diagnose(
            CASE, trials[:5], hold_out=trials[5:], candidates=["stiffness-defect", "gravity", "yield"],
            noise=shaken.SIGMA, workers=0,
        )  # fmt: skip
        assert found.verdict == "named"
        (one,) = found.findings
        assert one.id.startswith("stiffness-defect")
        assert abs(one.at.value - 0.37) < 0.05
