"""Scores of the blind benchmark: the trial that a diagnosis recommends."""

import json

from benchmarks.blind import judge, plan, run
from benchmarks.blind.generate import Setting
from tests.blind_truth import ERRORS, TERM, TRUTH


def test_a_class_is_followed_by_the_trial_that_is_recommended():
    """Which one it is, and whether it has resolved the class."""
    term = TERM | {"status": "class", "class": ["jam-onset", "drive-lag"]}
    proposal = {"trial": "plan_3", "needed": 1}
    found = {"verdict": "class", "terms": [term], "next_experiment": [proposal]}
    assert run.recommended(found) == [("plan", 3, 1)]
    many = {"next_experiment": [proposal | {"needed": 99}]}
    assert run.recommended(found | many) == [("plan", 3, run.REPEATS)]
    again = {"next_experiment": [proposal | {"trial": "repeating trial_2"}]}
    assert run.recommended(found | again) == [("trial", 2, 1)]
    two = {"next_experiment": [proposal, *again["next_experiment"], proposal | {"needed": 2}]}
    assert run.recommended(found | two) == [("plan", 3, 2), ("trial", 2, 1)]
    beside = {"next_experiment": [proposal | {"further": [["plan_1", 2]]}]}
    assert run.recommended(found | beside) == [("plan", 3, 1), ("plan", 1, 2)]
    assert not run.recommended(found | {"next_experiment": None})
    assert not run.recommended({"verdict": "named", "terms": [TERM]})
    row = "next trial resolves the class"
    assert row not in judge.judge(TRUTH, {"verdict": "named", "terms": [TERM]})
    assert row not in judge.judge(TRUTH, found)  # not run yet
    assert not judge.judge(TRUTH, found, found)[row]
    assert judge.judge(TRUTH, found, {"verdict": "named", "terms": [TERM]})[row]
    for after in (
        {"verdict": "named", "terms": [TERM | {"id": "drive-lag", "class": []}]},
        {"verdict": "partial", "terms": [TERM, TERM | {"id": "kink", "class": []}]},
        {"verdict": "surrogate", "terms": [TERM | {"status": "surrogate"}]},
    ):
        assert not judge.judge(TRUTH, found, after)[row]
    part = found["next_experiment"] + [{"needed": None, "between": [TERM["id"], "flow"]}]
    left = {"verdict": "class", "terms": [TERM | {"status": "class", "class": [TERM["id"], "flow"]}]}
    assert not judge.judge(TRUTH, found, left)[row]
    assert judge.judge(TRUTH, found | {"next_experiment": part}, left)[row]  # it was said to stay
    of_others = found["next_experiment"] + [{"needed": None, "between": ["flow", "kink"]}]
    assert not judge.judge(TRUTH, found | {"next_experiment": of_others}, left)[row]
    flow = {"verdict": "named", "terms": [TERM | {"id": "flow", "class": ["flow"]}]}
    assert not judge.judge(TRUTH, found | {"next_experiment": part}, flow)[row]
    told = "class without a trial that would tell"
    assert not judge.judge(TRUTH, found)[told]
    none = found | {"next_experiment": [{"trial": "plan_3", "needed": None}]}  # no number of them would tell
    assert not run.recommended(none)
    assert row not in judge.judge(TRUTH, none, found) and judge.judge(TRUTH, none)[told]


def test_of_trials_that_are_alike_no_name_is_asked():
    """But a class that has the true cause in it, and a trial that tells."""
    truth = TRUTH | {"kind": "alike", "concealed": "alike"}
    term = TERM | {"status": "class", "class": ["jam-onset", "drive-lag"]}
    found = {
        "verdict": "class",
        "terms": [term],
        "next_experiment": [{"trial": "plan_3", "needed": 1}],
        **ERRORS,
    }
    judged = judge.judge(truth, found, {"verdict": "named", "terms": [TERM]})
    assert judged == {
        "trials alike: true cause stated": True, "trials alike: left open": 1.0,
        "class without a trial that would tell": False, "next trial resolves the class": True,
    }  # fmt: skip
    assert judge.wrong(judged) == []
    sure = judge.judge(truth, {"verdict": "named", "terms": [TERM | {"id": "flow", "class": ["flow"]}]})
    assert sure == {"trials alike: true cause stated": False, "trials alike: left open": 0.0}
    assert judge.wrong(sure) == ["trials alike: true cause stated"]


def test_a_recommended_trial_whose_truth_flies_apart_resolves_nothing(tmp_path, monkeypatch):
    """It is told as failed: what cannot be made is not left out of the count."""
    spec = next(s for s in plan.plan("t") if s.kind == "effect")
    term = {"id": "flow", "status": "class", "class": ["flow", "gravity"]}
    found = {"verdict": "class", "terms": [term], "next_experiment": [{"trial": "plan_1", "needed": 1}]}
    truth = {"sigma_m": 1e-3, "truth": {}, "guess": {}, "kept": [0]}
    for folder, held in (("runs", found), ("truth", truth)):
        name = f"{spec.name}/diagnosis.json" if folder == "runs" else f"{spec.name}.json"
        (tmp_path / folder / name).parent.mkdir(parents=True)
        (tmp_path / folder / name).write_text(json.dumps(held))

    def simulate(self, effects, elements, machine=None):
        raise FloatingPointError("the rods fly apart")

    monkeypatch.setattr(Setting, "simulate", simulate)
    after = run.follow("t", spec, tmp_path)
    assert after["verdict"] == "failed" and "fly apart" in after["error"]
    row = "next trial resolves the class"
    judged = judge.judge(
        TRUTH, {**found, "terms": [TERM | {"status": "class", "class": ["jam-onset", "flow"]}]}, after
    )
    assert judged[row] is False
