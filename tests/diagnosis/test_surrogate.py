"""What helps on the whole but not in every trial: it joins the repaired model, never under a name."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.diagnose import bank_of
from rodnet.diagnosis.refit import assess, likely_width
from rodnet.diagnosis.repaired import write
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.searched import FEWEST, search
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken
from tests.diagnosis.test_locate import bench_of

# as if the rod had been turned about its axis in some of the trials
BENDS = (2.0, 1.8, 2.2, 0.6, 2.0, -0.5, 1.9, 2.1)
CASE = replace(shaken.CASE, noise=0.01)


@pytest.fixture(scope="module")
def trials():
    return [shaken.record(k, "natural-curvature", {"kappa1": b, "kappa2": 0.0}) for k, b in enumerate(BENDS)]


@pytest.fixture(scope="module")
def found(trials):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("rodnet.diagnosis.searched.WORK", 0)
        return rn.diagnose(
            CASE,
            trials[:6],
            hold_out=trials[6:],
            candidates=["natural-curvature"],
            executor=Serial(),
            bootstrap=1,
        )


def test_it_stands_in_without_a_name(found):
    """In six trials an effect of four that another one contradicts is no name, but it predicts better."""
    (one,) = (f for f in found.findings if f.id == "natural-curvature@rod")
    assert found.verdict == "surrogate"
    assert one.status == "surrogate"
    assert "natural-curvature@rod.kappa1" in found.to_dict()["repaired"]
    assert found.held.after.error < 0.75 * found.held.before.error


@pytest.mark.slow
def test_what_is_alike_in_all_trials_is_sure_beside_it():
    """Damping of the rod's own, much smaller than bends that differ from trial to trial, is found after these."""

    def true(robot, bend):
        damped = shaken.with_effect(robot, "kelvin-voigt", {"bend": 0.06})
        return shaken.with_effect(damped, "natural-curvature", {"kappa1": bend, "kappa2": 0.0})

    trials = [shaken.record(k, change=lambda robot, b=b: true(robot, b)) for k, b in enumerate(BENDS)]
    found = rn.diagnose(
        CASE,
        trials[:6],
        hold_out=trials[6:],
        candidates=["natural-curvature", "kelvin-voigt"],
        executor=Serial(),
    )
    assert [(one.id, one.status) for one in found.findings] == [
        ("natural-curvature@rod", "surrogate"), ("kelvin-voigt", "named")
    ]  # fmt: skip
    assert found.verdict == "partial"


def test_the_whole_is_repeated_with_trials_that_the_repaired_model_might_have_given(found):
    """With the sixth, which is not searched, too."""
    _, whole = found.resampled
    assert (whole.kind, whole.draws) == ("pipeline", 1)
    assert whole.verdicts in ({"surrogate": 1}, {"partial": 1})  # signs of what is left are drawn
    assert whole.removed is not None


def test_it_is_found_in_five_trials_and_fitted_to_all(found, tmp_path):
    """The sixth trial judges the effect, and then the repaired model learns from it, too."""
    assert (len(found.names), len(found.training)) == (FEWEST, 6)
    (one,) = (f for f in found.findings if f.id == "natural-curvature@rod")
    assert len(one.gains) == 6
    assert len(found.repaired.fits) == 6
    write(found, tmp_path)
    assert rn.Fitted.load(tmp_path).recordings == [rec.name for rec in found.training]
    path = "natural-curvature@rod.kappa1"
    assert rn.Fitted.load(tmp_path).values[path] == pytest.approx(found.repaired.values[path])


def test_judges_are_trials_that_nothing_is_fitted_to(trials, monkeypatch):
    """What five trials say of the others is the deviance of these at the values of the five."""
    monkeypatch.setattr("rodnet.diagnosis.searched.WORK", 0)
    bench = replace(bench_of(trials[:7]), case=CASE)
    some, base = search(bench, bench.fit())
    assert (len(some.recordings), len(some.judges.recordings)) == (FEWEST, 2)
    names = [rec.name for part in (some, some.judges) for rec in part.recordings]
    assert sorted(names) == [rec.name for rec in bench.recordings]
    robot = CASE.robot(trials[0])
    (bend,) = candidates(robot, [], ["natural-curvature"])
    (score,) = screen(some, base, [bend])
    fitted = some.fit([bend], {f"{bend.id}.kappa1": 1.5, f"{bend.id}.kappa2": 0.1})
    refit = assess(some, base, fitted, score, 1)
    gained = []
    for model in (base, fitted):
        problem = some.judges.problem(model.candidates, model.values, common=False)
        gained.append([float(fit.residual @ fit.residual) for fit in problem.fits(np.zeros(0))])
    before, after = np.array(gained)
    np.testing.assert_allclose(refit.gains[FEWEST:], (before - after) / refit.factor, rtol=1e-9)


def test_a_camera_that_saw_the_drive_is_not_turned_against_it(trials):
    """What holds the robot was measured by the same camera and clock: turned, both would be."""
    other = trials[0].replace(prescribed=[0])
    ids = [{c.family for c in bank_of(CASE, rec, None)} for rec in (trials[0], other)]
    assert ids[0] - ids[1] == {"camera-rotation", "camera-shift", "camera-scale", "record-lag"}
    assert "marker-offset" in ids[1]


def test_the_width_of_a_prior_is_that_of_the_strengths():
    """Of strengths drawn with one width and seen through unlike noise, it is recovered; of noise alone it is small."""
    rng = np.random.default_rng(0)
    J = rng.standard_normal((400, 60)) * np.logspace(-1.5, 1.0, 60)
    H = J.T @ J
    for width in (0.5, 3.0):
        seen = J @ (width * rng.standard_normal(60)) + rng.standard_normal(400)
        assert likely_width(H, np.linalg.solve(H, J.T @ seen)) == pytest.approx(width, rel=0.25)
    noise = np.linalg.solve(H, J.T @ rng.standard_normal(400))
    assert likely_width(H, noise) < 0.05 * np.sqrt(np.mean(noise**2))
