"""Replicas for the bootstrap of the whole pipeline: what cameras with one axis or two have seen, and what fails."""

from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.replicas import bootstrap, replica
from rodnet.inference.comparison import Fit
from tests.diagnosis import shaken

ORDER = {"m3": "rod@100%", "m0": "rod@25%"}  # not all that are recorded, and not as they are
WHICH, FRAMES = [3, 0], 400
NOISE = rn.NoiseModel(white=np.array([1e-3, 3e-3]))


def seen(plane, size):
    """A case with a camera, a recording, and a model that leaves so many times the noise."""
    case = rn.Case(shaken.build, lambda rec, robot: rn.Markers(robot, ORDER, plane=plane))
    rng = np.random.default_rng(3)
    along = np.array([0.25, 0.5, 0.75, 1.0]) * shaken.LENGTH
    markers = 0.01 * rng.standard_normal((FRAMES, 4, 3))
    markers[..., 0] += along
    markers[7, 3] = np.nan
    suspect = np.zeros((FRAMES, 4), dtype=bool)
    suspect[11, 0] = True
    rec = rn.Recording(
        np.arange(FRAMES) / 100.0, markers, names=[f"m{k}" for k in range(4)], suspect=suspect, attrs=shaken.drive(0)
    )  # fmt: skip
    (camera,) = case.observations(rec, case.robot(rec))
    measured = camera.measured(rec)
    whitened = size * rng.standard_normal(measured.shape)
    predicted = np.nan_to_num(measured) - NOISE.white[:, None] * whitened
    fit = Fit([measured], [predicted], whitened.ravel(), None, [whitened])
    model = SimpleNamespace(fits=[fit], quantities=[], samples=measured.size)
    return case, rec, model, predicted


@pytest.mark.parametrize("plane", ["xz", "x", "zx", "xyz"])
@pytest.mark.parametrize("size", [1.0, 5.0])
def test_a_camera_sees_new_markers_in_its_axes_and_nothing_else_changes(plane, size):
    """Prediction and noise, or what the model leaves up to a sign, in the axes that are observed."""
    case, rec, model, predicted = seen(plane, size)
    (made,) = replica(case, [rec], model, [{"markers": NOISE}], np.random.default_rng(0))
    axes = ["xyz".index(a) for a in plane]
    off = made.markers[:, WHICH][:, :, axes] - predicted
    lost = np.zeros((FRAMES, 2), dtype=bool)
    lost[7, 0] = lost[11, 1] = True
    np.testing.assert_array_equal(np.isnan(off).any(axis=2), lost)
    if size == 1.0:
        np.testing.assert_allclose(np.nanstd(off, axis=(0, 2)), NOISE.white, rtol=0.12)
        assert np.abs(np.nanmean(off, axis=(0, 2)) / NOISE.white).max() < 0.2
        assert np.nanmax(np.abs(off - (rec.trusted[:, WHICH][:, :, axes] - predicted))) > 1e-3
    else:
        left = rec.trusted[:, WHICH][:, :, axes] - predicted
        sign = np.sign((off * left)[0, 0, 0])
        np.testing.assert_allclose(off, sign * left, atol=1e-12)
    others = [a for a in range(3) if a not in axes]
    unseen = made.markers[:, WHICH][:, :, others]
    np.testing.assert_array_equal(unseen[~lost], rec.markers[:, WHICH][:, :, others][~lost])
    np.testing.assert_array_equal(made.markers[:, [1, 2]], rec.markers[:, [1, 2]])


def stage(name, compute, *arguments):
    return compute(*arguments)


def found(verdict, value):
    one = SimpleNamespace(id="drag", parameters={"drag.viscosity": SimpleNamespace(value=value)})
    return SimpleNamespace(verdict=verdict, findings=[one], explained_fraction=0.5)


def drawn(diagnose, draw=lambda number: ([number], []), count=4):
    told = []
    return bootstrap(count, draw, diagnose, stage, ["drag.viscosity"], ["drag"], told.append), told


def test_what_fails_is_no_evidence_of_how_often_something_is_found():
    def diagnose(recs, held):
        if recs[0] % 2:
            raise rn.RecordingError(f"replica {recs[0]} is odd")
        return found("named", 1.0)

    one, told = drawn(diagnose)
    assert one.named == {"drag": 1.0} and one.removed == (0.5, 0.5)
    assert one.draws == 4 and one.verdicts == {"named": 2, "failed": 2}
    assert any("2 of 4" in text and "replica 1 is odd" in text for text in told)


def test_where_all_fail_there_are_no_rates():
    def diagnose(recs, held):
        raise rn.ConvergenceError("no motion")

    one, _ = drawn(diagnose)
    assert one.named == {} and one.intervals == {} and one.removed is None
    assert one.verdicts == {"failed": 4}


def test_mistakes_in_programs_are_no_failures_of_a_replica():
    def broken(recs, held):
        raise TypeError("not a robot's fault")

    def misshapen(number):
        return np.zeros((3, 2, 2)) + np.zeros((3, 2, 3))

    with pytest.raises(TypeError, match="not a robot's fault"):
        drawn(broken)
    with pytest.raises(ValueError, match="broadcast"):  # of what is drawn, before anything is diagnosed
        drawn(lambda recs, held: found("named", 1.0), misshapen)
