"""Few and short trials: what they cannot tell is taken from others, or said to be unknown."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.crossval import Reduced, cross_gains
from rodnet.diagnosis.heldout import unseen_noise
from rodnet.diagnosis.workbench import Workbench
from rodnet.errors import RecordingError
from rodnet.report.diagnosis import diagnosis_page
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


@pytest.fixture(scope="module")
def trials():
    return [shaken.record(k, "natural-curvature", {"kappa1": 1.5, "kappa2": 1.0}) for k in (0, 1)]


@pytest.fixture(scope="module")
def found(trials):
    """One trial to learn from, and a held-out one that is too short for an estimate of its noise."""
    return rn.diagnose(
        shaken.CASE,
        trials[:1],
        hold_out=[trials[1].cut(0.0, 0.6)],
        candidates=["natural-curvature"],
        workers=0,
    )


def test_a_single_trial_has_none_to_leave_out(found, tmp_path):
    """It can be explained, not named; there is no gain on other trials, and no number stands for it."""
    told = found.to_dict()
    assert told["verdict"] == "class"
    (term,) = told["terms"]
    assert term["id"] == "natural-curvature@rod" and term["cross_gain"] is None
    assert term["gains"] == pytest.approx([term["gain"]], rel=0.02)
    assert term["gain"] > 25.0
    assert all(one["cross_gain"] is None for one in told["refits"])
    assert "on the only trial" in diagnosis_page(found).save(tmp_path / "report.html").read_text()


def test_noise_of_a_short_trial_is_told_with_that_of_training(found):
    told = found.to_dict()
    assert told["noise"]["held_out"] == "as given, or of all trials"
    assert told["error_floor"] == pytest.approx(np.sqrt(3.0) * shaken.SIGMA, rel=0.1)


def test_noise_of_other_markers_is_not_that_of_training(trials):
    """What is wrong with trials that the search does not see is told before it begins."""
    bench = Workbench.of(shaken.CASE, trials[:1], Serial(), shaken.SIGMA)
    short = trials[1].cut(0.0, 0.6)
    other = short.replace(names=["a", "b", "c", "d"])
    with pytest.raises(RecordingError, match="20 good frames"):
        unseen_noise(bench, [other], None)
    noise, borrowed = unseen_noise(bench, [short], shaken.SIGMA)
    assert not borrowed and noise[0]["markers"].white == shaken.SIGMA


def test_one_trial_has_the_noise_of_all():
    """A trial alone tells the slow part of its noise badly; the instrument is the same in all."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 4.0, 0.04)
    keep = np.exp(-0.04 / 0.4)
    recs = []
    for k in range(6):
        slow = rng.standard_normal((1, 4, 3))
        for _ in t[1:]:
            more = np.sqrt(1.0 - keep**2) * rng.standard_normal((1, 4, 3))
            slow = np.concatenate([slow, keep * slow[-1:] + more])
        rest = np.array([0.125, 0.25, 0.375, 0.5])[None, :, None] * np.array([1.0, 0.0, 0.0])
        seen = rest + 1e-3 * (np.sqrt(0.5) * slow + np.sqrt(0.5) * rng.standard_normal(slow.shape))
        recs.append(rn.Recording(t, seen, edges=[(0, 1), (1, 2), (2, 3)], name=f"{k}", attrs=shaken.drive(k)))
    bench = Workbench.of(shaken.CASE, recs[:5], Serial())
    total = lambda noise: float(np.mean(noise["markers"].total(4)))  # noqa: E731
    together = total(unseen_noise(bench, recs[5:], None)[0][0])
    alone = [total(Workbench.of(shaken.CASE, [rec], Serial()).noise[0]) for rec in recs]
    assert together == pytest.approx(1e-3, rel=0.1)
    assert abs(together - 1e-3) < np.mean(np.abs(np.array(alone) - 1e-3))


def test_gains_of_one_trial_are_those_of_its_fit():
    """The quadratic form's own minimum, and no number of 1e74."""
    rng = np.random.default_rng(0)
    J, r = rng.standard_normal((30, 3)), rng.standard_normal(30)
    form = Reduced(J.T @ J, J.T @ r, float(r @ r))
    prior = Reduced(np.zeros((3, 3)), np.zeros(3), 0.0)
    (gain,) = cross_gains([form], prior, np.eye(2)[None])[0]
    both, one = (np.linalg.lstsq(A, r, rcond=None)[1][0] for A in (J, J[:, :1]))
    assert gain == pytest.approx(one - both, rel=1e-9)
