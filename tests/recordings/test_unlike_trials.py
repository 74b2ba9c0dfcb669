"""The noise of trials that are not alike in length or frame rate."""

from __future__ import annotations

import re

import numpy as np
import pytest

import rodnet as rn

COUNT = 8
EDGES = [(i, i + 1) for i in range(COUNT - 1)]


def trial(noise, frames, rate, rng, swing=0.1):
    """A straight chain that swings as a whole."""
    t, s = np.arange(frames) / rate, np.linspace(0.0, 1.0, COUNT)
    up = swing * np.sin(2.0 * np.pi * t)[:, None]
    x = np.stack(np.broadcast_arrays(s, 0.0, up), axis=2)
    return rn.Recording(t, x + noise.sample(t, COUNT, rng), edges=EDGES)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_one_short_trial_changes_nothing():
    """A third of a second among minutes would leave lags up to 80 ms, to tell a time of 0.5 s by."""
    true, rng = rn.NoiseModel(2e-4, 5e-4, time=0.5), np.random.default_rng(0)
    long = [trial(true, 2000, 100.0, rng) for _ in range(6)]
    short = trial(true, 33, 100.0, rng)
    alone, both = rn.estimate_noise(long).model, rn.estimate_noise([short, *long]).model
    assert alone.time == pytest.approx(0.5, rel=3.0 * alone.unsure)
    assert both.time == pytest.approx(alone.time, rel=0.02)
    assert np.allclose(both.slow, alone.slow, rtol=0.02)
    assert np.allclose(both.white, alone.white, rtol=0.02)
    assert both.unsure == pytest.approx(alone.unsure, rel=0.02)


def test_trials_count_by_their_length():
    """Frames have a say, not files: half of the files are short and still."""
    rng = np.random.default_rng(1)
    long = [trial(rn.NoiseModel(1e-4, 8e-4, time=0.1), 1800, 100.0, rng) for _ in range(4)]
    short = [trial(rn.NoiseModel(1e-4), 450, 100.0, rng) for _ in range(4)]
    power = [np.mean(np.square(rn.estimate_noise(trials).breathing)) for trials in (long, [*short, *long])]
    assert power[1] / power[0] == pytest.approx(0.8, abs=0.04)


def test_lengths_that_differ_leave_no_bias():
    true = rn.NoiseModel(1e-4, 5e-4, time=0.3)
    times, sizes = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        found = rn.estimate_noise([trial(true, n, 100.0, rng) for n in (400, 600, 900, 1500, 1900)]).model
        times.append(found.time)
        sizes.append(rms(found.slow))
    assert np.mean(times) == pytest.approx(0.3, rel=0.1)
    assert np.mean(sizes) == pytest.approx(5e-4, rel=0.05)


@pytest.mark.parametrize("rates", [(50.0, 200.0), (200.0, 50.0)])
def test_frame_rates_are_not_mixed(rates):
    """The time of the same noise filmed at two rates, and what is slow in it, come out as well as the docs claim."""
    true, off = rn.NoiseModel(2e-4, 5e-4, time=0.3), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        trials = [trial(true, round(10.0 * rate), rate, rng) for rate in rates for _ in range(3)]
        found = rn.estimate_noise(trials)
        model = found.model
        off.append((rms(model.slow) ** 2 * model.time / (5e-4**2 * 0.3) - 1.0) / model.unsure)
        assert model.time == pytest.approx(0.3, rel=3.0 * model.unsure)
        assert np.median(model.white) == pytest.approx(2e-4, rel=0.05)
        assert any("frame rates" in note for note in found.notes)
    assert np.max(np.abs(off)) < 3.0


def test_the_rate_that_most_was_recorded_at_counts():
    true, rng = rn.NoiseModel(2e-4, 5e-4, time=0.3), np.random.default_rng(3)
    main = [trial(true, 1500, 100.0, rng) for _ in range(5)]
    other = [trial(true, 1500, 400.0, rng) for _ in range(5)]  # as many frames, a quarter of the time
    alone, found = rn.estimate_noise(main), rn.estimate_noise([*other, *main])
    assert found.model.time == pytest.approx(alone.model.time, rel=0.03)
    assert np.allclose(found.model.slow, alone.model.slow, rtol=0.03)
    assert any(re.search(r"75 of 93\.[78] s", note) and "100 Hz" in note for note in found.notes)
    assert not any("frame rates" in note for note in alone.notes)
    # 29.97 and 30 Hz are one rate
    near = [trial(true, 1500, rate, rng) for rate in (100.0, 99.9)]
    assert not any("frame rates" in note for note in rn.estimate_noise(near).notes)


def test_what_slow_noise_adds_to_differences_is_taken_off_at_each_rate():
    """So quick a slow part is a fifth of the variance of the differences at 50 Hz, and little at 400 Hz."""
    true, rng = rn.NoiseModel(1.5e-4, 5e-4, time=0.1), np.random.default_rng(4)
    trials = [trial(true, 1000, 50.0, rng, swing=0.0) for _ in range(3)]
    trials += [trial(true, 6000, 400.0, rng, swing=0.0) for _ in range(3)]
    for order in (trials, trials[::-1]):
        assert np.median(rn.estimate_noise(order).model.white) == pytest.approx(1.5e-4, rel=0.05)


def test_the_order_of_trials_does_not_matter():
    rng = np.random.default_rng(5)
    true = rn.NoiseModel(1e-4, slow=2e-4, time=0.2, common=4e-4, common_time=0.4)
    trials = [
        trial(true, n, rate, rng, 0.0) for n, rate in ((900, 200.0), (800, 50.0), (700, 50.0), (99, 50.0))
    ]
    one, other = (rn.estimate_noise(order).model for order in (trials, trials[::-1]))
    for name in ("white", "slow", "time", "common", "common_time", "unsure"):
        assert np.allclose(getattr(one, name), getattr(other, name), rtol=1e-6), name


def test_the_time_of_the_common_part_is_in_seconds():
    true = rn.NoiseModel(1e-5, common=4e-4, common_time=0.2)
    for rates in ((200.0, 50.0), (50.0, 200.0)):
        rng = np.random.default_rng(6)
        trials = [trial(true, round(4.0 * rate), rate, rng, 0.0) for rate in rates for _ in range(12)]
        apart = [rn.estimate_noise(part).model.common_time for part in (trials[:12], trials[12:])]
        both = rn.estimate_noise(trials).model
        assert min(apart) * 0.99 < both.common_time < max(apart) * 1.01
        assert both.common == pytest.approx(4e-4, rel=0.25)
