"""Trials of which some have an instrument that others lack."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.heldout import floor_of, open_trials
from rodnet.diagnosis.remainder import test_remainder as smooth_remainder
from rodnet.diagnosis.workbench import Workbench
from rodnet.report.sentences import about_remainder
from rodnet.sweeps.collect import Serial
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


@pytest.mark.slow
def test_an_instrument_that_some_trials_have_counts_where_it_is():
    """The first has none: what it is seen by is not what all are seen by."""
    trials = [recorded(k, laser=k % 2 == 1) for k in range(5)]
    found = rn.diagnose(
        CASE, trials, candidates=["stiffness-defect", "gravity"], noise=shaken.SIGMA, workers=0
    )
    assert found.verdict == "named"
    (one,) = found.findings
    assert one.id.startswith("stiffness-defect")
    assert abs(one.at.value - 0.37) < 0.05


def test_what_is_left_is_told_by_the_names_of_what_saw_it():
    """The first trial has no laser, and in the second it is where most is left."""
    trials = [recorded(k, laser=k == 1) for k in range(2)]
    off = trials[1].channels["laser"] + 0.05 * np.sin(6.0 * trials[1].t)
    trials[1] = trials[1].replace(channels={"laser": off})
    bench = Workbench.of(CASE, trials, Serial(), shaken.SIGMA)
    left = smooth_remainder(bench.fit(), bench.noise)
    assert set(left.where) == {"markers", "laser"} and set(left.where["markers"]) == set(trials[0].names)
    assert max(left.where["laser"].values()) > 0.5
    assert sum(sum(own.values()) for own in left.where.values()) == pytest.approx(1.0)
    found = SimpleNamespace(left=left, names=[rec.name for rec in trials])
    assert "'laser'" in about_remainder(found)


@pytest.mark.parametrize("first", [True, False])
def test_every_reading_counts_once(first):
    trials = [recorded(k, laser=(k % 2 == 0) == first) for k in range(3)]
    markers = sum(np.isfinite(rec.markers).sum() for rec in trials)
    readings = sum(len(rec.t) for rec in trials if "laser" in rec.channels)
    assert Workbench.of(CASE, trials, Serial(), shaken.SIGMA).fit().samples == markers + readings


@pytest.mark.parametrize(("plane", "instruments"), [("xz", 1), ("xyz", 1), ("xz", 2)])
def test_where_sigma_is_a_misfit_the_floor_is_the_noise_of_what_is_compared(plane, instruments):
    """Of the markers and axes that the camera sees; the recordings tell it. Of a laser that comes first, nothing."""

    def see(rec, robot):
        eye = rn.Markers(robot, {"m3": shaken.POINTS[3], "m0": shaken.POINTS[0]}, plane=plane)
        return [rn.Reading(robot, "laser", tip_height, unit="mm"), eye][-instruments:]

    case, trials = replace(CASE, observe=see, noise=0.01), [recorded(k, laser=True) for k in range(2)]
    given = {"laser": 1.0, "markers": 0.01} if instruments == 2 else 0.01
    bench = Workbench.of(case, trials, Serial(), given)
    floor = floor_of(open_trials(bench, bench.fit()), bench)
    assert floor == (
        None if instruments == 2 else pytest.approx(np.sqrt(len(plane)) * shaken.SIGMA, rel=0.15)
    )
