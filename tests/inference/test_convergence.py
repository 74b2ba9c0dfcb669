"""What a time step takes of vibrations, and what half of it changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rodnet as rn
from rodnet.cli import app
from rodnet.inference.convergence import convergence, numerical_loss
from rodnet.inference.trial import Trial
from rodnet.solve.steppers import SDIRK2, GeneralizedAlpha, ImplicitEuler

RATE, LENGTH = 0.8, 0.2
CASE = f"""
import numpy as np

import rodnet as rn

DT, STEPPER = 0.01, "sdirk2"


def build(rec):
    figure = rn.StickFigure()
    material = rn.Material(E=2e7, rho=1000.0)
    figure.rod("rod", [(0, 0, 0), ({LENGTH}, 0, 0)], edges=8, material=material, radius=2e-3)
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    return rn.Robot(figure.build(), [*elastic, rn.MassDamping(rate={RATE}), rn.Clamp(at="rod.start")])


def observe(rec, robot):
    return rn.Markers(robot, ["rod:4", "rod:8"])


def options(rec, robot):
    s = robot.graph.x0[:, 0] / {LENGTH}
    return {{"dt": DT, "stepper": STEPPER, "velocity": np.outer(0.02 * s**2 * (3.0 - s) / 2.0, (0.0, 0.0, 1.0))}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A case of a cantilever that was hit, and two recordings of nothing."""
    place = tmp_path_factory.mktemp("hit")
    (place / "hit.py").write_text(CASE)
    t = 0.01 * np.arange(61)
    for k in range(2):
        markers = np.zeros((61, 2, 3)) + np.array([[0.1, 0, 0], [0.2, 0, 0]]) + 1e-3 * k
        rn.Recording(t, markers).save(place / f"hit_{k}.npz")
    return place


def trial_of(folder: Path, **options) -> Trial:
    case, rec = rn.load_case(folder / "hit.py"), rn.read_recording(folder / "hit_0.npz")
    trial = Trial.of(case, rec)
    trial.options.update(options)
    return trial


@pytest.mark.parametrize("x", [0.05, 0.3, 1.0])
def test_loss_is_that_of_the_stability_function(x):
    """Of y' = i omega y, x = omega dt: Euler's, that of Alexander's method; the trapezoidal rule loses nothing."""
    g, z = SDIRK2.gamma, 1j * x
    expected = {
        ImplicitEuler(): 1.0 / (1.0 - z),
        SDIRK2(): (1.0 + (1.0 - 2.0 * g) * z) / (1.0 - g * z) ** 2,
        GeneralizedAlpha(1.0): 1.0,
    }
    for stepper, factor in expected.items():
        lost = 1.0 - abs(factor) ** (2.0 * np.pi / x)
        assert numerical_loss(stepper, x / 0.01, 0.01) == pytest.approx(lost, abs=1e-9, rel=1e-6)


def test_modes_of_a_prediction(folder):
    """A cantilever hit as its first mode moves: all energy is there, and damping leaves exp(-c T / 2)."""
    trial = trial_of(folder)
    traj, failure = trial.run()
    assert not failure
    found = convergence(trial, traj, trial.read(traj))
    (mode,) = found.modes
    beam = 1.875104069**2 / (2.0 * np.pi * LENGTH**2) * np.sqrt(2e7 * (2e-3) ** 2 / 4.0 / 1000.0)
    assert mode.frequency == pytest.approx(beam, rel=0.02)
    assert mode.share > 0.95  # the rest is slower than half its frequency, in 1.2 periods
    assert mode.fitted == pytest.approx(1.0 - np.exp(-0.5 * RATE / mode.frequency), rel=1e-6)
    assert found.worst == pytest.approx(mode.numerical / mode.fitted)


def test_a_motion_loses_what_its_mode_is_said_to(folder):
    """Swings of backward Euler, without and with damping, against the loss of the one mode."""
    trial = trial_of(folder, stepper="euler", dt=2e-3)
    traj, _ = trial.run()
    (mode,) = convergence(trial, traj, trial.read(traj)).modes
    tip = np.abs(traj.at("rod.end")[:, 2])
    first, second, *_ = np.flatnonzero((tip[1:-1] > tip[:-2]) & (tip[1:-1] > tip[2:])) + 1
    kept = (tip[second] / tip[first]) ** 2  # from one turn to the next is half a period
    assert kept == pytest.approx((1.0 - mode.fitted) * (1.0 - mode.numerical), rel=0.01)
    assert mode.numerical > 0.05


def test_half_the_step_is_compared(folder):
    """The change of trajectories, over both markers, is what two runs by hand differ by."""
    trial = trial_of(folder)
    traj, _ = trial.run()
    found = convergence(trial, traj, trial.read(traj))
    coarse, fine = (trial_of(folder, dt=dt).predict()[0][0] for dt in (0.01, 0.005))
    off = 1e3 * np.linalg.norm(coarse - fine, axis=2)
    assert found.max_mm == pytest.approx(off.max())
    assert found.rms_mm == pytest.approx(np.sqrt((off**2).mean()))
    assert 0.0 < found.max_mm < 1.0


def test_an_adaptive_step_cannot_be_halved(folder):
    trial = trial_of(folder, adaptive=rn.Adaptive(1e-4))
    with pytest.raises(rn.CaseError, match="cannot be halved"):
        convergence(trial, None, [])


def test_command_tells_of_the_step_and_writes_a_page(folder, tmp_path):
    """Of the recording that the model was not fitted to alone."""
    seen = rn.read_recording(folder / "hit_0.npz")
    rn.Fitted("hit", {"mass_damping.rate": rn.FittedValue(1.0)}, [], {"digests": {"x": seen.digest}}).save(
        tmp_path
    )
    arguments = [
        "evaluate",
        folder / "hit.py",
        "--model",
        tmp_path,
        "--recordings",
        folder,
        "--unseen",
        "--converge",
    ]
    arguments += ["--out", tmp_path / "page", "--workers", "0", "--no-progress"]
    done = CliRunner().invoke(app, [*map(str, arguments), "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout.splitlines()[-1])
    assert [f["name"] for f in told["files"]] == ["hit_1"]
    assert told["convergence"]["rms_mm"] == told["files"][0]["convergence"]["rms_mm"] > 0.0
    page = (tmp_path / "page" / "evaluation.html").read_text()
    assert page.count("<img") == 2 and "The time step" in page and "mass_damping.rate = 1" in page
    shown = CliRunner().invoke(app, [*map(str, arguments)]).stdout
    assert "time step 10 ms; halved it changes trajectories by" in shown


@pytest.mark.parametrize(("model", "message"), [(False, "give --model"), (True, "leaves nothing")])
def test_unseen_needs_a_model_that_leaves_something(folder, tmp_path, model, message):
    rn.Fitted("hit", {}, [str(folder / f"hit_{k}.npz") for k in range(2)]).save(tmp_path)
    arguments = [
        "evaluate",
        str(folder / "hit.py"),
        "--recordings",
        str(folder),
        "--unseen",
        "--workers",
        "0",
    ]
    done = CliRunner().invoke(app, [*arguments, *(["--model", str(tmp_path)] if model else [])])
    assert isinstance(done.exception, rn.ParameterError) and message in str(done.exception)
