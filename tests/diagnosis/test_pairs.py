"""Two effects at once: such as hide each other, and such for which a single one stands in."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.beside import beside_the_others
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.classes import classes_again
from rodnet.diagnosis.numerics import measure
from rodnet.diagnosis.pairs import _pairs, _promise, hidden, instead_of
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

SILENT = lambda text: None  # noqa: E731
BANK = ["stiffness-defect", "gravity", "kelvin-voigt", "natural-curvature"]


def weighted_and_damped(robot):
    """A rod that weighs something, and loses energy as it bends."""
    return robot.with_terms(rn.Gravity(g=0.15), rn.KelvinVoigt(bend=0.1, twist=0.1))


def bench_of(change=None, **effect):
    return Workbench.of(
        shaken.CASE, [shaken.record(k, change=change, **effect) for k in range(3)], Serial(), shaken.SIGMA
    )


@pytest.fixture(scope="module")
def two():
    return bench_of(weighted_and_damped)


@pytest.fixture(scope="module")
def base(two):
    return two.fit()


@pytest.fixture(scope="module")
def scores(two, base):
    return scored(two, base)


def scored(bench, model):
    robot = shaken.build(bench.recordings[0])
    return screen(bench, model, rn.candidates(robot, [], BANK))


def by_id(scores):
    return {s.candidate.id.removesuffix("@rod"): s for s in scores}


def test_two_simple_effects_stand_before_one_of_more_parameters(two, base, scores):
    """Weight and damping, with a soft spot that was accepted in their place."""
    some = [by_id(scores)[id] for id in ("stiffness-defect", "gravity", "kelvin-voigt")]
    spot, *others = (one for score in some for one in refit(two, base, [score], 1))
    pair = instead_of(two, base, spot, scores, [spot, *others], 0.0, SILENT)
    assert {one.candidate.family for one in pair} == {"gravity", "kelvin-voigt"}
    assert pair[-1].refit.fitted.deviance < spot.fitted.deviance


def test_the_right_one_stays():
    """What two others explain of a soft spot is less."""
    bench = bench_of(
        lambda robot: shaken.with_effect(
            robot, "stiffness-defect", {"loss": 0.5, "place": 0.4, "width": 0.06}
        )
    )
    base = bench.fit()
    scores = scored(bench, base)
    some = [by_id(scores)[id] for id in ("stiffness-defect", "gravity", "kelvin-voigt")]
    spot, *others = (one for score in some for one in refit(bench, base, [score], 1))
    assert instead_of(bench, base, spot, scores, [spot, *others], 0.0, SILENT) == []


def test_what_has_the_wrong_sign_alone_is_paired_all_the_same(two, base, scores):
    """Beside another it may have the right one; and no pair counts on a sign that cannot be."""
    r = Basis.of(base.jacobian).out(base.residual)
    found = by_id(scores)
    damped, heavy = found["kelvin-voigt"], found["gravity"]
    masked = replace(damped, chi2=0.0, strength=dict.fromkeys(damped.strength, 0.0))
    pairs = list(_pairs([heavy, masked], r))
    assert [(a.candidate.family, b.candidate.family) for a, b in pairs] == [("gravity", "kelvin-voigt")]
    assert _promise(base, r, heavy, damped) > 0.0
    assert damped.one_sided.all()
    assert _promise(base, r, heavy, replace(damped, columns=-damped.columns)) == 0.0
    pair = hidden(two, base, [heavy, masked], [], 0.0, SILENT)
    assert {one.candidate.family for one in pair} == {"gravity", "kelvin-voigt"}


def test_of_pairs_that_explain_the_same_the_simpler_stands(two, base):
    """A current of three components follows a trifle of what weight beside damping leaves: it may be the truth."""
    some = rn.candidates(shaken.build(two.recordings[0]), [], ["flow", "gravity", "kelvin-voigt"])
    scores = screen(two, base, some)
    assert hidden(two, base, [s for s in scores if s.candidate.id != "gravity"], [], 0.0, SILENT)
    pair = hidden(two, base, scores, [], measure(two, base).left, SILENT)
    assert [one.candidate.family for one in pair] == ["gravity", "kelvin-voigt"]
    assert [[other.id for other in one.equivalents] for one in pair] == [["flow"], []]


@pytest.fixture(scope="module")
def chain(two, base, scores):
    """Weight, and damping beside it."""
    (heavy,) = refit(two, base, [by_id(scores)["gravity"]], 1)
    (damped,) = refit(two, heavy.fitted, [by_id(scored(two, heavy.fitted))["kelvin-voigt"]], 1)
    return [Accepted(heavy, base, []), Accepted(damped, heavy.fitted, [])]


def test_an_effect_counts_with_what_it_gains_beside_the_others(two, base, chain):
    """Whatever it gained when it was alone."""
    nothing = replace(chain[0].refit, before=chain[0].refit.after)
    first, second = beside_the_others(
        two, [replace(chain[0], refit=nothing), chain[1]], chain[1].refit.fitted
    )
    assert nothing.cross_gain == 0.0 and first.refit.cross_gain > 50.0
    assert [c.family for c in first.parent.candidates] == ["kelvin-voigt"]
    assert second.refit.cross_gain == pytest.approx(chain[1].refit.cross_gain, rel=0.05)


@pytest.mark.slow
def test_a_rival_beside_what_is_gone_is_fitted_beside_what_there_is(two, base, scores, chain):
    """Its fit has a third effect, which was deleted since: beside the others it is far behind, and no rival."""
    model = chain[1].refit.fitted
    bent = by_id(scored(two, chain[0].refit.fitted))["natural-curvature"]
    (rival,) = refit(two, chain[0].refit.fitted, [bent], 1)
    (third,) = refit(two, rival.fitted, [by_id(scored(two, rival.fitted))["stiffness-defect"]], 1)
    stale = replace(rival, fitted=third.fitted)
    last = replace(chain[1], equivalents=[stale])
    again, same, _ = classes_again(two, base, [chain[0], last], model, 0.01, SILENT)
    assert same is model and [one.equivalents for one in again] == [[], []]


def test_a_rival_of_more_parameters_must_gain_by_them(two, base, scores, chain):
    """A soft spot beside damping, that is as good as the weight by its further parameters, is none.

    Of its place and width as of any two: they gain six by chance once in twenty, and less than the logarithm of the
    number of samples each, but for six, is strong evidence against them.
    """
    model = chain[1].refit.fitted
    factor = variance_factor(model)
    most = max(6.0, 2.0 * np.log(model.samples / factor) - 6.0)
    (spot,) = refit(two, base, [by_id(scores)["stiffness-defect"]], 1)
    both = replace(spot, fitted=replace(model, candidates=(spot.score.candidate, chain[1].candidate)))
    for share, kept in ((0.5, False), (0.95, False), (1.05, True), (1.3, True)):
        near = replace(both.fitted, deviance=model.deviance - share * most * factor)
        once = replace(chain[0], equivalents=[replace(both, fitted=near)])
        once = replace(once, refit=replace(once.refit, gain=10.0, factor=1.0))
        again, *_ = classes_again(two, base, [once, chain[1]], model, 0.0, SILENT)
        assert bool(again[0].equivalents) is kept


def test_numbers_of_one_side_are_those_of_the_candidates(scores):
    sides = {id: s.one_sided.tolist() for id, s in by_id(scores).items()}
    assert sides["kelvin-voigt"] == [True] and sides["gravity"] == [False]
    assert sides["natural-curvature"] == [False, False]
    assert np.all([s.one_sided.shape == (len(s.candidate.strength),) for s in scores])
