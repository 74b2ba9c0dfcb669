"""Scores of the blind benchmark: what is right counts, what is wrong does not, and all of it is shown."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind import generate, judge, plan, run, score
from benchmarks.blind.effects import EFFECTS
from tests.blind_truth import ERRORS, TERM, TRUTH


def test_clopper_pearson():
    """Limits of 57 of 60, and of none of 8: a rate of zero bounds little."""
    low, high = score.limits(57, 60)
    assert (low, high) == (pytest.approx(0.861, abs=1e-3), pytest.approx(0.990, abs=1e-3))
    assert score.limits(0, 8)[1] == pytest.approx(0.369, abs=1e-3)


def test_a_right_diagnosis_scores():
    """Name, class, onset, regime and intervals each by themselves."""
    judged = judge.judge(TRUTH, {"verdict": "named", "terms": [TERM], **ERRORS})
    assert judged["named right"] and judged["true cause in the stated class"] and judged["onset within 0.2 s"]
    assert judged["regime right"] and judged["class size"] == 1
    assert judged["90 % intervals of place cover"] == [True]
    assert judged["90 % intervals of strength cover"] == [False]
    assert judged["share of held-out excess removed"] == pytest.approx((25 - 1.21) / 24)
    assert judged["80 % of held-out excess removed"] and judged["more removed than by the placebo"]
    assert judge.wrong(judged) == ["90 % intervals of strength cover"]


def test_a_regime_is_told_by_the_right_term_else_by_the_force_that_was_missing():
    """An effect that is missed does not leave the count; and what the force alone tells stands beside it."""
    rows = "regime right", judge.BY_FORCE
    for verdict, terms, force, right in (
        ("named", [TERM], "depth", (True, False)),
        ("named", [TERM | {"regime": "speed"}], "time", (False, True)),
        (
            "surrogate",
            [TERM | {"id": "flow", "status": "surrogate", "regime": "depth"}],
            "time",
            (True, True),
        ),
        ("none", [], None, (False, False)),
    ):
        regime = None if force is None else {"variable": force}
        judged = judge.judge(TRUTH, {"verdict": verdict, "terms": terms, "regime": regime})
        assert tuple(judged[row] for row in rows) == right


def test_an_interval_of_one_side_covers_what_is_on_it_and_none_nothing():
    for low, high, covers in ((None, 2.3, True), (2.05, None, False), (None, None, False)):
        given = {"drag.onset": {"value": 2.1, "low": low, "high": high}}
        judged = judge.judge(TRUTH, {"verdict": "named", "terms": [TERM | {"parameters": given}]})
        assert judged["90 % intervals of place cover"] == [covers]


def test_where_nothing_is_to_be_removed_nothing_is_scored():
    """A trial held out that the effect does not reach is predicted to the noise as it is."""
    quiet = ERRORS | {"error_before": 0.99, "error_after": 1.0}
    judged = judge.judge(TRUTH, {"verdict": "named", "terms": [TERM], **quiet})
    assert judged["named right"] and "80 % of held-out excess removed" not in judged
    assert "80 % of held-out excess removed" not in judge.wrong(judged)


def test_a_class_counts_apart_once_what_it_recommends_is_done():
    """A class is no name; the trial that it asks for makes it one, or a wrong one."""
    alike = {"verdict": "class", "terms": [TERM | {"status": "class", "class": [TERM["id"], "flow@arm0"]}]}
    row = "named right, what is recommended done"
    assert not judge.judge(TRUTH, alike)[row]
    judged = judge.judge(TRUTH, alike, {"verdict": "named", "terms": [TERM]})
    assert judged[row] and not judged["named right"]
    assert not judge.judge(TRUTH, alike, {"verdict": "named", "terms": [TERM | {"id": "flow@arm0"}]})[row]


def test_a_class_of_names_of_one_law_is_a_name():
    """Friction with the medium or a yield stress of it, where the truth is a threshold; not where a drag may be it."""
    truth = TRUTH | {
        "effects": ["yield"], "right": [["yield", "medium-friction"]], "truth": {"yield": {"force": 0.01}},
    }  # fmt: skip
    for other, right in (("medium-friction", True), ("power-law", False)):
        term = TERM | {"id": "yield", "status": "class", "class": ["yield", other]}
        judged = judge.judge(truth, {"verdict": "class", "terms": [term]})
        assert judged["named right"] is right and judged["class size"] == 2
        assert judged["right name first"]  # whatever else may be it


def test_wrong_diagnoses_do_not_score():
    """A wrong name, a right one beside a wrong one, a right one only in the class, an alarm, a clean name outside."""
    wrong = TERM | {"id": "flow@arm0", "class": ["flow@arm0", "jam-onset"]}
    judged = judge.judge(TRUTH, {"verdict": "named", "terms": [wrong]})
    assert not judged["named right"] and judged["true cause in the stated class"]
    assert not judged["right name first"]
    assert judged["class size"] == 2 and not judged["80 % of held-out excess removed"]
    assert not judge.judge(TRUTH, {"verdict": "named", "terms": [TERM, wrong]})["named right"]
    assert not judge.judge(TRUTH, {"verdict": "class", "terms": [TERM, wrong]})["right name first"]
    beside = {"id": "flow@arm0", "status": "class", "class": ["flow@arm0", "gravity"]}
    assert not judge.judge(TRUTH, {"verdict": "partial", "terms": [TERM, beside]})["named right"]
    assert not judge.judge(TRUTH, {"verdict": "surrogate", "terms": [TERM | {"status": "surrogate"}]})[
        "named right"
    ]
    assert not any(v is True for v in judge.judge(TRUTH, {"verdict": "failed"}).values())
    control = {"kind": "control", "effects": ["white"]}
    assert judge.judge(control, {"verdict": "class", "terms": [TERM]})["false alarms, white"]
    assert judge.judge(control, {"verdict": "failed"})["false alarms, white"]
    assert not judge.judge(control, {"verdict": "none", "terms": []})["false alarms, white"]
    outside = {"kind": "outside", "effects": ["rope"]}
    for verdict, flagged in (("named", False), ("none", False), ("surrogate", True)):
        terms = [] if verdict == "none" else [TERM]
        assert (
            judge.judge(outside, {"verdict": verdict, "terms": terms})["outside the bank: flagged"] is flagged
        )


def test_a_drafted_law_must_remove_half_of_the_excess():
    """Of the held-out error^2 above the floor: 13 of 24 are half, 10 of 24 are not."""
    outside, found = (
        {"kind": "outside", "effects": ["rope"]},
        {"verdict": "surrogate", "terms": [], **ERRORS},
    )
    for after, enough in ((12.0**0.5, True), (15.0**0.5, False), (None, False)):
        law = {} if after is None else {"law": {"error_after": after}}
        assert judge.judge(outside, found | law)["outside: half removed by a law"] is enough


def test_a_law_beside_other_terms_is_judged_by_what_it_takes_off_itself():
    """Another term takes 60 % of the excess: of the 40 % that are left the law takes half, but not of all."""
    outside, left = (
        {"kind": "outside", "effects": ["rope"]},
        "outside: half of what was left removed by a law",
    )
    for own, enough in ((0.25, True), (0.15, False), (None, False)):
        terms = [{"id": "flow", "status": "surrogate", "explained_fraction": 0.6},
                 {"id": "local-law", "status": "surrogate", "explained_fraction": own}]  # fmt: skip
        found = {"verdict": "surrogate", "terms": terms, "law": {"accepted": True}, **ERRORS}
        judged = judge.judge(outside, found)
        assert judged[left] is enough and not judged["outside: half removed by a law"]


def test_a_strength_is_that_of_its_own_term():
    """Gravity acts along three axes: it is the one downwards that must hold the truth, with its sign."""
    truth = {
        "kind": "effect", "effects": ["gravity"], "right": [["gravity", "buoyancy"]], "concealed": "plain",
        "truth": {"gravity": {"g": 0.02}},
    }  # fmt: skip
    for value, covered in ((0.02, True), (-0.02, False)):
        axes = {"weight-x.g": 0.0, "weight-y.g": 0.0, "weight-z.g": value}
        given = {p: {"value": v, "low": v - 1e-3, "high": v + 1e-3} for p, v in axes.items()}
        judged = judge.judge(
            truth, {"verdict": "named", "terms": [TERM | {"id": "gravity", "parameters": given}]}
        )
        assert judged["90 % intervals of strength cover"] == [covered]


def test_of_two_effects_the_first_must_be_named_and_both_should():
    """The second missed: named right, not both; a third said: a false extra, and no right name."""
    two = TRUTH | {
        "effects": ["jam-onset", "flow"], "right": [["jam-onset"], ["flow"]],
        "truth": TRUTH["truth"] | {"flow": {"speed": 0.01, "along": [1.0, 0.0, 0.0]}},
    }  # fmt: skip
    flow = {
        "id": "flow",
        "status": "named",
        "parameters": {"flow.u_x": {"value": 0.01, "low": 0.009, "high": 0.011}},
    }
    one = judge.judge(two, {"verdict": "named", "terms": [TERM]})
    assert one["named right"] and not one["two effects: both named"] and not one["two effects: a false extra"]
    both = judge.judge(two, {"verdict": "named", "terms": [TERM, flow]})
    assert both["two effects: both named"] and both["90 % intervals of strength cover"] == [False, True]
    extra = judge.judge(
        two, {"verdict": "named", "terms": [TERM, flow | {"id": "gravity", "parameters": {}}]}
    )
    assert extra["two effects: a false extra"] and not extra["named right"]


def test_two_names_of_one_motion_are_right_together():
    """A recorder that is late, and a gripper that is: no drive tells them apart, and no more may be in the class."""
    truth = {
        "kind": "effect", "effects": ["record-lag"], "right": [["record-lag"]], "twins": [["drive-lag"]],
        "truth": {"record-lag": {"lag": 0.02}}, "post_refit": {"record-lag": 2.0},
    }  # fmt: skip
    late = {"id": "drive-lag@grip", "status": "class", "class": ["drive-lag@grip", "record-lag@markers"]}
    other = {"id": "kink@arm0", "status": "named", "class": ["kink@arm0"]}
    wider = late | {"class": [*late["class"], "camera-shift@markers"]}
    for verdict, terms, right in (
        ("class", [late], True), ("class", [wider], False), ("partial", [late, other], False),
        ("surrogate", [late | {"status": "surrogate"}], False), ("named", [late | {"class": [late["id"]]}], True),
    ):  # fmt: skip
        assert judge.judge(truth, {"verdict": verdict, "terms": terms})["named right"] is right
    alone = truth | {"twins": [[]]}
    assert not judge.judge(alone, {"verdict": "class", "terms": [late]})["named right"]
    # of two effects the second may have a twin, too
    two = truth | {
        "effects": ["kink", "record-lag"], "right": [["kink"], ["record-lag"]], "twins": [[], ["drive-lag"]],
        "truth": {"kink": {"size": 1.0, "kappa": [1.0, 0.0], "place": 0.5}, "record-lag": {"lag": 0.02}},
        "post_refit": {"kink": 2.0, "record-lag": 2.0},
    }  # fmt: skip
    single = late | {"status": "named", "class": [late["id"]]}
    both = judge.judge(two, {"verdict": "named", "terms": [other, single]})
    assert both["named right"] and both["two effects: both named"] and not both["two effects: a false extra"]
    one = judge.judge(two, {"verdict": "class", "terms": [other, late]})
    assert one["named right"] and one["two effects: both named"]
    for terms in (
        [other, wider],
        [other | {"status": "class", "class": ["kink@arm0", "flow"]}, late],
        [late],
    ):
        assert not judge.judge(two, {"verdict": "class", "terms": terms})["named right"]


def test_what_is_twisted_by_nature_is_a_twin_of_a_twisted_grip_on_a_straight_rod_alone():
    assert EFFECTS["grasp-twist"].twins_on("branched") == ("natural-twist",)
    assert EFFECTS["grasp-twist"].twins_on("spatial") == ()
    assert EFFECTS["record-lag"].twins_on("spatial") == ("drive-lag",)


def test_a_diagnosis_that_fails_removes_nothing():
    judged = judge.judge(TRUTH, {"verdict": "failed"})
    assert judged["share of held-out excess removed"] == 0.0 and not judged["80 % of held-out excess removed"]
    assert judged["more removed than by the placebo"] is False


def test_what_is_said_of_another_marker_is_not_in_the_class():
    truth = {
        "kind": "effect", "effects": ["misplaced-marker"], "right": [["marker-place"]], "kept": [0, 1, 2, 3],
        "truth": {"misplaced-marker": {"along": 0.01, "marker": 2}}, "post_refit": {"misplaced-marker": 3.0},
    }  # fmt: skip
    ids = [f"marker-place@markers:{k}" for k in (1, 3)]
    judged = judge.judge(
        truth, {"verdict": "class", "terms": [{"id": ids[0], "status": "class", "class": ids}]}
    )
    assert judged["class size"] == 2 and not judged["true cause in the stated class"]


def test_parts_of_one_set_are_told_together(tmp_path):
    """Rates of all of its cases; another seed is another set."""
    alarm = {"scores": {"false alarms, white": True}, "kind": "control"}
    quiet = {"scores": {"false alarms, white": False}, "kind": "control"}
    parts = [
        {"set": "full", "seed": seed, "share": share, "missing": 0, "commit": "c", "cases": cases}
        for seed, share, cases in (
            ("a" * 64, "control:1/2", {"one": alarm, "two": quiet}), ("b" * 64, "1/18", {"three": alarm}),
            ("a" * 64, "control:2/2", {"four": quiet}),
        )
    ]  # fmt: skip
    parts = [{**part, **score.counted(part["cases"])} for part in parts]
    other, both = score.together(parts)
    assert other["seed"][0] == "b" and both["share"] == "control:1/2, control:2/2"
    assert (
        both["rates"]["false alarms, white"]["hits"] == 1 and both["rates"]["false alarms, white"]["of"] == 3
    )
    assert "3 of 276 cases" in score.head(both)
    lost = [{**part, "missing": k + 1} for k, part in enumerate(parts)]
    _, both = score.together([*lost, {**parts[0], "missing": 0}])  # the first part once more, whole now
    assert both["missing"] == 3 and both["share"] == "control:1/2, control:2/2"


class Blowing:
    """A setting in which an effect of unit size per strength blows up beyond some strength."""

    machine = SimpleNamespace(arms=[SimpleNamespace(length=1.0)], family="shaken")

    def __init__(self, stable):
        self.stable, self.asked = stable, []

    def simulate(self, effects, elements):
        strength = effects["nonlinear-elasticity"]["hardening"]
        self.asked.append(strength)
        size = strength if strength <= self.stable else 50.0
        return size * np.sin(np.arange(20.0))[None, :, None, None] * np.ones((2, 20, 1, 3))


def test_strengths_at_which_the_truth_blows_up_are_no_truth():
    """The largest that does not is sought; where everything does, there is no case."""
    nominal, slopes = np.zeros((2, 20, 1, 3)), [np.ones((2, 20, 1, 3))]

    def sized(there, start, size):
        given = {"hardening": start}
        return generate._sized("nonlinear-elasticity", given, there, nominal, slopes, [0], size, 40)

    values, seen = sized(Blowing(1e-2), 4e-3, 5e-3)
    assert generate.left_over(seen, slopes, [0]) == pytest.approx(5e-3, rel=0.2)
    there = Blowing(3e-3)  # what is wanted is not stable
    values, seen = sized(there, 4e-3, 5e-3)
    assert there.asked[0] == 4e-3 and 1e-3 < values["hardening"] <= 3e-3 and np.abs(seen).max() < 0.1
    values, seen = sized(Blowing(1e-4), 4e-3, 5e-3)  # nor is what is tried first, by far
    assert 3e-5 < values["hardening"] <= 1e-4 and np.abs(seen).max() < 0.1
    with pytest.raises(ArithmeticError, match="a motion that is none"):
        sized(Blowing(1e-9), 4e-3, 5e-3)


def test_an_effect_that_cannot_be_made_large_enough_does_not_count():
    """Below half a sigma after the refit there is nothing to score."""
    assert judge.judge(TRUTH | {"post_refit": {"jam-onset": 0.4}}, {"verdict": "none"}) == {}
    assert judge.judge(TRUTH | {"post_refit": {"jam-onset": 0.6}}, {"verdict": "none"}) != {}


def test_a_case_that_takes_too_long_is_stopped():
    """By CPU time, in the middle of what it does, whatever catches errors there."""
    with pytest.raises(run.OutOfTime), run._within(0.05):
        while True:
            try:
                sum(range(1000))
            except Exception:
                continue


def test_a_score_prints_every_demand_and_every_failure(tmp_path, monkeypatch):
    """Met, not met and not measured; and the ledger shows what is in it."""
    specs = plan.plan("s", "smoke")
    for spec in specs:
        truth = {**plan.as_dict(spec), "made_by": plan.made_by(), "truth": {}, "post_refit": {}}
        (tmp_path / "truth").mkdir(exist_ok=True)
        (tmp_path / "truth" / f"{spec.name}.json").write_text(json.dumps(truth))
        (tmp_path / "runs" / spec.name).mkdir(parents=True)
        (tmp_path / "runs" / spec.name / "diagnosis.json").write_text(
            json.dumps({"verdict": "none", "terms": []})
        )
    said = []
    ledger = tmp_path / "ledger.jsonl"
    monkeypatch.setattr(plan, "commit", lambda: "0" * 40)
    entry = score.report(tmp_path, "s", "smoke", ledger=ledger, say=said.append)
    for demand in score.DEMANDS:
        assert f"| {demand.row} |" in said[0]
    assert (
        "| false alarms, white | 0 of 1 | 0 % (0 to 98 %) | at most 1 of 60 | so far, with 1 of 60 |"
        in said[0]
    )
    assert "| named right | 0 of 2 | 0 % (0 to 84 %) | at least 57 of 60 | no |" in said[0]
    assert (
        "| next trial resolves the class | 0 | not measured | at least 80 % of 10 or more | no |" in said[0]
    )
    wrong = [spec.name for spec in specs if spec.kind != "control"]
    shown = score.ledger_table(ledger)
    assert all(name in said[0] and name in shown for name in wrong) and table_of(shown) == table_of(said[0])
    assert entry["missing"] == 0 and len(entry["cases"]) == len(specs)


def table_of(text: str) -> list[str]:
    """Rows of a Markdown table."""
    return [line for line in text.splitlines() if line.startswith("|")]


def test_only_the_marker_that_is_elsewhere_is_the_right_one():
    truth = {
        "kind": "effect", "effects": ["misplaced-marker"], "right": [["marker-place"]], "kept": [0, 2, 3],
        "truth": {"misplaced-marker": {"along": 0.01, "marker": 2}}, "post_refit": {"misplaced-marker": 3.0},
    }  # fmt: skip
    for number, low, right, covers in (
        (1, 0.009, True, [True]),
        (1, 0.0105, True, [False]),
        (2, 0.009, False, None),
    ):
        path = f"markers.misplaced[{number}]"
        term = {
            "id": f"marker-place@markers:{number}", "status": "named",
            "parameters": {path: {"value": 0.0107, "low": low, "high": 0.011}},
        }  # fmt: skip
        found = judge.judge(truth, {"verdict": "named", "terms": [term]})
        assert found["named right"] is right
        assert found.get("90 % intervals of strength cover") == covers
