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


def test_noise_that_a_short_trial_cannot_tell_is_that_of_training(found):
    told = found.to_dict()
    assert told["noise"]["held_out"] == "that of the training trials"
    assert told["error_floor"] == pytest.approx(np.sqrt(3.0) * shaken.SIGMA, rel=0.2)
    assert found.held.bench.noise[0]["markers"].white == pytest.approx(found.noise["markers"].white)


def test_noise_of_other_markers_is_not_that_of_training(trials):
    """What is wrong with trials that the search does not see is told before it begins."""
    bench = Workbench.of(shaken.CASE, trials[:1], Serial(), shaken.SIGMA)
    short = trials[1].cut(0.0, 0.6)
    other = short.replace(names=["a", "b", "c", "d"])
    with pytest.raises(RecordingError, match="20 good frames"):
        unseen_noise(bench, [other], None)
    noise, borrowed = unseen_noise(bench, [short], None)
    assert borrowed and noise[0]["markers"].white == shaken.SIGMA
    noise, borrowed = unseen_noise(bench, [trials[1]], None)
    assert not borrowed and np.all(noise[0]["markers"].white != shaken.SIGMA)


def test_gains_of_one_trial_are_those_of_its_fit():
    """The quadratic form's own minimum, and no number of 1e74."""
    rng = np.random.default_rng(0)
    J, r = rng.standard_normal((30, 3)), rng.standard_normal(30)
    form = Reduced(J.T @ J, J.T @ r, float(r @ r))
    prior = Reduced(np.zeros((3, 3)), np.zeros(3), 0.0)
    (gain,) = cross_gains([form], prior, np.eye(2)[None])[0]
    both, one = (np.linalg.lstsq(A, r, rcond=None)[1][0] for A in (J, J[:, :1]))
    assert gain == pytest.approx(one - both, rel=1e-9)
