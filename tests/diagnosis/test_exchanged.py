"""A first effect that stood for two is exchanged before a third is looked for."""

from __future__ import annotations

import rodnet as rn
from tests.diagnosis import shaken

BANK = ["medium-friction", "power-law", "wall"]


def test_no_third_effect_is_looked_for_beside_a_wrong_first():
    """A medium that thins and a wall: friction predicts more than the power law while the wall is missing."""

    def both(robot):
        thin = shaken.with_effect(robot, "power-law", {"exponent": 0.4, "speed": 0.05})
        return shaken.with_effect(thin, "wall@+z", {"reach": 0.012, "position": -0.05})

    trials = [shaken.record(k, change=both) for k in range(3)]
    found = rn.diagnose(shaken.CASE, trials, candidates=BANK, noise=shaken.SIGMA, workers=0)
    first = [one for one in found.tried if one.round == 0]
    assert max(first, key=lambda one: one.cross_gain).id == "medium-friction"
    assert {one.id for one in found.findings} == {"power-law", "wall@+z"}
    assert max(one.round for one in found.tried) == 1
    assert found.remainder.p > 0.01
