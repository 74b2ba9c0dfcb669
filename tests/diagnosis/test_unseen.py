"""A model that is complete for the trials it was found in, and is contradicted by one that it was not."""

from __future__ import annotations

import pytest

import rodnet as rn
from rodnet.diagnosis.verdict import UNSEEN
from rodnet.report.sentences import about_law, summary, sure
from tests.diagnosis import shaken


def heavy(robot: rn.Robot) -> rn.Robot:
    return robot.with_terms(rn.Gravity(g=0.3, name="weight"))


def tied(robot: rn.Robot) -> rn.Robot:
    return heavy(robot).with_terms(
        rn.Tether(on="rod", point=(0.3, 0.05, 0.08), stiffness=0.1, place=0.6, name="thread")
    )


def diagnosed(unseen: rn.Recording, change=heavy) -> rn.Diagnosis:
    recs = [shaken.record(k, change=change) for k in range(4)]
    return rn.diagnose(
        shaken.CASE,
        recs,
        hold_out=[unseen],
        noise=shaken.SIGMA,
        workers=0,
        candidates=["gravity", "added-mass"],
    )


@pytest.mark.slow
def test_a_trial_not_seen_that_has_something_else_in_it_is_told():
    """Weight alone explains the four trials of the search; in the fifth a thread pulls, too."""
    found = diagnosed(shaken.record(5, change=tied))
    assert [one.id for one in found.findings] == ["gravity"]
    assert found.held.unexplained > UNSEEN
    assert found.verdict == "surrogate"
    assert "left beside the noise" in summary(found)
    # a law of what is missing is told beside it, and nothing more
    assert found.law is not None and not found.law.judgement.accepted
    assert found.to_dict()["law"]["error_after"] == found.law.alone_after > found.floor
    assert found.openings == 3
    assert "trials held out" in about_law(found, found.law)


def test_one_that_has_nothing_else_in_it_is_no_contradiction():
    found = diagnosed(shaken.record(5, change=heavy))
    assert found.held.unexplained < 0.3
    assert found.verdict == "named"
    assert "left beside the noise" not in summary(found)


def test_what_acts_in_a_trial_not_seen_alone_is_missing_all_the_same():
    """Nothing at all is missing in the four trials of the search; it cannot be named, but it is not nothing."""
    found = diagnosed(shaken.record(5, change=tied), None)
    assert found.verdict == "surrogate" and not found.findings
    assert found.remainder.p > 0.01
    assert "in trials held out, and not in those that were searched" in summary(found)
    assert f"in {found.held.bench.recordings[0].name} by" in sure(found)


def test_where_nothing_is_missing_a_trial_not_seen_says_so_too():
    found = diagnosed(shaken.record(5), None)
    assert found.verdict == "none"
    assert "searched" not in summary(found)
