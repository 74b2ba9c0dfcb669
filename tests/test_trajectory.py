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

    with pytest.raises(rn.OutputError, match=r"nothing\.nc"):
        rn.Trajectory.load(tmp_path / "nothing.nc")
    text = tmp_path / "text.nc"
    text.write_text("not a trajectory")
    with pytest.raises(rn.OutputError, match=r"text\.nc"):
        rn.Trajectory.load(text)
    xr.Dataset({"a": ("x", np.arange(3.0))}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(rn.OutputError, match="not a rodnet trajectory"):
        rn.Trajectory.load(tmp_path / "other.nc")
    path = traj.save(tmp_path / "run.nc")
    cut = tmp_path / "cut.nc"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    with pytest.raises(rn.OutputError, match=r"cut\.nc"):
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
