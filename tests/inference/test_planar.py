"""Recordings of x and z among recordings in space: refused where y would count, calibrated where it does not."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

import rodnet as rn
from rodnet.cli import app
from rodnet.errors import RecordingError
from tests.diagnosis import shaken

REMEDY = "plane='xz' if rec.planar else 'xyz'"


@pytest.fixture(scope="module")
def trials():
    """Two in space, and one that was filmed from the side."""
    first, second, third = (shaken.record(k) for k in range(3))
    side = rn.Recording(
        third.t, third.markers[..., [0, 2]], names=third.names, name="from-the-side", attrs=third.attrs
    )
    return [first, second, side]


def observe(rec, robot):
    return rn.Markers(robot, shaken.POINTS, plane="xz" if rec.planar else "xyz")


BY_PLANE = rn.Case(shaken.build, observe, free=shaken.free, options=shaken.options, name="by plane")


@pytest.mark.parametrize("call", ["calibrate", "evaluate", "diagnose", "held out"])
def test_a_mixture_is_refused_before_anything_is_computed(trials, call):
    told: list[str] = []
    with pytest.raises(RecordingError, match="from-the-side") as caught:
        if call == "calibrate":
            rn.calibrate(shaken.CASE, trials, noise=shaken.SIGMA, workers=0, progress=told.append)
        elif call == "evaluate":
            rn.evaluate(shaken.CASE, trials, workers=0)
        elif call == "diagnose":
            rn.diagnose(shaken.CASE, trials, noise=shaken.SIGMA, workers=0, progress=told.append)
        else:
            rn.diagnose(shaken.CASE, trials[:2], hold_out=trials[2:], workers=0, progress=told.append)
    assert REMEDY in str(caught.value) and "trial0" in str(caught.value)
    assert not told


def test_recordings_all_in_the_plane_are_as_before(trials):
    flat = [rec.replace(markers=np.delete(rec.markers, 1, axis=2)) for rec in trials[:2]]
    assert all(rec.planar for rec in flat)
    found = rn.evaluate(shaken.CASE, flat, workers=0)
    assert all(file["metric"] > 0.0 for file in found.files)


def test_the_remedy_calibrates_both_together(trials):
    found = rn.calibrate(BY_PLANE, trials, noise=shaken.SIGMA, workers=0)
    one = found.parameters["rod.E"]
    assert abs(np.log(one.value / 2e6)) < 0.1
    assert found.measured["from-the-side"][0].shape[-1] == 2 and found.measured["trial0"][0].shape[-1] == 3


def test_the_command_looks_at_what_is_held_out_too(trials, tmp_path):
    for rec in trials:
        rec.save(tmp_path / f"{rec.name}.npz")
    case = tmp_path / "case.py"
    case.write_text("from tests.diagnosis.shaken import build, free, observe, options\n", encoding="utf-8")
    given = ["--recordings", str(tmp_path / "*.npz"), "--hold-out", "from-the-side*", "--workers", "0"]
    done = CliRunner().invoke(app, ["calibrate", str(case), *given])
    assert isinstance(done.exception, RecordingError)
    assert "from-the-side" in str(done.exception) and REMEDY in str(done.exception)
