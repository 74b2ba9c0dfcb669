"""Times: the rounding of single precision goes, and what the camera left out stays."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn


def times(t):
    return rn.Recording(t, np.zeros((len(t), 1, 3))).t


@pytest.mark.parametrize("start", [0.0, 8e4, 1.7e9])  # a trial's own, of the day, of Unix
@pytest.mark.parametrize("missing", [slice(300, 301), slice(1, 2), slice(998, 999), slice(300, 500)])
def test_what_was_left_out_stays_so(start, missing):
    """A dropped frame in the midst or at an end, and a gap of two seconds, of the clock of the day and of Unix."""
    t = start + np.delete(0.01 * np.arange(1000), missing)
    kept = times(t)
    assert np.abs(kept - t).max() < 1e-6
    assert np.diff(kept).max() == pytest.approx(0.01 * (missing.stop - missing.start + 1), abs=1e-6)
    rec = rn.Recording(t, np.zeros((len(t), 1, 3)))
    assert rec.rate == pytest.approx(100.0, rel=1e-4)
    assert rn.inspect(rec).files[0]["steps_missing"] == missing.stop - missing.start


@pytest.mark.parametrize("every", [2, 3, 10])
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_frames_dropped_over_and_over_stay_so(every, kind):
    """Steps of one and two by turns stay within a third of a step of an even grid."""
    numbers = np.delete(np.arange(3000), np.arange(every, 3000, every + 1))
    t = (1000.0 + 0.01 * numbers).astype(kind)
    assert np.abs(times(t) - t).max() < 1e-6
    assert np.diff(times(t)).max() == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize("missing", [1, 500, 998])
@pytest.mark.parametrize("start", [0.0, 1e3, 8e3])
def test_single_precision_hides_no_dropped_frame(start, missing):
    t = (start + np.delete(0.01 * np.arange(1000), missing)).astype(np.float32)
    assert np.array_equal(times(t), t.astype(float))


@pytest.mark.parametrize("start", [0.0, 10.0, 1e3, 8e3])
@pytest.mark.parametrize("rate", [30.0, 100.0, 240.0])
def test_rounding_of_single_precision_goes(start, rate):
    true = start + np.arange(2000) / rate
    even = times(true.astype(np.float32))
    assert np.ptp(np.diff(even)) < 1e-9
    assert np.abs(even - true).max() < 1e-7 * true.max() + 1e-12


def test_so_it_does_where_it_was_widened_before():
    t = 5000.0 + 0.01 * np.arange(3000)
    assert np.abs(times(t.astype(np.float32).astype(float)) - t).max() < 1e-9


def test_doubles_keep_their_jitter_at_any_time_of_day():
    """Half a millisecond at 100 Hz is none of rounding."""
    t = 8e4 + 0.01 * np.arange(500) + 5e-4 * np.sin(np.arange(500))
    assert np.array_equal(times(t), t)


def test_times_of_a_file_in_single_precision(tmp_path):
    t = (500.0 + 0.01 * np.arange(400)).astype(np.float32)
    np.savez(tmp_path / "even.npz", t=t, markers=np.zeros((400, 1, 3), dtype=np.float32))
    np.savez(tmp_path / "gap.npz", t=np.delete(t, 200), markers=np.zeros((399, 1, 3), dtype=np.float32))
    even, gap = (rn.read_recording(tmp_path / f"{k}.npz") for k in ("even", "gap"))
    assert np.abs(even.t - (500.0 + 0.01 * np.arange(400))).max() < 1e-9
    assert np.diff(gap.t).max() == pytest.approx(0.02, rel=0.01)
    # and once read, they go round as they are
    for rec in (even, gap):
        assert rn.read_recording(rec.save(tmp_path / "again.npz")).digest == rec.digest
