"""Trials of one group are left out together: what they share must not tell of each other."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.crossval import cross_gains, left_out, reduced
from rodnet.diagnosis.folds import predicted
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


@pytest.fixture(scope="module")
def trials():
    """Two and two of rods that differ, so that a trial tells of its fellow more than of the others."""
    stiff = {"slope": 0.2}
    return [
        shaken.record(k, *(("stiffness-gradient", stiff) if k > 1 else ())).replace(group="ab"[k // 2])
        for k in range(4)
    ]


def bench(trials):
    return Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)


def test_a_trial_is_predicted_from_other_groups(trials):
    """To first order what a fit to them gives, and worse than with its fellow's help."""
    one = bench(trials)
    fitted = one.fit()
    alone = left_out(bench([rec.replace(group=rec.name) for rec in trials]).fit())
    together = left_out(fitted)
    assert together.sum() > alone.sum()
    assert together[0] == pytest.approx(predicted(one, fitted, 0), rel=2e-2)
    assert len(one.subset([0, 1]).fit().groups) == 2


def test_gains_are_those_of_predictions_from_other_groups(trials):
    """Of a direction that only the trials of one group know, its trials gain nothing."""
    fitted = bench(trials).fit()
    rng = np.random.default_rng(0)
    extra = np.concatenate(
        [rng.standard_normal((len(f.residual), 1)) * (k < 2) for k, f in enumerate(fitted.fits)]
    )
    gains = cross_gains(*reduced(fitted, extra), np.ones((1, 1, 1)))[0]
    np.testing.assert_allclose(gains[:2], 0.0, atol=1e-6 * left_out(fitted).max())


def test_files_of_one_name_are_no_group() -> None:
    """Two folders may have files of the same names: what one gives is evidence for the other."""
    recs = [shaken.record(k).replace(name=f"trial{k % 2}", group=f"trial{k % 2}") for k in range(4)]
    found = rn.diagnose(shaken.CASE, recs, candidates=["gravity"], noise=shaken.SIGMA, workers=0)
    assert found.names == ["trial0", "trial1", "trial0 (2)", "trial1 (2)"]
    assert found.base.groups == ("trial0", "trial1", "trial0 (2)", "trial1 (2)")
