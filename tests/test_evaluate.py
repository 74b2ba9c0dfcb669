"""`rodnet evaluate`: naive predictions, fitted models, totals, failures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rodnet as rn
from rodnet.cli import app
from rodnet.inference.naive import held, interpolated
from rodnet.inference.trial import Trial
from tests.synthetic_recordings import write

CASE = """
import numpy as np
import rodnet as rn

free = ["rod.E", "mass_damping.rate", "markers.lag"]
tied = {"rod.rho": lambda values: 1000.0 + values["mass_damping.rate"]}
metric_name = "worst (m)"


def build(rec):
    if rec.attrs["kind"] == 2:
        raise rn.RecordingError(f"'{rec.name}' is of no kind that this case knows")
    figure = rn.StickFigure()
    material = rn.Material(E=1e6, rho=1000.0)
    figure.rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=4, material=material, radius=3e-3)
    ends = 0.195 if rec.attrs["kind"] == 1 else np.inf
    blow = rn.PointForce(at="rod.end", force=lambda t: (0.0, 0.0, np.nan if t > ends else 0.0))
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    return rn.Robot(figure.build(), [*elastic, rn.Gravity(), rn.MassDamping(rate=1.0), rn.Clamp(at="rod.start"), blow])


def observe(rec, robot):
    return rn.Markers(robot, {"middle": "rod@50%", "tip": "rod.end"})


def metric(rec, predicted):
    return np.abs(predicted[0] - rec.markers).max()


def baselines(train):
    mean = np.mean([rec.markers.mean(axis=0) for rec in train], axis=0)
    return {"mean pose": lambda rec: [np.broadcast_to(mean, rec.markers.shape)]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A case, and three recordings: what it simulates with E = 2 MPa, one that fails, one that it refuses."""
    folder = tmp_path_factory.mktemp("evaluate")
    (folder / "rod.py").write_text(CASE)
    t = 0.01 * np.arange(41)
    blank = rn.Recording(t, np.zeros((41, 2, 3)), names=["middle", "tip"], attrs={"kind": 0})
    trial = Trial.of(rn.load_case(folder / "rod.py"), blank, {"rod.E": 2e6})
    (markers,), failure = trial.predict()
    assert not failure
    for kind, name in enumerate(("good", "breaks", "refused")):
        path = folder / "set" / f"{name}.npz"
        write(path, t, markers, {}, names=np.array(["middle", "tip"]), kind=kind)
    return folder


# -- without a model ----------------------------------------------------------------------------
def chain(offset=0.0) -> rn.Recording:
    """A bent chain of six markers with a branch, prescribed at markers 1 and 4, which move linearly in time."""
    line = np.array(
        [[0, 0, 0], [0.1, 0, 0], [0.2, 0, -0.1], [0.4, 0, -0.1], [0.5, 0, 0], [0.6, 0, 0], [0.2, 0, -0.2]],
        dtype=float,
    )
    t = 0.01 * np.arange(21)
    markers = np.repeat(line[None], 21, axis=0)
    markers[:, 1] += t[:, None] * np.array([1.0, 0.0, 0.5])
    markers[:, 4] += t[:, None] * np.array([0.0, 2.0, 0.0])
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (2, 6)]
    return rn.Recording(t, markers, edges=edges, prescribed=[1, 4])


def instrument(rec: rn.Recording) -> rn.Markers:
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.6, 0, 0)], edges=6, material=rn.Material(E=1e6, rho=1000.0), radius=3e-3)
    robot = rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting()])
    return rn.Markers(robot, [f"rod:{k % 7}" for k in range(len(rec.names))])


def test_prescribed_motion_is_interpolated_along_the_rods():
    """Linear in arc length between what is held, constant beyond it, and in a branch that of where it hangs."""
    rec = chain()
    found = interpolated(rec, instrument(rec))
    pose = rec.markers[1]
    moved = rec.markers - pose
    s = np.cumsum([0.0, *np.linalg.norm(np.diff(pose[1:5], axis=0), axis=1)])
    for marker, share in ((2, s[1] / s[3]), (3, s[2] / s[3]), (0, 0.0), (5, 1.0), (6, s[1] / s[3])):
        expected = pose[marker] + (1.0 - share) * moved[:, 1] + share * moved[:, 4]
        np.testing.assert_allclose(found[:, marker], expected, atol=1e-12)
    np.testing.assert_array_equal(found[:, [1, 4]], rec.markers[:, [1, 4]])


def test_without_prescribed_markers_the_pose_is_held():
    rec = chain().replace(prescribed=())
    markers = instrument(rec)
    np.testing.assert_array_equal(interpolated(rec, markers), held(rec, markers))
    np.testing.assert_array_equal(held(rec, markers)[5], rec.markers[1])


def test_a_marker_lost_in_the_first_frames_is_held_from_where_it_is_first_seen():
    rec = chain()
    lost = rec.markers.copy()
    lost[:3, 2] = np.nan
    rec = rec.replace(markers=lost)
    np.testing.assert_array_equal(held(rec, instrument(rec))[0, 2], rec.markers[3, 2])


# -- fitted models --------------------------------------------------------------------------------
def test_paths_of_a_fit_are_those_of_a_prediction(folder):
    """A glob over rods, and one number of an instrument's, as a calibration writes them."""
    case, rec = rn.load_case(folder / "rod.py"), rn.read_recording(folder / "set" / "good.npz")
    one = Trial.of(case, rec, {"rod.E": 3e6, "markers.shift": [0.0, 0.0, 0.01]})
    other = Trial.of(case, rec, {"ro*.E": 3e6, "markers.shift[2]": 0.01})
    assert other.robot.parameters["rod.E"].value == 3e6
    np.testing.assert_array_equal(other.predict()[0][0], one.predict()[0][0])
    with pytest.raises(rn.CaseError, match=r"has no parameter 'rid\*.E'"):
        Trial.of(case, rec, {"rid*.E": 3e6})


def test_fitted_values_survive_a_file(tmp_path):
    shift = rn.FittedValue([0.0, 1e-3, 0.0], "m")
    values = {"rod.E": rn.FittedValue(2e6, "Pa", 1.9e6, 2.1e6), "markers.shift": shift}
    fitted = rn.Fitted("rod", values, ["a.npz"], {"seed": 3})
    path = fitted.save(tmp_path / "fit")
    assert path.name == "fitted.json"
    assert rn.Fitted.load(tmp_path / "fit") == fitted == rn.Fitted.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "not a fitted model"),
        ({"version": 2}, "of version 2"),
        ({"parameters": [1]}, "object of values by path"),
        ({"parameters": {"rod.E": 3.0}}, "'rod.E' must be an object"),
        ({"parameters": {"rod.E": {"value": None}}}, "value = None of 'rod.E'"),
        ({"parameters": {"rod.E": {"value": "2e6"}}}, "must be a finite number"),
        ({"parameters": {"rod.E": {"value": 1.0, "hgih": 2.0}}}, "unknown entries hgih"),
    ],
)
def test_broken_models_are_refused(tmp_path, change, message):
    path = rn.Fitted("rod", {"rod.E": rn.FittedValue(1.0)}).save(tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(rn.CaseError, match=message):
        rn.Fitted.load(tmp_path)


def test_a_missing_model_is_named(tmp_path):
    with pytest.raises(rn.CaseError, match=r"no fitted model at .*nowhere"):
        rn.Fitted.load(tmp_path / "nowhere")


def test_values_reach_robot_and_observation(folder):
    """Values of both, and what is tied to them."""
    case, rec = rn.load_case(folder / "rod.py"), rn.read_recording(folder / "set" / "good.npz")
    trial = Trial.of(case, rec, {"rod.E": 3e6, "mass_damping.rate": 7.0, "markers.lag": 0.02})
    values = {path: p.value for path, p in trial.robot.parameters.items()}
    assert (values["rod.E"], values["mass_damping.rate"], values["rod.rho"]) == (3e6, 7.0, 1007.0)
    assert trial.observations[0].lag.value == 0.02
    assert trial.observations[0].robot is trial.robot
    with pytest.raises(rn.CaseError, match=r"no parameter 'rod\.F'"):
        Trial.of(case, rec, {"rod.F": 1.0})


# -- scores -----------------------------------------------------------------------------------------
def test_the_truth_has_no_error(folder):
    """What was simulated with 2 MPa is predicted with 2 MPa, up to single precision; not with the case's 1 MPa."""
    recs = folder / "set" / "good.npz"
    right = rn.evaluate(folder / "rod.py", recs, {"rod.E": 2e6}, workers=0).total()
    wrong = rn.evaluate(folder / "rod.py", recs, workers=0).total()
    assert right["metric"] < 1e-7 and right["mean_mm_5s"] < 1e-4
    assert wrong["metric"] > 1e-3 and wrong["mean_mm_1s"] > 0.5
    assert right["baselines"]["last pose held"]["metric"] > 2.0 * wrong["metric"]


def test_measures_are_those_of_the_predictions(folder):
    """Mean distance from the third frame on [mm]; the total is the mean over files; baselines of the case, too."""
    rec = rn.read_recording(folder / "set" / "good.npz")
    later = rec.replace(name="later", markers=rec.markers + np.array([0.0, 4e-3, 3e-3]))
    found = rn.evaluate(folder / "rod.py", [rec, later], {"rod.E": 2e6}, train=[rec], workers=0)
    assert found.files[1]["mean_mm_5s"] == pytest.approx(5.0, rel=1e-4)
    assert found.total()["mean_mm_1s"] == pytest.approx(2.5, rel=1e-4)
    off = np.abs(rec.markers - rec.markers.mean(axis=0)).max()
    assert found.files[0]["baselines"]["mean pose"]["metric"] == pytest.approx(off)


def test_what_fails_is_told_and_the_others_go_on(folder):
    """A simulation that breaks off before 0.2 s holds its last state, what cannot be built has no score."""
    found = rn.evaluate(folder / "rod.py", folder / "set", {"rod.E": 2e6}, workers=0)
    files = {f["name"]: f for f in found.files}
    assert files["good"]["failure"] == "" and files["good"]["metric"] < 1e-7
    assert files["breaks"]["failure"].startswith("fails at 0.19 s")
    rec = rn.read_recording(folder / "set" / "breaks.npz")
    assert files["breaks"]["metric"] == pytest.approx(
        np.abs(rec.markers - rec.markers[19])[19:].max(), rel=1e-3
    )
    assert (
        "no kind that this case knows" in files["refused"]["failure"] and files["refused"]["metric"] is None
    )
    total = found.total()
    assert (total["recordings"], total["failed"]) == (3, 2)
    assert total["metric"] == pytest.approx((files["good"]["metric"] + files["breaks"]["metric"]) / 2)


def test_processes_find_the_same(folder):
    recs = [folder / "set" / f"{name}.npz" for name in ("good", "breaks")]
    here = rn.evaluate(folder / "rod.py", recs, workers=0).to_dict()
    there = rn.evaluate(folder / "rod.py", recs, workers=1).to_dict()
    for file in (*here["files"], *there["files"]):
        del file["seconds"]
    assert here == there


# -- the command ----------------------------------------------------------------------------------------
def test_command_prints_one_object(folder, tmp_path):
    rn.Fitted("rod", {"rod.E": rn.FittedValue(2e6, "Pa")}, [str(folder / "set" / "good.npz")]).save(tmp_path)
    good = str(folder / "set" / "good.npz")
    arguments = [
        "evaluate",
        str(folder / "rod.py"),
        "--model",
        str(tmp_path),
        "--workers",
        "0",
        "--no-progress",
    ]
    done = CliRunner().invoke(app, [*arguments, "--json", "--recordings", good, good])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["metric_name"] == "worst (m)" and told["metric"] < 1e-7
    assert set(told["baselines"]) == {"last pose held", "prescribed motion interpolated", "mean pose"}
    assert [f["name"] for f in told["files"]] == ["good"] and told["kinds"]["set"]["recordings"] == 1
    table = CliRunner().invoke(app, [*arguments, "--recordings", str(folder / "set")])
    assert table.exit_code == 3
    assert "mean of 3" in table.stdout and "refused" in table.stderr


def test_a_model_of_another_case_is_refused(folder, tmp_path):
    rn.Fitted("cable", {}).save(tmp_path)
    with pytest.raises(rn.CaseError, match="fitted for the case 'cable', not for 'rod'"):
        rn.evaluate(folder / "rod.py", folder / "set", tmp_path, workers=0)
