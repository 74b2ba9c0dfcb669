"""What a robot runs into without its model knowing: found on its side and in its place, or not taken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.columns import bank_columns
from rodnet.diagnosis.workbench import Workbench
from rodnet.report.sentences import summary
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

PLACE, STIFFNESS = 0.025, 40.0  # beside the rod, which swings through three times that [m], [N/m^2]


def test_an_obstacle_is_named_where_it_is():
    values = {"stiffness": STIFFNESS, "position": -PLACE}
    recs = [shaken.record(k, "obstacle@+y", values) for k in range(5)]
    found = rn.diagnose(
        shaken.CASE, recs[:4], hold_out=recs[4:], candidates=["obstacle", "gravity", "medium-friction"],
        noise=shaken.SIGMA, workers=0,
    )  # fmt: skip
    assert found.verdict == "named"
    (one,) = found.findings
    assert one.id == "obstacle@+y"
    place, firm = (one.parameters[f"obstacle@+y.{name}"] for name in ("position", "stiffness"))
    assert place.low < -PLACE < place.high and place.high - place.low < 0.25 * PLACE
    assert firm.low < STIFFNESS < firm.high
    assert found.held.after.sigma < found.held.before.sigma


@pytest.mark.slow
def test_a_trial_that_stays_out_of_its_reach_does_not_speak_against_it():
    """What is held out is predicted no better, for there is nothing in it that the model lacks."""
    values = {"stiffness": STIFFNESS, "position": -PLACE}
    recs = [shaken.record(k, "obstacle@+y", values, share=1.0 if k < 4 else 0.2) for k in range(5)]
    found = rn.diagnose(
        shaken.CASE, recs[:4], hold_out=recs[4:], candidates=["obstacle"], noise=shaken.SIGMA, workers=0
    )
    assert found.held.silent and found.held.change < 0.1
    assert found.verdict == "named" and [one.id for one in found.findings] == ["obstacle@+y"]
    assert "hardly show it" in summary(found) and "falls" not in summary(found)


def test_rods_begin_short_of_an_obstacle():
    """Deep in a bed of springs they would be pulled back to a plane: that is none."""
    robot = shaken.build(shaken.record(0))
    for one in rn.candidates(robot, [], ["obstacle"]):
        built = one.build(robot)
        low, high = built.parameters[f"{one.id}.position"].bounds
        normal = next(term.normal for term in built.terms if term.name == one.id)
        nearest = (robot.graph.x0 @ normal).min()
        assert low == -np.inf and nearest < high < nearest + 0.05 * shaken.LENGTH
        assert max(one.values(built, 5.0)[f"{one.id}.position"]) < high


def test_an_obstacle_is_looked_for_where_the_rod_that_it_was_made_for_begins_short_of_it():
    """Also where other trials are looked at, in which the rod begins 0.06 m nearer to it, or farther away."""
    recs = [shaken.record(k) for k in range(2)]
    case = replace(shaken.CASE, build=Moved({recs[1].name: 0.06}))
    bench = Workbench.of(case, recs[1:], Serial(), shaken.SIGMA)
    robot, fitted = case.robot(recs[0]), bench.fit()
    for one in rn.candidates(robot, [], ["obstacle"]):
        path = f"{one.id}.position"
        scanned = [place.shape[path] for place in bank_columns(bench, fitted, one)]
        assert scanned and max(scanned) <= one.build(robot).parameters[path].bounds[1]


class Moved:
    """Builds the rod so far along y as its trial says [m]."""

    def __init__(self, ahead):
        self.ahead = ahead

    def __call__(self, rec):
        robot = shaken.build(rec)
        x0 = robot.graph.x0 + np.array([0.0, self.ahead.get(rec.name, 0.0), 0.0])
        return rn.Robot(replace(robot.graph, x0=x0), robot.terms, robot.sensors)
