"""The paper's robot in grains that yield, seen by its head alone: its fit is good, and something is missing."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.confirm import profiles
from rodnet.diagnosis.heldout import floor_of, open_trials
from rodnet.diagnosis.scales import ALPHA
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.told import regime_of
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.problem import Problem
from rodnet.sweeps.collect import Serial
from rodnet.testing import check_term

PATH = Path(__file__).parents[2] / "examples" / "paper_concealed.py"
TRIED = ["yield", "anisotropy"]


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("paper_concealed", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def fitted(example):
    """Trials with two tails and three, resistive force theory fitted to them, and the scores about it."""
    trials = [(2, (100.0, 0.0)), (2, (240.0, 60.0)), (3, (80.0, 160.0)), (2, (70.0, 150.0))]
    recs = [
        example.record("yield", n, speeds, f"trial {k}", np.random.default_rng(k), edges=12, plateau=3.0)
        for k, (n, speeds) in enumerate(trials)
    ]
    bench = Workbench.of(example.CASE, recs[:3], Serial(), example.WHITE)
    base = bench.fit()
    robot = example.CASE.robot(bench.simplest)
    scores = screen(bench, base, candidates(robot, [], TRIED))
    held = Workbench.of(example.CASE, recs[3:], Serial(), example.WHITE)
    return bench, base, scores, held


def test_the_true_medium_is_a_law(example):
    check_term(example.Threshold)


def test_a_motor_turns_by_the_integral_of_its_speed(example):
    t, rpm = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 60.0, 60.0, 0.0])
    turned = example.Turned(t, rpm)
    fine = np.linspace(0.0, 5.0, 5001)
    speed = np.interp(fine, t, rpm) * 2.0 * np.pi / 60.0
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(fine))])
    assert [turned(s) for s in fine[::500]] == pytest.approx(whole[::500], abs=1e-5)


def test_resistive_force_theory_is_not_enough_and_a_threshold_scores_first(fitted):
    bench, base, scores, _ = fitted
    assert scores[0].candidate.id == "yield" and scores[0].p < ALPHA
    assert base.deviance / base.samples < 1.5  # by eye nothing is missing
    better = bench.fit(
        [scores[0].candidate], {**base.values, **scores[0].shape, **scores[0].strength}, evaluations=6
    )
    assert better.deviance < base.deviance - 0.5 * scores[0].chi2


def test_the_profile_of_what_hardly_matters_stays_near_it(fitted, monkeypatch):
    """A creep slower than anything that was seen may be any slower: nobody runs a law that is all but a jump."""
    _, _, scores, held = fitted
    candidate, creep = scores[0].candidate, 3e-7
    problem = held.problem([candidate], {"yield.yield_stress": 0.12, "yield.speed": creep})
    model = held.evaluate(problem, np.zeros(len(problem.quantities)), [candidate])
    asked, fits = [], Problem.fits

    def noted(self, z, slopes=True):
        asked.append(self.values(z, 0)["yield.speed"])
        return fits(self, z, slopes)

    monkeypatch.setattr(Problem, "fits", noted)
    found = profiles(held, model, candidate.paths)
    assert all(found["yield.speed"].open) and not any(found["yield.yield_stress"].open)
    # a faster one is less of a jump, and is run until it would show
    assert min(asked) == pytest.approx(0.1 * creep)


def test_errors_are_of_the_position_alone(fitted, example):
    """Metres are not added to revolutions per minute; the floor is that of one coordinate."""
    _, base, _, held = fitted
    opened = open_trials(held, base)
    (fit,) = opened.fitted.fits
    far = (fit.measured[0] - fit.predicted[0]).ravel()
    assert opened.error == pytest.approx(np.sqrt(np.mean(far**2)))
    assert floor_of(opened, held) == pytest.approx(example.WHITE["position"])


def test_a_plugin_says_what_its_law_depends_on():
    pytest.importorskip("rodnet_jamming", reason="pip install -e plugins/rodnet-jamming")
    for family, regime in (("jamming", "spacing"), ("grain-yield", "speed"), ("quadratic", None)):
        one = SimpleNamespace(id=family, family=family, on="", when=None, at=None)
        assert regime_of(one, None)[0] == regime
