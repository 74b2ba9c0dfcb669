"""Replicas for the bootstrap of the whole pipeline: what cameras with one axis or two have seen, and what fails."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.replicas import bootstrap, check_written, replica
from rodnet.diagnosis.stage_files import Stages
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


class Doubled(rn.HeadSpeed):
    """A counter that reads twice the rate, and does not say how that is written."""

    def measured(self, rec):
        return 0.5 * super().measured(rec)


class Silent(rn.Observation):
    """An instrument that says nothing of where its readings are."""

    def measured(self, rec):
        return np.zeros(len(rec.t))


def swimmer(instruments):
    """A case of a robot with a head, a recording with counters on it, and what they read."""
    robot = rn.robots.flagellated(n_tails=2, rpm=60.0)
    t = np.linspace(0.0, 4.0, 201)
    rng = np.random.default_rng(1)
    channels = {
        "v": rng.standard_normal(201),
        "turned": rng.standard_normal(201),
        "x": rng.standard_normal((201, 4)),
    }
    channels["v"][5] = np.nan
    rec = rn.Recording(t, np.zeros((201, 1, 3)), names=["head"], channels=channels, name="swim")
    return rn.Case(lambda rec: robot, lambda rec, robot: instruments(robot), name="swimmer"), rec


def counters(robot):
    return [
        rn.HeadSpeed(robot, "v"), rn.HeadAngle(robot, "turned"),
        rn.Reading(robot, "x", lambda view: np.zeros(4), unit="m"), rn.Markers(robot, {"head": "head:1"}, plane="x"),
    ]  # fmt: skip


def test_whatever_was_read_is_drawn_anew():
    """Counters, angles and other channels are written where they are read, about what the model predicts."""
    case, rec = swimmer(counters)
    check_written(case, [rec])
    instruments = case.observations(rec, case.robot(rec))
    measured = [one.measured(rec) for one in instruments]
    sizes = {one.name: size for one, size in zip(instruments, (3.0, 0.1, 1e-2, 1e-3), strict=True)}
    noise = {name: rn.NoiseModel(white=size) for name, size in sizes.items()}
    predicted = [np.full_like(m, 7.0) for m in measured]
    predicted[1] = np.linspace(0.0, 2.0, 201)
    # white, so that the model is complete
    white = [np.random.default_rng(k).standard_normal((201, m[0].size, 1)) for k, m in enumerate(measured)]
    fit = Fit(measured, predicted, np.concatenate([w.ravel() for w in white]), None, white)
    model = SimpleNamespace(fits=[fit], quantities=[], samples=sum(w.size for w in white))
    (made,) = replica(case, [rec], model, [noise], np.random.default_rng(0))
    for one, old, expected in zip(instruments, measured, predicted, strict=True):
        new = one.measured(made)
        np.testing.assert_array_equal(np.isnan(new), np.isnan(old))
        off = (new - expected) + (0.0 if one.name != "head_angle" else made.channels["turned"][0])
        assert np.nanstd(off) == pytest.approx(sizes[one.name], rel=0.2)


@pytest.mark.parametrize("instrument", [lambda robot: Doubled(robot, "v"), Silent])
def test_an_instrument_that_does_not_say_where_it_reads_is_told(instrument):
    """In whichever trial it is: not after the diagnosis."""
    case, rec = swimmer(instrument)
    known, _ = swimmer(counters)
    mixed = replace(
        case, observe=lambda one, robot: (case if one.name == "last" else known).observe(one, robot)
    )
    check_written(mixed, [rec, rec])
    with pytest.raises(rn.ParameterError, match=r"does not say where a recording holds them.*written"):
        check_written(mixed, [rec, rec.replace(name="last")])


def stage(name, compute, *arguments):
    return compute(*arguments)


def found(verdict, value):
    one = SimpleNamespace(id="drag", parameters={"drag.viscosity": SimpleNamespace(value=value)})
    return SimpleNamespace(verdict=verdict, findings=[one], explained_fraction=0.5)


def drawn(diagnose, draw=lambda number: ([number], []), count=4, stage=stage):
    told = []
    return bootstrap(count, draw, diagnose, stage, ["drag.viscosity"], ["drag"], told.append), told


def test_an_interrupted_bootstrap_goes_on_after_its_last_replica(tmp_path):
    calls = []

    def diagnose(recs, held):
        calls.append(recs[0])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return found("named", float(recs[0]))

    with pytest.raises(KeyboardInterrupt):
        drawn(diagnose, stage=Stages(tmp_path, "a", {}))
    one, _ = drawn(diagnose, stage=Stages(tmp_path, "a", {}))
    assert calls == [0, 1, 2, 2, 3]
    assert one.intervals["drag.viscosity"] == pytest.approx(np.percentile(np.arange(4.0), [5.0, 95.0]))
    more, _ = drawn(
        diagnose, count=6, stage=Stages(tmp_path, "a", {})
    )  # of a larger number the first are there
    assert calls == [0, 1, 2, 2, 3, 4, 5] and more.draws == 6


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
