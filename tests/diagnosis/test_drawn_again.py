"""Trials drawn again to first order: groups of them with all their trials, as they are left out."""

import numpy as np
import pytest

from rodnet.diagnosis.confirm import DRAWS, linearised
from rodnet.diagnosis.crossval import best_change, reduced
from rodnet.diagnosis.workbench import Fitted
from rodnet.inference.comparison import Fit
from rodnet.inference.quantities import Quantity

PATH = "drag.viscosity"
QUANTITY = Quantity(PATH, "Pa s", 10.0, 0.0, 100.0, 1.0, False)


def fitted(offsets, groups):
    """A model of trials of one sample each, which have the value so far from what all together have it."""
    fits = [Fit([], [], np.array([-float(d)]), np.ones((1, 1)), []) for d in offsets]
    prior = np.zeros(0), np.zeros((0, 1))
    own = [{} for _ in offsets]
    return Fitted((), {PATH: 10.0}, own, 0.0, fits, [QUANTITY], prior, True, tuple(groups))


def test_an_interval_is_as_wide_as_groups_are_apart():
    """Of two groups of five alike trials one is drawn twice in half of the draws: the ends are where they have it.

    If all ten were drawn by themselves the interval would be 10 -+ 1.64 / sqrt(10).
    """
    model = fitted([-1.0] * 5 + [1.0] * 5, "aaaaabbbbb")
    one = linearised(model, [PATH], {}, 0.0, None, 0)
    assert one.intervals[PATH] == pytest.approx((9.0, 11.0))
    alone = linearised(fitted([-1.0] * 5 + [1.0] * 5, "abcdefghij"), [PATH], {}, 0.0, None, 0)
    low, high = alone.intervals[PATH]
    assert high - low == pytest.approx(2.0 * 1.64 / np.sqrt(10.0), rel=0.2)


def test_a_single_trial_says_nothing_of_others():
    """Drawn again it is the same: an interval without width would be a lie."""
    one = linearised(fitted([0.3], "a"), [PATH], {"effect": np.array([9.0])}, 0.0, None, 0)
    assert one.intervals == {} and one.named == {}


def test_groups_that_differ_in_size_count_by_their_trials():
    """Of all equally likely draws of three groups, enumerated."""
    offsets, groups = np.array([0.0, 0.3, 0.2, -0.5, 0.9, 0.1]), "abbbca"
    model = fitted(offsets, groups)
    of = [offsets[[g == name for g in groups]] for name in "abc"]
    every = [np.concatenate([a, b, c]).mean() for a in of for b in of for c in of]
    one = linearised(model, [PATH], {}, 0.0, None, 1)
    wanted = 10.0 + np.percentile(np.repeat(every, 1000), [5.0, 95.0])
    assert one.intervals[PATH] == pytest.approx(wanted, abs=0.1)


def test_errors_of_trials_not_seen_are_drawn_by_their_groups():
    """Where one group is repaired and the other is not, nobody knows of a third; five alike trials are no evidence."""
    model = fitted([-1.0, 1.0], "ab")
    before, after = np.ones(10), np.repeat([0.0, 1.0], 5)
    grouped = linearised(model, [PATH], {}, 0.0, (before, after, None), 0, ["x"] * 5 + ["y"] * 5)
    assert grouped.removed == pytest.approx((0.0, 1.0))
    alone = linearised(model, [PATH], {}, 0.0, (before, after, None), 0)
    assert alone.removed[0] > 0.1 and alone.removed[1] < 0.9
    # of a single group of trials each is drawn alone, as each is left out alone
    one = linearised(model, [PATH], {}, 0.0, (before, after, None), 0, ["x"] * 10)
    assert one.removed == alone.removed


def test_without_groups_nothing_has_changed():
    """Bit by bit what drawing trials gives, with the same stream of random numbers."""
    rng = np.random.default_rng(5)
    model = fitted(rng.standard_normal(7), [f"trial{k}" for k in range(7)])
    gains = {"a": rng.standard_normal(7), "b": 1.0 + rng.standard_normal(9)}
    before, after = 1.0 + rng.random(4), rng.random(4)
    one = linearised(model, [PATH], gains, 0.5, (before, after, 0.1), 11)

    rng = np.random.default_rng(11)
    forms, prior = reduced(model)
    drawn, hits = [], dict.fromkeys(gains, 0)
    for _ in range(DRAWS):
        picked = rng.integers(7, size=7)
        drawn.append(best_change([forms[k] for k in picked], prior)[0])
        for id, gain in gains.items():
            hits[id] += float(gain[rng.integers(len(gain), size=len(gain))].sum()) > 0.5
    low, high = np.percentile([QUANTITY.value(z) for z in np.array(drawn)], [5.0, 95.0])
    picks = rng.integers(4, size=(DRAWS, 4))
    a, b = (before[picks] ** 2).mean(axis=1), (after[picks] ** 2).mean(axis=1)
    assert one.intervals == {PATH: (float(low), float(high))}
    assert one.named == {id: n / DRAWS for id, n in hits.items()}
    assert one.removed == tuple(map(float, np.percentile((a - b) / (a - 0.1**2), [5.0, 95.0])))
