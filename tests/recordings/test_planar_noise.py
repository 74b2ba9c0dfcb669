"""The noise of recordings in the plane is that of the same recordings in space: y was not measured as zero."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.recordings.rest import rest_stretches

T = 0.01 * np.arange(400)
COUNT = 10


def pairs(noise, trials=8, swing=0.1, seed=0):
    """The same trials in space and in the plane: an inclined chain that swings in the plane."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, COUNT)
    space, plane = [], []
    for k in range(trials):
        up = swing * np.sin(2.0 * np.pi * (1.0 + 0.2 * k) * T)[:, None]
        x = np.stack(np.broadcast_arrays(0.8 * s, 0.0, 0.6 * s + up), axis=2) + noise.sample(T, COUNT, rng)
        edges = [(i, i + 1) for i in range(COUNT - 1)]
        space.append(rn.Recording(T, x, edges=edges))
        plane.append(rn.Recording(T, x[..., [0, 2]], edges=edges))
    assert all(rec.planar for rec in plane)
    return space, plane


def test_both_parts_are_those_of_the_same_robot_in_space():
    true = rn.NoiseModel(3e-4, np.linspace(3e-4, 9e-4, COUNT), time=0.3)
    space, plane = pairs(true)
    spatial, planar = rn.estimate_noise(space).model, rn.estimate_noise(plane).model
    assert np.median(planar.white) == pytest.approx(np.median(spatial.white), rel=0.03)
    assert np.median(planar.white) == pytest.approx(3e-4, rel=0.03)
    assert np.allclose(planar.slow, spatial.slow, rtol=0.05)
    assert planar.time == pytest.approx(spatial.time, rel=0.05)
    assert planar.dof == spatial.dof == np.inf  # a third of zeros looks like heavy tails
    assert planar.unsure == pytest.approx(spatial.unsure, rel=0.05)


def test_white_noise_does_not_leak_into_the_slow_part():
    space, plane = pairs(rn.NoiseModel(3e-4))
    slow = [np.sqrt(np.mean(rn.estimate_noise(trials).model.slow ** 2)) for trials in (space, plane)]
    assert max(slow) < 0.1 * 3e-4
    assert slow[1] == pytest.approx(slow[0], rel=0.2)


def test_heavy_tails_are_the_same():
    space, plane = pairs(rn.NoiseModel(3e-4, dof=4.0))
    spatial, planar = rn.estimate_noise(space).model, rn.estimate_noise(plane).model
    assert planar.dof == pytest.approx(spatial.dof, rel=0.25)
    assert np.median(planar.white) == pytest.approx(np.median(spatial.white), rel=0.03)


def test_the_common_part_is_the_same():
    true = rn.NoiseModel(5e-5, slow=1e-4, time=0.3, common=3e-4, common_time=0.5)
    space, plane = pairs(true, trials=20, swing=0.0)
    spatial, planar = rn.estimate_noise(space), rn.estimate_noise(plane)
    assert sum(b - a for rec in plane for a, b in rest_stretches(rec)) > 4000
    assert planar.rest == pytest.approx(spatial.rest, rel=0.1)
    # of two axes in three there are 1.5 times as wide errors: of so many seconds a tenth
    assert planar.model.common == pytest.approx(spatial.model.common, rel=0.1)
    assert planar.model.common_time == pytest.approx(spatial.model.common_time, rel=0.25)


def test_space_and_plane_go_together():
    """Of trials of either kind each counts with the axes that it has."""
    space, plane = pairs(rn.NoiseModel(3e-4, 5e-4, time=0.3))
    mixed = rn.estimate_noise([*space[:4], *plane[4:]]).model
    assert np.median(mixed.white) == pytest.approx(3e-4, rel=0.03)


def test_twenty_frames_are_enough_in_the_plane():
    space, plane = pairs(rn.NoiseModel(3e-4), trials=1)
    for trial in (space[0], plane[0]):
        assert np.median(rn.estimate_noise(trial.cut(0.0, 0.19)).model.white) > 1e-4
        with pytest.raises(rn.RecordingError, match="20 good frames"):
            rn.estimate_noise(trial.cut(0.0, 0.18))
