"""Noise models: what they draw, whiten and find again."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.recordings.estimate import arc_lengths
from rodnet.recordings.rest import rest_stretches

T = 0.01 * np.arange(400)


def swinging(noise, count=10, trials=8, seed=0, lost=0.0, T=T):
    """Recordings of a straight chain of markers that swings as a whole."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, count)
    found = []
    for k in range(trials):
        swing = 0.1 * np.sin(2 * np.pi * (1 + 0.2 * k) * T)
        x = np.stack(np.broadcast_arrays(s, 0.0, swing[:, None]), axis=2) + noise.sample(T, count, rng)
        x[rng.random(x.shape[:2]) < lost] = np.nan
        found.append(rn.Recording(T, x, edges=[(i, i + 1) for i in range(count - 1)]))
    return found


def test_samples_have_the_covariance_of_the_model():
    model = rn.NoiseModel(1e-3, slow=2e-3, time=0.05, common=1.5e-3, common_time=0.1)
    t = 0.01 * np.arange(20)
    e = np.stack([model.sample(t, 2, np.random.default_rng(k)) for k in range(4000)])[:, :, 0, :]
    C = np.einsum("kia,kja->ij", e, e) / (e.shape[0] * 3)
    assert np.abs(C - model.covariance(t)).max() < 0.05 * model.covariance(t)[0, 0]


def test_a_model_is_told_in_a_line():
    """Of ten markers not ten numbers each."""
    assert str(rn.NoiseModel(1e-3)) == "noise: white 0.001"
    model = rn.NoiseModel(np.linspace(1e-4, 3e-4, 10), np.full(10, 5e-4), time=0.2, common=8e-4, dof=5.0)
    assert str(model) == (
        "noise: white 0.0001 to 0.0003, slow 0.0005 for 0.2 s, common 0.0008 for 1 s, "
        "white of Student's t with 5 degrees of freedom"
    )


@pytest.mark.parametrize("common", [0.0, 8e-4])
def test_whitened_residuals_are_independent_and_their_likelihood_is_the_normal_one(common):
    model = rn.NoiseModel([1e-4, 3e-4, 2e-4], [5e-4, 0.0, 1e-3], time=0.2, common=common, common_time=0.7)
    rng, t = np.random.default_rng(3), np.cumsum(rng_steps())
    r = model.sample(t, 3, rng)
    r[rng.random(r.shape[:2]) < 0.25] = np.nan
    w, logdet = model.whiten(t, r)
    # the same from the whole covariance
    seen = np.isfinite(r[..., 0])
    lag = np.abs(np.subtract.outer(t, t))
    full = np.zeros((len(t), 3, len(t), 3))
    for m in range(3):
        full[:, m, :, m] = model.slow[m] ** 2 * np.exp(-lag / 0.2) + model.white[m] ** 2 * np.eye(len(t))
        for n in range(3):
            full[:, m, :, n] += common**2 * np.exp(-lag / 0.7)
    C = full.reshape(3 * len(t), -1)[seen.ravel()][:, seen.ravel()]
    y = r.reshape(-1, 3)[seen.ravel()]
    assert (w**2).sum() == pytest.approx(np.sum(y * np.linalg.solve(C, y)), rel=1e-9)
    assert logdet == pytest.approx(3.0 * np.linalg.slogdet(C)[1], rel=1e-10)
    assert not w[~seen].any()


def rng_steps():
    return np.random.default_rng(5).uniform(0.005, 0.05, 40)


def test_whitening_is_linear_so_derivatives_may_go_through_it():
    model = rn.NoiseModel(1e-4, 1e-3, 0.3, 5e-4)
    rng = np.random.default_rng(0)
    r = rng.standard_normal((30, 4, 3, 5))
    r[3, 2] = np.nan
    together, _ = model.whiten(T[:30], r)
    apart = np.stack([model.whiten(T[:30], r[..., k])[0] for k in range(5)], axis=-1)
    assert np.allclose(together, apart, rtol=0, atol=1e-12 * np.abs(apart).max())


def test_effective_samples():
    """White: all of them. An Ornstein-Uhlenbeck process: (n + (n - 2) (1 - rho)/(1 + rho) ...) in closed form."""
    assert rn.NoiseModel(1e-3).effective_samples(T) == pytest.approx(len(T))
    rho, n = np.exp(-0.01 / 0.5), len(T)
    expected = (n * (1 - rho) + 2 * rho) / (1 + rho)  # 1' R^-1 1 of an AR(1) process
    model = rn.NoiseModel(1e-9, slow=1e-3, time=0.5)
    assert model.effective_samples(T) == pytest.approx(expected, rel=1e-4)


def test_estimate_finds_both_parts():
    true = rn.NoiseModel(1e-4, np.linspace(3e-4, 9e-4, 10), time=0.3)
    found = rn.estimate_noise(swinging(true, trials=10)).model
    assert np.median(found.white) == pytest.approx(1e-4, rel=0.15)
    assert np.sqrt(np.mean(found.slow**2)) == pytest.approx(np.sqrt(np.mean(true.slow**2)), rel=0.1)
    assert found.time == pytest.approx(0.3, rel=0.2)
    assert np.corrcoef(found.slow, true.slow)[0, 1] > 0.9


def smooth_variance(model, recordings):
    """Variance of what is slow (the first cosines of time) of noise whitened by a model: 1 if it is the right one."""
    found = []
    for rec in recordings:
        x = rec.markers - [[0.0, 0.0, 1.0]] * np.nanmean(rec.markers, axis=1, keepdims=True)
        x[..., 0] -= np.linspace(0.0, 1.0, x.shape[1])
        white, _ = model.whiten(rec.t, x[..., :2])
        slow = np.cos(np.pi * np.outer(np.arange(6), np.arange(len(rec.t)) + 0.5) / len(rec.t))
        Q = np.linalg.qr(slow.T)[0]
        found.append(np.einsum("tk,tma->kma", Q, white))
    return float(np.mean(np.square(found)))


def test_a_marker_that_is_lost_for_most_of_a_long_trial_is_told_by_the_rest():
    """Long trials are looked at piece by piece: where it is never seen, or not for so long, others tell."""
    true = rn.NoiseModel(1e-4, 4e-4, time=0.3)
    (rec,) = swinging(true, trials=1, T=0.01 * np.arange(4200))
    assert len(rec.t) > 2000
    markers = rec.markers.copy()
    markers[int(0.56 * len(rec.t)) :, -1] = np.nan
    found = rn.estimate_noise(rec.replace(markers=markers)).model
    whole = rn.estimate_noise(rec).model
    assert np.isfinite(found.slow).all()
    np.testing.assert_allclose(found.slow, whole.slow, rtol=0.3)


def test_a_few_seconds_of_slow_noise_do_not_tell_markers_apart():
    """Of trials of five correlation times, alike markers come out alike, and what is slow is whitened as it should:
    off by no more than the estimate says of itself.
    """
    true, off, apart = rn.NoiseModel(4e-4, 4e-4, time=0.4), [], []
    for seed in range(6):
        recordings = [rec.cut(0.0, 2.0) for rec in swinging(true, count=8, trials=4, seed=seed)]
        assert smooth_variance(true, recordings) == pytest.approx(1.0, abs=0.2)
        found = rn.estimate_noise(recordings).model
        off.append((smooth_variance(found, recordings) - 1.0) / found.unsure)
        apart.append(np.std(found.slow**2) / np.mean(found.slow**2))
        assert 0.1 < found.unsure < 0.5
    assert np.max(np.abs(off)) < 2.5
    assert np.max(apart) < 0.5


def test_a_marker_that_slips_is_not_noise():
    """One marker creeps along by forty times the noise: it stays in what a model will leave, and off the others."""
    recordings = swinging(rn.NoiseModel(3e-4), count=8, trials=4)
    for rec in recordings:
        rec.markers[:, 3, 0] += 3e-3 * rec.t  # to 12 mm
    found = rn.estimate_noise(recordings).model
    assert found.total(8).max() < 2.0 * 3e-4
    # yet one that is a few times as slow as the others is followed
    sizes = np.full(8, 5e-4)
    sizes[3] = 1e-3
    found = rn.estimate_noise(swinging(rn.NoiseModel(3e-4, sizes, time=0.3), count=8, trials=10)).model
    assert np.argmax(found.slow) == 3
    assert found.slow[3] > 7e-4


def test_estimate_of_white_noise_alone_has_no_slow_part_to_speak_of():
    found = rn.estimate_noise(swinging(rn.NoiseModel(3e-4, dof=4.0), lost=0.02))
    assert np.median(found.model.white) == pytest.approx(3e-4, rel=0.25)  # the median of tails is narrower
    assert np.median(found.model.slow) < 0.3 * 3e-4
    assert found.model.dof < 15.0
    assert found.effective > 0.3 * len(T)


@pytest.mark.parametrize("lost", [0.0, 0.002, 0.01])
def test_gaps_are_no_motion_of_the_camera(lost):
    """The mean of those markers that are seen throughout wanders more than that of all."""
    s, t = np.linspace(0.0, 1.0, 12), 0.01 * np.arange(500)
    shape = np.stack(np.broadcast_arrays(s, 0.0, 0.0 * t[:, None]), axis=2)
    edges = [(i, i + 1) for i in range(11)]
    for seed in range(4):
        rng = np.random.default_rng(seed)
        x = shape + rn.NoiseModel(white=1e-4).sample(t, 12, rng)
        x[rng.random(x.shape[:2]) < lost] = np.nan
        assert rn.estimate_noise([rn.Recording(t, x, edges=edges)]).model.common == 0.0, seed


def test_common_part_is_told_at_rest_and_only_there():
    true = rn.NoiseModel(5e-5, slow=1e-4, time=0.3, common=3e-4, common_time=0.5)
    rng, x = np.random.default_rng(2), np.zeros((400, 10, 3))
    x[..., 0] = np.linspace(0.0, 1.0, 10)
    edges = [(i, i + 1) for i in range(9)]
    resting = [rn.Recording(T, x + true.sample(T, 10, rng), edges=edges) for _ in range(10)]
    assert sum(b - a for rec in resting for a, b in rest_stretches(rec)) > 2000
    assert rn.estimate_noise(resting).model.common == pytest.approx(3e-4, rel=0.35)
    moving = rn.estimate_noise(swinging(true))
    assert moving.model.common == 0.0
    assert any("common" in note for note in moving.notes)


@pytest.mark.parametrize("white", [1e-4, 3e-4])
def test_the_time_of_what_is_common_is_that_of_a_camera_that_drifts(white):
    """White noise of the markers is in no two frames: it makes nothing faster than it is."""
    t = np.arange(0.0, 60.0, 0.01)
    true = rn.NoiseModel(white=white, slow=0.0, time=0.5, common=4e-4, common_time=1.0)
    x = np.zeros((len(t), 4, 3)) + 0.1 * np.arange(4)[None, :, None]
    edges = [(0, 1), (1, 2), (2, 3)]
    found = [
        rn.estimate_noise(rn.Recording(t, x + true.sample(t, 4, np.random.default_rng(k)), edges=edges)).model
        for k in range(6)
    ]
    assert np.mean([m.common for m in found]) == pytest.approx(4e-4, rel=0.15)
    assert np.median([m.common_time for m in found]) == pytest.approx(1.0, rel=0.4)


def slow_trial(seed, t):
    """A chain at rest, seen with noise that has a slow part of 0.3 s."""
    true = rn.NoiseModel(white=2e-4, slow=4e-4, time=0.3)
    x = np.zeros((len(t), 5, 3)) + 0.1 * np.arange(5)[None, :, None] * np.array([1.0, 0.0, 0.0])
    return rn.Recording(
        t, x + true.sample(t, 5, np.random.default_rng(seed)), edges=[(k, k + 1) for k in range(4)]
    )


def test_frames_that_a_file_leaves_out_are_not_made_up():
    """A line over a gap is slow, and no noise."""
    times, slows = [], []
    for seed in range(4):
        rec = slow_trial(seed, np.arange(0.0, 20.0, 0.01))
        keep = (rec.t < 5.0) | (rec.t > 13.0)
        model = rn.estimate_noise(rn.Recording(rec.t[keep], rec.markers[keep], edges=rec.edges)).model
        times.append(model.time)
        slows.append(float(np.mean(model.slow)))
    assert np.mean(times) == pytest.approx(0.3, rel=0.35)
    assert np.mean(slows) == pytest.approx(4e-4, rel=0.15)


def test_times_in_whole_milliseconds_smooth_nothing():
    """At 60 Hz a step is 16 or 17 ms; that in the middle is neither of the rate."""
    exact = [slow_trial(seed, np.arange(0.0, 30.0, 1.0 / 60.0)) for seed in range(3)]
    rounded = [rn.Recording(np.round(rec.t, 3), rec.markers, edges=rec.edges) for rec in exact]
    assert rounded[0].rate == pytest.approx(60.0, rel=1e-3)
    one, other = (rn.estimate_noise(recs).model for recs in (exact, rounded))
    assert other.time == pytest.approx(one.time, rel=0.05) and other.time > 0.15
    assert np.allclose(other.slow, one.slow, rtol=0.05) and np.allclose(other.white, one.white, rtol=0.05)


def test_numbers_of_a_coarse_resolution_have_noise():
    """Positions in whole millimetres of a robot that rests: the noise is what rounding makes, not nothing."""
    t = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(0)
    moving = 0.05 * np.sin(2.0 * np.maximum(t - 7.0, 0.0))[:, None, None]
    x = np.round(0.1 * np.arange(3)[None, :, None] + moving + 2e-5 * rng.standard_normal((len(t), 3, 3)), 3)
    white = rn.estimate_noise(rn.Recording(t, x)).model.white
    assert np.all((white > 2e-5) & (white < 5e-4))


@pytest.mark.parametrize("dof", [6.0, 9.0])
def test_tails_are_those_of_the_samples_not_of_their_differences(dof):
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, 0.01)
    x = 1e-4 * rng.standard_t(dof, size=(len(t), 4, 3))
    found = rn.estimate_noise(rn.Recording(t, x)).model.dof
    assert 0.6 * dof < found < 1.6 * dof


def test_arc_length_of_a_circle():
    """Chords of a circle of radius R, corrected, are its arcs: to fourth order."""
    for n, error in ((12, 2e-3), (24, 2e-4)):
        angle = np.linspace(0.0, np.pi, n + 1)
        x = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[None].repeat(5, axis=0)
        arcs = arc_lengths(rn.Recording(T[:5], x, edges=[(i, i + 1) for i in range(n)]))
        assert np.abs(arcs / (np.pi / n) - 1.0).max() < error


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"white": 0.0}, "resolution"),
        ({"white": -1e-3}, "standard deviations"),
        ({"white": 1e-3, "time": 0.0}, "time"),
        ({"white": 1e-3, "dof": 2.0}, "dof"),
        ({"white": np.nan}, "standard deviations"),
    ],
)
def test_bad_noise_is_named(values, message):
    with pytest.raises(rn.RecordingError, match=message):
        rn.NoiseModel(**values)


def test_noise_goes_through_json():
    model = rn.NoiseModel([1e-4, 2e-4], 1e-3, dof=5.0)
    assert rn.NoiseModel.from_dict(model.to_dict()).to_dict() == model.to_dict()
    assert rn.NoiseModel.from_dict(rn.NoiseModel(1e-4).to_dict()).dof == np.inf
