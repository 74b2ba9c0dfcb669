"""A fit that stays far behind a rival is not followed to its end."""

from __future__ import annotations

import pytest

import rodnet as rn
from rodnet.diagnosis.begin import _wild, begun_with
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


def test_what_cannot_come_near_a_rival_is_given_up_and_what_can_is_not():
    """A mass explains nothing of a soft spot: given up early. With a goal that is in reach, the fit is the same."""
    recordings = [
        shaken.record(k, "stiffness-defect", {"loss": 0.8, "place": 0.3, "width": 0.1}).cut(0.0, 0.5)
        for k in range(2)
    ]
    told: list[str] = []
    bench = Workbench.of(shaken.CASE, recordings, Serial(), shaken.SIGMA, tell=told.append)
    mass = rn.candidates(shaken.build(recordings[0]), [], ["local-mass"])[0]
    base = bench.fit()
    begin = {**base.values, **dict(zip(mass.paths, (0.01, 0.5), strict=True))}
    runs, found = [], []
    for goal in (None, 0.01 * base.deviance, 0.9999 * base.deviance):
        told.clear()
        found.append(bench.fit([mass], begin, goal=goal))
        runs.append(len(told))
    full, behind, near = found
    assert runs[1] < runs[0]
    assert behind.deviance - full.deviance < 0.1 * (behind.deviance - 0.01 * base.deviance)
    assert near.deviance == pytest.approx(full.deviance, rel=1e-3)


def test_no_search_begins_where_trials_are_predicted_far_worse_than_without_the_effect():
    """To first order a strength may be anything."""
    recordings = [
        shaken.record(k, "local-mass", {"mass": 2e-3, "place": 0.7}).cut(0.0, 0.5) for k in range(2)
    ]
    bench = Workbench.of(shaken.CASE, recordings, Serial(), shaken.SIGMA)
    base = bench.fit()
    bank = rn.candidates(shaken.build(recordings[0]), [], ["local-mass"])
    (score,) = screen(bench, base, bank)
    for times, wild in ((0.02, False), (1.0, False), (1e3, True)):
        changes = {p: times * v for p, v in score.strength.items()}
        assert _wild(bench, base, *begun_with(bench, base, [(score, changes)])) is wild
