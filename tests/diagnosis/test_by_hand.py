"""Stages of a diagnosis by hand: what each finds, and that it is computed once."""

import pytest

import rodnet as rn
from tests.diagnosis import shaken

TRIED = ["stiffness-defect", "gravity"]


@pytest.fixture(scope="module")
def bench():
    values = {"loss": 0.6, "place": 0.37, "width": 0.06}
    return rn.stages.trials(
        shaken.CASE, [shaken.record(k, "stiffness-defect", values) for k in range(2)], noise=1e-3
    )


def test_what_is_missing_scores_best_and_is_kept(bench, tmp_path):
    bank = rn.stages.bank(bench, TRIED)
    stage = rn.stages.kept(tmp_path, bench, bank)
    fitted = stage("calibrate", bench.fit)
    scores = stage("screen", rn.stages.screen, bench, fitted, bank)
    assert scores[0].candidate.family == "stiffness-defect" and scores[0].p < 1e-6
    assert rn.stages.test_remainder(fitted, bench.noise).p < 1e-6

    again = rn.stages.kept(tmp_path, bench, bank)
    assert again("calibrate", lambda: pytest.fail("computed twice")).values == fitted.values
    kept = again("screen", lambda: pytest.fail("computed twice"))
    assert [one.chi2 for one in kept] == [one.chi2 for one in scores]
    assert kept[0].candidate is scores[0].candidate  # by name: it may hold functions

    fewer = rn.stages.kept(tmp_path, bench, bank[:1])
    assert fewer("screen", lambda: "anew") == "anew"


def test_the_bank_is_that_of_a_diagnosis(bench):
    everything = {one.id for one in rn.stages.bank(bench)}
    assert {one.id for one in rn.stages.bank(bench, TRIED)} < everything
    with pytest.raises(rn.ParameterError, match="none of the candidates motor-droop"):
        rn.stages.bank(bench, ["motor-droop"])
