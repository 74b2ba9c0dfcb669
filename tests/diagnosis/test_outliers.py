"""Two markers that were swapped for a few frames: left out, and no reason for anything."""

from __future__ import annotations

import pytest

import rodnet as rn
from tests.diagnosis import shaken

ASKED = ["stiffness-defect", "gravity", "yield"]


def swapped(rec: rn.Recording, frames: slice) -> rn.Recording:
    """The recording with its last two markers exchanged for a while."""
    markers = rec.markers.copy()
    markers[frames, [2, 3]] = markers[frames, [3, 2]]
    return rec.replace(markers=markers)


def heavy(robot: rn.Robot) -> rn.Robot:
    """The robot with a weight that changes its motion by many sigma."""
    return robot.with_terms(rn.Gravity(g=1.0))


def test_swapped_markers_are_no_physics() -> None:
    recs = [shaken.record(k) for k in range(6)]
    recs[1], recs[5] = swapped(recs[1], slice(20, 21)), swapped(recs[5], slice(12, 14))
    found = rn.diagnose(
        shaken.CASE, recs[:5], hold_out=recs[5:], candidates=ASKED, noise=shaken.SIGMA, workers=0
    )
    assert found.verdict == "none"
    assert found.preflight is not None and found.preflight.outliers["trial1"] == 2
    assert any("trial1: 2 samples" in remark for remark in found.preflight.remarks)
    assert found.held is not None and found.held.before.sigma < 1.3


@pytest.mark.slow
def test_an_effect_is_found_beside_swapped_markers() -> None:
    soft = {"loss": 0.6, "place": 0.37, "width": 0.06}
    recs = [shaken.record(k, "stiffness-defect", soft) for k in range(5)]
    clean = rn.diagnose(shaken.CASE, recs, candidates=ASKED, noise=shaken.SIGMA, workers=0)
    recs[2] = swapped(recs[2], slice(8, 10))
    found = rn.diagnose(shaken.CASE, recs, candidates=ASKED, noise=shaken.SIGMA, workers=0)
    assert [one.id for one in found.findings] == [one.id for one in clean.findings]
    (one,) = found.findings
    assert one.at is not None and abs(one.at.value - 0.37) < 0.05
    assert found.preflight is not None and sum(found.preflight.outliers.values()) == 4


def test_what_misfits_for_a_while_is_kept() -> None:
    recs = [shaken.record(k, change=heavy) for k in range(5)]
    found = rn.diagnose(shaken.CASE, recs, candidates=["gravity"], noise=shaken.SIGMA, workers=0)
    assert found.preflight is not None and not any(found.preflight.outliers.values())
    assert [one.id for one in found.findings] == ["gravity"]
