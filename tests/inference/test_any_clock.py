"""Clocks that do not begin at zero, derivatives that are not finite, and numbers that are meant for one instrument."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.records import record_noise
from rodnet.inference.comparison import Comparison
from tests.diagnosis import shaken

STARTS = 1.7e9  # Unix seconds


def driven(rec: rn.Recording) -> rn.Robot:
    """A rod whose root follows what was recorded of it, without a thought of when the clock began."""
    plain = shaken.robot({"amplitude": 0.0, "frequency": 1.0, "lift": 0.0})
    hand = rn.smooth_motion(rec.t, rec.channels["hand"], 1e-3)
    start = hand(float(rec.t[0]))
    terms = [term for term in plain.terms if not isinstance(term, rn.PrescribedMotion)]
    moved = rn.PrescribedMotion(
        at="rod.start", position=lambda t: hand(t) - start, orientation=shaken.upright
    )
    return rn.Robot(plain.graph, [*terms, moved])


CASE = replace(shaken.CASE, build=driven)


def recorded(k: int, first: float) -> rn.Recording:
    rec = shaken.record(k)
    shake = shaken.Shake(**shaken.drive(k))
    hand = np.array([shake(t) for t in rec.t]) + 1e-3 * np.random.default_rng(k).standard_normal(
        (len(rec.t), 3)
    )
    return rec.replace(t=rec.t + first, channels={"hand": hand})


def test_a_clock_may_begin_anywhere() -> None:
    """Calibrated, predicted and told how noisy the drives' records are, as if it began at zero."""
    here, there = ([recorded(k, first) for k in range(2)] for first in (0.0, STARTS))
    fits = [rn.calibrate(CASE, recs, noise=shaken.SIGMA, workers=0) for recs in (here, there)]
    assert fits[1].values["rod.E"] == pytest.approx(fits[0].values["rod.E"], rel=1e-4)
    errors = [rn.evaluate(CASE, recs, workers=0).to_dict()["metric"] for recs in (here, there)]
    assert errors[1] == pytest.approx(errors[0], rel=1e-4)
    noises = [
        next(iter(record_noise(CASE.robot, map(CASE.part, recs)).values())).shift for recs in (here, there)
    ]
    assert noises[1] == pytest.approx(noises[0], rel=1e-4)
    assert 0.5e-3 < noises[0] < 1.2e-3  # a spline through so few frames follows some of it


def test_a_part_counts_from_its_first_frame() -> None:
    rec = recorded(0, 0.0)
    case = replace(CASE, cut=lambda rec: rec.cut(0.2, 1.0))
    assert case.part(rec).t[0] == 0.0
    assert case.part(rec).duration == pytest.approx(0.8)
    assert case.part(rec).channels["hand"](0.0) == pytest.approx(rec.channels["hand"](0.2))


def test_a_derivative_that_is_not_finite_takes_no_residual_away() -> None:
    noise = rn.NoiseModel(white=1e-3, slow=1e-3, time=0.2)
    t = np.arange(0.0, 1.0, 0.04)
    residual = noise.sample(t, 3, np.random.default_rng(0))
    table = np.stack([residual, np.ones_like(residual), np.ones_like(residual)], axis=-1)
    table[4, 1, :, 1] = np.nan
    for common in (0.0, 1e-3):
        alone, _ = replace(noise, common=common).whiten(t, residual)
        white, _ = replace(noise, common=common).whiten(t, table)
        np.testing.assert_array_equal(white[..., 0], alone)
        assert np.isnan(white[4, 1, :, 1]).all()
        assert np.isfinite(white[..., 2]).all()


def turning(view: object) -> float:
    return 0.0


def test_one_number_is_not_meant_for_metres_and_turns() -> None:
    rec = shaken.record(0).replace(channels={"rpm": np.zeros(len(shaken.record(0).t))})
    case = replace(
        shaken.CASE,
        observe=lambda rec, robot: [
            rn.Markers(robot, shaken.POINTS),
            rn.Reading(robot, "rpm", turning, unit="rpm"),
        ],
    )
    with pytest.raises(rn.ParameterError, match=r"noise = 0.001 .* markers \[m\], rpm \[rpm\].*mapping"):
        rn.calibrate(case, [rec], noise=1e-3, workers=0)


def test_samples_left_out_count_as_not_read() -> None:
    rec = shaken.record(0)
    mask = np.zeros((len(rec.t), len(shaken.POINTS)), dtype=bool)
    mask[3, 2] = True

    def observe(rec: rn.Recording, robot: rn.Robot) -> list[rn.Markers]:
        (eye,) = shaken.CASE.observations(rec, robot)
        eye.left_out = mask
        return [eye]

    noise = {"markers": rn.NoiseModel(white=1e-3)}
    trial = Comparison(replace(shaken.CASE, observe=observe), rec, noise)
    assert np.isnan(trial.measured[0][3, 2]).all()
    assert np.isnan(trial.measured[0]).sum() == 3
    whole = Comparison(shaken.CASE, rec, noise)
    assert len(trial.evaluate({}).residual) == len(whole.evaluate({}).residual) - 3
