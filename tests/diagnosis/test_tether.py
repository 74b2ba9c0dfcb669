"""A thread that is tied to a rod without its model knowing: found where it is, and told from a current."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from tests.diagnosis import shaken

HOOK, STIFFNESS, PLACE = np.array([0.3, 0.05, 0.08]), 0.12, 0.63


def tied(robot: rn.Robot) -> rn.Robot:
    return robot.with_terms(
        rn.Tether(on="rod", point=HOOK, stiffness=STIFFNESS, place=PLACE, width=0.03, name="thread")
    )


@pytest.mark.slow
def test_a_thread_is_named_where_it_is():
    recs = [shaken.record(k, change=tied) for k in range(6)]
    found = rn.diagnose(
        shaken.CASE, recs[:5], hold_out=recs[5:], noise=shaken.SIGMA, workers=0,
        candidates=["tether", "flow", "viscoelastic-medium", "gravity", "local-mass"],
    )  # fmt: skip
    assert found.verdict == "named"
    (one,) = found.findings
    assert one.id == "tether@rod" and one.equivalents == []
    edge = 1.0 / shaken.EDGES  # of the model, whose knot is wider than the thread's
    assert abs(one.at.value - PLACE) < 0.2 * edge and one.at.high - one.at.low < edge
    firm = one.parameters["tether@rod.stiffness"]
    assert firm.low < STIFFNESS < firm.high
    pull = np.array([one.parameters[f"tether@rod.f{axis}"].value for axis in "xyz"])
    nodes = shaken.robot(shaken.drive(0)).graph.x0
    middle = 0.5 * (nodes[0] + nodes[-1])  # where F is the pull
    np.testing.assert_allclose(middle + pull / firm.value, HOOK, atol=0.03)  # its anchor
    assert found.explained_fraction > 0.9
