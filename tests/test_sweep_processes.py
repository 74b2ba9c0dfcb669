"""Sweeps on processes and clusters: killed, interrupted, restarted, without a guard, from the command line."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import time
import warnings
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
import xarray as xr

import rodnet as rn

COMMAND = [sys.executable, "-c", "from rodnet.cli import main; main()", "sweep", "flagellated"]
posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


def cantilever(load=1.0, edges=6):
    """A clamped rod with a load at its tip, [mN]."""
    if load < 0.0:
        raise ValueError(f"load = {load} pulls the wrong way")
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=edges, material=rn.Material(E=1e6), radius=2e-3)
    force = rn.PointForce(at="arm.end", force=(0, 0, -1e-3 * load))
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), force, rn.Clamp(at="arm.start")]
    )


def sag(traj):
    return {"sag": -traj.x[-1, -1, 2], "process": os.getpid()}


def killer(load=1.0):
    """Dies of load = 3, as if it had no memory left."""
    if load == 3.0:
        os.kill(os.getpid(), signal.SIGKILL)
    return cantilever(load)


def rest(robot):
    return rn.equilibrium(robot)


# -- executors --------------------------------------------------------------------------------
def test_on_a_cluster_of_two_workers(tmp_path):
    """The points go through dask's scheduler to two processes, and give what this process gives."""
    with warnings.catch_warnings():
        # what dask imports and opens is its own affair
        warnings.simplefilter("ignore")
        distributed = pytest.importorskip("distributed")
        loads = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, -1.0]
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=tmp_path / "dask"
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            processes = set(client.run(os.getpid).values())
            executor = client.get_executor()
            there = rn.sweep(
                cantilever, {"load": loads}, sag, executor, simulate=rest, out=tmp_path / "sweep.nc"
            )
            assert client.submit(pow, 2, 3).result() == 8  # it is still at work: the sweep left it alone
    here = rn.sweep(cantilever, {"load": loads}, sag, simulate=rest, workers=0)
    assert np.array_equal(here.sag, there.sag, equal_nan=True) and np.array_equal(here.error, there.error)
    assert set(there.process.values[:-1]) <= processes and len(processes) == 2
    with xr.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as kept:
        assert kept.equals(there)


@posix
def test_a_robot_that_kills_its_process_does_not_stop_the_others():
    loads = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    found = rn.sweep(killer, {"load": loads}, sag, simulate=rest, workers=2)
    assert found.state.values.tolist() == ["failed" if load == 3.0 else "done" for load in loads]
    assert "its process died" in found.error.sel(load=3.0).item()


@posix
def test_a_process_that_is_killed_by_another_one_is_replaced(tmp_path):
    """Its robot is computed again, and nothing is lost."""

    def build(load, mark=tmp_path / "killed"):
        if load == 2.0 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return cantilever(load)

    found = rn.sweep(build, {"load": [1.0, 2.0, 3.0]}, sag, simulate=rest, workers=1)
    assert (found.state == "done").all() and len(set(found.process.values)) == 2


@posix
def test_an_executor_that_breaks_loses_nothing_that_was_computed(tmp_path):
    """It says what to do; without that executor the same sweep comes to its end."""
    out, loads = tmp_path / "s.nc", [1.0, 2.0, 3.0, 4.0]
    with (
        ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool,
        pytest.raises(rn.SweepError, match=r"BrokenProcessPool.*Without executor="),
    ):
        rn.sweep(killer, {"load": loads}, sag, pool, simulate=rest, out=out)
    with xr.open_dataset(out, engine="h5netcdf") as found:
        assert found.state.values.tolist() == ["missing", "missing", "missing", "done"]
    seen = []
    found = rn.sweep(killer, {"load": loads}, sag, simulate=rest, out=out, workers=1, progress=seen.append)
    assert found.state.values.tolist() == ["done", "done", "failed", "done"] and len(seen) == 3


def test_processes_have_one_thread_each():
    def threads(traj):
        from threadpoolctl import threadpool_info

        return {"most": max(pool["num_threads"] for pool in threadpool_info()), "process": os.getpid()}

    found = rn.sweep(cantilever, {"load": [0.1, 0.2]}, threads, simulate=rest, workers=1)
    assert (found.most == 1).all() and os.getpid() not in found.process.values


def test_what_cannot_be_sent_is_named():
    import threading

    lock = threading.Lock()
    with pytest.raises(rn.ParameterError, match=r"cannot be sent to other processes.*lock"):
        rn.sweep(lambda load: lock and cantilever(load), {"load": [0.1]}, sag, simulate=rest)


# -- scripts ----------------------------------------------------------------------------------
SCRIPT = """
    import sys, time
    from pathlib import Path
    import rodnet as rn

    def build(load):
        with Path("built.txt").open("a") as file:
            file.write(f"{load}\\n")
        fig = rn.StickFigure()
        fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=6, material=rn.Material(E=1e6), radius=2e-3)
        force = rn.PointForce(at="arm.end", force=(0, 0, -1e-3 * load))
        terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), force, rn.Clamp(at="arm.start")]
        return rn.Robot(fig.build(), terms)

    def simulate(robot):
        while Path("hold").exists() and len(Path("built.txt").read_text().split()) > 6:
            time.sleep(0.05)
        return rn.equilibrium(robot)

    def main():
        loads = [0.1 * k for k in range(1, 13)]
        found = rn.sweep(
            build, {"load": loads}, lambda traj: {"sag": -traj.x[-1, -1, 2]}, simulate=simulate,
            out="sweep.nc", workers=2, progress=True,
        )
        sys.exit(130 if found.attrs["status"] == "interrupted" else 0)
"""
GUARDED = textwrap.dedent(SCRIPT) + 'if __name__ == "__main__":\n    main()\n'


def begun(folder, lines):
    """Start the script, and return its process when its journal has so many results."""
    (folder / "study.py").write_text(GUARDED)
    (folder / "hold").touch()
    process = subprocess.Popen(
        [sys.executable, "study.py"],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        # a shell starts background jobs with SIGINT ignored, and children inherit that
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    journal, deadline = folder / "sweep.nc.jsonl", time.monotonic() + 120
    while not (journal.exists() and journal.read_bytes().count(b"\n") > lines):
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()
        time.sleep(0.01)
    return process


def theory(found):
    """Sag of a slender cantilever under a small load, without the mesh's error [m]."""
    return 1e-3 * found["load"] * 0.1**3 / (3.0 * 1e6 * np.pi * (2e-3) ** 4 / 4.0)


@posix
def test_killed_and_called_again_it_computes_only_what_is_missing(tmp_path):
    process = begun(tmp_path, 4)
    process.send_signal(signal.SIGKILL)  # the first process only: the others must see to themselves
    process.communicate(timeout=60)
    lines = (tmp_path / "sweep.nc.jsonl").read_bytes()
    time.sleep(1.0)
    assert (tmp_path / "sweep.nc.jsonl").read_bytes() == lines
    built = (tmp_path / "built.txt").read_text().split()
    time.sleep(1.0)
    assert (tmp_path / "built.txt").read_text().split() == built  # no process is left that goes on
    kept = [json.loads(line)["parameters"]["load"] for line in lines.splitlines()[1:] if line.endswith(b"}")]
    assert 4 <= len(kept) < 12
    (tmp_path / "sweep.nc.jsonl").write_bytes(lines + b'{"key": "half a li')  # what a power cut leaves
    (tmp_path / "hold").unlink()
    subprocess.run([sys.executable, "study.py"], cwd=tmp_path, check=True)
    again = [float(load) for load in (tmp_path / "built.txt").read_text().split()[len(built) :]]
    assert sorted(again) == [0.1 * k for k in range(1, 13) if 0.1 * k not in kept]
    with xr.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as found:
        assert found.attrs["status"] == "finished" and (found.state == "done").all()
        assert np.abs(found.sag[:3] / theory(found)[:3] - 1.0).max() < 0.02
    for line in (tmp_path / "sweep.nc.jsonl").read_bytes().splitlines():
        json.loads(line)


@posix
def test_interrupted_it_says_so_and_leaves_a_dataset(tmp_path):
    process = begun(tmp_path, 3)
    second = subprocess.run([sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True)
    process.send_signal(signal.SIGINT)
    assert second.returncode == 1 and "another sweep is under way" in second.stderr
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in err and "interrupted" in err
    with xr.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as found:
        assert found.attrs["status"] == "interrupted"
        done = found.where(found.state == "done", drop=True)
        assert 3 <= done.sizes["load"] < 12 and (found.state.values == "missing").any()
        assert np.isfinite(done.sag).all()
    (tmp_path / "hold").unlink()
    again = subprocess.run([sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True)
    assert again.returncode == 0 and "12 of 12 robots" in again.stderr


def test_a_script_needs_no_guard(tmp_path):
    """Processes do not import the script: it runs once, with its lambda, its globals and its class."""
    text = """
        import rodnet as rn

        print("runs")
        EDGES = 4

        class Load:
            def __init__(self, size):
                self.force = (0, 0, -1e-3 * size)

        def build(load):
            fig = rn.StickFigure()
            fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=EDGES, material=rn.Material(E=1e6), radius=2e-3)
            force = rn.PointForce(at="arm.end", force=Load(load).force)
            terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), force, rn.Clamp(at="arm.start")]
            return rn.Robot(fig.build(), terms)

        found = rn.sweep(build, {"load": [0.1, 0.2]}, lambda traj: traj.x[-1, -1, 2],
                         simulate=lambda robot: rn.equilibrium(robot))
        assert (found.value < 0).all() and not found.error.any()
        assert __file__.endswith("study.py")
    """
    (tmp_path / "study.py").write_text(textwrap.dedent(text))
    result = subprocess.run([sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (0, "runs\n"), result.stderr


# -- the command ------------------------------------------------------------------------------
def call(*options, cwd):
    return subprocess.run([*COMMAND, *options], cwd=cwd, capture_output=True, text=True)


def test_the_command(tmp_path):
    """Ranges and lists, a table or JSON; nothing is computed twice."""
    options = ["--set", "n_tails=2,3", "--set", "rpm=100:200:2", "--set", "edges=6", "--duration", "8"]
    options += ["--out", "s.nc", "--workers", "1"]
    first = call(*options, "--json", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    result = json.loads(first.stdout.splitlines()[-1])
    assert (result["status"], result["failed"], result["missing"]) == ("finished", 0, 0)
    assert [(r["n_tails"], r["rpm"]) for r in result["results"]] == [(2, 100), (2, 200), (3, 100), (3, 200)]
    speeds = [r["speed_mm_s"] for r in result["results"]]
    assert speeds[1] > speeds[0] > 0 and speeds[3] > speeds[2] > 0
    sim = rn.Simulation(rn.robots.flagellated(3, 100, edges=6), 0.01)
    metrics = rn.robots.flagellated_metrics(sim.run(8.0, save_every=5))
    assert speeds[2] == 1e3 * metrics.speed
    again = call(*options, "--json", cwd=tmp_path)
    assert json.loads(again.stdout.splitlines()[-1]) == result
    table = call(*options, cwd=tmp_path).stdout
    assert all(word in table for word in ("speed [mm/s]", "head_rpm [rpm]", "written: s.nc"))
    other = call(*options, "--dt", "0.02", cwd=tmp_path)
    assert other.returncode == 2 and "another sweep" in other.stderr
    assert "dt was 0.01 and is now 0.02" in other.stderr


def test_the_command_with_samples_and_failures(tmp_path):
    (tmp_path / "designs.csv").write_text("rpm, drag.viscosity\n50, 6.8\n100, 9\n100, -1\n")
    options = ["--samples", "designs.csv", "--set", "edges=6", "--duration", "3", "--workers", "0"]
    result = call(*options, "--save", "runs", "--json", cwd=tmp_path)
    assert result.returncode == 3 and "1 of 3 failed, first: ParameterError" in result.stderr
    found = json.loads(result.stdout.splitlines()[-1])
    assert [r["state"] for r in found["results"]] == ["done", "done", "failed"]
    robot = rn.robots.flagellated(2, 100, edges=6).with_parameters({"drag.viscosity": 9.0})
    kept = rn.Trajectory.load(found["results"][1]["trajectory"], robot)
    assert np.array_equal(kept.x[-1], rn.Simulation(robot, 0.01).run(3.0).x[-1])
    assert (tmp_path / "runs/flagellated-sweep.nc").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--set", "legs=2"], "takes no 'legs'; did you mean 'edges'? it takes n_tails"),
        (["--set", "drag.viscosty=2"], "no parameter 'drag.viscosty'; did you mean 'drag.viscosity'"),
        (["--set", "rpm=1:2:x"], "FROM:TO:COUNT"),
        (["--set", "rpm=1,,2"], "empty value"),
        (["--set", "rpm"], "NAME=VALUES"),
        (["--set", "rpm=1", "--set", "rpm=2"], "given twice"),
        ([], "the grid is empty"),
        (["--samples", "none.csv"], "cannot read the samples"),
        (["--set", "rpm=1,2", "--samples", "none.csv"], "rpm has several values"),
        (["--set", "rpm=1", "--duration", "-1"], "duration = -1.0"),
        (["--set", "rpm=1", "--stepper", "rk4"], "known are"),
    ],
)
def test_the_command_names_bad_input(options, message, tmp_path, capsys, monkeypatch):
    from rodnet import cli

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["rodnet", "sweep", "flagellated", *options, "--json"])
    with pytest.raises(SystemExit) as leaving:
        cli.main()
    assert leaving.value.code == 2
    out, err = capsys.readouterr()
    assert message in err and json.loads(out.splitlines()[-1])["exit_code"] == 2
    assert not list(tmp_path.iterdir())
