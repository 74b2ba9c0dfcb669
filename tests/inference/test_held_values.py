"""What a fit was given it keeps: values that are not free, and a noise of the recording's markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from tests.diagnosis import shaken

TRUE = {"drag.eta_n": 5.0}


@pytest.fixture(scope="module")
def recordings():
    return [shaken.record(k, change=lambda robot: robot.with_parameters(TRUE)) for k in range(2)]


def test_a_model_predicts_with_the_values_that_it_was_fitted_with(recordings, tmp_path):
    """Also with what was given and is not free, from a file, too: else it would be another model than the fit's."""
    found = rn.calibrate(shaken.CASE, recordings, start=TRUE, noise=shaken.SIGMA, workers=0)
    assert found.chi2 < 1.2 * found.samples
    assert found.robot().parameters["drag.eta_n"].value == 5.0 and found.held == TRUE
    size = np.sqrt(3.0) * shaken.SIGMA
    for told in found.predictions(recordings).values():
        assert told.rms["markers"] < 1.2 * size
    found.save(tmp_path)
    assert rn.Fitted.load(tmp_path).values["drag.eta_n"] == 5.0
    scores = rn.evaluate(shaken.CASE, recordings, tmp_path, workers=0)
    assert max(file["metric"] for file in scores.files) < 2.0 * size


def test_a_noise_of_all_markers_is_of_those_that_are_seen(recordings):
    """A recording's noise has its markers in order, a case may see some of them, in another one."""
    sigmas = np.array([1.0, 2.0, 3.0, 4.0]) * shaken.SIGMA
    noise = rn.NoiseModel(white=sigmas)
    names = recordings[0].names
    some = {names[3]: shaken.POINTS[3], names[1]: shaken.POINTS[1]}
    case = rn.Case(
        shaken.build, lambda rec, robot: rn.Markers(robot, some), free=["rod.E"], options=shaken.options
    )
    for given in (noise, lambda rec: noise):
        found = rn.calibrate(case, recordings[:1], noise=given, workers=0)
        (trial,) = found.to_dict()["noise"].values()
        np.testing.assert_allclose(trial["markers"]["white"], sigmas[[3, 1]])
    own = rn.NoiseModel(white=sigmas[:2])  # by the instrument's name it is of its own markers
    found = rn.calibrate(case, recordings[:1], noise={"markers": own}, workers=0)
    (trial,) = found.to_dict()["noise"].values()
    np.testing.assert_allclose(trial["markers"]["white"], sigmas[:2])
    with pytest.raises(rn.ParameterError, match="noise: it is of 3 markers; 'markers' sees 2"):
        rn.calibrate(case, recordings[:1], noise=rn.NoiseModel(white=sigmas[:3]), workers=0)


def test_a_start_of_a_trial_is_fitted_beside_the_values_that_are_held(recordings):
    """Else it would stand for what they change, and be predicted with them."""
    case = replace(shaken.CASE, per_trial=["initial.velocity"])
    found = rn.calibrate(case, recordings[:1], start=TRUE, noise=shaken.SIGMA, modes=2, workers=0)
    (told,) = found.predictions(recordings[1:], own=True).values()
    assert told.own and told.rms["markers"] < 1.1 * np.sqrt(3.0) * shaken.SIGMA


def test_other_recordings_are_predicted_whatever_the_search_began_with(recordings):
    """A start of an instrument's parameter that was free, and a tie to what each trial has of its own."""
    case = replace(shaken.CASE, free=["rod.E", "markers.scale"], per_trial=["initial.velocity"])
    start = {**TRUE, "markers.scale": 1.01}
    found = rn.calibrate(case, recordings[:1], start=start, noise=shaken.SIGMA, modes=2, workers=0)
    (told,) = found.predictions(recordings[1:], own=True).values()
    assert not told.failure and told.rms["markers"] < 1.2 * np.sqrt(3.0) * shaken.SIGMA
    tied = {"drag.eta_t": lambda values: 0.5 * values["drag.eta_n"]}
    case = replace(shaken.CASE, free=["rod.E"], per_trial=["drag.eta_n"], tied=tied)
    found = rn.calibrate(case, recordings[:1], noise=shaken.SIGMA, workers=0)
    alone, own = (found.predictions(recordings[1:], own=o)[recordings[1].name] for o in (False, True))
    assert not alone.failure and not own.failure and own.rms["markers"] <= alone.rms["markers"]


def test_distances_of_a_camera_in_the_plane_are_in_it(recordings):
    """What it did not see is no error, neither of the fit nor of a prediction."""
    flat = [
        rn.Recording(rec.t, rec.markers[:, :, [0, 2]], names=rec.names, name=rec.name, attrs=dict(rec.attrs))
        for rec in recordings
    ]
    assert all(np.ptp(rec.markers[..., 1]) > 0.02 for rec in recordings)
    found = rn.calibrate(shaken.CASE, flat[:1], start=TRUE, noise=shaken.SIGMA, outliers=5.0, workers=0)
    (told,) = found.predictions(flat[1:]).values()
    size = np.sqrt(2.0) * shaken.SIGMA
    assert found.rms["markers"] == pytest.approx(size, rel=0.1) and told.rms["markers"] < 1.2 * size


def test_a_recording_that_cannot_begin_is_told_and_the_others_are_predicted(recordings):
    def build(rec):
        if rec.name == "odd":
            raise rn.RecordingError("'odd' is of another robot")
        return shaken.build(rec)

    found = rn.calibrate(
        replace(shaken.CASE, build=build), recordings[:1], start=TRUE, noise=shaken.SIGMA, workers=0
    )
    told = found.predictions([recordings[1], recordings[1].replace(name="odd")], own=True)
    assert told["odd"].failure == "'odd' is of another robot" and not told["odd"].rms
    assert told[recordings[1].name].rms


def test_noise_of_another_recording_goes_by_the_names_of_its_markers(recordings):
    """Listed in another order they have their own; other ones are told by their own recording, as many as they are."""
    first, second = recordings
    sigmas = shaken.SIGMA * np.array([1.0, 2.0, 3.0, 4.0])
    found = rn.calibrate(
        shaken.CASE, [first.replace(noise=rn.NoiseModel(white=sigmas))], start=TRUE, workers=0
    )
    order = [2, 0, 3, 1]
    turned = second.replace(markers=second.markers[:, order], names=[second.names[k] for k in order])
    np.testing.assert_allclose(found.comparison(turned).noise["markers"].white, sigmas[order])
    others = second.replace(names=[f"other {k}" for k in range(4)])
    assert np.all(found.comparison(others).noise["markers"].white < 2.0 * shaken.SIGMA)
    given = rn.calibrate(shaken.CASE, [first], start=TRUE, noise=2.0 * shaken.SIGMA, workers=0)
    loud = second.replace(noise=rn.NoiseModel(white=9.0))
    assert given.comparison(loud).noise["markers"].white == 2.0 * shaken.SIGMA  # as in the calibration
