"""The command line as a user meets it: real processes, short runs."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import rodnet as rn

ROOT = Path(__file__).parents[1]
COMMAND = [str(Path(sys.executable).with_name("rodnet"))]
SHORT = ["run", "flagellated", "--edges", "6", "--no-progress", "--json"]


def rodnet(*arguments, cwd, **environment):
    env = {**os.environ, "COLUMNS": "100", **environment}
    return subprocess.run([*COMMAND, *map(str, arguments)], cwd=cwd, env=env, capture_output=True, text=True)


def last_json(result) -> dict:
    return json.loads(result.stdout.splitlines()[-1])


def same_state(a, b) -> bool:
    arrays = ("q", "v", "a", "acc", "tangents", "directors", "tau", "turns")
    return (
        (a.t, a.index) == (b.t, b.index)
        and all(np.array_equal(getattr(a, n), getattr(b, n)) for n in arrays)
        and all(np.array_equal(x, y) for x, y in zip(a.memories, b.memories, strict=True) if x is not None)
    )


# -- pages ------------------------------------------------------------------------------------
def test_help_names_every_command_and_shows_examples(tmp_path):
    result = rodnet("--help", cwd=tmp_path)
    assert result.returncode == 0
    for word in (
        "run",
        "demo",
        "view",
        "terms",
        "--version",
        "Examples",
        "Exit codes",
        "rodnet run flagellated",
    ):
        assert word in result.stdout


def test_help_is_quick_because_heavy_libraries_wait(tmp_path):
    code = "import sys, rodnet.cli; print(sorted({'numpy','numba','scipy','rerun','matplotlib'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def test_version(tmp_path):
    """The script's, and that of the module."""
    module = subprocess.run(
        [sys.executable, "-m", "rodnet", "--version"], cwd=tmp_path, capture_output=True, text=True
    )
    for told in (rodnet("--version", cwd=tmp_path), module):
        assert told.stdout.strip() == f"rodnet {rn.__version__}"


def test_terms_lists_parameters_units_and_sources(tmp_path):
    page = rodnet("terms", cwd=tmp_path).stdout
    for text in (
        "energy",
        "drag",
        "load",
        "actuator",
        "constraint",
        "viscosity [Pa s]",
        "Gray & Hancock 1955",
        "named drag; takes on, ",
        "named force; takes at, force",
        "named tendon; takes route, schedule",
        "docs, theory",
    ):
        assert text in page
    some = last_json(rodnet("terms", "dry", "friction", "--candidates", "--json", cwd=tmp_path))["terms"]
    assert "dry-friction" in {t["id"] for t in some} and all("friction" in str(t).lower() for t in some)
    nothing = rodnet("terms", "nosuch", cwd=tmp_path)
    assert nothing.returncode == 2 and "no term has nosuch in its id" in nothing.stderr
    found = {t["id"]: t for t in last_json(rodnet("terms", "--json", cwd=tmp_path))["terms"]}
    viscosity = found["resistive-force"]["parameters"][0]
    assert (viscosity["name"], viscosity["unit"], viscosity["bounds"]) == ("viscosity", "Pa s", [0.0, None])
    assert (found["clamp"]["name"], found["clamp"]["arguments"]) == ("clamp", ["at"])
    assert found["motor"]["class"] == "rodnet.terms.actuators.Motor"
    assert all(t["source"] and t["summary"] and t["distribution"] for t in found.values())


# -- run --------------------------------------------------------------------------------------
def test_run_writes_its_results_and_one_line_of_json(tmp_path):
    result = rodnet(*SHORT, "--duration", "8", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    summary = last_json(result)
    keys = {
        "speed_mm_s",
        "head_rpm",
        "tail_rpm",
        "efficiency",
        "newton_iterations_per_step",
        "realtime_factor",
    }
    keys |= {"converged", "factorizations", "fallbacks", "duration", "dt", "versions"}
    assert keys <= set(summary)
    assert summary["head_rpm"] + summary["tail_rpm"] == pytest.approx(100.0, abs=1e-6)
    assert 0.05 < summary["speed_mm_s"] < 0.4
    assert summary["converged"] is False  # the speed still drifts by more than 0.1 %
    assert summary["steps"] == 800
    assert 1.0 <= summary["newton_iterations_per_step"] < 3.0
    assert json.loads((tmp_path / "out/summary.json").read_text()) == summary
    traj = rn.Trajectory.load(tmp_path / "out/run.nc", rn.robots.flagellated(edges=6))
    assert traj.t[-1] == 8.0
    assert rn.robots.flagellated_metrics(traj).speed * 1e3 == pytest.approx(summary["speed_mm_s"])
    assert (tmp_path / "out/run.rrd").read_bytes()[:3] == b"RRF"
    assert (tmp_path / "out/shapes.png").read_bytes()[:4] == b"\x89PNG"


def test_settings_reach_arguments_and_parameters(tmp_path):
    settings = ["--tails", "3", "--set", "drag.viscosity=9", "--set", "L3=0.08", "--set", "tail1.E=2e6"]
    result = rodnet(*SHORT, *settings, "--duration", "0.05", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    summary = last_json(result)
    assert summary["spec"]["drag.viscosity"] == 9
    assert summary["speed_mm_s"] is None  # shorter than two turns of the motor
    assert "two motor turns" in summary["note"]
    robot = rn.robots.flagellated(n_tails=3, edges=6, L3=0.08)
    traj = rn.Trajectory.load(tmp_path / "out/run.nc", robot)
    changed = robot.with_parameters({"drag.viscosity": 9.0, "tail1.E": 2e6})
    assert np.array_equal(rn.Simulation(changed).run(0.05).x[-1], traj.x[-1])


def test_the_table_for_people(tmp_path):
    result = rodnet(*SHORT[:-1], "--duration", "2", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    for text in ("forward speed", "head", "rpm", "steady state", "rodnet view out/run.rrd"):
        assert text in result.stdout
    assert "not steady: 2 motor turns are fewer than the 10" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dt", "-1"], "dt = -1.0 must be a positive time step"),
        (["--dt", "nan"], "dt = nan"),
        (["--duration", "inf"], "duration = inf"),
        (["--tails", "0"], "n_tails = 0 must be a positive integer"),
        (["--rpm", "nan"], "rpm"),
        (["--root", "loose"], "'clamped' or 'rigid', not 'loose'"),
        (["--stepper", "rk4"], "known are euler"),
        (["--save-every", "0"], "save_every"),
        (
            ["--set", "drag.viscosty=1"],
            "no parameter 'drag.viscosty'; did you mean 'drag.viscosity'? there are",
        ),
        (["--set", "drag.viscosity=-1"], "outside its bounds"),
        (["--set", "L3=NaN"], "finite"),
        (["--set", "L3=long"], "L3 = 'long' must be positive"),
        (["--set", "motor.rpm=[1,2]"], "rpm must be one number"),
        (["--set", "head.radius=null"], "head.radius=None"),
        (["--set", "L4=1"], "takes no 'L4'; it takes n_tails"),
        (["--set", "L3"], "NAME=VALUE"),
        (["--out", "taken"], "it is a file; give a directory"),
        (["--out", "taken/below"], "cannot write 'taken/below/run.nc'"),
    ],
)
def test_bad_input_is_named_before_anything_is_computed(arguments, message, tmp_path, capsys, monkeypatch):
    from rodnet import cli, runs

    (tmp_path / "taken").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["rodnet", *SHORT, *arguments])
    monkeypatch.setattr(runs.TimedSimulation, "step", lambda *_: pytest.fail("something was computed"))
    with pytest.raises(SystemExit) as leaving:
        cli.main()
    assert leaving.value.code == 2
    out, err = capsys.readouterr()
    assert message in err
    assert "Traceback" not in err
    assert json.loads(out.splitlines()[-1])["exit_code"] == 2


def test_unknown_robot_and_option(tmp_path):
    result = rodnet("run", "flagelated", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert "did you mean 'flagellated'?" in result.stderr
    assert rodnet("run", "flagellated", "--rmp", "3", cwd=tmp_path).returncode == 2


def test_a_step_that_does_not_converge_leaves_what_came_before(tmp_path):
    result = rodnet(*SHORT, "--set", "E=1", "--duration", "5", "--out", "out", cwd=tmp_path)
    assert result.returncode == 3, result.stderr
    assert "failed even at dt" in result.stderr
    assert "Traceback" not in result.stderr
    summary = last_json(result)
    assert summary["status"] == "failed"
    assert rn.Trajectory.load(tmp_path / "out/run.nc").t[-1] == pytest.approx(summary["t_end"])


# -- interruption -----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that nothing interrupts, and its options."""
    folder = tmp_path_factory.mktemp("whole")
    options = ["--duration", "400", "--save-every", "3"]
    assert rodnet(*SHORT, *options, "--out", "out", cwd=folder).returncode == 0
    return options, rn.Trajectory.load(folder / "out/run.nc", rn.robots.flagellated(edges=6))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_an_interrupted_run_continues_bit_equal(how, whole, tmp_path):
    options, uninterrupted = whole
    command = [*COMMAND, *SHORT, *options, "--out", "out"]
    process = subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell starts background jobs with SIGINT ignored, and children inherit that
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    file, deadline = tmp_path / "out/run.nc", time.monotonic() + 60
    some = 0.05 * uninterrupted.path.stat().st_size  # early: the rest takes seconds
    while not (file.exists() and file.stat().st_size > some):
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()
        time.sleep(0.01)
    process.send_signal(how)
    out, err = process.communicate(timeout=60)
    robot = uninterrupted.robot
    kept = rn.Trajectory.load(file, robot)
    assert 0 < kept.state().index < uninterrupted.state().index
    assert kept.t[-1] == kept.state().index * kept.dt
    same = np.flatnonzero(uninterrupted._arrays["state/index"] <= kept.state().index)[-1]
    assert np.array_equal(kept.x[same], uninterrupted.x[same])
    if how == signal.SIGINT:
        assert process.returncode == 130, err
        assert kept.status == json.loads(out.splitlines()[-1])["status"] == "interrupted"
    result = rodnet(*SHORT, *options, "--out", "out", "--resume", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert last_json(result)["resumed_from"] == pytest.approx(kept.t[-1])
    assert same_state(rn.Trajectory.load(file, robot).state(), uninterrupted.state())


def test_resume_refuses_another_run_and_adds_nothing_to_a_complete_one(tmp_path):
    options = ["--duration", "0.5", "--out", "out"]
    first = rodnet(*SHORT, *options, "--resume", cwd=tmp_path)  # nothing there yet: starts
    assert first.returncode == 0, first.stderr
    other = rodnet(*SHORT, *options, "--resume", "--rpm", "50", cwd=tmp_path)
    assert other.returncode == 2
    assert "rpm was 100.0 and is now 50.0" in other.stderr
    assert "rodnet run flagellated --edges 6 --dt 0.01 --stepper euler --resume" in other.stderr
    default = rodnet(*SHORT, *options, "--resume", "--rpm", "100", cwd=tmp_path)  # in other words, the same
    assert default.returncode == 0, default.stderr
    again = last_json(rodnet(*SHORT, *options, "--resume", cwd=tmp_path))
    assert again["steps"] == 0
    assert again["newton_iterations_per_step"] == last_json(first)["newton_iterations_per_step"]
    (tmp_path / "out/run.nc").write_bytes(b"torn")
    torn = rodnet(*SHORT, *options, "--resume", cwd=tmp_path)
    assert torn.returncode == 2
    assert "without --resume" in torn.stderr


# -- view, demo, README -----------------------------------------------------------------------
def test_steps_that_are_chosen(tmp_path):
    options = ["--stepper", "sdirk2", "--adaptive", "0.03", "--duration", "3.33", "--out", "out"]
    result = rodnet(*SHORT, *options, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    summary = last_json(result)
    traj = rn.Trajectory.load(tmp_path / "out/run.nc", rn.robots.flagellated(edges=6))
    assert traj.t[-1] == summary["t_end"] == 3.33
    assert summary["steps"] == len(traj) - 1 < 100  # every one is kept
    assert np.diff(traj.t).max() > 2.0 * np.diff(traj.t).min()
    assert summary["spec"]["adaptive"] == summary["adaptive"] == 0.03
    again = rodnet(*SHORT, *options, "--resume", cwd=tmp_path)
    assert last_json(again)["steps"] == 0, again.stderr
    fixed = rodnet(*SHORT, "--stepper", "sdirk2", *options[-2:], "--resume", cwd=tmp_path)
    assert fixed.returncode == 2 and "adaptive was 0.03 and is now not set" in fixed.stderr
    (tmp_path / "out/summary.json").unlink()
    fixed = rodnet(*SHORT, "--stepper", "sdirk2", *options[-2:], "--resume", cwd=tmp_path)
    assert fixed.returncode == 2 and "with step size control" in fixed.stderr
    loose = rodnet(*SHORT, "--adaptive", "2", cwd=tmp_path)
    assert loose.returncode == 2 and "tolerance = 2.0 must lie between 0 and 1" in loose.stderr


def test_a_sweep_says_why_there_is_no_number(tmp_path):
    command = ["sweep", "flagellated", "--set", "edges=6", "--set", "rpm=60,240", "--duration", "1.1"]
    result = rodnet(*command, "--workers", "0", "--no-progress", "--out", "s.nc", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "converged" in result.stdout and "nan" in result.stdout
    assert "notes on 2 of 2, first: the run is shorter than two motor turns of 1 s" in result.stderr
    with xr.open_dataset(tmp_path / "s.nc") as found:
        assert np.isnan(found["speed_mm_s"]).values.tolist() == [True, False]
        assert not found["converged"].any()
        assert "4 motor turns are fewer than the 10" in str(found["note"].values[1])


def test_view_says_what_is_wrong(tmp_path):
    missing = rodnet("view", "nothing.rrd", cwd=tmp_path)
    assert missing.returncode == 2
    assert "there is no file 'nothing.rrd'" in missing.stderr
    (tmp_path / "text.rrd").write_text("text")
    assert "not a rerun recording" in rodnet("view", "text.rrd", cwd=tmp_path).stderr
    (tmp_path / "some.rrd").write_bytes(b"RRF2....")
    if sys.platform.startswith("linux"):
        result = rodnet("view", "some.rrd", cwd=tmp_path, DISPLAY="", WAYLAND_DISPLAY="")
        assert result.returncode == 2
        assert "no display" in result.stderr and "--web" in result.stderr


def test_demo_compares_with_the_paper(tmp_path):
    result = rodnet("demo", "--duration", "3", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    for text in ("95.47", "4.53", "0.22", "97.49", "2.51", "0.13", "n/a", "view demo/2_tails/run.rrd"):
        assert text in result.stdout
    for tails in (2, 3):
        names = {p.name for p in (tmp_path / f"demo/{tails}_tails").iterdir()}
        assert names == {"run.nc", "run.rrd", "shapes.png", "position.png", "summary.json"}


def test_the_readme_says_what_is_true(tmp_path, monkeypatch, capsys):
    text = (ROOT / "README.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert sum(1 for line in blocks[0].splitlines() if line.strip()) <= 15
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in blocks:
        exec(block, names)
    metrics = rn.robots.flagellated_metrics(names["traj"])
    assert metrics.speed == pytest.approx(0.2152e-3, rel=5e-3)
    assert (metrics.head_rpm, metrics.tail_rpm) == pytest.approx((95.50, 4.50), abs=0.01)
    assert "form.c" in names["robot"].parameters
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (ROOT / target).exists(), target
