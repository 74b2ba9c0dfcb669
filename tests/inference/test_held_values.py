"""What a fit was given it keeps: values that are not free, and a noise of the recording's markers."""

from __future__ import annotations

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
