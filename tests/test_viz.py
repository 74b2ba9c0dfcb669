"""Pictures: what is written can be read back, and looking does not change what is looked at."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rodnet as rn


@pytest.fixture(scope="module")
def traj() -> rn.Trajectory:
    return rn.Simulation(rn.robots.flagellated(2, 100.0, edges=8), dt=1e-2).run(1.0, save_every=5)


def chunks(path: Path) -> dict[str, list]:
    import rerun as rr

    reader = rr.chunk.RrdReader(path)
    found: dict[str, list] = {}
    for chunk in reader.stream(store=reader.recordings()[0]):
        found.setdefault(chunk.entity_path, []).append(chunk)
    return found


def strips(chunk_list: list, nodes: int) -> np.ndarray:
    """Positions (T, nodes, 3) of a polyline entity."""
    for chunk in chunk_list:
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.endswith("LineStrips3D:strips") and not chunk.is_static:
                values = batch.column(name).flatten().flatten().flatten().to_numpy()
                return values.reshape(-1, nodes, 3)
    raise AssertionError("no strips in this entity")


def verified(path: Path) -> bool:
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    return subprocess.run(command, capture_output=True, timeout=120).returncode == 0


def test_rerun_holds_the_trajectory(traj, tmp_path):
    path = rn.viz.log_rerun(traj, tmp_path / "run.rrd")
    assert verified(path)
    found = chunks(path)
    rod = traj.rods["tail1"]
    positions = strips(found["/robot/rods/tail1"], len(rod.nodes))
    assert np.array_equal(positions, traj.x[:, rod.nodes].astype(np.float32))
    for entity in ("/robot/rigid/head", "/robot/drag", "/energies/bending", "/powers/motor", "/about"):
        assert entity in found


def test_a_trajectory_without_its_robot_is_shown_too(traj, tmp_path):
    loaded = rn.Trajectory.load(traj.save(tmp_path / "run.nc"))
    found = chunks(rn.viz.log_rerun(loaded, tmp_path / "run.rrd"))
    assert "/robot/rods/tail0" in found and "/energies/bending" in found
    assert "/robot/drag" not in found


def test_debug_leaves_the_simulation_alone(tmp_path):
    looked, alone = (rn.Simulation(rn.robots.flagellated(2, 100.0, edges=8), dt=1e-2) for _ in range(2))
    looked.run(0.2)
    alone.run(0.2)
    path = rn.viz.debug(looked, tmp_path / "debug.rrd")
    looked.step()
    alone.step()
    for name in ("q", "v", "directors", "tau"):
        assert np.array_equal(getattr(looked.state, name), getattr(alone.state, name))
    assert verified(path)
    found = chunks(path)
    for entity in ("directors/m1", "springs", "residual", "rods/tail0"):
        assert f"/robot/{entity}" in found
    assert "/residual_by_dof" in found


def test_a_failed_step_writes_its_debug_recording(tmp_path):
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (1, 0, 0)], edges=8, material=rn.Material(E=1e6), radius=0.01)
    broken = rn.PointForce(at="arm.end", force=lambda t: np.full(3, np.nan if t > 0.05 else 0.0))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm.start"), broken]
    sim = rn.Simulation(rn.Robot(fig.build(), terms), dt=1e-2)
    with pytest.raises(rn.ConvergenceError, match=r"arm:8.*run\.debug\.rrd") as caught:
        sim.run(0.2, out=tmp_path / "run.nc")
    assert caught.value.debug_path == str(tmp_path / "run.debug.rrd")
    assert verified(Path(caught.value.debug_path))
    found = chunks(Path(caught.value.debug_path))
    assert "/robot/prescribed" in found and any(e.startswith("/robot/walls") for e in found)


def shades(path: Path) -> int:
    from matplotlib.image import imread

    return len(np.unique(imread(path)[..., :3].reshape(-1, 3).round(2), axis=0))


def test_figures_show_something(traj, tmp_path):
    assert shades(rn.viz.plot_shapes(traj, tmp_path / "shapes.png")) > 50
    assert shades(rn.viz.plot_position(traj, tmp_path / "position.png")) > 20
    markers = traj.x[:, traj.rods["tail0"].nodes]
    edges = np.stack([np.arange(8), np.arange(1, 9)], axis=1)
    path = rn.viz.plot_comparison(
        tmp_path / "cmp.png", traj.t, markers, markers + 1e-3, edges, title="one mm off"
    )
    assert shades(path) > 50
    path = rn.viz.log_comparison(tmp_path / "cmp.rrd", traj.t, markers, markers + 1e-3, edges, traj)
    assert verified(path) and "/distance/marker03" in chunks(path)


def test_an_unwritable_picture_is_refused(traj, tmp_path):
    with pytest.raises(rn.OutputError, match="directory"):
        rn.viz.plot_shapes(traj, tmp_path)
