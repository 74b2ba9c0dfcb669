"""A medium that remembers: named, with its modulus and its time, where fluids and grains would leave something."""

from __future__ import annotations

import pytest

import rodnet as rn
from tests.diagnosis import shaken

MODULUS, TIME = 8.0, 0.15  # [N/m^2], [s]


@pytest.mark.slow
def test_a_medium_that_is_elastic_for_a_while_is_named():
    recs = [shaken.record(k, "viscoelastic-medium", {"modulus": MODULUS, "time": TIME}) for k in range(8)]
    found = rn.diagnose(
        shaken.CASE, recs[:7], hold_out=recs[7:], workers=0, noise=shaken.SIGMA,
        candidates=["viscoelastic-medium", "power-law", "added-mass", "kelvin-voigt"],
    )  # fmt: skip
    assert found.verdict == "named"
    (one,) = found.findings
    assert one.id == "viscoelastic-medium"
    modulus, time = (one.parameters[f"viscoelastic-medium.{name}"] for name in ("modulus", "time"))
    assert modulus.low < MODULUS < modulus.high and modulus.high - modulus.low < 0.5 * MODULUS
    assert time.low < TIME < time.high
    assert found.held.after.sigma < found.held.before.sigma


def test_where_there_is_no_medium_it_is_no_candidate():
    robot = shaken.build(shaken.record(0))
    bare = rn.Robot(robot.graph, [t for t in robot.terms if not isinstance(t, rn.ResistiveForce)])
    assert not rn.candidates(bare, [], ["viscoelastic-medium"])
