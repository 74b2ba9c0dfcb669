"""What has been computed stays: files are replaced whole, and what is of another run keeps apart."""

from __future__ import annotations

import json

import numpy as np
import pytest

import rodnet as rn
from rodnet import runs
from rodnet.storage import TrajectoryFile, read


def robot(*terms):
    return rn.Robot(
        rn.robots.flagellated(2, edges=4).graph, [*rn.robots.flagellated(2, edges=4).terms, *terms]
    )


@pytest.fixture
def traj(tmp_path):
    return rn.Simulation(robot(), 0.01).run(0.05, out=tmp_path / "run.nc")


@pytest.mark.parametrize("name", ["run.nc", "copy.nc"])
def test_what_was_loaded_is_saved_again(traj, tmp_path, name):
    again = rn.Trajectory.load(tmp_path / "run.nc", robot())
    back = rn.Trajectory.load(again.save(tmp_path / name), robot())
    np.testing.assert_array_equal(back.x, traj.x)
    assert back.energies.keys() == traj.energies.keys() and back.status == "finished"


def test_what_cannot_be_saved_takes_nothing_away(traj, tmp_path):
    again = rn.Trajectory.load(tmp_path / "run.nc", robot())
    again.header["odd"] = {1, 2}
    with pytest.raises(TypeError):
        again.save(tmp_path / "run.nc")
    np.testing.assert_array_equal(rn.Trajectory.load(tmp_path / "run.nc").x, traj.x)
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]


def test_of_a_run_that_goes_on_nothing_is_known_until_its_end(traj, tmp_path):
    """Its energies are not zero."""
    header, arrays = read(tmp_path / "run.nc")
    frames = {k: v[-1:] for k, v in arrays.items() if ":" not in k and v.shape[:1] == (len(arrays["time"]),)}
    file = TrajectoryFile(tmp_path / "run.nc", header, append=True)
    file.append(frames)
    file.close()
    _, arrays = read(tmp_path / "run.nc")
    energy = next(v for k, v in arrays.items() if k.startswith("energies:"))
    assert np.isnan(energy[-1]) and np.isfinite(energy[:-1]).all()


@pytest.mark.parametrize(
    "other",
    [robot(rn.Gravity(name="more")), rn.robots.flagellated(2, edges=5), rn.robots.flagellated(3, edges=4)],
)
def test_a_trajectory_is_not_another_robots(traj, tmp_path, other):
    with pytest.raises(rn.OutputError, match="not the same robot"):
        rn.Trajectory.load(tmp_path / "run.nc", other)


def test_a_refined_robot_is_not_written():
    """Its selectors go by another mesh: a file would be of another robot."""
    with pytest.raises(rn.RobotFileError, match="as it was drawn"):
        robot().refined().save("nowhere.toml")


def test_sweeps_keep_their_trajectories_apart(tmp_path):
    """In one folder, and where a journal has the numbers already."""

    def make(rpm):
        return rn.robots.flagellated(2, rpm=rpm, edges=4)

    def sweep(dt, out):
        return rn.sweep(
            make, {"rpm": [50.0]}, lambda t: {"x": float(t.x[-1, 0, 0])}, duration=0.05, dt=dt, out=tmp_path / out,
            save=tmp_path / "all", workers=0,
        )  # fmt: skip

    places = [str(sweep(dt, out)["trajectory"].values[0]) for dt, out in ((0.01, "a.nc"), (0.005, "b.nc"))]
    assert places[0] != places[1]
    steps = [rn.Trajectory.load(p).dt for p in places]
    assert steps == [0.01, 0.005]


def test_an_interrupted_run_that_had_got_as_far_is_finished(tmp_path):
    spec = runs.RunSpec("flagellated", {"n_tails": 2, "edges": 4}, duration=0.1, dt=0.01)
    first = runs.execute(spec, tmp_path, progress=False)
    first.trajectory.status = "interrupted"
    first.trajectory.save(tmp_path / "run.nc")
    again = runs.execute(spec, tmp_path, resume=True, progress=False)
    assert again.trajectory.status == "finished" == rn.Trajectory.load(tmp_path / "run.nc").status
    assert json.loads((tmp_path / "summary.json").read_text())["status"] == "finished"


def test_each_earlier_run_keeps_its_file_and_nothing_of_it_stands_beside_the_new_one(tmp_path):
    spec = runs.RunSpec("flagellated", {"n_tails": 2, "edges": 4}, duration=0.05, dt=0.01)
    for _ in range(3):
        runs.execute(spec, tmp_path, progress=False)
    assert {p.name for p in tmp_path.glob("*.nc")} == {"run.nc", "run.previous.nc", "run.previous-2.nc"}


def test_metrics_that_fail_cost_no_run(tmp_path, monkeypatch):
    def broken(trajectory):
        raise ZeroDivisionError("no turns")

    monkeypatch.setattr(runs, "flagellated_metrics", broken)
    spec = runs.RunSpec("flagellated", {"n_tails": 2, "edges": 4}, duration=0.05, dt=0.01)
    found = runs.execute(spec, tmp_path, progress=False)
    assert found.summary["status"] == "finished" and "no turns" in found.summary["note"]
    assert (tmp_path / "shapes.png").exists()
