"""Sweeps: right results, failures recorded, nothing computed twice, nothing mixed."""

from __future__ import annotations

import json
from collections import namedtuple
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import rodnet as rn
from tests.sweep_robots import EI, cantilever, here, rest, sag


# -- results ----------------------------------------------------------------------------------
def test_a_grid_is_laid_out_by_its_parameters():
    found = here({"load": [0.1, 0.2], "E": np.array([1e6, 2e6])}, units={"sag": "m", "load": "mN"}, workers=2)
    assert found["sag"].dims == ("load", "E") and found["tip"].dims == ("load", "E", "tip_0")
    theory = 1e-3 * found["load"] * 0.1**3 / (3.0 * EI * found["E"] / 1e6)
    assert np.abs(found.sag / theory - 1.0).max() < 1e-2
    assert float(found.sag.sel(load=0.1, E=1e6)) == -rest(cantilever(0.1)).at("arm.end")[-1, 2]
    assert (found.sag.attrs["units"], found["load"].attrs["units"]) == ("m", "mN")
    assert found.attrs["status"] == "finished" and (found.state == "done").all()
    assert not found.error.any() and (found.seconds > 0).all()


def test_samples_are_rows_whatever_holds_them():
    import pandas as pd

    rows = [{"load": 0.1, "edges": 4}, {"load": 0.2, "edges": 8}, {"load": 0.1, "edges": 8}]
    columns = {"load": (0.1, 0.2, 0.1), "edges": np.array([4, 8, 8])}
    found = here(rows)
    assert found.sag.dims == ("sample",) and found.edges.dims == ("sample",)
    assert found.edges.values.tolist() == [4, 8, 8]
    assert float(found.sag[1]) == -rest(cantilever(0.2, 8)).at("arm.end")[-1, 2]
    for same in (here(None, samples=rows), here(None, samples=columns), here(pd.DataFrame(columns))):
        assert same.drop_vars("seconds").equals(found.drop_vars("seconds"))
    seen = []
    twice = here([rows[0], rows[1], rows[0]], progress=seen.append)
    assert twice.sag[0] == twice.sag[2] == found.sag[0] and len(seen) == 2


def test_parameter_paths_and_values_that_are_the_same_everywhere():
    found = here({"arm.E": [1e6, 2e6], "load": 0.1})
    assert found.sag.dims == ("arm.E",) and float(found["load"]) == 0.1
    assert found["arm.E"].attrs["units"] == "Pa"
    assert np.array_equal(found.sag, here({"E": [1e6, 2e6], "load": 0.1}).sag)
    alone = here({"arm.E": 2e6, "load": 0.1})
    assert alone.sag.dims == () and alone.sag == found.sag[1]


def test_a_run_is_that_of_the_simulation_with_these_options():
    samples = [{"load": 0.1, "edges": 4}, {"load": 0.2, "edges": 8}]
    options = {"duration": 0.05, "dt": 5e-3, "options": {"stepper": "sdirk2"}}
    found = rn.sweep(cantilever, samples, sag, ThreadPoolExecutor(2), **options)
    sim = rn.Simulation(cantilever(0.2, 8), 5e-3, stepper="sdirk2")
    assert float(found.sag[1]) == -sim.run(0.05, save_every=5).at("arm.end")[-1, 2]
    made = rn.sweep(
        lambda load, edges: rn.Simulation(cantilever(load, edges), 5e-3, stepper="sdirk2"),
        samples,
        sag,
        duration=0.05,
        workers=0,
    )
    assert np.array_equal(made.sag, found.sag)


def test_a_stop_that_remembers_starts_afresh_at_every_point():
    class After:
        def __init__(self, steps):
            self.left = steps

        def __call__(self, state):
            self.left -= 1
            return self.left == 0

    found = here(
        {"load": [0.1, 0.2, 0.3]}, lambda traj: {"t": traj.t[-1]}, duration=1.0, dt=0.01, stop=After(7)
    )
    assert found.t.values == pytest.approx([0.07] * 3)


@dataclass
class Measured:
    sag: float = field(metadata={"unit": "m"})
    below: bool
    frames: int


def test_metrics_of_every_kind_keep_their_kind():
    def measure(traj):
        return Measured(float(-traj.x[-1, -1, 2]), bool(traj.x[-1, -1, 2] < -4e-3), len(traj))

    found = here({"load": [0.1, 0.2]}, measure)
    assert (found.sag.attrs["units"], found.below.dtype, found.frames.dtype.kind) == ("m", bool, "i")
    pair = namedtuple("pair", "first second")
    both = here({"load": [0.1]}, lambda traj: pair(np.float32(1.5), None))
    assert float(both["first"][0]) == 1.5 and np.isnan(both["second"][0])
    assert float(here({"load": [0.1]}, lambda traj: 3.0)["value"][0]) == 3.0
    failed = here({"load": [0.1, -1.0]}, measure)
    assert failed.below.values.tolist() == [0.0, pytest.approx(np.nan, nan_ok=True)]


def test_trajectories_are_kept_on_request(tmp_path):
    found = here({"load": [0.1, 0.2]}, duration=0.05, save=tmp_path / "runs", out=tmp_path / "sweep.nc")
    for load in (0.1, 0.2):
        point = found.sel(load=load)
        kept = rn.Trajectory.load(point.trajectory.item(), cantilever(load))
        assert -kept.at("arm.end")[-1, 2] == float(point.sag)


def test_installed_robots_have_metrics_of_their_own():
    found = rn.sweep("flagellated", {"rpm": [100.0], "edges": 4}, duration=2.0, workers=0)
    sim = rn.Simulation(rn.robots.flagellated(rpm=100.0, edges=4), 0.01)
    metrics = rn.robots.flagellated_metrics(sim.run(2.0, save_every=5))
    assert float(found.speed[0]) == metrics.speed and not bool(found.converged[0])
    assert found.speed.attrs["units"] == "m/s"


# -- failures ---------------------------------------------------------------------------------
def test_what_fails_is_recorded_and_the_rest_goes_on(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = rn.sweep(
        lambda rpm, E: rn.robots.flagellated(2, rpm, edges=6, E=E),
        {"rpm": [0.0, 100.0], "E": [1.2e6, 1.0, -1.0]},
        rn.robots.flagellated_metrics,
        duration=2.5,
        out="out/sweep.nc",
        save="out/runs",
        workers=0,
    )
    assert found.state.values.tolist() == [["failed", "failed", "failed"], ["done", "failed", "failed"]]
    assert np.isfinite(found.speed.values).tolist() == [[False] * 3, [True, False, False]]
    # a motor that stands still is an error of the metrics, after the run
    standing, soft, negative = (
        found.isel(rpm=0, E=0),
        found.sel(rpm=100.0, E=1.0),
        found.sel(rpm=100.0, E=-1.0),
    )
    assert "needs a motor that turns" in standing.error.item() and standing.error_time == 2.5
    # a step that fails: at its time, and with what was computed before
    assert "failed even at dt" in soft.error.item() and 0.0 < soft.error_time < 2.5
    kept = rn.Trajectory.load(soft.trajectory.item())
    assert kept.t[-1] == soft.error_time
    debug = Path(soft.trajectory.item()).with_suffix(".debug.rrd")
    assert debug.exists() and str(debug) in soft.error.item()
    # a robot that cannot be built: before any time
    assert negative.error.item().startswith("GraphError") and np.isnan(negative.error_time)
    with xr.open_dataset("out/sweep.nc", engine="h5netcdf") as file:
        assert file.equals(found)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_failures_leave_nothing_behind_unless_trajectories_are_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = rn.sweep("flagellated", {"E": [1.0]}, duration=5.0, workers=0)
    assert "failed even at dt" in found.error.item() and ".rrd" not in found.error.item()
    assert not list(tmp_path.iterdir())


def test_failures_are_run_again_on_request(tmp_path):
    licence = tmp_path / "licence"

    def build(load, licence=licence):
        if not licence.exists():
            raise OSError("no licence for today")
        return cantilever(load)

    for retry, failed in ((False, True), (False, True), (True, False), (False, False)):
        found = here({"load": [0.1]}, build=build, out=tmp_path / "sweep.nc", retry=retry)
        assert (found.state.item() == "failed") is failed
        licence.touch()


# -- the journal ------------------------------------------------------------------------------
def test_a_larger_grid_computes_what_is_new(tmp_path):
    log = tmp_path / "built.txt"

    def build(load, log=log):
        with log.open("a") as file:
            file.write(f"{load}\n")
        return cantilever(load)

    out = tmp_path / "sweep.nc"
    for loads, known in (([0.1, 0.2], []), ([0.1, 0.2, 0.3], [0.1, 0.2]), ([0.3, 0.1], [0.1, 0.2, 0.3])):
        log.write_text("")
        seen = []
        found = here({"load": loads}, build=build, out=out, progress=seen.append)
        assert found["load"].values.tolist() == loads and np.isfinite(found.sag).all()
        assert set(map(float, log.read_text().split())) == set(loads) - set(known)
        assert len(seen) == len(set(loads) - set(known))
        assert all(p.done == len(known) + k and p.total == len(loads) for k, p in enumerate(seen, 1))
        assert not seen or (seen[-1].left == 0.0 and seen[-1].elapsed > 0.0 and seen[-1].failed == 0)


def test_an_estimate_of_the_time_left_counts_what_is_computed_now(tmp_path):
    here({"load": [0.1, 0.2]}, out=tmp_path / "sweep.nc")
    seen = []
    here({"load": [0.1, 0.2, 0.3, 0.4, 0.5]}, out=tmp_path / "sweep.nc", progress=seen.append)
    assert [p.computed for p in seen] == [1, 2, 3]
    assert all(p.left == pytest.approx(p.elapsed / p.computed * (5 - p.done)) for p in seen)
    assert "3 of 5 robots" in str(seen[0]) and "left" in str(seen[0])


SCALE = 1.0


def scaled(load):
    return cantilever(SCALE * load)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"build": lambda load: cantilever(2.0 * load)}, "build was .*scaled and is now .*lambda"),
        ({"metrics": lambda traj: {"sag": 0.0}}, "metrics was .*sag and is now"),
        ({"simulate": None, "duration": 0.1}, "simulate was .*rest and is now None"),
    ],
)
def test_another_sweep_is_not_mixed_in(changes, message, tmp_path):
    out = tmp_path / "sweep.nc"
    arguments = {"build": scaled, "grid": {"load": [0.1]}, "metrics": sag, "simulate": rest, "out": out}
    rn.sweep(**arguments, workers=0)
    before = out.read_bytes(), (tmp_path / "sweep.nc.jsonl").read_bytes()
    with pytest.raises(rn.OutputError, match=f"another sweep.*{message}.*Choose another file"):
        rn.sweep(**{**arguments, **changes}, workers=0)
    assert (out.read_bytes(), (tmp_path / "sweep.nc.jsonl").read_bytes()) == before


def test_a_value_that_a_function_uses_is_part_of_it(tmp_path, monkeypatch):
    here({"load": [0.1]}, build=scaled, out=tmp_path / "sweep.nc")
    monkeypatch.setitem(globals(), "SCALE", 2.0)
    with pytest.raises(rn.OutputError, match=r"the code or the values of build \(.*scaled\) have changed"):
        here({"load": [0.1]}, build=scaled, out=tmp_path / "sweep.nc")


def test_a_torn_line_is_computed_again_and_a_damaged_one_named(tmp_path):
    out, journal = tmp_path / "sweep.nc", tmp_path / "sweep.nc.jsonl"
    whole = here({"load": [0.1, 0.2, 0.3]}, out=out)
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:3]) + lines[3][:25])
    seen = []
    again = here({"load": [0.1, 0.2, 0.3]}, out=out, progress=seen.append)
    assert len(seen) == 1 and np.array_equal(again.sag, whole.sag)
    assert all(json.loads(line) for line in journal.read_bytes().splitlines())
    journal.write_bytes(lines[0] + lines[1][:25] + b"\n" + lines[2])
    with pytest.raises(rn.OutputError, match=r"line 2 of .* is damaged; delete that line"):
        here({"load": [0.1, 0.2, 0.3]}, out=out)
    journal.write_bytes(lines[0][:12])  # killed while it began
    assert np.array_equal(here({"load": [0.1, 0.2, 0.3]}, out=out).sag, whole.sag)


def test_files_of_something_else_are_left_alone(tmp_path):
    out = tmp_path / "run.nc"
    rn.Simulation(cantilever(0.1), 0.01).run(0.05, out=out)
    with pytest.raises(rn.OutputError, match="exists and has no journal"):
        here({"load": [0.1]}, out=out)
    (tmp_path / "other.nc.jsonl").write_text("my notes\n")
    with pytest.raises(rn.OutputError, match="not the journal of a sweep"):
        here({"load": [0.1]}, out=tmp_path / "other.nc")
    assert (tmp_path / "other.nc.jsonl").read_text() == "my notes\n"
    with pytest.raises(rn.OutputError, match="cannot write"):
        here({"load": [0.1]}, out=tmp_path / "run.nc" / "below.nc")


# -- parameters that are neither numbers nor words ------------------------------------------------
def straight(s):
    return 0.0 * s


def bent(s):
    return 0.1 * s


def shaped(shape, load=0.1):
    """A cantilever drawn along a function, or heights."""
    x = np.linspace(0.0, 0.1, 7)
    z = shape(x) if callable(shape) else np.zeros(7) if shape is None else shape
    fig = rn.StickFigure()
    fig.rod("arm", np.stack([x, 0.0 * x, z], axis=1), material=rn.Material(E=1e6), radius=2e-3)
    force = rn.PointForce(at="arm.end", force=(0, 0, -1e-3 * load))
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), force, rn.Clamp(at="arm.start")]
    )


def test_functions_and_mixed_values_are_labelled_by_name(tmp_path):
    """By the name of a function, also of a lambda in a process; None among others is a value like them."""
    out = tmp_path / "s.nc"
    found = here({"shape": [straight, bent, None, lambda s: 0.2 * s]}, build=shaped, workers=1, out=out)
    assert found["shape"].values.tolist() == ["straight", "bent", "None", "<lambda>"]
    assert found.sag.sel(shape="straight") == found.sag.sel(shape="None") > found.sag.sel(shape="bent")
    seen = []
    here({"shape": [bent, lambda s: 0.2 * s, lambda s: 0.3 * s]}, build=shaped, out=out, progress=seen.append)
    assert len(seen) == 1  # the lambda that is new
    with xr.open_dataset(out, engine="h5netcdf") as kept:
        assert kept["shape"].values.tolist() == ["bent", "<lambda> 1", "<lambda> 2"]


def test_arrays_that_look_alike_are_different_parameters(tmp_path):
    """Also if only one entry differs; equal ones are run once, and the values are in the dataset."""
    flat = np.zeros(7)
    up, down = flat.copy(), flat.copy()
    up[-1], down[3] = 1e-3, -1e-3
    rows, seen = [flat, up, down, flat.copy()], []
    for _ in range(2):
        found = here([{"shape": s} for s in rows], build=shaped, out=tmp_path / "s.nc", progress=seen.append)
    assert len(seen) == 3 and len(set(found.sag.values)) == 3 and found.sag[0] == found.sag[3]
    assert np.array_equal(found["shape_values"], rows) and found["shape_values"].dims == ("sample", "shape_0")
    grid = here({"shape": rows[:3], "load": [0.1, 0.2]}, build=shaped, out=tmp_path / "s.nc")
    assert grid.sag.dims == ("shape", "load") and np.array_equal(grid["shape_values"], rows[:3])
    assert np.array_equal(grid.sag.sel(load=0.1), found.sag[:3])


def test_one_journal_takes_one_sweep_at_a_time(tmp_path):
    """Also within one process: a sweep that a robot of another one starts."""
    out = tmp_path / "s.nc"
    within = here({"load": [0.1]}, lambda traj: here({"load": [0.2]}, out=out) and 1.0, out=out)
    assert "another sweep is under way" in within.error.item()
    here({"load": [0.1]}, lambda traj: 1.0, out=tmp_path / "t.nc")  # and it is free afterwards
    here({"load": [0.1]}, lambda traj: 1.0, out=tmp_path / "t.nc")
