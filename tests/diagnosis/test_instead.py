"""Effects with a wrong name give way to a law alone that explains more; what is right stays."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.chosen import Accepted, Attempt, Selection
from rodnet.diagnosis.crossval import left_out
from rodnet.diagnosis.instead import EXPLAINED, instead, law_alone
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.remainder import test_remainder as remainder_of
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import Judgement
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

TRIALS, TELL = 3, lambda text: None
DEFECT = {"loss": 0.6, "place": 0.37, "width": 0.06}


def chosen_with(bench: Workbench, effect: str) -> Selection:
    """What a search would return that had accepted one effect, right or wrong."""
    base = bench.fit()
    scores = screen(bench, base, candidates(bench.case.robot(bench.recordings[0]), [], [effect]))
    (one,) = refit(bench, base, scores[:1], 1)
    model, attempt = one.fitted, Attempt(one, Judgement(True, ()), 1)
    left = remainder_of(model, bench.noise)
    return Selection(model, [Accepted(one, base, [])], [attempt], scores, left, bench, base, 0.0)


def flat(k: int) -> rn.Recording:
    """A trial of a rod that bends more easily one way than the other."""
    true = shaken.robot(shaken.drive(k), 2 * shaken.EDGES).with_terms(rn.SectionStiffness(first=0.8))
    traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=list("abcd"), name=f"flat{k}", attrs=shaken.drive(k))


@pytest.mark.slow
def test_a_wrong_name_gives_way_to_a_law_that_explains_more():
    bench = Workbench.of(shaken.CASE, [flat(k) for k in range(TRIALS)], Serial(), shaken.SIGMA)
    wrong = chosen_with(bench, "plastic-set")
    found = instead(bench, wrong, None, law_alone(bench, wrong, 0.0, TELL), TELL)
    assert found is not None
    without, law = found
    assert without.accepted == [] and without.model is without.base
    assert without.attempts[0].judgement is EXPLAINED
    assert without.remainder.excess == remainder_of(wrong.base, bench.noise).excess
    assert left_out(law.refit.fitted).sum() < left_out(wrong.model).sum()
    assert law.pieces[-1].kind == "section"


def test_what_is_right_stays():
    recs = [shaken.record(k, "stiffness-defect", DEFECT) for k in range(TRIALS)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    right = chosen_with(bench, "stiffness-defect")
    assert instead(bench, right, None, law_alone(bench, right, 0.0, TELL), TELL) is None
    assert instead(bench, right, None, None, TELL) is None
