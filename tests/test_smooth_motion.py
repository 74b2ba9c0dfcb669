"""Motions and rotations through noisy records: they follow what moves, not the noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.terms.motion import white_noise


def test_smooth_motion_follows_the_signal_not_the_noise():
    t = np.linspace(0.0, 4.0, 401)
    signal = np.stack([0.1 * np.sin(3.0 * t), 0.05 * np.cos(5.0 * t), 0.02 * t], axis=1)
    noisy = signal + 3e-5 * np.random.default_rng(2).standard_normal(signal.shape)
    noisy[100:103] = np.nan
    motion = rn.smooth_motion(t, noisy)
    error = np.array([motion(s) for s in t]) - signal
    assert np.sqrt(np.mean(error**2)) < 2e-5
    h = 1e-4
    jumps = [(motion(s + h) - 2.0 * motion(s) + motion(s - h)) / h**2 for s in np.arange(1.0, 1.1, 5e-4)]
    assert np.abs(np.diff(jumps, axis=0)).max() < 0.2  # the acceleration is continuous
    with pytest.raises(rn.TermError, match="increase"):
        rn.smooth_motion(t[::-1], noisy)
    with pytest.raises(rn.TermError, match="at least 5"):
        rn.smooth_motion(t[:3], signal[:3])


@pytest.mark.parametrize("still", [[0, 1], [1]], ids=["along z alone", "in the plane"])
def test_a_coordinate_that_stands_still_tells_nothing_of_the_noise_of_the_others(still):
    """Nor is a motion shaken by noise for it."""
    t, rng = np.arange(401) / 100.0, np.random.default_rng(4)
    true = 0.02 * np.sin(4.4 * t[:, None] * [1.0, 0.8, 0.9])
    noisy = true + 1e-3 * rng.standard_normal(true.shape)
    noisy[:, still] = 0.0
    assert white_noise(noisy) == pytest.approx(1e-3, rel=0.15)
    free = [k for k in range(3) if k not in still]
    for given in (None, 1e-3):
        bent = rn.smooth_motion(t, noisy, given).spline.derivative(2)(t)[20:-20]
        assert np.abs(bent[:, free]).max() < 2.0  # [m/s^2]; the motion has 0.4
        assert np.abs(bent[:, still]).max() < 1e-9


def test_a_noise_that_is_said_counts_where_a_motion_begins_late():
    """What stands still for most of a record, to the last digit, moves in the rest of it."""
    t, rng = np.arange(501) / 100.0, np.random.default_rng(4)
    true = np.where(t < 3.0, 0.0, 0.02 * np.sin(4.4 * (t - 3.0)) ** 3)[:, None] * [1.0, 0.8, 0.9]
    noisy = true + np.where(t < 3.0, 0.0, 1e-3)[:, None] * rng.standard_normal(true.shape)
    motion = rn.smooth_motion(t, noisy, 1e-3)
    assert len(motion.spline.t) < 250  # it does not go through every sample


def test_smooth_motion_flattens_no_swing():
    """Over many draws of the noise its mean is the motion, to a third of the noise; a draw is off by two thirds."""
    rng, t, noise = np.random.default_rng(5), np.arange(101) / 25.0, 5e-5
    ramp = 1.0 - np.exp(-((t[:, None] / 0.3) ** 2))
    for frequency in (0.3, 0.7, 1.1):
        true = ramp * 0.03 * np.sin(2.0 * np.pi * frequency * t[:, None] * [1.0, 0.8, 0.9])
        draws = [
            rn.smooth_motion(t, true + noise * rng.standard_normal(true.shape), noise).many(t) - true
            for _ in range(40)
        ]
        assert np.sqrt(np.mean(np.mean(draws, axis=0) ** 2)) < 0.35 * noise
        assert np.sqrt(np.mean(np.square(draws))) < 0.72 * noise


@pytest.mark.parametrize("said", [0.8, 0.9, 1.0, 1.2])
def test_smooth_motion_bears_a_noise_that_is_said_wrong(said):
    """The acceleration of what is at rest, or swings, is not shaken by noise that is larger or smaller than said."""
    rng, t, noise = np.random.default_rng(6), np.arange(401) / 100.0, 5e-5
    for size, most in ((0.0, 0.02), (0.03, 0.06)):
        true = size * np.sin(4.4 * t[:, None] * [1.0, 0.8, 0.9])
        curved = -((4.4 * np.array([1.0, 0.8, 0.9])) ** 2) * true
        errors = []
        for _ in range(6):
            spline = rn.smooth_motion(t, true + noise * rng.standard_normal(true.shape), said * noise).spline
            errors.append((spline.derivative(2)(t) - curved)[20:-20])
        assert np.sqrt(np.mean(np.square(errors))) < most  # [m/s^2]


def test_smooth_rotation_follows_measured_orientations():
    t = np.linspace(0.0, 2.0, 201)
    true = Rotation.from_rotvec(np.stack([0.0 * t, 0.3 * np.sin(3.0 * t), 2.0 * t], axis=1))
    shaken = Rotation.from_rotvec(1e-3 * np.random.default_rng(3).standard_normal((201, 3))) * true
    signs = np.where(np.arange(201) % 3, 1.0, -1.0)[:, None]  # q and -q are the same rotation
    for samples in (shaken.as_matrix(), shaken.as_quat() * signs):
        smooth = rn.smooth_rotation(t, samples, noise=1e-3)
        assert np.abs(smooth(0.0) - np.eye(3)).max() < 1e-12
        # away from the ends, where a smoothing spline is at its worst, relative to the middle
        turned = Rotation.from_matrix([smooth(s) @ smooth(t[100]).T for s in t[10:-10]])
        error = (turned * (true[10:-10] * true[100].inv()).inv()).magnitude()
        assert error.mean() < 1e-3
    with pytest.raises(rn.TermError, match="not a rotation"):
        rn.smooth_rotation(t, np.tile(2.0 * np.eye(3), (201, 1, 1)))


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.3])
def test_a_gripper_that_hardly_turns_is_followed(turn):
    """One cubic piece is enough for it: a spline of as many coefficients as a quaternion has components."""
    t = np.arange(140) / 35.0
    true = Rotation.from_rotvec(np.outer(turn * np.sin(0.2 * np.pi * t), [0.0, 0.6, 0.8]))
    noise = 5e-3 * np.random.default_rng(0).standard_normal((len(t), 3))
    smooth = rn.smooth_rotation(t, (true * Rotation.from_rotvec(noise)).as_quat(), 5e-3)
    off = (true.inv() * Rotation.from_matrix(smooth.many(t))).magnitude()
    assert off.max() < 3.0 * 5e-3
