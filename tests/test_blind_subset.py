"""A fixed part of the blind benchmark, made by PyElastica: an effect, a control, and what is not in the bank."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rodnet as rn
from benchmarks.blind import judge

KEPT = Path(__file__).parent / "data" / "blind"
TRIED = ["root-compliance", "gravity", "yield", "flow", "stiffness-gradient", "kelvin-voigt"]


@pytest.mark.parametrize(
    ("name", "verdict", "hits"),
    [
        (
            "give", "named",
            ["named right", "true cause in the stated class", "80 % of held-out excess removed",
             "more removed than by the placebo"],
        ),
        ("nothing", "none", []),
        ("pulse", "surrogate", ["outside the bank: flagged", "outside: half removed by a law"]),
    ],
)  # fmt: skip
def test_kept_cases_are_judged_right(name: str, verdict: str, hits: list[str]) -> None:
    """Five trials each, with several explanations to choose from, and none that is right in the last."""
    truth = json.loads((KEPT / f"{name}.json").read_text())
    trials = rn.read_recordings(str(KEPT / name / "trial_*.npz"))
    found = rn.diagnose(
        rn.load_case(KEPT / name / "CASE.py"), trials[:4], hold_out=trials[4:], candidates=TRIED, workers=0
    ).to_dict()
    assert found["verdict"] == verdict
    judged = judge.judge(truth, found)
    assert all(judged[row] is True for row in hits)
    assert not any(
        value is True for row, value in judged.items() if row.startswith(("false alarms", "outside: a name"))
    )
