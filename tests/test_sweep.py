"""Parameter studies: right results on any executor, failures recorded, nothing computed twice."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr

import rodnet as rn

COMMAND = [sys.executable, "-c", "from rodnet.cli import main; main()"]


def cantilever(load=1.0, edges=8, E=1e6):
    """A clamped rod with a load at its tip, [mN]."""
    if load < 0.0:
        raise ValueError(f"load = {load} pulls the wrong way")
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=edges, material=rn.Material(E=E), radius=2e-3)
    force = rn.PointForce(at="arm.end", force=(0, 0, -1e-3 * load))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), force, rn.Clamp(at="arm.start")]
    return rn.Robot(fig.build(), terms)


def sag(traj):
    return {"sag": -traj.at("arm.end")[-1, 2], "tip": traj.at("arm.end")[-1]}


def rest(robot):
    return rn.equilibrium(robot)


def killer(load=1.0):
    """Dies of load = 3, as if it had no memory left."""
    if load == 3.0:
        os.kill(os.getpid(), signal.SIGKILL)
    return cantilever(load)


LICENCES: list[str] = []
PROFILES: list[np.ndarray] = []


def licensed(load):
    """Fails as long as there is no licence."""
    if not LICENCES:
        raise OSError("no licence for today")
    return cantilever(load)


def noted(profile):
    """Takes note of every call."""
    PROFILES.append(profile)
    return profile


EI = 1e6 * np.pi * (2e-3) ** 4 / 4.0


def test_a_grid_is_laid_out_by_its_parameters():
    found = rn.sweep(
        cantilever, {"load": [0.01, 0.02], "E": [1e6, 2e6]}, sag, simulate=rest, workers=2, units={"sag": "m"}
    )
    assert found["sag"].dims == ("load", "E") and found["tip"].dims == ("load", "E", "tip_0")
    theory = 1e-3 * found["load"] * 0.1**3 / (3.0 * EI * found["E"] / 1e6)
    assert np.abs(found.sag / theory - 1.0).max() < 1e-2  # 8 edges
    assert float(found.sag.sel(load=0.01, E=1e6)) == -rest(cantilever(0.01)).at("arm.end")[-1, 2]
    assert found.sag.attrs["units"] == "m" and not found.error.any() and (found.seconds > 0).all()


def test_samples_have_one_dimension_and_a_simulation_runs():
    samples = [{"load": 0.1, "edges": 4}, {"load": 0.2, "edges": 8}]
    found = rn.sweep(
        cantilever, samples, sag, ThreadPoolExecutor(2), duration=0.05, options={"stepper": "sdirk2"}
    )
    assert found.sag.dims == ("sample",) and found.edges.values.tolist() == [4, 8]
    sim = rn.Simulation(cantilever(0.2, 8), 1e-2, stepper="sdirk2")
    assert float(found.sag[1]) == -sim.run(0.05, save_every=5).at("arm.end")[-1, 2]


def test_what_fails_is_recorded_and_the_rest_goes_on(tmp_path):
    out = tmp_path / "sweep.nc"
    found = rn.sweep(cantilever, {"load": [0.1, -1.0, 0.2]}, sag, simulate=rest, out=out, workers=1)
    assert found.error.values.tolist() == ["", "ValueError: load = -1.0 pulls the wrong way", ""]
    assert np.isfinite(found.sag.values).tolist() == [True, False, True]
    with xr.open_dataset(out, engine="h5netcdf") as kept:
        assert kept.equals(found)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_robot_that_kills_its_process_does_not_stop_the_others():
    found = rn.sweep(killer, {"load": [1.0, 2.0, 3.0, 4.0, 5.0]}, sag, simulate=rest, workers=2)
    assert [bool(e) for e in found.error.values] == [False, False, True, False, False]
    assert "killed" in str(found.error.values[2]) and np.isfinite(found.sag.values).sum() == 4


def test_on_a_cluster_of_two_workers():
    """The tasks go through dask's scheduler to two processes, and give what one process gives."""
    distributed = pytest.importorskip("distributed")
    loads = [0.1, 0.2, 0.3, 0.4, -1.0]
    here = rn.sweep(cantilever, {"load": loads}, sag, simulate=rest, workers=1)
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
        client.get_executor(pure=False) as executor,
    ):
        there = rn.sweep(cantilever, {"load": loads}, sag, executor, simulate=rest)
    assert np.array_equal(here.sag, there.sag, equal_nan=True) and np.array_equal(here.error, there.error)


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
        time.sleep(0.2)
        return rn.equilibrium(robot)

    def sag(traj):
        return {"sag": -traj.x[-1, -1, 2]}

    if __name__ == "__main__":
        loads = [0.01 * k for k in range(1, 13)]
        rn.sweep(build, {"load": loads}, sag, simulate=simulate, out="sweep.nc", workers=1)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_killed_and_called_again_it_computes_only_what_is_missing(tmp_path):
    (tmp_path / "study.py").write_text(textwrap.dedent(SCRIPT))
    command = [sys.executable, "study.py"]
    process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True)
    journal, deadline = tmp_path / "sweep.nc.jsonl", time.monotonic() + 60
    while not (journal.exists() and journal.read_bytes().count(b"\n") > 4):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    lines = journal.read_bytes()
    finished = lines.count(b"\n") - 1
    assert 4 <= finished < 12 and not (tmp_path / "sweep.nc").exists()
    journal.write_bytes(lines + b'{"key": "half a li')  # as a crash of the machine leaves it
    before = (tmp_path / "built.txt").read_text().split()
    subprocess.run(command, cwd=tmp_path, check=True)
    after = (tmp_path / "built.txt").read_text().split()
    assert len(after) - len(before) == 12 - finished
    with xr.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as found:
        assert np.abs(found.sag / (1e-3 * found["load"] * 0.1**3 / (3.0 * EI)) - 1.0).max() < 2e-2
    for line in journal.read_bytes().splitlines():
        json.loads(line)


def test_a_larger_grid_goes_on_and_another_robot_is_refused(tmp_path):
    out, built = tmp_path / "sweep.nc", []

    def build(load):
        built.append(load)
        return cantilever(load)

    threads = ThreadPoolExecutor(1)
    for loads in ([0.1, 0.2], [0.1, 0.2, 0.3], [0.3, 0.1]):
        found = rn.sweep(build, {"load": loads}, sag, threads, simulate=rest, out=out)
        assert found["load"].values.tolist() == loads and np.isfinite(found.sag).all()
    with pytest.raises(rn.OutputError, match="another sweep: build, simulate changed"):
        rn.sweep(cantilever, {"load": [0.1]}, sag, threads, duration=0.01, out=out)


def test_failures_are_run_again_on_request(tmp_path):
    threads = ThreadPoolExecutor(1)
    for retry, failed in ((False, True), (False, True), (True, False)):
        found = rn.sweep(
            licensed, {"load": [0.1]}, sag, threads, simulate=rest, out=tmp_path / "s.nc", retry=retry
        )
        assert bool(found.error.values[0]) is failed
        LICENCES.append("for today")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grid": {}}, "nothing to run"),
        ({"grid": {"load": []}}, "no values for 'load'"),
        ({"grid": {"load": [1.0, 1.0]}}, "same value of 'load' twice"),
        ({"grid": {"weight": [1.0]}}, "build takes no 'weight'; it takes load, edges, E"),
        ({"grid": [{"load": 1.0}, {"E": 1.0}]}, "sample 1 has parameters"),
        ({"duration": None}, "duration = None"),
        ({"duration": -1.0}, "duration = -1.0"),
        ({"metrics": "sag"}, "metrics must be a function"),
    ],
)
def test_bad_input_is_refused_before_computing(changes, message):
    arguments = {"build": cantilever, "grid": {"load": [1.0]}, "metrics": sag, "duration": 1.0} | changes
    with pytest.raises(rn.ParameterError, match=message):
        rn.sweep(**arguments)


def test_metrics_that_are_no_numbers_are_named():
    found = rn.sweep(cantilever, {"load": [0.1]}, lambda traj: {"colour": "red"}, simulate=rest, workers=1)
    assert "metrics must return numbers, but 'colour' is 'red'" in str(found.error.values[0])


def test_the_command(tmp_path):
    """Ranges and lists, a table or JSON, exit code 3 if a robot failed, and nothing is computed twice."""
    options = ["--set", "n_tails=2,3", "--set", "rpm=100:200:2", "--set", "edges=6", "--duration", "8"]
    command = [*COMMAND, "sweep", "flagellated", *options, "--out", "s.nc", "--workers", "1", "--json"]
    first = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert first.returncode == 0, first.stderr
    result = json.loads(first.stdout.splitlines()[-1])
    assert [(r["n_tails"], r["rpm"]) for r in result["results"]] == [(2, 100), (2, 200), (3, 100), (3, 200)]
    speeds = [r["speed_mm_s"] for r in result["results"]]
    assert speeds[1] > speeds[0] > 0 and speeds[3] > speeds[2] > 0
    again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert json.loads(again.stdout.splitlines()[-1]) == result
    wrong = [*COMMAND, "sweep", "flagellated", "--set", "rpm=50,0", "--duration", "4", "--out", "t.nc"]
    failed = subprocess.run([*wrong, "--set", "mass=0.035,-1"], cwd=tmp_path, capture_output=True, text=True)
    assert failed.returncode == 3 and "failed" in failed.stderr
    bad = subprocess.run(
        [*COMMAND, "sweep", "flagellated", "--set", "legs=2"], cwd=tmp_path, capture_output=True, text=True
    )
    assert bad.returncode == 2 and "takes no 'legs'" in bad.stderr


# -- what must not be confused ------------------------------------------------------------------
def test_arrays_that_look_alike_are_different_parameters(tmp_path):
    """Also if only one of many entries, or the last digit, differs; equal ones are run once."""
    a = np.zeros(2000)
    b, c = a.copy(), a.copy()
    b[1000], c[0] = 5.0, 1e-12
    for _ in range(2):
        found = rn.sweep(
            noted, [{"profile": p} for p in (a, b, c, a)], np.sum, ThreadPoolExecutor(1), simulate=lambda x: x,
            out=tmp_path / "s.nc",
        )  # fmt: skip
        assert found["value"].values.tolist() == [0.0, 5.0, 1e-12, 0.0]
    assert len(PROFILES) == 3


def test_an_identity_is_the_same_in_every_process_and_differs_with_what_is_held_on_to():
    import functools

    from rodnet.sweeps import Run, identity

    code = (
        "import functools, rodnet as rn; from rodnet.sweeps import Run, identity;"
        "print(identity(Run(1.0, 0.1, 5, {'stepper': rn.SDIRK2()})));"
        "print(identity(functools.partial(rn.robots.flagellated, rpm=50.0)))"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    here = [
        identity(Run(1.0, 0.1, 5, {"stepper": rn.SDIRK2()})),
        identity(functools.partial(rn.robots.flagellated, rpm=50.0)),
    ]
    assert other.splitlines() == here
    assert identity(functools.partial(rn.robots.flagellated, rpm=51.0)) != here[1]
    assert identity(Run(1.0, 0.1, 5, {"stepper": rn.GeneralizedAlpha()})) != here[0]

    def closing_over(values):
        return lambda load: values[load]

    assert identity(closing_over({1: 2.0})) != identity(closing_over({1: 3.0}))
    assert identity(closing_over(np.zeros(3))) == identity(closing_over(np.zeros(3)))


def test_names_of_the_results_are_not_for_parameters_or_metrics():
    threads = ThreadPoolExecutor(1)
    with pytest.raises(rn.ParameterError, match="cannot be named 'error'"):
        rn.sweep(lambda error: error, {"error": [1.0]}, float, threads, simulate=lambda x: x)
    for name in ("error", "k"):
        found = rn.sweep(
            lambda k: k, {"k": [1.0]}, lambda x, name=name: {name: x}, threads, simulate=lambda x: x
        )
        assert f"metrics cannot return '{name}'" in str(found["error"].values[0])
