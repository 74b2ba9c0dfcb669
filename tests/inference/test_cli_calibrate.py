"""`rodnet calibrate`: what it prints, what it writes, what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import rodnet as rn
from rodnet.cli import app
from tests.inference.swings import cable, record

CASE = """
import rodnet as rn
from tests.inference.swings import POINTS, cable

free = ["cable.E", "mass_damping.rate"]
per_trial = ["initial.velocity"]


def build(rec):
    return cable(E=3e6, rate=0.8)


def observe(rec, robot):
    return rn.Markers(robot, POINTS)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A case and five trials."""
    place = tmp_path_factory.mktemp("swings")
    (place / "swing.py").write_text(CASE)
    for k in range(5):
        kick = np.zeros((5, 3))
        kick[:, 1] = np.linspace(0.0, 0.1 * k, 5)
        record(cable(), rn.NoiseModel(white=3e-4), k, 0.15, velocity=kick).save(place / f"swing_{k}.npz")
    return place


def rodnet(folder, *arguments):
    given = [
        "calibrate",
        folder / "swing.py",
        "--recordings",
        folder / "swing_*.npz",
        "--workers",
        "0",
        "--modes",
        "3",
    ]
    return CliRunner().invoke(app, [*map(str, given), *map(str, arguments)])


def test_calibrate_splits_fits_and_writes_a_page(folder, tmp_path):
    done = rodnet(folder, "--out", tmp_path / "fit", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["split"] == "split by trial, 60/20/20"
    names = [*told["trained_on"], *told["held_out"], *told["confirm"]]
    assert sorted(names) == [f"swing_{k}" for k in range(5)] and len(told["trained_on"]) == 3
    E = told["parameters"]["cable.E"]
    assert E["low"] < 2e6 * 1.03 and E["high"] > 2e6 * 0.97
    # the held-out trial is predicted to the noise, with a start of its own
    (rms,) = (value["markers"] for value in told["held_out"].values())
    assert rms < 3.0 * 3e-4
    assert rn.Fitted.load(tmp_path / "fit").values["cable.E"] == pytest.approx(E["value"])
    notes = rn.Fitted.load(tmp_path / "fit").notes
    assert notes["made"]["held_out"] == list(told["held_out"]) and notes["made"]["confirm"] == told["confirm"]
    digest = {name: rn.read_recording(folder / f"{name}.npz").digest for name in told["trained_on"]}
    assert notes["digests"] == digest
    page = (tmp_path / "fit" / "calibration.html").read_text()
    assert page.count("<img") == 4 and "Held out" in page and "60/20/20" in page
    for path in told["parameters"]:
        assert path in page
    # once more: nothing is searched again, and people read the same
    again = rodnet(folder, "--out", tmp_path / "fit")
    assert again.exit_code == 0 and "evaluation 1:" not in again.stderr
    assert f"{E['value']:.5g}" in again.stdout and "left alone to confirm" in again.stdout


def test_patterns_hold_out(folder):
    done = rodnet(folder, "--hold-out", "*_[3-4].npz", "--confirm", "swing_0", "--json", "--no-progress")
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["trained_on"] == ["swing_1", "swing_2"] and told["confirm"] == ["swing_0"]
    assert list(told["held_out"]) == ["swing_3", "swing_4"] and done.stderr == ""


def test_files_that_a_shell_expands_stay_with_their_option(folder, tmp_path):
    """`--recordings day1/*.npz --hold-out day2/*.npz`: the second file after an option belongs to it, too."""
    day2 = tmp_path / "day2"
    day2.mkdir()
    for k in (3, 4):
        (day2 / f"swing_{k}.npz").write_bytes((folder / f"swing_{k}.npz").read_bytes())
    case = folder / "swing.py"
    train, others = [folder / f"swing_{k}.npz" for k in (1, 2)], sorted(day2.iterdir())
    fast = ["--workers", "0", "--modes", "3", "--json", "--no-progress"]
    for given in (
        [case, "--recordings", *train, "--hold-out", *others, *fast],
        ["--hold-out", *others, *fast, "--recordings", *train, case],
        [case, "--recordings", *train, "--hold-out", day2, *fast],
        [case, "--recordings", folder / "swing_[1-2].npz", *train, *others, "--hold-out", *others, *fast],
    ):
        done = CliRunner().invoke(app, ["calibrate", *map(str, given)])
        told = json.loads(done.stdout.splitlines()[-1])
        assert told["trained_on"] == ["swing_1", "swing_2"] and list(told["held_out"]) == [
            "swing_3",
            "swing_4",
        ]


PRESSED = """
import signal


class Eye(rn.Markers):
    looks = 0

    def read(self, view):
        Eye.looks += 1
        if Eye.looks == 400:  # in the second evaluation
            signal.raise_signal(signal.SIGINT)
        return super().read(view)


def observe(rec, robot):
    return Eye(robot, POINTS)
"""


def test_ctrl_c_leaves_the_best_so_far(folder, tmp_path):
    case = tmp_path / "pressed.py"
    case.write_text(CASE + PRESSED)
    arguments = [
        "--recordings",
        folder / "swing_[0-3].npz",
        "--workers",
        "0",
        "--modes",
        "3",
        "--out",
        tmp_path / "fit",
    ]
    done = CliRunner().invoke(app, ["calibrate", str(case), *map(str, arguments)])
    assert done.exit_code == 130 and "interrupted" in done.stdout, done.output
    assert rn.Fitted.load(tmp_path / "fit").values["cable.E"] > 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hold-out", "nix*"], "fits no recording"),
        (["--hold-out", "*"], "nothing to fit"),
        (["--loss", "l1"], "loss"),
        (["--segments", "-1"], "segments"),
    ],
)
def test_bad_options_are_named(folder, arguments, message):
    done = rodnet(folder, *arguments)
    assert isinstance(done.exception, rn.RodnetError) and message in str(done.exception)
