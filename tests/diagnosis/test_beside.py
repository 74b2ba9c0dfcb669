"""How sure values are beside a remainder: as trials disagree."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis import beside, confirm
from rodnet.diagnosis.beside import _Region, by_trials
from rodnet.diagnosis.findings import Interval
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.quantities import Quantity
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

RNG = np.random.default_rng(4)


def record(k, E):
    """A trial with a rod of that modulus."""
    attrs = shaken.drive(k)
    true = shaken.robot(attrs).with_parameters({"rod.E": E})
    traj = rn.Simulation(true, dt=shaken.DT, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * RNG.standard_normal(seen.shape)
    return rn.Recording(t, seen, names=list("abcd"), name=f"rod{k}", attrs=attrs)


def test_what_differs_from_trial_to_trial_is_as_uncertain_as_that():
    """Rods of unlike stiffness and a model of one: its error is their scatter over the root of how many there are."""
    scatter, count = 0.3, 8
    trials = [
        record(k, 2e6 * np.exp(z))
        for k, z in enumerate(scatter * RNG.permutation(np.linspace(-1.5, 1.5, count)))
    ]
    bench = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    model = bench.fit()
    alone = [np.log(bench.subset([k]).fit().values["rod.E"]) for k in range(count)]
    weights = np.array([float(np.sum(model.jacobian_of(k) ** 2)) for k in range(count)])
    weights /= weights.sum()
    mean = float(weights @ alone)
    expected = np.sqrt(np.sum((weights * (np.array(alone) - mean)) ** 2) * count / (count - 1))
    k = model.place("rod.E")
    found = float(np.sqrt(by_trials(model)[0][k] * model.covariance()[k, k]))
    said = float(np.sqrt(variance_factor(model) * model.covariance()[k, k]))
    assert 0.7 < found / expected < 1.4
    assert found > 1.5 * said


def test_what_is_alike_in_all_trials_is_as_sure_as_the_noise_makes_it():
    trials = [record(k, 2e6) for k in range(8)]
    model = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA).fit()
    k = model.place("rod.E")
    assert np.sqrt(by_trials(model)[0][k]) < 1.7


def linear(J, residuals, groups):
    """A model of one value whose trials are linear."""
    C = np.linalg.inv(sum(j.T @ j for j in J))
    return SimpleNamespace(
        quantities=[SimpleNamespace(trial=None, prior=None)], prior=(np.zeros(0), np.zeros((0, 1))),
        fits=[SimpleNamespace(residual=r) for r in residuals], jacobian_of=J.__getitem__, covariance=lambda: C,
        group=groups.__getitem__,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("scatter", "weights", "groups", "least", "most"),
    [
        (0.0, (1, 1, 1, 1), "abcd", 0.9, 0.97),
        (0.0, (1000, 1, 1, 1), "abcd", 0.9, 0.97),
        (1.0, (1, 1, 1, 1), "abcd", 0.88, 0.95),
        (3.0, (1, 1, 1, 1), "abcd", 0.86, 0.95),
        (3.0, (5, 1, 1, 1), "abcd", 0.8, 0.95),
        (3.0, (1, 1, 1, 1, 1, 1, 1, 1, 1), "aaabbbccc", 0.86, 0.95),
    ],
)
def test_intervals_of_few_trials_hold_the_truth_as_often_as_they_say(
    monkeypatch, scatter, weights, groups, least, most
):
    """Trials, or groups of them, that each want another value, by so many times what their noise makes of it.

    90 % of the intervals hold the middle; a few less where one trial tells most of it.
    """
    monkeypatch.setattr(confirm, "doubt", lambda bench, model: 1.0)
    rng, inside = np.random.default_rng(0), 0
    for _ in range(2000):
        J = [np.sqrt(w) * rng.standard_normal((50, 1)) for w in weights]
        wants = dict(zip("abcd", scatter * rng.standard_normal(4) / np.sqrt(50.0), strict=True))
        seen = [j[:, 0] * wants[g] + rng.standard_normal(50) for j, g in zip(J, groups, strict=True)]
        value = sum(j[:, 0] @ y for j, y in zip(J, seen, strict=True)) / sum(float(np.sum(j**2)) for j in J)
        model = linear(J, [j[:, 0] * value - y for j, y in zip(J, seen, strict=True)], groups)
        half = np.sqrt(confirm.RISE * confirm.doubts(None, model)[0] * model.covariance()[0, 0])
        inside += abs(value) <= half
    assert least < inside / 2000 < most


@pytest.mark.parametrize(("value", "may"), [(0.3, True), (3.0, False)])
def test_a_strength_may_be_none_where_trials_disagree_by_more_than_it(monkeypatch, value, may):
    """Four trials of one strength that is 1 more or less in each, told apart by the noise a hundred times better."""
    monkeypatch.setattr(beside, "variance_factor", lambda model: 1.0)
    rng, q = np.random.default_rng(1), Quantity("law.gain", "1", value, -np.inf, np.inf, 1.0, False)
    J = [np.full((100, 1), 10.0) for _ in range(4)]
    noise = [rng.standard_normal(100) for _ in J]
    r = [10.0 * away + e - e.mean() for away, e in zip((1.0, -1.0, 1.0, -1.0), noise, strict=True)]
    model = linear(J, r, "abcd")
    model.quantities, model.place, model.values = [q], lambda path: 0, {"law.gain": value}
    region = _Region.of(model, ["law.gain"])
    assert region.holds({"law.gain": 0.0}) is may
    assert region.holds({"law.gain": value})


@pytest.mark.parametrize(("low", "may"), [(1e-5, True), (2e-3, False)])
def test_a_strength_may_be_none_where_its_interval_has_none_in_it(low, may):
    """A mass of 5 g that may be a hundredth of a gram is no name, though the trials agree to first order."""
    path = "mass.mass"
    candidate, score = SimpleNamespace(strength=(path,)), SimpleNamespace(nulls={path: 0.0})
    one, model = (
        SimpleNamespace(candidate=candidate, refit=SimpleNamespace(score=score)),
        SimpleNamespace(values={path: 5e-3}),
    )
    known = {path: Interval(5e-3, low, 0.02, "kg")}
    (held,) = beside.with_intervals([beside.Beside((), {}, 1.0)], [one], model, known)
    assert held.holds is not may
    assert beside.with_intervals([], [one], model, known) == []  # nothing is left: it is not asked


def test_an_interval_is_stretched_to_what_the_limit_gives():
    """To either side as far as its end moves; at a bound nothing is known beyond."""
    q = Quantity("one", "1", 0.3, 0.0, 1.0, 0.1, False)
    model = SimpleNamespace(quantities=[q])
    one = Interval(0.3, 0.2, 0.4, "1")
    for change, low, high, beyond in (
        (1.5, 0.2, 0.55, (False, False)),
        (-1.5, 0.05, 0.4, (False, False)),
        (-5.0, 0.0, 0.4, (True, False)),
    ):
        found = confirm._stretched(one, model, 0, change)
        assert (found.low, found.high) == pytest.approx((low, high)) and found.open == beyond
