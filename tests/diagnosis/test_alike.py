"""Whether the numerical error may be why one explanation fits better than another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.design import plan
from rodnet.diagnosis.equivalence import equivalents, errors_of_trials, numerically_alike
from rodnet.diagnosis.powers import Powers
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


@pytest.fixture(scope="module")
def bench():
    recs = [shaken.record(k, change=lambda r: r.with_terms(rn.Gravity(g=0.15))) for k in range(3)]
    return Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def base(bench):
    return bench.fit()


def left(model, residuals, error=None):
    """A model that leaves other residuals; its last quantity is a share of a numerical error, if one is given."""
    model = shaken.leaving(model, residuals)
    if error is None:
        return model
    *others, last = model.quantities
    fits = [
        replace(f, jacobian=np.column_stack([f.jacobian[:, :-1], e]))
        for f, e in zip(model.fits, error, strict=True)
    ]
    return replace(model, fits=fits, quantities=[*others, replace(last, path="markers.numerics[0]")])


def test_explanations_nearer_than_the_numerical_error_are_one_class(bench, base):
    """Meshes and steps that differ from nature's make as large a difference between two explanations."""
    robot = shaken.build(bench.recordings[0])
    some = screen(bench, base, rn.candidates(robot, [], ["stiffness-defect", "gravity"]))
    some = [s for s in some if s.candidate.id in ("gravity", "stiffness-defect@rod")]
    both = [one for score in some for one in refit(bench, base, [score], 1)]
    first, second = sorted(both, key=lambda one: -one.gain)
    assert first.gain - second.gain * second.factor / first.factor > 50.0
    d = [a.residual - b.residual for a, b in zip(first.fitted.fits, second.fitted.fits, strict=True)]
    size = np.sqrt(
        np.mean(np.concatenate(d) ** 2)
    )  # at an error of twice that it may be anything, at a tenth nothing
    assert equivalents(first, [first, second], bench.noise, 0.1 * size) == []
    assert equivalents(first, [first, second], bench.noise, 2.0 * size) == [second]


def test_an_error_that_is_as_large_as_the_difference_may_be_all_of_it(base):
    """Of an explanation that is true: one that is off by d is behind by d.d, which an error of that size undoes."""
    rng = np.random.default_rng(0)
    d = [0.3 * rng.standard_normal(len(f.residual)) for f in base.fits]
    nothing = [0.0 * one for one in d]
    true, off, wrong = left(base, nothing), left(base, d), left(base, [1.7 * d[0], *nothing[1:]])
    size = np.sqrt(np.mean(np.concatenate(d) ** 2))
    assert numerically_alike(true, true, 0.0) and numerically_alike(true, off, 1.05 * size)
    assert not numerically_alike(true, off, 0.5 * size)
    assert not numerically_alike(true, wrong, 0.9 * size)  # one trial tells


def waves(base, scale, rng):
    """Errors of a code, smooth in time, in each trial so many times as large."""
    found = []
    for f, one in zip(base.fits, scale, strict=True):
        shape = f.whitened[0].shape
        t = np.linspace(0.0, 1.0, shape[0])[:, None, None]
        wave = sum(rng.standard_normal(shape[1:]) * np.sin(np.pi * (k + 1) * t) for k in range(3))
        found.append(one * wave[f.seen[0]].reshape(-1))
    return found


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.2, 0.2, 2.0), (0.0, 0.0, 1.0)])
def test_the_true_explanation_stays_whatever_its_rival_takes_up_of_the_error(base, scale):
    """Drives make errors of different sizes; what finer runs change tells in which trial, and that is no proof."""
    rng, kept = np.random.default_rng(1), 0
    for _ in range(50):
        e = waves(base, scale, rng)
        n = sum(map(len, e))
        e = [0.4 * one * np.sqrt(n) / np.linalg.norm(np.concatenate(e)) for one in e]
        noise = [rng.standard_normal(len(one)) for one in e]
        true = left(base, [a + b for a, b in zip(e, noise, strict=True)], e)
        rival = left(base, [0.1 * a + b for a, b in zip(e, noise, strict=True)], e)
        np.testing.assert_allclose(errors_of_trials(rival, 0.4), [np.linalg.norm(one) for one in e])
        kept += numerically_alike(rival, true, 0.4)
    assert kept >= 49


def test_noise_that_counts_for_several_moves_a_difference_as_much_more(base):
    """Of a model that is off by something smooth that no effect is: sigma is the misfit, and its variance counts."""
    rng, kept, factor = np.random.default_rng(2), 0, []
    for _ in range(50):
        smooth = waves(base, (3.0, 3.0, 3.0), rng)
        d = waves(base, (0.5, 0.5, 0.5), rng)
        true = left(base, smooth)
        rival = left(base, [a - b for a, b in zip(smooth, d, strict=True)])
        factor.append(variance_factor(true))
        kept += numerically_alike(rival, true, 0.0)
    assert kept >= 48 and np.median(factor) > 5.0


@pytest.mark.parametrize(("power", "numerical"), [(26.0, 0.05), (7.0, 0.1), (7.0, 0.3)])
def test_trials_that_are_said_to_decide_do(base, power, numerical):
    """As often as it says, one of two explanations being true: what is recommended must not be for nothing."""
    rng, apart = np.random.default_rng(3), 0
    count = len(base.fits[0].residual)
    error = numerical * np.sqrt(count)
    size = np.sqrt(power) + error
    part = {pair: np.array([[size]]) for pair in ((0, 1), (1, 0))}
    known = Powers([np.zeros((0, 0))] * 2, [1.0, 1.0], [part], [error])
    needed = plan("ab", ["plan_0"], known)[0].needed
    assert needed is not None
    kinds = replace(base, fits=base.fits[:1] * needed, own=base.own[:1] * needed)
    for _ in range(50):
        d = rng.standard_normal(count)
        d *= size / np.linalg.norm(d)
        noise = [rng.standard_normal(count) for _ in range(needed)]
        true, other = left(kinds, noise), left(kinds, [one + d for one in noise])
        apart += not numerically_alike(true, other, numerical)
    assert apart >= 45
