"""What must not end a diagnosis, or mislead it: zero residuals, short trials, equal names, failing meshes."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis import numerics
from rodnet.diagnosis.begin import fit_both
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.confirm import doubt
from rodnet.diagnosis.crossval import left_out
from rodnet.diagnosis.diagnose import _apart
from rodnet.diagnosis.folds import predicted
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.remainder import test_remainder as remainder_of
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, screen
from rodnet.diagnosis.worth import nearly, worth_a_refit
from tests.diagnosis import shaken
from tests.diagnosis.test_locate import bench_of

DEFECT = {"loss": 0.6, "place": 0.37, "width": 0.06}


@pytest.fixture(scope="module")
def soft():
    return bench_of([shaken.record(k, "stiffness-defect", DEFECT) for k in range(4)])


def test_left_out_by_a_fit_of_its_own_is_as_to_first_order(soft):
    """Where one strength is known from every trial, first order is right, and a fit must say the same."""
    robot = soft.case.robot(soft.recordings[0])
    (defect,) = candidates(robot, [], ["stiffness-defect"])
    fitted = soft.fit([defect], {f"{defect.id}.{name}": v for name, v in DEFECT.items()})
    linear = left_out(fitted)
    for k in (0, 2):
        assert predicted(soft, fitted, k) == pytest.approx(linear[k], rel=0.02)


def test_an_exactly_zero_residual_is_one(soft):
    """Whatever is left pairs with the marker and the frame that it is of."""
    fitted = soft.fit()
    first = fitted.fits[0]
    white = [w.copy() for w in first.whitened]
    white[0][0, 1] = 0.0
    residual = np.concatenate([w[seen].ravel() for w, seen in zip(white, first.seen, strict=True)])
    exact = replace(fitted, fits=[replace(first, whitened=white, residual=residual), *fitted.fits[1:]])
    assert variance_factor(exact, exact.residual) == pytest.approx(variance_factor(exact), rel=1e-12)


def test_what_is_smooth_over_the_body_is_one_number(soft):
    """Markers that move together count once: the variance of a smooth sum of residuals is the factor times theirs."""
    fitted = soft.fit()
    rng = np.random.default_rng(0)
    fits = []
    for fit in fitted.fits:
        frames, markers, axes = fit.whitened[0].shape
        white = np.repeat(rng.standard_normal((frames, 1, axes)), markers, axis=1)
        fits.append(replace(fit, whitened=[white], residual=white[fit.seen[0]].ravel()))
    together = replace(fitted, fits=fits)
    assert (
        variance_factor(together) == 1.0
    )  # no larger than noise, and not alike in time: nothing says it is none
    loud = replace(
        together, fits=[replace(f, whitened=[3.0 * f.whitened[0]], residual=3.0 * f.residual) for f in fits]
    )
    assert variance_factor(loud) == pytest.approx(
        9.0 * 3.0, rel=0.3
    )  # of four markers the next and the one after


def test_values_are_as_uncertain_as_a_smooth_error_makes_them(soft):
    """One that is too small to be a remainder scatters values more than noise does: their doubt says how much."""
    fitted = soft.fit()
    U, rng, scatter, told, seen = Basis.of(fitted.jacobian).U, np.random.default_rng(1), [], [], []
    for _ in range(100):
        fits = []
        for fit in fitted.fits:
            frames, markers, axes = fit.whitened[0].shape
            time = np.cos(np.pi * np.outer((np.arange(frames) + 0.5) / frames, np.arange(5)))
            body = np.cos(np.pi * np.outer((np.arange(markers) + 0.5) / markers, np.arange(4)))
            smooth = np.einsum("fi,mj,ija->fma", time, body, 0.08 * rng.standard_normal((5, 4, axes)))
            white = rng.standard_normal((frames, markers, axes)) + smooth
            fits.append(replace(fit, whitened=[white], residual=white[fit.seen[0]].ravel()))
        drawn = replace(fitted, fits=fits)
        scatter.append(np.mean((U.T @ drawn.residual) ** 2))  # of what values follow
        told.append(doubt(soft, drawn))
        seen.append(variance_factor(drawn) > 1.0)
    assert np.mean(scatter) > 1.15 and np.mean(seen) < 0.3  # of all residuals together little is seen
    assert np.mean(told) == pytest.approx(np.mean(scatter), rel=0.25)


def test_trials_too_short_to_tell_anything_are_no_alarm():
    recs = [shaken.record(k) for k in range(2)]
    short = bench_of([rec.cut(rec.t[0], rec.t[4]) for rec in recs])
    found = remainder_of(short.fit())
    assert found.p == 1.0 and found.excess == 0.0


def test_the_smallest_effect_told_is_one_that_is_found(soft):
    """With the strength that is said to be seen, the score is significant and the effect large enough to name."""
    plain = bench_of([shaken.record(k) for k in range(4)])
    robot = plain.case.robot(plain.recordings[0])
    bank = candidates(robot, [], ["gravity", "natural-curvature"])
    fitted = plain.fit()
    for score in screen(plain, fitted, bank):
        for k, path in enumerate(score.strength):
            change = score.detectable[path] / score.scales[path] * score.columns[:, k]
            assert np.sqrt(np.mean(change**2)) > 0.1
            assert np.linalg.norm(change) > 4.0


def test_recordings_of_one_name_are_told_apart():
    rec = shaken.record(0)
    second, other = (shaken.record(k).replace(name=rec.name) for k in (1, 2))
    parts = _apart({"training": [rec, second], "held out": [other]})
    names = [one.name for recs in parts.values() for one in recs]
    assert names == [rec.name, f"{rec.name} (2)", f"{rec.name} (3)"]
    taken = second.replace(name=f"{rec.name} (2)")  # as systems call a copy
    names = [one.name for one in _apart({"training": [rec, taken, other]})["training"]]
    assert names == [rec.name, f"{rec.name} (2)", f"{rec.name} (3)"]
    with pytest.raises(rn.ParameterError, match="same data"):
        _apart({"training": [rec], "held out": [rec.replace(name="another")]})
    with pytest.raises(rn.ParameterError, match="a copy is no further evidence"):
        _apart({"training": [rec, second, rec.replace(name="another")]})


def test_a_mesh_that_fails_leaves_the_numerical_error_unknown(soft, monkeypatch):
    def build(rec):
        raise rn.errors.TermError("it knows 20 edges alone")

    monkeypatch.setattr(numerics, "doubled", lambda case: replace(case, build=build))
    found = numerics.measure(soft, soft.fit())
    assert "20 edges" in found.failed["mesh"]
    assert found.worst == np.inf


def test_a_model_of_some_trials_is_that_of_these_alone():
    recs = [shaken.record(k, "stiffness-defect", DEFECT) for k in range(4)]
    bench = bench_of(recs)
    fitted, some = bench.fit(), bench.subset([1, 3])
    part = some.evaluate(some.problem((), fitted.values), np.zeros(len(fitted.quantities)))
    assert fitted.of_trials([1, 3]).deviance == pytest.approx(part.deviance, rel=1e-9)


def test_all_trials_tell_what_is_worth_a_refit_also_where_sigma_is_no_noise():
    """Which ones are fitted worst hangs on little, and so would what is tried at all."""
    recs = [shaken.record(k, "stiffness-defect", DEFECT) for k in range(7)]
    plain = bench_of(recs)
    rough = replace(plain, case=replace(plain.case, noise=1e-3))
    bank = candidates(plain.case.robot(recs[0]), [], ["stiffness-defect", "gravity"])
    fitted = plain.fit()
    ours, theirs = screen(rough, fitted, bank), screen(plain, fitted, bank)
    assert ours[0].candidate.family == "stiffness-defect" and np.all(ours[0].gains != 0.0)
    assert [s.chi2 for s in ours] == pytest.approx([s.chi2 for s in theirs], rel=1e-9)


def test_what_the_nominal_parameters_can_do_is_refitted_only_if_it_promises_something():
    """Of a candidate of whose signal they leave a hundredth, a large score is one of first order alone."""
    recs = [shaken.record(k, "stiffness-defect", DEFECT) for k in range(3)]
    bench = bench_of(recs)
    bank = candidates(bench.case.robot(recs[0]), [], ["stiffness-defect", "gravity"])
    first, other, _ = screen(bench, bench.fit(), bank)
    hidden = replace(other, chi2=2.0 * first.chi2, p=0.0, survives=0.01, promise=0.0 * other.promise)
    assert [s.candidate.id for s in worth_a_refit([hidden, first])] == [first.candidate.id]
    assert worth_a_refit([replace(hidden, survives=0.5), first])[0].candidate.id == other.candidate.id
    assert len(worth_a_refit([replace(hidden, promise=first.promise), first])) == 2
    assert len(worth_a_refit([hidden])) == 1


def test_what_is_simpler_than_all_others_is_refitted_where_it_scores_nearly_as_well():
    """Of two that explain the same the simpler one stands, and first order is no guide to a tenth of a score."""
    recs = [shaken.record(k, "stiffness-defect", DEFECT) for k in range(3)]
    bench = bench_of(recs)
    bank = candidates(bench.case.robot(recs[0]), [], ["stiffness-defect", "gravity"])
    spot, weight, _ = screen(bench, bench.fit(), bank)
    assert weight.candidate.size < spot.candidate.size
    many = [replace(spot, chi2=spot.chi2 - k) for k in range(8)]
    near, far = (
        replace(weight, p=0.0, chi2=share * spot.chi2, promise=0.5 * spot.promise) for share in (0.95, 0.85)
    )
    assert worth_a_refit([*many, near])[-1] is near
    assert all(s is not far for s in worth_a_refit([*many, far]))
    # and so is it, whatever it promises, beside what scored as little and then explained most
    low = replace(near, promise=0.0 * spot.promise)
    assert nearly([spot, low, far], spot, {spot.candidate.id}) == [low]
    assert nearly([spot, low, far], spot, {spot.candidate.id, low.candidate.id}) == []


def test_what_scores_like_the_best_is_refitted_beside_a_misfit_whatever_it_promises():
    """Promises far from first order differ between candidates that score alike; what scores less must promise."""
    recs = [shaken.record(k, "stiffness-defect", DEFECT) for k in range(3)]
    plain = bench_of(recs)
    rough = replace(plain, case=replace(plain.case, noise=1e-3))
    base = rough.fit()
    first, other, _ = screen(
        rough, base, candidates(plain.case.robot(recs[0]), [], ["stiffness-defect", "gravity"])
    )
    tried = lambda *more: [one.id for one in refit(rough, base, [first, *more], 1)]  # noqa: E731
    alike = replace(other, chi2=0.95 * first.chi2, promise=0.0 * other.promise)
    assert set(tried(alike)) == {first.candidate.id, other.candidate.id}
    assert tried(replace(alike, chi2=0.85 * first.chi2)) == [first.candidate.id]


def beside_another(rec):
    """The rod, and another one beside it that nothing holds."""
    alone = shaken.build(rec)
    figure = rn.StickFigure()
    material = rn.Material(E=2e6, rho=1200.0)
    for name, y in (("rod", 0.0), ("other", 0.05)):
        figure.rod(
            name, [(0, y, 0), (shaken.LENGTH, y, 0)], edges=shaken.EDGES, material=material, radius=4e-3
        )
    return rn.Robot(figure.build(), alone.terms)


def test_effects_that_cannot_be_in_one_robot_end_no_diagnosis():
    """An edit that refuses a robot with another effect in it: the pair is no model, and no failure."""
    bench = replace(bench_of([shaken.record(0)]), case=replace(shaken.CASE, build=beside_another))
    robot = bench.case.robot(bench.recordings[0])
    crowd, onset = (candidates(robot, [], [id])[0] for id in ("neighbours", "jam-onset"))

    def alone(robot):
        if any(isinstance(term, rn.CrowdedForce) for term in robot.terms):
            raise rn.TermError("there is no such medium")
        return switched(robot)

    switched, onset = onset.build, replace(onset, build=alone)
    base = bench.fit()
    scores = [screen(bench, base, [one])[0] for one in (crowd, onset)]
    assert fit_both(bench, base, *scores) is None
    beside = bench.fit([crowd], {**base.values, "drag.crowding": 0.01, "drag.range": 0.1})
    assert screen(bench, beside, [onset]) == []
