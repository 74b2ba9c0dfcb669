"""How a set is worked through: what it costs, cases of one machine together, and what fails stops no other."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind import cost, plan, work
from benchmarks.blind.generate import Setting, generate, setting
from benchmarks.blind.run import BEGUN, diagnose, through


def test_the_cost_is_of_what_is_left(tmp_path):
    """A machine is simulated once for all its cases, two effects cost more than one, done cases nothing."""
    specs = [s for s in plan.plan("a") if s.kind == "control"]
    one = [
        s
        for s in specs
        if (s.family, s.machine) == (specs[0].family, specs[0].machine) and s.engine == specs[0].engine
    ]
    assert cost.simulations(one) == cost.simulations(one[:1]) > 0.0
    before = cost.told(one, tmp_path / "set", 2)
    assert f"to diagnose {len(one)}" in before and "guessed" in before
    for folder, text in (("truth", {"kind": "control"}), ("runs", {"cpu_seconds": 7200.0})):
        at = tmp_path / "set" / folder / one[0].name
        at.mkdir(parents=True)
        (at.with_suffix(".json") if folder == "truth" else at / "diagnosis.json").write_text(json.dumps(text))
    after = cost.told(one, tmp_path / "set", 2)
    assert (
        f"to diagnose {len(one) - 1}: about {2.0 * (len(one) - 1):.1f} CPU h (measured on 1 cases)" in after
    )


def test_jobs_go_on_when_processes_are_renewed_and_one_fails(monkeypatch, capsys):
    """More jobs than the processes of one batch do, all of which end at once."""
    monkeypatch.setattr(work, "BATCH", 2)
    assert work.each(math.sqrt, [(float(k - 1),) for k in range(9)], 2, "roots") == 1
    told = capsys.readouterr().err
    assert "roots: ValueError" in told and "roots 9/9" in told


def test_cases_of_a_machine_come_together_and_the_dearest_first():
    groups = cost.by_machine(plan.plan("a"))
    assert sorted(s.name for some in groups for s in some) == sorted(s.name for s in plan.plan("a"))
    keys = [{(s.engine, s.family, s.machine) for s in some} for some in groups]
    assert all(len(key) == 1 for key in keys) and len(set(map(frozenset, keys))) == len(keys)
    costs = [cost.simulations(some) for some in groups]
    assert costs == sorted(costs, reverse=True) and costs[0] > costs[-1]


def test_a_case_that_cannot_be_made_stops_no_other(tmp_path, monkeypatch):
    one, two = [s for s in plan.plan("t", "small") if s.kind == "control"][:2]
    monkeypatch.setattr(Setting, "simulate", lambda self, effects, elements, machine=None: at_rest(self))
    nobody = replace(one, name="case_nobody", family="nobody")
    with pytest.raises(RuntimeError, match="case_nobody: ValueError: no family") as error:
        through("t", [nobody, two], tmp_path, ["generate"])
    assert two.name not in str(error.value)
    assert (tmp_path / "truth" / f"{two.name}.json").exists()


def test_an_effect_at_which_rods_fly_apart_is_drawn_calmer(tmp_path, monkeypatch):
    """An explicit scheme bears no stiffness at all: what it cannot run is half as strong, as often as it takes."""
    spec = next(
        s for s in plan.plan("t") if s.effects == ("nonlinear-elasticity",) and s.concealed == "plain"
    )
    there = setting("t", spec)
    still = at_rest(there)
    rng = np.random.default_rng(0)
    ways, moves = rng.standard_normal((2, *still.shape)), rng.standard_normal(still.shape)

    def simulate(self, effects, elements, machine=None):
        strength = effects.get("nonlinear-elasticity", {}).get("hardening", 0.0)
        if strength > 1.5e-3:
            raise FloatingPointError("the rods fly apart")
        nudged = [] if machine is None else [k for k, n in enumerate(("young", "viscosity"))
                                             if getattr(machine, n) != getattr(self.machine, n)]  # fmt: skip
        return still + 10.0 * strength * moves + sum(1e-3 * ways[k] for k in nudged)

    monkeypatch.setattr(Setting, "simulate", simulate)
    generate("t", spec, tmp_path)
    truth = json.loads((tmp_path / "truth" / f"{spec.name}.json").read_text())
    assert truth["truth"]["nonlinear-elasticity"]["hardening"] <= 1.5e-3
    assert 0.8 < truth["post_refit"]["nonlinear-elasticity"] / spec.size < 1.25


def at_rest(there: Setting) -> np.ndarray:
    """The markers where they are drawn, in all trials and at all times."""
    arms = there.machine.arms
    at = [arms[k].shape(np.array([0.0, s * arms[k].length]))[0][1] for k, s in there.places]
    return np.broadcast_to(np.array(at), (len(there.drives), len(there.t), len(at), 3))


def test_a_case_that_was_made_otherwise_is_made_anew(tmp_path, monkeypatch):
    """And what was found in it is gone: a score is of one generator."""
    spec = next(s for s in plan.plan("t", "small") if s.kind == "control")
    monkeypatch.setattr(Setting, "simulate", lambda self, effects, elements, machine=None: at_rest(self))
    truth, found = tmp_path / "truth" / f"{spec.name}.json", tmp_path / "runs" / spec.name / "diagnosis.json"
    generate("t", spec, tmp_path)
    before, made = truth.stat().st_mtime_ns, json.loads(truth.read_text())
    found.parent.mkdir(parents=True)
    found.write_text("{}")
    generate("t", spec, tmp_path)
    assert truth.stat().st_mtime_ns == before and found.exists()
    truth.write_text(json.dumps({**made, "made_by": "another"}))
    generate("t", spec, tmp_path)
    assert json.loads(truth.read_text()) == made and not found.exists()


def test_a_diagnosis_that_takes_its_process_with_it_has_failed(tmp_path):
    """After a few tries: a run that was ended goes on, but what never ends is no case that was not run."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "begun").write_text(f"[{BEGUN}, 0.0]")
    found = diagnose(tmp_path / "nothing", out)
    assert found["verdict"] == "failed" and "begun 3 times" in found["error"]
    assert not (out / "begun").exists() and json.loads((out / "diagnosis.json").read_text()) == found


def test_a_diagnosis_that_is_stopped_goes_on_with_the_time_that_is_left(tmp_path, monkeypatch):
    """By hand or by the system's leave: it did not fail, and what it took counts."""
    spec = next(s for s in plan.plan("t", "small") if s.kind == "control")

    def stopped(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("rodnet.read_recordings", stopped)
    for _ in range(BEGUN + 1):
        with pytest.raises(KeyboardInterrupt):
            diagnose(tmp_path / spec.name, tmp_path / "out")
    times, spent = json.loads((tmp_path / "out" / "begun").read_text())
    assert times == 0 and spent >= 0.0


def test_what_the_seal_does_not_tell_has_a_folder_of_its_own(monkeypatch):
    """Diagnoses of other candidates, and of code that is not committed, are not those of the sealed set."""
    monkeypatch.setattr(plan, "unsealed", list)
    assert plan.variant((None, 0, 0.0)) == ""
    some = plan.variant((["yield"], 0, 0.0))
    assert some and some != plan.variant((None, 4, 0.0))
    monkeypatch.setattr(plan, "unsealed", lambda: ["README.md"])
    assert plan.variant((None, 0, 0.0))
