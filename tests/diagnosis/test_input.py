"""What a diagnosis is given that makes no sense is told before anything is computed."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import rodnet as rn
from rodnet.cli import app
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.edited import with_candidates
from rodnet.diagnosis.forces import Placebo
from rodnet.diagnosis.heldout import note
from rodnet.diagnosis.repaired import as_splines
from rodnet.report.views import clear
from rodnet.sweeps.job import pack
from tests.diagnosis import shaken


@pytest.mark.parametrize("word", ["priors", "start"])
def test_a_value_for_what_is_not_there_is_refused(word):
    given = {"priors": {"rod.e": (2e6, 1e5)}, "start": {"rod.e": 2e6}}[word]
    with pytest.raises(rn.ParameterError, match=rf"{word}: there is no rod\.e in this case; it has rod\.E"):
        rn.diagnose(shaken.CASE, [shaken.record(0)], noise=shaken.SIGMA, workers=0, **{word: given})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"candidates": "yeild"}, "no candidate is called 'yeild'"),
        ({"bootstrap": "3"}, "must be a number of replicas"),
        ({"minutes": 0.0}, "more than 0"),
        ({"modes": -3}, "must be a number of modes"),
    ],
)
def test_other_options_that_make_no_sense(options, message):
    with pytest.raises(rn.RodnetError, match=message):
        rn.diagnose(shaken.CASE, [shaken.record(0)], noise=shaken.SIGMA, workers=0, **options)


CASE = """
import rods_beside
import rodnet as rn

free = ["rod.E"]


def build(rec):
    return rods_beside.robot()


def observe(rec, robot):
    return rn.Markers(robot, ["rod.end"])
"""
BESIDE = """
import rodnet as rn


def robot():
    fig = rn.StickFigure().rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=4, material=rn.Material(E=1e6), radius=3e-3)
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="rod.start")])
"""


@pytest.fixture
def case_file(tmp_path):
    """A case that imports what lies beside it."""
    (tmp_path / "rods_beside.py").write_text(BESIDE)
    (tmp_path / "own_case.py").write_text(CASE)
    return tmp_path / "own_case.py"


def test_a_case_and_recordings_may_be_files(case_file):
    t = 0.1 * np.arange(20)
    path = rn.Recording(t, np.full((20, 1, 3), 0.1), names=["tip"]).save(case_file.parent / "a.npz")
    with pytest.raises(rn.RodnetError, match="no candidate is called 'yeild'"):
        rn.diagnose(case_file, path, candidates="yeild", noise=1e-3, workers=0)
    with pytest.raises(rn.RecordingError, match="no recording at 'b"):
        rn.diagnose(case_file, path, hold_out="b/*.npz", noise=1e-3, workers=0)


def test_a_case_with_effects_in_it_reaches_other_processes(case_file):
    """Neither its file nor what lies beside it can be imported there."""
    case, rec = rn.load_case(case_file), rn.Recording([0.0, 0.1, 0.2], np.zeros((3, 1, 3)), names=["tip"])
    some = candidates(case.robot(rec), [], ["stiffness-defect"])
    sent = case_file.with_name("sent")
    sent.write_bytes(pack(with_candidates(case, some, ()), "functions of the case"))
    code = f"import pickle; print(*pickle.load(open({str(sent)!r}, 'rb')).build(None).parameters)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "stiffness-defect@rod.loss" in ran.stdout.split(), ran.stderr


def test_a_ledger_that_cannot_be_read_is_told_before_anything_is_computed(tmp_path):
    """Its last line is torn, as of a run that was killed while it wrote: openings cannot be counted."""
    recs, ledger, told = [shaken.record(k).cut(0.0, 0.2) for k in range(2)], tmp_path / "kept.jsonl", []
    note(ledger, recs[1:], "held out: model as it is")
    ledger.write_text(ledger.read_text() + '{"time": "2026-')
    with pytest.raises(rn.CaseError, match=r"line 2 of the ledger '.*kept\.jsonl' is no entry"):
        rn.diagnose(
            shaken.CASE, recs[:1], hold_out=recs[1:], noise=shaken.SIGMA, workers=0, ledger=ledger,
            progress=told.append,
        )  # fmt: skip
    assert told == []


@pytest.mark.parametrize("id", ["drive-gain", "drive-lag", "grasp-offset"])
def test_robots_with_imperfect_grips_are_written_to_files(id, tmp_path):
    """Drives are functions in a case, and splines in a file."""
    robot = shaken.build(shaken.record(0))
    (one,) = candidates(robot, [], [id])
    robot = one.build(robot).with_parameters({p: 0.02 for p in one.strength})
    read = rn.Robot.load(as_splines(robot, 1.0).save(tmp_path / "robot.toml"))
    assert {p: read.parameters[p].value for p in one.strength} == {p: 0.02 for p in one.strength}
    there, here = (rn.Simulation(r, dt=shaken.DT, stepper="sdirk2").run(0.5).x[-1] for r in (read, robot))
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-5)


def test_a_drive_that_ends_stops():
    """A run that is longer than the recording holds the grip where it was last."""
    drive = as_splines(shaken.build(shaken.record(0)), 1.0).terms[-1]
    true = shaken.build(shaken.record(0)).terms[-1]
    for t in (0.0, 0.3, 0.9):
        np.testing.assert_allclose(drive.displacement(t), true.displacement(t), atol=1e-7)
    last = drive.displacement(60.0)
    np.testing.assert_allclose(last, drive.displacement(3600.0), atol=1e-12)
    assert np.abs(last - true.displacement(1.0)).max() < 0.01
    np.testing.assert_allclose(drive.rotation(60.0), np.eye(3), atol=1e-12)


def test_a_short_motion_is_what_it_was_to_its_end():
    """The last pieces of a spline, which stop it, are short."""
    there = rn.PrescribedMotion(
        at="rod.start", position=lambda t: np.array([0.0, 0.0, np.sin(2 * np.pi * t / 0.15)]), name="grip"
    )
    robot = shaken.build(shaken.record(0))
    drive = as_splines(rn.Robot(robot.graph, [*robot.terms[:-1], there]), 1.1 * 0.15).terms[-1]
    for t in np.linspace(0.0, 0.15, 40):
        np.testing.assert_allclose(drive.displacement(t), there.displacement(t), atol=1e-6)


def test_what_an_earlier_diagnosis_has_written_does_not_stay_beside_a_new_one(tmp_path):
    (tmp_path / "figures").mkdir()
    old = ["repaired.toml", "repaired.py", "fitted.json", "diagnosis.rrd", "figures/held-out-a.png"]
    mine = ["notes.txt", "figures/mine.png"]
    for name in (*old, *mine):
        (tmp_path / name).write_text("")
    clear(tmp_path)
    assert sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.*")) == sorted(mine)


def test_nothing_beats_placebos_that_cannot_be_drawn():
    assert Placebo(np.zeros((0, 0)), np.zeros(0), np.zeros(0)).beaten(100.0) == 0.0


def test_ids_on_the_command_line_may_have_commas_between(tmp_path):
    path, case = shaken.record(0).save(tmp_path / "one.npz"), tmp_path / "shaken_rod.py"
    case.write_text("from tests.diagnosis.shaken import build, free, observe, options\n")
    some = ["--recordings", str(path), "--noise", "1e-3", "--candidates", "gravity,yeild"]
    ran = CliRunner().invoke(app, ["diagnose", str(case), *some])
    assert ran.exit_code != 0 and "no candidate is called 'yeild'" in ran.output + str(ran.exception)
