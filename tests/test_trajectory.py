"""Trajectories: round trips, units, chunks, and files that are not what they should be."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn


@pytest.fixture(scope="module")
def robot() -> rn.Robot:
    return rn.robots.flagellated(2, 120.0, edges=5)


@pytest.fixture(scope="module")
def traj(robot) -> rn.Trajectory:
    return rn.Simulation(robot, dt=1e-2).run(0.5, save_every=3)


def test_save_and_load_are_exact(robot, traj, tmp_path):
    loaded = rn.Trajectory.load(traj.save(tmp_path / "run.nc"), robot)
    for name in ("t", "x", "v", "theta", "w", "directors", "edges"):
        assert np.array_equal(getattr(loaded, name), getattr(traj, name))
    for name, energy in traj.energies.items():
        assert np.array_equal(loaded.energies[name], energy)
    assert loaded.stats == traj.stats and loaded.status == "finished"
    assert np.array_equal(traj.t, [*np.arange(0, 49, 3) * 0.01, 0.5])


def test_any_netcdf_reader_sees_it(robot, traj, tmp_path):
    import xarray as xr

    with xr.open_dataset(traj.save(tmp_path / "run.nc")) as file:
        assert np.array_equal(file["position"].values, traj.x)
        assert file["position"].attrs["units"] == "m"
        assert file["twist"].dims == ("time", "edge")


def test_xarray_view_has_units_and_terms(traj):
    data = traj.to_xarray()
    assert data["position"].dims == ("time", "node", "axis")
    units = {name: data[name].attrs["units"] for name in ("position", "velocity", "twist", "energy", "power")}
    assert units == {"position": "m", "velocity": "m/s", "twist": "rad", "energy": "J", "power": "W"}
    bending = data["energy"].sel(energy_term="bending").values
    assert np.array_equal(bending, traj.energies["bending"])
    assert set(data["rod"].values) == {"head", "disc0", "disc1", "tail0", "tail1"}


def test_without_its_robot_it_still_shows_shapes_and_energies(traj, tmp_path):
    loaded = rn.Trajectory.load(traj.save(tmp_path / "run.nc"))
    assert np.array_equal(loaded.powers["motor"], traj.powers["motor"])
    assert list(loaded.rods) == list(traj.rods)
    with pytest.raises(rn.OutputError, match="robot"):
        _ = loaded.internal


def test_stations_are_interpolated(traj):
    nodes = traj.rods["tail0"].nodes
    middle = 0.5 * (traj.x[:, nodes[2]] + traj.x[:, nodes[3]])
    assert np.allclose(traj.at("tail0@50%"), middle, rtol=0, atol=1e-15)


def test_files_of_other_kinds_are_refused(robot, traj, tmp_path):
    import xarray as xr

    with pytest.raises(rn.OutputError, match=r"nothing\.nc': there is no such file$"):
        rn.Trajectory.load(tmp_path / "nothing.nc")
    text = tmp_path / "text.nc"
    text.write_text("not a trajectory")
    with pytest.raises(rn.OutputError, match=r"text\.nc': it is not a NetCDF-4 file$"):
        rn.Trajectory.load(text)
    xr.Dataset({"a": ("x", np.arange(3.0))}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(rn.OutputError, match="not a rodnet trajectory"):
        rn.Trajectory.load(tmp_path / "other.nc")
    path = traj.save(tmp_path / "run.nc")
    cut = tmp_path / "cut.nc"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    with pytest.raises(rn.OutputError, match=r"cut\.nc': it is cut off or damaged$"):
        rn.Trajectory.load(cut)
    with pytest.raises(rn.OutputError, match="not the same robot"):
        rn.Trajectory.load(path, rn.robots.flagellated(3, 120.0, edges=5))


def test_internal_forces_balance_at_every_node(robot, traj):
    """What flows in along the edges, drag and inertia sum to zero at every node."""
    graph, k = robot.graph, -1
    t = traj.x[k, traj.edges[:, 1]] - traj.x[k, traj.edges[:, 0]]
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    flow = traj.internal.tension[k, :, None] * t + traj.internal.shear[k]
    total = np.zeros_like(graph.x0)
    np.add.at(total, traj.edges[:, 0], flow)
    np.add.at(total, traj.edges[:, 1], -flow)
    total += traj.term_forces("drag")[k] + traj.term_forces("head")[k]
    state = traj.state(k)
    inertia = graph.node_mass[:, None] * state.a[: 3 * graph.node_count].reshape(-1, 3)
    assert np.abs(total - inertia).max() < 1e-8 * np.abs(flow).max()


def test_forces_of_chosen_states(traj):
    whole = traj.term_forces("drag")
    assert whole.shape == traj.x.shape
    for frames in (-1, [5, 2], slice(1, 9, 3), traj.t > 0.3):
        assert np.array_equal(traj.term_forces("drag", frames), whole[frames])
    with pytest.raises(rn.ParameterError, match="no term is named 'gravity'"):
        traj.term_forces("gravity")


def events():
    return [rn.Event(lambda s: np.sin(200.0 * s.t + 0.1), "tick")]


def test_a_continued_file_holds_the_whole_run(robot, tmp_path):
    """States, events, statistics and energies of both parts; chunks of any length."""
    whole = rn.Simulation(robot, dt=1e-3).run(0.6, events=events())
    path = tmp_path / "run.nc"
    rn.Simulation(robot, dt=1e-3).run(0.35, out=path, events=events())
    sim = rn.Simulation(robot, dt=1e-3)
    sim.restore(rn.Trajectory.load(path, robot).state())
    returned = sim.run(0.25, out=path, append=True, events=events())
    for part in (returned, rn.Trajectory.load(path, robot)):
        assert np.array_equal(part.x, whole.x) and np.array_equal(part.t, whole.t)
        assert part.events["tick"] == pytest.approx(whole.events["tick"])
        assert part.stats["steps"] == part.stats["substeps"] == 600
        assert part.stats["iterations"] == whole.stats["iterations"]
        for name, values in whole.energies.items():
            assert np.array_equal(part.energies[name], values)
    bare = rn.Trajectory.load(path)
    assert np.array_equal(bare.energies["bending"], whole.energies["bending"])


@pytest.mark.parametrize("other", ["robot", "dt", "stepper", "place"])
def test_another_run_cannot_be_appended_and_harms_nothing(robot, tmp_path, other):
    path = tmp_path / "run.nc"
    rn.Simulation(robot, dt=1e-2).run(0.1, out=path)
    before = path.read_bytes()
    options = {"dt": 5e-3 if other == "dt" else 1e-2, "stepper": "sdirk2" if other == "stepper" else "euler"}
    sim = rn.Simulation(rn.robots.flagellated(2, 120.0, edges=6) if other == "robot" else robot, **options)
    sim.run(0.05 if other in ("dt", "place") else 0.1)
    with pytest.raises(rn.OutputError, match=r"cannot continue .*run\.nc"):
        sim.run(0.1, out=path, append=True)
    assert path.read_bytes() == before


def test_a_killed_run_leaves_what_was_written(tmp_path):
    """No chance to clean up: the chunks that were written are there."""
    import os
    import subprocess
    import sys
    from pathlib import Path

    code = f"""
import os, rodnet as rn
robot = rn.robots.flagellated(2, 120.0, edges=4)
stop = lambda s: os._exit(9) if s.t > 0.6 else False
rn.Simulation(robot, dt=1e-3).run(1.0, out={str(tmp_path / "run.nc")!r}, stop=stop)
"""
    root = Path(rn.__file__).parents[1]
    env = {**os.environ, "PYTHONPATH": str(root)}
    assert subprocess.run([sys.executable, "-c", code], env=env, check=False).returncode == 9
    kept = rn.Trajectory.load(tmp_path / "run.nc", rn.robots.flagellated(2, 120.0, edges=4))
    assert kept.status == "unfinished"
    assert len(kept) >= 512 and kept.t == pytest.approx(1e-3 * np.arange(len(kept)), abs=1e-12)
    sim = rn.Simulation(kept.robot, dt=1e-3)
    sim.restore(kept.state())
    assert sim.step().ok


@pytest.mark.parametrize("written", [0, 1, 5, 12])
def test_a_file_whose_run_was_killed_at_its_beginning_is_cut_off(traj, tmp_path, written):
    """Only the first variables are there."""
    from rodnet.storage import TrajectoryFile

    names = [name for name in traj._arrays if ":" not in name]
    file = TrajectoryFile(tmp_path / "run.nc", traj.header, append=False)
    file.append({name: traj._arrays[name][:1] for name in ("time", *names[1:written])})
    file.close()
    with pytest.raises(rn.OutputError, match=r"run\.nc' is cut off: its run was killed"):
        rn.Trajectory.load(tmp_path / "run.nc")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.9999])
def test_a_file_cut_anywhere_is_refused_by_name(traj, tmp_path, share):
    whole = traj.save(tmp_path / "run.nc").read_bytes()
    cut = tmp_path / "cut.nc"
    cut.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(rn.OutputError, match=r"cut\.nc"):
        rn.Trajectory.load(cut)


def test_what_needs_the_robot_says_so(traj, tmp_path):
    loaded = rn.Trajectory.load(traj.save(tmp_path / "run.nc"))
    for ask in (lambda: loaded.reactions, lambda: loaded.at("tail0@50%"), lambda: loaded.term_forces("drag")):
        with pytest.raises(rn.OutputError, match=r"Trajectory\.load\(path, robot\)"):
            ask()
    assert "finished" in repr(loaded) and len(loaded) == len(traj)


def test_whole_turns_survive_in_the_record(robot):
    """Stored angles stay small, what is shown counts every turn."""
    run = rn.Simulation(robot, dt=1e-2).run(3.0, save_every=10)
    head = run.rods["head"].edges[0]
    turned = run.theta[-1, head] - run.theta[3, head]  # after the start
    assert abs(turned) > 4.0 * np.pi
    assert np.abs(np.diff(run.theta[:, head])).max() < 2.0
    k = 3 * robot.graph.node_count
    assert np.abs(run.state().q[k:]).max() <= np.pi
    assert turned == pytest.approx(np.trapezoid(run.w[3:, head], run.t[3:]), rel=1e-2)


def test_a_run_killed_while_it_wrote_keeps_the_frames_before_and_goes_on(tmp_path):
    """Its file says that there are more frames than were written: its end, as its head has it, lies before them."""
    from rodnet.storage import TrajectoryFile

    robot, path = rn.robots.flagellated(2, 100.0, edges=5), tmp_path / "run.nc"
    whole = rn.Simulation(robot, 0.01).run(6.0)
    file, ends = TrajectoryFile(path, {**whole.header, "status": "unfinished"}, append=False), []
    for part in (slice(0, 300), slice(300, None)):
        file.append({name: values[part] for name, values in whole._arrays.items() if ":" not in name})
        ends.append(path.read_bytes()[40:48])  # in the superblock of version 0
    file.close()
    torn = bytearray(path.read_bytes())
    assert torn[8] == 0 and ends[0] != ends[1]
    torn[40:48] = ends[0]
    path.write_bytes(torn)

    kept = rn.Trajectory.load(path, robot)
    assert 0 < len(kept.t) < len(whole.t)
    assert np.array_equal(kept.x, whole.x[: len(kept.t)])
    sim = rn.Simulation(robot, 0.01)
    sim.restore(kept.state())
    sim.run(6.0 - float(kept.t[-1]), out=path, append=True)
    assert np.array_equal(rn.Trajectory.load(path, robot).x, whole.x)
