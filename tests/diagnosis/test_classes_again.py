"""What was found first is compared again when the model has what was found later."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis import numerics
from rodnet.diagnosis.anew import beside_all
from rodnet.diagnosis.backward import exchanged
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.classes import classes_again
from rodnet.diagnosis.patience import Patience
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

SILENT = lambda text: None  # noqa: E731
NUMERICAL = 0.01


def record(k: int) -> rn.Recording:
    """A trial of a rod that is bent by nature, in a current."""
    robot = shaken.robot(shaken.drive(k), 2 * shaken.EDGES)
    robot = shaken.with_effect(robot, "natural-curvature", {"kappa1": 1.0, "kappa2": 0.0})
    robot = shaken.with_effect(robot, "flow", {"u_z": 0.03})
    traj = rn.Simulation(robot, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
    t = [n / shaken.RATE for n in range(int(shaken.RATE * shaken.DURATION))]
    seen = rn.observe([rn.Markers(robot, shaken.POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    names = [f"m{i}" for i in range(len(shaken.POINTS))]
    return rn.Recording(t, seen, names=names, name=f"trial{k}", attrs=shaken.drive(k))


@pytest.fixture(scope="module")
def bench():
    return Workbench.of(shaken.CASE, [record(k) for k in range(3)], Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def base(bench):
    return bench.fit()


@pytest.fixture(scope="module")
def gravity(bench, base):
    """Gravity, and the current beside it."""
    return one_after_the_other(bench, base, "gravity", "flow")


@pytest.fixture(scope="module")
def bend(bench, base):
    """The bend, and the current beside it."""
    return one_after_the_other(bench, base, "natural-curvature", "flow")


def one_after_the_other(bench, base, *ids):
    """Effects, each refitted beside those before it."""
    found, model, robot = [], base, bench.case.robot(bench.recordings[0])
    for id in ids:
        scores = screen(bench, model, candidates(robot, [], [id])[:1])
        (best,) = refit(bench, model, scores, 1)
        found.append(Accepted(best, model, []))
        model = best.fitted
    return found


def test_a_wrong_first_choice_is_put_right_by_what_is_found_later(bench, base, gravity, bend):
    """Gravity stood for the bend while the current was unknown; with it in, the bend explains far more."""
    model = gravity[-1].refit.fitted
    wrong = Accepted(gravity[0].refit, base, [bend[0].refit])
    again, better, _ = classes_again(bench, base, [wrong, gravity[1]], model, NUMERICAL, SILENT)
    assert [a.candidate.family for a in again] == ["natural-curvature", "flow"]
    assert better.deviance < 0.8 * model.deviance
    assert better.deviance < 1.2 * better.samples
    assert again[0].equivalents == []
    assert again[1].parent is again[0].refit.fitted
    assert better.values["natural-curvature@rod.kappa1"] == pytest.approx(1.0, abs=0.1)


def test_what_is_behind_beside_what_is_found_later_leaves_the_class(bench, base, gravity, bend):
    """The bend stood first and gravity in its class; beside the current it is no rival, and nothing else changes."""
    model = bend[-1].refit.fitted
    both = Accepted(bend[0].refit, base, [gravity[0].refit])
    again, same, _ = classes_again(bench, base, [both, bend[1]], model, NUMERICAL, SILENT)
    assert same is model
    assert [a.refit for a in again] == [a.refit for a in bend]
    assert again[0].equivalents == []


def test_what_explains_as_much_is_kept_with_all_that_was_found_later(bench, base, bend):
    """By that models are compared where a trial is looked for that tells them apart: only the one thing differs."""
    model = bend[-1].refit.fitted
    first = bend[0].refit
    named = replace(first.score.candidate, id="bend")
    twin = replace(
        first,
        score=replace(first.score, candidate=named),
        fitted=replace(first.fitted, candidates=(named,)),
    )
    again, same, _ = classes_again(
        bench, base, [Accepted(first, base, [twin]), bend[1]], model, NUMERICAL, SILENT
    )
    assert same is model
    (rival,) = again[0].equivalents
    assert {c.id for c in rival.whole.candidates} == {"bend", bend[1].candidate.id}
    assert rival.whole.deviance == pytest.approx(model.deviance, rel=1e-4)
    assert rival.whole.deviance < 0.8 * rival.fitted.deviance  # which lacks the current


@pytest.mark.slow
def test_what_takes_many_parameters_to_explain_a_trifle_more_takes_no_place(bench, base, bend):
    """The truth has another mesh: a natural shape of ten strengths takes up what that is off by, beside a bend."""
    model = bend[-1].refit.fitted
    (shape,) = one_after_the_other(bench, base, "natural-shape")
    both = Accepted(bend[0].refit, base, [shape.refit])
    other = bench.fit(
        [shape.candidate, bend[1].candidate], model.values | shape.refit.fitted.values, model.own
    )
    assert other.deviance < model.deviance - 30.0
    again, same, _ = classes_again(bench, base, [both, bend[1]], model, NUMERICAL, SILENT)
    assert same is model
    assert again[0].refit is bend[0].refit and again[0].equivalents == []


BANK = ["gravity", "natural-curvature", "flow", "kelvin-voigt", "added-mass"]


def test_a_wrong_first_choice_is_exchanged_without_having_been_in_a_class(bench, base, gravity):
    """Nothing told of the bend when gravity was chosen: beside the current the whole bank is asked again."""
    model = gravity[-1].refit.fitted
    bank = candidates(bench.case.robot(bench.recordings[0]), [], BANK)
    found = exchanged(bench, base, gravity, model, bank, [], NUMERICAL, SILENT)
    again, better, tried = found.accepted, found.model, found.attempts
    assert [a.candidate.family for a in again] == ["flow", "natural-curvature"]
    assert better.deviance < 1.2 * better.samples
    assert again[1].parent is again[0].refit.fitted and again[1].refit.fitted is better
    assert "natural-curvature" in {a.refit.score.candidate.family for a in tried if a.judgement.accepted}


def test_what_is_right_is_not_exchanged(bench, base, bend):
    model = bend[-1].refit.fitted
    bank = candidates(bench.case.robot(bench.recordings[0]), [], BANK)
    same = exchanged(bench, base, bend, model, bank, [], NUMERICAL, SILENT)
    assert same.accepted is bend and same.model is model and not same.hurried and not same.anew
    late = exchanged(bench, base, bend, model, bank, [], NUMERICAL, SILENT, Patience(lambda: 100.0, 1.0))
    assert late.hurried


def test_the_numerical_error_is_that_of_the_model_with_all_effects(bench, base):
    """What finer runs change is another thing beside the second effect than it was when the first was found."""
    over = numerics.carrying(bench, numerics.measure(bench, base))
    plain = over.fit(values=base.values)
    accepted = one_after_the_other(over, plain, "natural-curvature", "flow")
    model = accepted[-1].refit.fitted
    found = beside_all(over, plain, accepted, model, NUMERICAL, SILENT)
    assert found is not None
    again, without, chain, whole, left = found
    assert whole.deviance < model.deviance and left >= NUMERICAL
    assert [a.candidate.id for a in chain] == [a.candidate.id for a in accepted]
    assert chain[-1].refit.fitted is whole and chain[0].parent is without
    now, then = numerics.measure(again, whole), again.case.observe.fields
    for fields, recording in zip(now.fields, again.recordings, strict=True):
        for here, there in zip(fields["markers"], then[recording.name]["markers"], strict=True):
            assert np.linalg.norm(here - there) < 0.05 * np.linalg.norm(there) + 0.05 * shaken.SIGMA
    assert beside_all(again, without, chain, whole, left, SILENT) is None
