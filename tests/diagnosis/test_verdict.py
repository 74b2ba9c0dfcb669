"""What may be claimed, and when: verdicts, effects beside a remainder, placebos, the draws of a bootstrap."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.design import propose_all
from rodnet.diagnosis.findings import Interval, interval
from rodnet.diagnosis.forces import ForceColumns, Placebo, beside_force, placebo
from rodnet.diagnosis.pairs import hidden
from rodnet.diagnosis.refit import NEVER, _comparable, refit
from rodnet.diagnosis.remainder import test_remainder as remainder_of
from rodnet.diagnosis.replicas import replica
from rodnet.diagnosis.screen import strongest
from rodnet.diagnosis.verdict import (
    CROSS,
    LIKELY,
    Evidence,
    beats_trials,
    blind,
    judge,
    noticed,
    outweighs,
    status,
    word,
)  # fmt: skip
from rodnet.diagnosis.workbench import Workbench
from rodnet.report.sentences import told
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

CLEAR = Evidence(
    classes=(False,), trials=6, training=5, whole=True, holds=(), sure=(True,), resolved=True, alarmed=True,
    blind=False, improved=True,
)  # fmt: skip


@pytest.mark.parametrize(
    ("gains", "gain", "sure"),
    [
        ([390.0, 39.0, 5.2, -0.9], 525.0, True),  # met in two trials, and nothing in the others
        ([390.0, 3.0, 2.0, -0.9], 525.0, False),  # in one alone
        ([390.0, 39.0, 5.2, -20.0], 525.0, False),
        ([30.0, 8.0, -3.0, 2.0], 40.0, False),
        ([20.0, 30.0, 25.0, -1.0], 80.0, True),  # alike in most
    ],
)
def test_trials_gain_alike_or_some_of_them_for_sure(gains, gain, sure):
    assert beats_trials(np.array(gains), LIKELY, CROSS * gain) == sure


@pytest.mark.parametrize(
    ("change", "verdict", "called"),
    [
        ({}, "named", "named"),
        ({"trials": 4}, "class", "class"),
        ({"training": 2}, "class", "class"),
        ({"classes": (True,)}, "class", "class"),
        ({"whole": False, "holds": (True,)}, "partial", "named"),
        ({"whole": False, "holds": (False,)}, "surrogate", "surrogate"),
        ({"whole": False, "holds": (True,), "trials": 4}, "class", "class"),
        ({"many": True}, "partial", "named"),
        ({"improved": False}, "surrogate", "surrogate"),
        ({"sure": (False,)}, "surrogate", "surrogate"),
        ({"whole": False, "holds": (True,), "sure": (False,)}, "surrogate", "surrogate"),
        ({"resolved": False}, "unresolved-numerics", "surrogate"),
        ({"blind": True}, "unidentifiable", "class"),
    ],
)
def test_the_verdict(change, verdict, called):
    evidence = replace(CLEAR, **change)
    assert word(evidence) == verdict
    assert status(0, evidence, verdict) == called
    assert status(1, evidence, verdict) == "surrogate"  # a drafted law is no name


def test_the_verdict_without_an_effect():
    quiet = replace(CLEAR, sure=(), classes=(), alarmed=False)
    assert word(quiet) == "none"
    assert word(replace(quiet, blind=True)) == "unidentifiable"
    assert word(replace(quiet, near=True)) == "unresolved-numerics"
    assert word(replace(quiet, alarmed=True, whole=False)) == "surrogate"


@pytest.mark.parametrize(
    ("beyond", "words"),
    [
        ((False, False), "2 (1 to 3) Pa"),
        ((True, False), "at most 3 Pa"),
        ((False, True), "at least 1 Pa"),
        ((True, True), "any value fits"),
    ],
)
def test_an_interval_says_which_side_is_open(beyond, words):
    assert told(Interval(2.0, 1.0, 3.0, "Pa", beyond)) == words


def test_a_pair_is_found_together(two, base, scores):
    pair = hidden(two, base, scores, [], 0.0, lambda text: None)
    assert {one.candidate.family for one in pair} == {"stiffness-defect", "gravity"}
    assert pair[1].parent is pair[0].refit.fitted


def test_an_effect_that_explains_less_than_is_left_may_be_a_part_of_that(two, base, scores):
    """Beside noise it is one all the same."""
    (one,) = refit(two, base, [next(s for s in scores if s.candidate.id == "gravity")], 1)
    wave = shaken.left_with(base, 0.2)
    power = 0.2**2 * np.mean(np.sin(np.linspace(0.0, 6.0, 400)) ** 2) * wave.samples
    for fitted, gain, more in (
        (wave, 0.8, False),
        (wave, 1.6, True),
        (shaken.left_with(base, 0.0), 0.01, True),
    ):
        effect = replace(one, fitted=fitted, gain=gain * power, factor=1.0)
        assert outweighs(effect, remainder_of(fitted)) is more


def test_what_trials_contradict_each_other_about_is_no_sign(two, base, scores):
    """The trial is the unit of evidence; what is near the numerical error is one."""
    (one,) = refit(two, base, [next(s for s in scores if s.candidate.id == "gravity")], 1)
    cross = one.cross_gain
    assert noticed(one) and judge(one, 0.0).accepted
    near = replace(one, effect_sigma=0.3)
    assert noticed(near) and not judge(near, 0.2).accepted
    split = replace(one, after=one.before - one.factor * cross * np.array([2.0, -0.3, -0.7]))
    assert split.cross_gain == pytest.approx(cross) and not noticed(split)


def test_no_trial_is_looked_for_where_more_than_two_explanations_differ(two, base, scores):
    """A rival that was fitted before what was found later lacks that, which any trial would show."""
    weight, spot = (
        next(s for s in scores if s.candidate.id == id) for id in ("gravity", "stiffness-defect@rod")
    )
    (first,) = refit(two, base, [weight], 1)
    both = two.fit((weight.candidate, spot.candidate), first.fitted.values)
    heard = []
    alone = Accepted(first, base, [replace(first, fitted=both)])
    assert propose_all(two, [alone], first.fitted, 0.0, heard.append) == []
    assert "gravity was not fitted beside all that was found" in heard[0]
    named = replace(weight.candidate, id="weight")
    twin = replace(
        first,
        score=replace(first.score, candidate=named),
        fitted=replace(first.fitted, candidates=(named,)),
    )
    (same,) = propose_all(two, [Accepted(first, base, [twin])], first.fitted, 0.0, heard.append)
    assert same.needed is None  # nothing tells a thing from itself


def test_blind_if_nothing_could_have_been_seen(scores):
    assert not blind(scores)
    weak = [replace(s, p=1.0, visible={p: 1e9 * v for p, v in s.visible.items()}) for s in scores]
    assert blind(weak)
    same = [replace(scores[0], candidate=s.candidate) for s in scores]  # three that explain as much
    assert blind(same)


def test_placebos_of_noise_gain_little_and_those_of_a_signal_much(base):
    rng = np.random.default_rng(0)
    own = rng.standard_normal((base.samples, 6))
    names = [f"f{k}" for k in range(6)]
    forces = ForceColumns(names, dict.fromkeys(names, 1.0), own, np.zeros(6, dtype=bool))
    drawn = placebo(base, forces, 10, 2)
    assert drawn.beaten(50.0) == 1.0  # no force made of noise is worth that on trials left out
    residual = np.concatenate([f.residual for f in base.fits])
    told = ForceColumns(names, forces.scales, own + residual[:, None], forces.one_sided)
    assert placebo(base, told, 10, 2).cross.mean() > 10.0 * max(drawn.cross.mean(), 1.0)
    assert Placebo(np.zeros((2, 1)), np.zeros(2), np.array([1.0, 3.0])).beaten(2.0) == 0.5


def test_a_flexible_force_takes_away_what_it_explains(base):
    """A value stays where it is beside forces that explain nothing, and moves where they share its explanation."""
    rng = np.random.default_rng(1)
    J = np.concatenate([base.jacobian_of(k) for k in range(len(base.fits))])[:, 0]
    names = ["f"]
    idle = ForceColumns(names, {"f": 1.0}, rng.standard_normal((len(J), 1)), np.zeros(1, dtype=bool))
    assert beside_force(base, idle, ("rod.E",))["rod.E"] == pytest.approx(base.values["rod.E"], rel=0.01)
    residual = np.concatenate([f.residual for f in base.fits])
    mixed = residual[:, None] + 3.0 * np.linalg.norm(residual) / np.linalg.norm(J) * J[:, None]
    moved = beside_force(base, replace(idle, columns=mixed), ("rod.E",))["rod.E"]
    assert abs(np.log(moved / base.values["rod.E"])) > 5.0 * base.sd("rod.E") / base.values["rod.E"]


def test_replicas_are_the_model_and_noise(two, base):
    """Beside a remainder a replica is off its prediction by what the model leaves, up to a sign for each trial."""
    made = replica(shaken.CASE, two.recordings, base, two.noise, np.random.default_rng(0))
    for rec, old, fit in zip(made, two.recordings, base.fits, strict=True):
        np.testing.assert_allclose(
            np.abs(rec.markers - fit.predicted[0]), np.abs(old.markers - fit.predicted[0]), atol=1e-12
        )
    assert made[0].digest != two.recordings[0].digest or made[1].digest != two.recordings[1].digest


def test_strengths_of_one_side_are_the_best_there_are():
    """Of two columns nearly alike one strength is below zero at the free optimum: without it the other takes less."""
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 400))
    P = np.stack([a, a + 0.1 * b], axis=1)
    r = -(2.0 * P[:, 0] - 0.8 * P[:, 1]) + 0.01 * rng.standard_normal(400)
    free, sides = np.array([False, False]), np.array([True, True])
    assert strongest(P, r, free) == pytest.approx([2.0, -0.8], abs=0.05)
    z = strongest(P, r, sides)
    alone = -(P[:, 0] @ r) / (P[:, 0] @ P[:, 0])
    assert z == pytest.approx([alone, 0.0]) and z[0] < 1.3


def test_what_trials_do_not_depend_on_may_be_anything():
    """A rod that stays in a plane tells nothing of the friction that it has in twist."""
    recs = [shaken.record(k).cut(0.0, 0.3) for k in range(2)]
    flat = [replace(rec, attrs={**rec.attrs, "lift": 0.0}) for rec in recs]
    bench = Workbench.of(shaken.CASE, flat, Serial(), shaken.SIGMA)
    (friction,) = rn.candidates(shaken.build(flat[0]), [], ["dry-friction"])
    torque = "dry-friction.torque"
    values = {"rod.E": 2e6, "dry-friction.moment": 1e-4, torque: 1e-4, "dry-friction.curvature": 1.0}
    problem = bench.problem([friction], values)
    model = bench.evaluate(problem, np.zeros(len(problem.quantities)), [friction])
    told = interval(model, torque)
    assert told.low < 1e-3 * told.value and told.high > 1e3 * told.value and told.open == (True, True)
    assert 0.0 < interval(model, "rod.E").low < interval(model, "rod.E").high < np.inf


def test_a_judge_that_no_model_can_run_says_nothing():
    """Nor may one that a single model runs make all else nothing."""
    never, both = np.inf, _comparable(np.array([np.inf, 5.0, np.inf]), np.array([np.inf, 3.0, 4.0]))
    assert [float(d) for d in both[0] - both[1]] == [0.0, 2.0, NEVER - 4.0]
    assert np.all(np.isfinite(both)) and never > NEVER
