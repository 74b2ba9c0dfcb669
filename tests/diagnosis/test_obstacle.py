"""What a robot runs into without its model knowing: found on its side and in its place, or not taken for it."""

from __future__ import annotations

import numpy as np

import rodnet as rn
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
