"""Simpler models that stand beside a fitted one: a pose held, and a linear law of second order."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.linalg import expm

import rodnet as rn
from rodnet.inference.simpler import restored, stored
from rodnet.numbers import plain

REST = np.array([[0.0, 0.0, -0.1], [0.0, 0.01, -0.2]])


def swings(count: int, seed: int = 0, frames: int = 301) -> list[rn.Recording]:
    """Two markers on damped springs of different stiffness in each direction, let go at rest."""
    rng = np.random.default_rng(seed)
    square = rng.standard_normal((6, 6))
    stiffness = 60.0 * np.eye(6) + 10.0 * square @ square.T
    step = expm(0.01 * np.block([[np.zeros((6, 6)), np.eye(6)], [-stiffness, -4.0 * np.eye(6)]]))
    recs = []
    for k in range(count):
        states = [np.concatenate([0.05 * rng.standard_normal(6), np.zeros(6)])]
        for _ in range(frames - 1):
            states.append(step @ states[-1])
        y = np.array(states)[:, :6].reshape(-1, 2, 3)
        recs.append(rn.Recording(0.01 * np.arange(frames), REST + y, name=f"swing {k}"))
    return recs


def off(model, rec) -> float:
    return float(np.linalg.norm(model(rec)[0] - rec.markers, axis=2).mean())


def test_the_rest_pose_is_the_median_of_where_markers_end():
    """One that ends elsewhere does not change it much, nor do lost frames at the end."""
    recs = swings(6)
    away, lost = recs[0].markers + 0.1, recs[1].markers.copy()
    lost[-20:, 1] = np.nan
    recs[0], recs[1] = recs[0].replace(markers=away), recs[1].replace(markers=lost)
    np.testing.assert_allclose(rn.RestPose.fit(recs).pose, REST, atol=2e-3)


def test_a_linear_law_predicts_what_is_linear():
    """A trial that it was not fitted to, to a tenth of what holding the rest pose is off, at another rate too."""
    *train, new = swings(10)
    model, held = rn.LinearMotion.fit(train), rn.RestPose.fit(train)
    assert off(model, new) < 0.1 * off(held, new)
    half = new.replace(t=new.t[::2], markers=new.markers[::2], suspect=new.suspect[::2])
    assert off(model, half) < 0.1 * off(held, half)
    lost = train[0].markers.copy()
    lost[3:40, 0] = np.nan
    again = rn.LinearMotion.fit([train[0].replace(markers=lost), *train[1:]])
    assert off(again, new) < 0.1 * off(held, new)


def test_a_prediction_knows_the_first_frame_only():
    *train, new = swings(6)
    model = rn.LinearMotion.fit(train)
    other = new.markers.copy()
    other[1:] += 0.3
    np.testing.assert_array_equal(model(new)[0], model(new.replace(markers=other))[0])
    np.testing.assert_allclose(model(new)[0][0], new.markers[0], atol=1e-12)


def test_simpler_models_survive_a_file(tmp_path):
    *train, new = swings(6)
    models = {
        "held": rn.RestPose.fit(train),
        "linear": rn.LinearMotion.fit(train),
        "own": lambda rec: [rec.markers],
    }
    fitted = rn.Fitted("case", {}, ["a.npz"], {}, stored(models))
    back = restored(rn.Fitted.load(fitted.save(tmp_path)).baselines)
    assert set(back) == {"held", "linear"}  # a function of the case's own is not kept
    for name, model in back.items():
        np.testing.assert_allclose(model(new)[0], models[name](new)[0], atol=1e-12)


@pytest.mark.parametrize(
    "broken", [{"model": "oracle"}, {"model": "rest pose"}, {"model": "rest pose", "pose": [["x"]]}, {}, 3]
)
def test_what_is_no_model_is_refused(broken):
    with pytest.raises(rn.CaseError, match="'held' cannot be read; calibrate again"):
        restored({"held": broken})


def test_recordings_that_tell_nothing_are_refused():
    with pytest.raises(rn.RecordingError, match="no recordings"):
        rn.LinearMotion.fit([])
    (rec,) = swings(1)
    blind = np.tile([False, True], (len(rec.t), 1))
    with pytest.raises(rn.RecordingError, match="marker 1 is never trusted"):
        rn.RestPose.fit([rec.replace(suspect=blind)])
    with pytest.raises(rn.RecordingError, match="too short"):
        rn.LinearMotion.fit([rec.cut(0.0, 0.03)])


def test_a_calibration_keeps_them_and_an_evaluation_shows_them(tmp_path):
    """Stored with the model, they are there without the training recordings; those of --train come first."""
    train = swings(4)
    kept = stored({"held": rn.RestPose.fit(train)})
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0, 0.01, -0.2)], edges=2, material=rn.Material(E=1e6), radius=3e-3)
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    robot = rn.Robot(figure.build(), [*elastic, rn.Gravity(), rn.Clamp(at="rod.start")])
    case = rn.Case(
        lambda rec: robot, lambda rec, robot: rn.Markers(robot, ["rod@50%", "rod.end"]), name="two",
        baselines=lambda recs: {"held": rn.RestPose.fit(recs)}, free=("rod.E",),
    )  # fmt: skip
    new = swings(1, frames=11)[0]
    found = rn.evaluate(
        case, [new], rn.Fitted("two", {}, [], {}, json.loads(json.dumps(plain(kept)))), workers=0
    )
    expected = 1e3 * np.linalg.norm(REST - new.markers, axis=2)[2:].mean()
    assert found.files[0]["baselines"]["held"]["mean_mm_5s"] == pytest.approx(expected, rel=0.05)
    again = rn.evaluate(
        case, [new], rn.Fitted("two", {}, [], {}, kept), train=[new.cut(0.0, 0.05)], workers=0
    )
    other = again.files[0]["baselines"]["held"]["mean_mm_5s"]
    assert other != pytest.approx(found.files[0]["baselines"]["held"]["mean_mm_5s"], rel=1e-6)
    calibration = rn.calibrate(
        case, [swings(1, frames=6)[0]], noise=1e-2, workers=0, evaluations=1, outliers=None
    )
    assert calibration.fitted().baselines["held"]["model"] == "rest pose"
