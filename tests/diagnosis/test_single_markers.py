"""One marker that sits elsewhere along its rod, or slips: found as that one, and no force on the body."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.diagnose import bank_of
from rodnet.diagnosis.locate import locate
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

OFF = {"marker-place": ("misplaced", 0.012), "marker-slip": ("drift", -0.015)}  # [m], [m/s]
ASKED = ["marker-place", "marker-slip", "marker-offset", "stiffness-gradient", "gravity", "record-lag"]


def trials(name, value, which):
    eye = {name: value * (np.arange(len(shaken.POINTS)) == which)}
    return [shaken.record(k, **eye) for k in range(5)]


@pytest.mark.parametrize("family", OFF)
def test_the_marker_is_named(family):
    name, value = OFF[family]
    recs = trials(name, value, 2)
    found = rn.diagnose(
        shaken.CASE, recs[:4], hold_out=recs[4:], candidates=ASKED, noise=shaken.SIGMA, workers=0
    )
    assert found.verdict == "named"
    (one,) = found.findings
    assert one.id == f"{family}@markers:2"
    strength = one.parameters[f"markers.{name}[2]"]
    assert strength.low < value < strength.high and strength.high - strength.low < 0.2 * abs(value)
    assert found.held.after.sigma == pytest.approx(1.0, abs=0.1)


def test_a_marker_that_slips_looks_like_no_force():
    bench = Workbench.of(shaken.CASE, trials("drift", -0.015, 1), Serial(), shaken.SIGMA)
    found = locate(bench, bench.fit())
    assert found.shares["markers"] > 0.99
    assert found.evidence["markers"] > 20.0 * max(
        n for name, n in found.evidence.items() if name != "markers"
    )


def test_markers_that_drive_the_model_are_where_they_are():
    """What prescribes the model's motion cannot be elsewhere on it."""
    rec = shaken.record(0)
    driven = rec.replace(prescribed=[0])
    ids = [{c.on for c in bank_of(shaken.CASE, one, None) if c.group == "marker"} for one in (rec, driven)]
    assert ids[0] == {f"markers:{k}" for k in range(4)}
    assert ids[0] - ids[1] == {"markers:0"}


def test_trials_with_unlike_markers_have_none_tried_by_itself():
    """A marker is known by its number: where one is missing in a trial, the numbers mean others there."""
    few = shaken.record(1)
    few = rn.Recording(few.t, few.markers[:, 1:], names=few.names[1:], name=few.name, attrs=few.attrs)
    case = rn.Case(
        shaken.build,
        lambda rec, robot: rn.Markers(robot, shaken.POINTS[len(shaken.POINTS) - len(rec.names) :]),
        free=shaken.CASE.free, options=shaken.options,
    )  # fmt: skip
    recs = [shaken.record(0), few]
    assert any(c.group == "marker" for c in bank_of(case, recs[0], None, recs[:1]))
    assert not any(c.group == "marker" for c in bank_of(case, recs[0], None, recs))


def test_each_rod_may_have_its_markers_on_a_side_of_its_own():
    """Directors of different rods have nothing to do with each other: one offset of all of them says little."""
    figure = rn.StickFigure()
    figure.rod(
        "stem", [(0, 0, 0), (0.2, 0, 0)], edges=8, radius=3e-3, material=rn.Material(E=1e6, rho=1000.0)
    )
    figure.rod(
        "twig", ["stem:4", (0.1, 0, 0.1)], edges=4, radius=3e-3, material=rn.Material(E=1e6, rho=1000.0)
    )
    robot = rn.Robot(
        figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="stem.start")]
    )
    both = rn.candidates(robot, [rn.Markers(robot, ["stem@90%", "twig.end"])], ["marker-offset"])
    assert [(one.id, one.size) for one in both] == [
        ("marker-offset@markers", 2),
        ("marker-offset@markers:each", 4),
    ]
    (one,) = rn.candidates(robot, [rn.Markers(robot, ["stem@90%", "stem@40%"])], ["marker-offset"])
    assert one.size == 2
