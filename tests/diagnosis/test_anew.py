"""An effect that stands in for a numerical error is given up when that error is measured with it in the model."""

from __future__ import annotations

from dataclasses import replace

import pytest

import rodnet as rn
from rodnet.diagnosis.anew import anew
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.numerics import carrying, measure
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import judge
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

SILENT = lambda text: None  # noqa: E731
LEFT = 0.02  # [sigma] numerical error that is left beside what is carried


def damped(rec: rn.Recording, robot: rn.Robot) -> dict[str, object]:
    """Steps that damp by themselves."""
    return {"dt": shaken.DT, "stepper": "euler"}


@pytest.fixture(scope="module")
def bench() -> Workbench:
    recs = [shaken.record(k) for k in range(4)]  # nothing is missing
    return Workbench.of(replace(shaken.CASE, options=damped), recs, Serial(), shaken.SIGMA)


def chosen(bench: Workbench, plain, numerics, kinds):
    """The trials with a numerical error carried along, and what is refitted beside it."""
    over = carrying(bench, numerics)
    base = over.fit(values=plain.values, own=plain.own)
    bank = candidates(bench.case.robot(bench.recordings[0]), (), kinds)
    scores = screen(over, base, bank)
    return over, base, refit(over, base, scores, len(scores))


def test_what_a_stale_numerical_error_lets_through_does_not_stand(bench):
    plain = bench.fit()
    true = measure(bench, plain)
    stale = replace(
        true, fields=[{n: tuple(0.0 * f for f in own) for n, own in one.items()} for one in true.fields]
    )
    over, base, found = chosen(bench, plain, stale, ["added-mass", "kelvin-voigt", "drive-lag"])
    good = [one for one in found if judge(one, LEFT).accepted]
    assert good
    again = anew(over, base, found, good, 3, LEFT, SILENT)
    assert again is not None
    over, without, refits, left = again
    # what decides from now on is the larger error, that without the effect here
    assert left == pytest.approx(measure(over, without).left, rel=0.1) and left > LEFT
    assert without.deviance < base.deviance - good[0].gain
    assert not any(judge(one, LEFT).accepted for one in refits)


def test_of_explanations_as_good_it_is_that_of_the_simplest():
    """A bend that is alike all along: what eight strengths explain a trifle better has another numerical error."""
    recs = [shaken.record(k, "natural-curvature", {"kappa2": 0.6}) for k in range(3)]
    bench = Workbench.of(replace(shaken.CASE, options=damped), recs, Serial(), shaken.SIGMA)
    plain = bench.fit()
    true = measure(bench, plain)
    stale = replace(
        true, fields=[{n: tuple(0.0 * f for f in own) for n, own in one.items()} for one in true.fields]
    )
    over, base, found = chosen(bench, plain, stale, ["natural-curvature", "natural-shape"])
    assert {one.id for one in found if judge(one, LEFT).accepted} == {
        "natural-curvature@rod",
        "natural-shape@rod",
    }
    told: list[str] = []
    anew(over, base, found, found, 2, LEFT, told.append)
    assert told[0] == "the numerical error is another one with natural-curvature@rod"


def test_what_explains_as_much_elsewhere_stays(bench):
    """An interval holds all places: they are not lost where the numerical error is measured again."""
    plain = bench.fit()
    true = measure(bench, plain)
    stale = replace(
        true, fields=[{n: tuple(0.0 * f for f in own) for n, own in one.items()} for one in true.fields]
    )
    over, base, found = chosen(bench, plain, stale, ["added-mass"])
    (one,) = (replace(one, others=(one.fitted,)) for one in found)
    again = anew(over, base, [one], [one], 1, LEFT, SILENT)
    assert again is not None
    assert [len(kept.others) for kept in again[2] if kept.id == one.id] == [1]
