"""What takes long to run is refitted where nothing quick explains all there is, and not otherwise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis import selection
from rodnet.diagnosis.candidate import Candidate, add_terms, candidates
from rodnet.diagnosis.folds import checked, shaky
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.slow import affordable, apart, derivative_times
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


class Weighty(rn.DragModel):
    """Weight along z by a law that takes long to tell it."""

    default_name = "weighty"
    weight = rn.Parameter(0.0, unit="N/m", null=0.0)

    def force(self, site: Any, p: Any) -> np.ndarray:
        for _ in range(80):
            down = np.linalg.svd(np.diag([3.0, 2.0, 1.0]))[2][2]
        return -p.weight * np.abs(down) * np.ones((len(site.v), 1))


def weighty(robot):
    return add_terms(robot, parts=((Weighty, {"name": "weighty"}),))


SLOW = Candidate("weighty", "weight", "load", weighty, ("weighty.weight",), falsifier="none")


@pytest.fixture(scope="module")
def bench():
    trials = []
    for k in range(2):  # on the mesh of the model: nothing else is wrong
        heavy = shaken.robot(shaken.drive(k)).with_terms(rn.Gravity(g=0.3))
        trials.append(shaken.record(k, change=lambda _, heavy=heavy: heavy))
    return Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def scored(bench):
    base = bench.fit()
    quick = candidates(bench.case.robot(bench.recordings[0]), [], ["gravity", "kelvin-voigt"])
    return base, screen(bench, base, [*quick, SLOW])


@pytest.mark.slow
def test_the_slow_are_told_from_the_quick(bench, scored):
    base, scores = scored
    quick, slow = apart(bench, base, scores)
    assert [s.candidate.id for s in slow] == ["weighty"]
    assert {s.candidate.id for s in quick} == {s.candidate.id for s in scores} - {"weighty"}
    assert apart(bench, base, slow) == ([], slow)


@pytest.mark.slow
def test_nothing_slow_is_refitted_beside_what_explains_all(bench, scored, monkeypatch):
    base, scores = scored
    asked = []
    plain = selection.refit

    def spied(bench, base, some, *rest):
        asked.extend(s.candidate.id for s in some)
        return plain(bench, base, some, *rest)

    monkeypatch.setattr(selection, "refit", spied)
    found = selection._refits(bench, base, scores, 0.0, False, lambda text: None, ENDLESS)
    assert found[0].id == "gravity" and "weighty" not in asked
    without = [s for s in scores if s.candidate.id != "gravity"]
    found = selection._refits(bench, base, without, 0.0, False, lambda text: None, ENDLESS)
    assert found[0].id == "weighty"


class Remembering(Weighty):
    """The same with a memory of which the tangent knows nothing."""

    memory_size = 1

    def update(self, site: Any, p: Any, m_old: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return super().force(site, p), m_old


def remembering(robot):
    return add_terms(robot, parts=((Remembering, {"name": "weighty"}),))


def test_what_takes_differences_for_each_column_takes_longer(bench):
    """Laws without memory don't, whatever they take themselves."""
    robot = bench.case.robot(bench.recordings[0])
    assert derivative_times(robot, 20) == derivative_times(weighty(robot), 20) < 5.0
    assert derivative_times(remembering(robot), 20) > 10.0


def test_what_there_is_no_time_for_is_left_out(bench, scored):
    """Of explanations whose derivatives take long."""
    base, scores = scored
    (score,) = [s for s in scores if s.candidate.id == "weighty"]
    rest = [s for s in scores if s is not score]
    slow = replace(score, candidate=replace(SLOW, build=remembering))
    told: list[str] = []
    short = Patience(lambda: 60.0, minutes=1e-3)  # and that is over
    assert affordable(bench, base, [*rest, score], told.append, short) == ([*rest, score], False)
    assert affordable(bench, base, [*rest, slow], told.append) == ([*rest, slow], False)
    assert not told
    assert affordable(bench, base, [*rest, slow], told.append, short) == (rest, True)
    assert "no time for weighty" in told[0]


def test_trials_are_left_out_in_earnest_while_there_is_time():
    """A refit that one trial alone tells, and that took long, stays as it is to first order, and says so."""
    spot = {"loss": 0.6, "place": 0.37, "width": 0.06}
    trials = [shaken.record(k, "stiffness-defect", spot, share=s) for k, s in enumerate((1.0, 0.1, 0.1))]
    bench = Workbench.of(shaken.CASE, [rec.cut(0.0, 0.6) for rec in trials], Serial(), shaken.SIGMA)
    base = bench.fit()
    scores = screen(bench, base, candidates(bench.case.robot(trials[0]), [], ["stiffness-defect"]))
    (one,) = refit(bench, base, scores, 1)
    assert shaky(one.fitted) and one.cross_gain < 0.0 < one.seconds
    told: list[str] = []
    (left,) = checked(bench, base, [one], 0.0, told.append, Patience(lambda: 60.0, minutes=1e-3))
    assert left.hurried and not left.earnest and left.cross_gain == one.cross_gain
    assert "no time to leave out trials" in told[0]
    (left,) = checked(bench, base, [one], 0.0, told.append)
    assert left.earnest and not left.hurried and left.cross_gain > one.cross_gain
