"""A diagnosis that was killed goes on after its last finished stage."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.stage_files import Stages
from tests.diagnosis import shaken

TRIED = ["stiffness-defect", "gravity"]


def test_a_stage_is_computed_once(tmp_path):
    """What is known by name is not written, and the same object again; a function without a name may be in it."""
    known, told = {"secret": lambda: 3}, []
    result = {"numbers": np.arange(3.0), "function": known["secret"]}
    first = Stages(tmp_path, "a", known)
    first("one", lambda: result)
    again = Stages(tmp_path, "a", known, told.append)
    got = again("one", lambda: pytest.fail("computed twice"))
    np.testing.assert_array_equal(got["numbers"], result["numbers"])
    assert got["function"] is known["secret"]
    assert "taken from the earlier run: one" in told[0]
    assert again("two", lambda: 2) == 2  # an earlier run had not come that far


def test_what_is_done_between_moves_no_stage(tmp_path):
    """As a bootstrap that is asked for later; a stage of a name that was there before is another one."""
    first = Stages(tmp_path, "a", {})
    assert [first("place", lambda k=k: k) for k in range(2)] == [0, 1]
    again = Stages(tmp_path, "a", {})
    got = [again("place", lambda: pytest.fail("computed twice")), again("bootstrap 1", lambda: 7)]
    assert [*got, again("place", lambda: pytest.fail("computed twice"))] == [0, 7, 1]


def test_another_diagnosis_starts_anew(tmp_path):
    Stages(tmp_path, "a", {})("one", lambda: 1)
    told = []
    assert Stages(tmp_path, "b", {}, told.append)("one", lambda: 2) == 2
    assert "from the start" in told[0]
    again = Stages(tmp_path, "a", {}, told.append)  # the first one's results are still there
    assert again("one", lambda: pytest.fail("computed twice")) == 1


def test_a_torn_file_is_computed_again(tmp_path):
    Stages(tmp_path, "a", {})("one", lambda: list(range(1000)))
    (path,) = (tmp_path / "stages").glob("*/*.pkl")
    path.write_bytes(path.read_bytes()[:100])
    told = []
    assert Stages(tmp_path, "a", {}, told.append)("one", lambda: 2) == 2
    assert "cannot be read" in told[0]


def test_killed_and_started_again(tmp_path):
    """SIGKILL after the first screening: the second run takes up all that was finished, and ends as one run does."""
    values = {"loss": 0.6, "place": 0.37, "width": 0.06}
    paths = []
    for k in range(3):
        rec = shaken.record(k, "stiffness-defect", values)
        paths.append(str(rec.save(tmp_path / f"{rec.name}.npz")))
    case, out = tmp_path / "shaken_rod.py", tmp_path / "found"
    case.write_text("from tests.diagnosis.shaken import build, free, observe, options\n")
    command = [
        sys.executable, "-c", "from rodnet.cli import main; main()", "diagnose", str(case), "--recordings", *paths,
        "--noise", "1e-3", "--workers", "0", "--out", str(out), *(f"--candidates={c}" for c in TRIED),
    ]  # fmt: skip
    run = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=os.environ)
    deadline = time.monotonic() + 120.0
    while not list(out.glob("stages/*/screen-1-*.pkl")):
        assert run.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert not (out / "diagnosis.json").exists()
    before = {path: path.stat().st_mtime_ns for path in out.glob("stages/*/*.pkl")}

    again = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=True)
    for stage in ("calibrate", "calibrate with the numerical error", "screen 1"):
        assert f"taken from the earlier run: {stage} (" in again.stderr
    assert {path: path.stat().st_mtime_ns for path in before} == before
    told = json.loads((out / "diagnosis.json").read_text())
    assert told["terms"][0]["id"] == "stiffness-defect@rod"
    ledger = case.with_suffix(".ledger.jsonl").read_text().splitlines()
    assert len(ledger) == told["heldout_openings"]

    whole = rn.diagnose(
        rn.load_case(case), [rn.read_recording(p) for p in paths[:2]], hold_out=[rn.read_recording(paths[2])],
        candidates=TRIED, noise=1e-3, workers=0,
    )  # fmt: skip
    assert told["repaired"] == json.loads(json.dumps(whole.to_dict()["repaired"]))
