"""What is said of odd cases: trials that cannot be run, repairs that do harm, classes, sides, what is out of reach."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

import rodnet as rn
from rodnet.diagnosis.findings import Interval
from rodnet.diagnosis.preflight import preflight
from rodnet.diagnosis.remainder import Remainder
from rodnet.diagnosis.scales import ALPHA, LEAST
from rodnet.diagnosis.screen import MISSED, screen
from rodnet.diagnosis.told import regime_of
from rodnet.diagnosis.workbench import Workbench
from rodnet.report.figures import before_after
from rodnet.report.sentences import NAMELESS, summary
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken
from tests.diagnosis.test_page import text_of


def heavy(robot):
    return robot.with_terms(rn.Gravity(g=0.3, name="weight"))


@pytest.fixture(scope="module")
def lost():
    """A weight, found; the one trial held out is shaken by metres at 40 Hz, which no model of these steps runs."""
    recs = [shaken.record(k, change=heavy) for k in range(5)]
    wild = recs[4].replace(attrs={"amplitude": 4.0, "frequency": 12.3, "lift": 0.1}, name="wild")
    return rn.diagnose(
        shaken.CASE, recs[:4], hold_out=[wild], candidates=["gravity", "yield"], noise=shaken.SIGMA, workers=0
    )


def test_trials_held_out_that_no_model_runs_are_told(lost, tmp_path):
    """They were there, and opened: the page does not say that none were held out."""
    assert [one.id for one in lost.findings] == ["gravity"] and lost.held is None
    assert lost.lost == ["wild"] and lost.openings == 2
    assert lost.verdict == "surrogate"
    page = text_of(lost.page(), tmp_path / "report.html")
    assert "wild was not searched, and cannot be simulated" in page and "No trials were held out" not in page
    assert "Not with every model can wild be simulated" in summary(lost)


def test_what_falls_has_a_positive_acceleration(lost):
    assert lost.findings[0].parameters["weight-z.g"].value == pytest.approx(0.3, rel=0.2)


def opened(before, after, share):
    """A diagnosis with one effect, of which trials held out have these errors."""
    one = SimpleNamespace(
        id="gravity", title="weight", on="", at=None, when=None, strength=("weight.g",), equivalents=["flow", "wind"],
        parameters={"weight.g": Interval(1.0, 0.9, 1.1, "m/s^2")},
    )  # fmt: skip
    sizes = {"before": SimpleNamespace(error=before), "after": SimpleNamespace(error=after)}
    held = SimpleNamespace(**sizes, silent=False, unexplained=0.0, failed=[])
    fit = SimpleNamespace(residual=np.ones(4))
    titles = [
        SimpleNamespace(candidate=SimpleNamespace(id=id, title=t)) for id, t in (("flow", "a current"),)
    ]
    left = Remainder(p=0.5, ratio=1.0, excess=0.0, where={}, when=[], trials=[])
    return SimpleNamespace(
        verdict="class", findings=[one], held=held, tested=held, explained_fraction=share, shown="held out",
        screened=titles, remainder=left, base=SimpleNamespace(fits=[fit], samples=4), hurried=False, lost=[], unit="m",
    )  # fmt: skip


@pytest.mark.parametrize(("before", "after", "share"), [(2e-3, 1e-3, 0.8), (1e-3, 1.1e-3, -0.2)])
def test_errors_fall_or_rise(before, after, share):
    told = summary(opened(before, after, share))
    fell, rose = "falls from" in told, "rises from" in told
    assert (fell, rose) == (share > 0.0, share < 0.0)
    assert ("removes 80 % of" in told, "adds 20 % to" in told) == (fell, rose)
    assert "weight, g 1 (0.9 to 1.1) m/s^2, or a current, or wind" in told  # the class, not its head alone


def test_nothing_is_said_to_stand_in_where_nothing_was_found():
    found = replace_verdict(opened(2e-3, 2e-3, 0.0))
    assert NAMELESS in summary(found) and "stands in for it" not in summary(found)


def test_records_that_are_off_by_more_than_their_noise_are_told():
    """The trial-by-trial errors of a drive's record that are no noise have no name, but are no secret."""
    found = opened(2e-3, 1e-3, 0.8)
    told = [replace(found.remainder, records=size) for size in (1.9, 2.6)]
    quiet, loud = (summary(SimpleNamespace(**{**vars(found), "remainder": left})) for left in told)
    assert "2.6 times as far beside their drives' records" in loud
    assert "drives' records" not in quiet


def replace_verdict(found):
    left = Remainder(p=1e-9, ratio=9.0, excess=1.0, where={}, when=[], trials=[])
    return SimpleNamespace(**{**vars(found), "verdict": "surrogate", "findings": [], "remainder": left})


def test_a_side_is_no_depth():
    for on, word in (("-z", "depth"), ("+z", "depth"), ("+x", "place"), ("-y", "place")):
        for family in ("wall", "obstacle"):
            one = SimpleNamespace(id=family, family=family, on=on, when=None, at=None)
            assert regime_of(one, None)[0] == word
    assert (
        regime_of(SimpleNamespace(id="depth", family="depth", on="", when=None, at=None), None)[0] == "depth"
    )


def test_a_strength_beyond_its_bounds_would_not_have_shown():
    """Of next to no motion a mass that changes along the rod by more than all of it would be needed."""
    robot = shaken.build(shaken.record(0))
    slope, weight = (rn.candidates(robot, [], [id])[0] for id in ("mass-gradient", "gravity"))
    bench = Workbench.of(
        shaken.CASE, [shaken.record(k, share=0.02) for k in range(2)], Serial(), shaken.SIGMA
    )
    fitted = bench.fit()
    (score,) = screen(bench, fitted, [slope])
    assert score.detectable == {"mass-gradient@rod.slope": np.inf}
    fine, coarse = (
        screen(bench, fitted, [weight], numerical=n)[0].detectable["weight-z.g"] for n in (0.0, 2.0)
    )
    assert fine < np.inf
    samples = np.sqrt(fitted.samples)  # beside an error of two sigma six are named
    assert coarse == pytest.approx(
        fine * 6.0 * samples / max(LEAST * samples, seen_at(screen(bench, fitted, [weight])[0]))
    )


def seen_at(score):
    """Change of all residuals together that nine of ten times is seen, in sigma."""
    return np.sqrt(chi2.isf(ALPHA / score.tried, 1)) + MISSED


def clamped(rec, robot):
    return rn.Markers(robot, ["rod.start", *shaken.POINTS])


def test_a_drive_is_compared_with_the_noise_that_was_given():
    """Of trials too short to tell it, too, and what cannot be estimated is no remark."""
    case = replace(shaken.CASE, observe=clamped)
    recs = []
    for k in range(2):
        rec = shaken.record(k).cut(0.0, 0.5)
        hand = np.tile([0.0, 0.03, 0.0], (len(rec.t), 1, 1))
        seen = np.concatenate([hand, rec.markers], axis=1)
        recs.append(rn.Recording(rec.t, seen, names=["hand", *rec.names], name=rec.name, attrs=rec.attrs))
    bench = Workbench.of(case, recs, Serial(), shaken.SIGMA)
    checked = preflight(bench, bench.fit())
    (one,) = checked.driven
    assert one.noise == pytest.approx(np.sqrt(3.0) * shaken.SIGMA) and one.astray
    assert not any("frames in a row" in remark for remark in checked.remarks)


def test_errors_over_time_are_at_the_times_of_the_frames():
    """Of a recording with a gap, too."""
    recs = [shaken.record(k, change=heavy) for k in range(4)]
    kept = np.r_[0:10, 24 : len(recs[3].t)]
    last = recs[3]
    gap = rn.Recording(last.t[kept], last.markers[kept], names=last.names, name="gap", attrs=last.attrs)
    found = rn.diagnose(
        shaken.CASE, recs[:3], hold_out=[gap], candidates=["gravity"], noise=shaken.SIGMA, workers=0
    )
    ((_, figure),) = before_after(found)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xdata(), gap.t)
