"""Pictures: what is written can be read back, and looking does not change what is looked at."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import rodnet as rn
from rodnet.viz import scenes
from rodnet.viz.rerun_log import si


@pytest.fixture(scope="module")
def traj() -> rn.Trajectory:
    return rn.Simulation(rn.robots.flagellated(2, 100.0, edges=8), dt=1e-2).run(1.0, save_every=5)


def arm(*terms: rn.Term) -> rn.Robot:
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (1, 0, 0)], edges=8, material=rn.Material(E=1e6), radius=0.01)
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), *terms])


# -- reading back ---------------------------------------------------------------------------
def store(path: Path):
    import rerun as rr

    reader = rr.chunk.RrdReader(path)
    (recording,) = reader.recordings()
    return reader, recording


def chunks(path: Path) -> dict[str, list]:
    reader, recording = store(path)
    found: dict[str, list] = {}
    for chunk in reader.stream(store=recording):
        found.setdefault(chunk.entity_path, []).append(chunk)
    return found


def column(chunk_list: list, name: str, static: bool = False) -> list[np.ndarray]:
    """Rows of a component, one flat array per frame."""
    rows: list[np.ndarray] = []
    for chunk in chunk_list:
        batch = chunk.to_record_batch()
        if chunk.is_static is static and name in batch.schema.names:
            for row in batch.column(name):
                values = row.values
                while hasattr(values, "flatten") and values.type.num_fields:
                    values = values.flatten()
                rows.append(np.asarray(values))
    assert rows, f"no {name} in this entity"
    return rows


def strips(chunk_list: list, nodes: int) -> np.ndarray:
    """Positions (T, nodes, 3) of a polyline entity."""
    return np.concatenate(column(chunk_list, "LineStrips3D:strips")).reshape(-1, nodes, 3)


def text(path: Path) -> str:
    batch = next(c for c in chunks(path)["/about"] if c.is_static).to_record_batch()
    return batch.column("TextDocument:text")[0].as_py()[0]


def verified(path: Path) -> bool:
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    return subprocess.run(command, capture_output=True, timeout=120).returncode == 0


# -- trajectories ---------------------------------------------------------------------------
def test_rerun_holds_the_trajectory(traj, tmp_path):
    path = rn.viz.log_rerun(traj, tmp_path / "run.rrd")
    assert verified(path)
    found = chunks(path)
    for name, kind in (("tail1", "rods"), ("head", "rigid")):
        rod = traj.rods[name]
        positions = strips(found[f"/robot/{kind}/{name}"], len(rod.nodes))
        assert np.array_equal(positions, traj.x[:, rod.nodes].astype(np.float32))
    bending = np.concatenate(column(found["/energies/bending"], "Scalars:scalars"))
    assert np.array_equal(bending, traj.energies["bending"])
    for entity in ("robot/joints", "robot/forces/drag", "powers/motor", "about"):
        assert f"/{entity}" in found
    assert any(entity.startswith("/robot/trails/tail0") for entity in found)
    moving = next(c for c in found["/robot/rods/tail1"] if not c.is_static)
    assert set(moving.timeline_names) >= {"time", "step"}
    t = np.asarray(moving.to_record_batch().column("time")).astype("timedelta64[ns]").astype(float) * 1e-9
    assert np.allclose(t, traj.t, rtol=0.0, atol=1e-8)
    assert "tail0.E, tail1.E" in text(path) and "euler" in text(path)


def test_long_trajectories_are_thinned(traj, tmp_path, monkeypatch):
    frames = lambda path: len(strips(chunks(path)["/robot/rods/tail0"], 9))  # noqa: E731
    assert frames(rn.viz.log_rerun(traj, tmp_path / "all.rrd")) == len(traj)
    assert frames(rn.viz.log_rerun(traj, tmp_path / "some.rrd", every=4)) == -(-len(traj) // 4)
    monkeypatch.setattr(scenes, "FRAMES", 7)
    assert frames(rn.viz.log_rerun(traj, tmp_path / "few.rrd")) == 7
    with pytest.raises(rn.ParameterError, match="every"):
        rn.viz.log_rerun(traj, tmp_path / "no.rrd", every=0)


def test_a_trajectory_without_its_robot_is_shown_too(traj, tmp_path):
    loaded = rn.Trajectory.load(traj.save(tmp_path / "run.nc"))
    found = chunks(rn.viz.log_rerun(loaded, tmp_path / "run.rrd"))
    assert "/robot/rods/tail0" in found and "/energies/bending" in found
    assert "/robot/forces/drag" not in found
    bare = {name: values for name, values in traj._arrays.items() if ":" not in name}
    found = chunks(rn.viz.log_rerun(rn.Trajectory(bare, traj.header), tmp_path / "bare.rrd"))
    assert "/robot/rods/tail0" in found and not any(e.startswith("/energies") for e in found)


def test_the_eye_follows_a_robot_that_travels_far(traj):
    assert scenes._opening(scenes._scenes(traj, None))[1] is None
    away = np.linspace(0.0, 10.0, len(traj))[:, None, None] * np.array([1.0, 0.0, 0.0])
    arrays = {**traj._arrays, "position": traj.x + away}
    shape, follow = scenes._opening(scenes._scenes(rn.Trajectory(arrays, traj.header), None))
    assert follow == "/robot/rigid/head" and np.ptp(shape[:, 0]) < 1.0


def test_recordings_of_one_name_do_not_merge(traj, tmp_path):
    paths = [rn.viz.log_rerun(traj, tmp_path / folder / "run.rrd", every=10) for folder in "ab"]
    assert len({store(path)[1].recording_id for path in paths}) == 2


def test_spawn_opens_the_viewer_on_the_file(traj, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(subprocess, "Popen", lambda command, **kw: calls.append(command))
    path = rn.viz.log_rerun(traj, tmp_path / "run.rrd", spawn=True)
    assert calls == [[sys.executable, "-m", "rerun", str(path)]]


# -- steps ----------------------------------------------------------------------------------
@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_debug_leaves_the_simulation_alone(tmp_path, stepper):
    def make() -> rn.Simulation:
        wave = rn.CurvatureWave("arm", amplitude=3.3, wavelength=0.7, frequency=1.7)
        robot = arm(
            rn.Clamp(at="arm.start"),
            wave,
            rn.Motor(at="arm:4", rpm=30.0),
            rn.ResistiveForce(eta_t=1, eta_n=2),
        )
        return rn.Simulation(robot, dt=1e-2, stepper=stepper)

    looked, alone = make(), make()
    looked.run(0.2)
    alone.run(0.2)
    before = looked.state
    counts = looked.newton.iterations, looked.newton.evaluations, looked.model.solver.factorizations
    path = rn.viz.debug(looked, tmp_path / "debug.rrd")
    assert looked.state is before
    assert counts == (
        looked.newton.iterations,
        looked.newton.evaluations,
        looked.model.solver.factorizations,
    )
    for _ in range(5):
        for field in fields(looked.state):
            mine, other = getattr(looked.state, field.name), getattr(alone.state, field.name)
            if field.name == "memories":
                assert all((a is b) or np.array_equal(a, b) for a, b in zip(mine, other, strict=True))
            else:
                assert np.array_equal(mine, other), field.name
        looked.step()
        alone.step()
    assert verified(path)


def test_debug_shows_the_step(tmp_path):
    sim = rn.Simulation(rn.robots.flagellated(2, 100.0, edges=8), dt=1e-2)
    sim.run(0.2)
    path = rn.viz.debug(sim, tmp_path / "debug.rrd")
    found = chunks(path)
    parts = ("directors/m1", "directors/m2", "directors/t", "springs", "natural", "before")
    for entity in (*parts, "residual/forces", "residual/moments", "rods/tail0"):
        assert f"/robot/{entity}" in found
    shown = strips(found["/robot/rods/tail0"], 9)
    residual = np.concatenate(column(found["/residual/forces"], "Scalars:scalars"))
    assert len(shown) == len(residual) >= 2 and residual[-1] < -8.0 < residual[0]
    assert sum(c.num_rows for c in found["/residual_by_dof"] if not c.is_static) == len(residual)
    sim.step()
    last = sim.state.q.reshape(-1)[: sim.model.twist0].reshape(-1, 3)[sim.model.graph.rods["tail0"].nodes]
    assert np.array_equal(shown[-1], last.astype(np.float32))
    # directors are unit vectors of the edges' frames, drawn to 0.4 of the edges
    t = column(found["/robot/directors/t"], "Arrows3D:vectors")[0].reshape(-1, 3)
    assert np.allclose(np.linalg.norm(t, axis=1), 0.4 * sim.model.rest_length, rtol=1e-5)


def test_debug_marks_what_is_held(tmp_path):
    sim = rn.Simulation(arm(rn.Clamp(at="arm.start"), rn.Hinge(at="arm.end"), rn.Gravity()), dt=1e-2)
    found = chunks(rn.viz.debug(sim, tmp_path / "debug.rrd"))
    held = column(found["/robot/prescribed"], "Points3D:positions")[0].reshape(-1, 3)
    assert np.array_equal(held, sim.model.x0[[0, 8]].astype(np.float32))
    assert "/robot/walls" in found


def test_debug_finds_a_place_for_its_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = rn.viz.debug(rn.Simulation(arm(rn.Gravity()), dt=1e-2))
    assert path.parent == tmp_path and path.name.startswith("rodnet-debug-") and verified(path)
    monkeypatch.setattr("rodnet.viz.debug_step.os.access", lambda *_: False)
    path = rn.viz.debug(rn.Simulation(arm(rn.Gravity()), dt=1e-2))
    assert path.parent != tmp_path and verified(path)
    path.unlink()


def test_a_failed_step_writes_its_debug_recording(tmp_path):
    broken = rn.PointForce(at="arm.end", force=lambda t: np.full(3, np.nan if t > 0.05 else 0.0))
    sim = rn.Simulation(arm(rn.Clamp(at="arm.start"), broken), dt=1e-2)
    with pytest.raises(rn.ConvergenceError, match=r"arm:8.*run\.debug\.rrd") as caught:
        sim.run(0.2, out=tmp_path / "run.nc")
    assert caught.value.debug_path == str(tmp_path / "run.debug.rrd")
    path = Path(caught.value.debug_path)
    assert verified(path)
    found = chunks(path)
    assert "/robot/prescribed" in found and "/robot/walls" in found
    culprit = column(found["/robot/not_finite"], "Points3D:positions")[0].reshape(-1, 3)
    assert np.allclose(culprit, [[1.0, 0.0, 0.0]], atol=1e-6)
    assert "the force on x of arm:8" in text(path)


def test_a_failed_step_is_shown_at_the_length_that_step_size_control_chose(tmp_path):
    sim = rn.Simulation(arm(rn.Gravity()), dt=1e-3, stepper="sdirk2", adaptive=3e-2)
    sim.run(0.05)
    sim.newton.tolerance = rn.Tolerance(residual=1e-30, update=1e-30)
    start, end = sim.t, sim.t + sim.next_dt
    assert sim.next_dt != sim.dt
    with pytest.raises(rn.ConvergenceError, match="failed even at dt = 1e-07 s"):
        sim.run(0.05, out=tmp_path / "run.nc")
    assert f"t = {start:g} s to {end:g} s in one step" in text(tmp_path / "run.debug.rrd")


def test_a_folding_step_writes_its_debug_recording(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # without a file of its own, the recording goes here
    blow = rn.PointForce(at="arm:4", force=lambda t: np.array([0.0, 0.0, -3e9 * (t > 0.05)]))
    sim = rn.Simulation(arm(rn.Clamp(at="arm.start"), rn.Hinge(at="arm.end"), blow), dt=1e-2)
    with pytest.raises(rn.FoldedStateError) as caught:
        for _ in sim.iterate(0.2):
            pass
    path = Path(caught.value.debug_path)
    assert str(path) in str(caught.value) and path.parent == tmp_path
    assert verified(path)
    assert "172 degrees at arm:4" in text(path) and "| folded |" in text(path)
    assert len(strips(chunks(path)["/robot/rods/arm"], 9)) > 5


def test_a_guess_that_is_folded_already_is_shown(tmp_path):
    sim = rn.Simulation(arm(rn.Gravity()), dt=1e-2)
    q, v = sim.state.q.copy(), sim.state.v.copy()
    v[3:24:3] = 100.0 * np.arange(7.0)  # within one step, the nodes pass each other
    sim.restore(type(sim.state)(**{**vars(sim.state), "q": q, "v": -v}))
    path = rn.viz.debug(sim, tmp_path / "debug.rrd")
    assert verified(path) and "no forces at the first guess" in text(path)


# -- comparisons ----------------------------------------------------------------------------
@pytest.fixture
def recording(traj):
    markers = traj.x[:, traj.rods["tail0"].nodes].copy()
    edges = np.stack([np.arange(8), np.arange(1, 9)], axis=1)
    markers[3:6, 4] = np.nan  # a lost marker
    return traj.t, markers, markers + np.array([0.0, 0.0, 1e-3]), edges


def test_a_comparison_shows_both_and_their_distance(traj, recording, tmp_path):
    t, measured, predicted, edges = recording
    path = rn.viz.log_comparison(tmp_path / "cmp.rrd", t, measured, predicted, edges, traj)
    assert verified(path)
    found = chunks(path)
    distance = np.concatenate(column(found["/distance/marker03"], "Scalars:scalars"))
    assert np.allclose(distance, 1.0, atol=1e-9)
    assert np.allclose(np.concatenate(column(found["/distance/mean"], "Scalars:scalars")), 1.0, atol=1e-9)
    counts = [len(row) // 3 for row in column(found["/robot/measured/markers"], "Points3D:positions")]
    assert counts == [8 if 3 <= k < 6 else 9 for k in range(len(t))]
    assert len(strips(found["/robot/rods/tail0"], 9)) == len(t)
    assert "/robot/measured/lines" in found and "/robot/predicted/lines" not in found
    alone = chunks(rn.viz.log_comparison(tmp_path / "alone.rrd", t, measured, predicted, edges))
    assert "/robot/predicted/lines" in alone


def test_a_comparison_that_does_not_fit_is_refused(recording, tmp_path):
    t, measured, predicted, edges = recording
    for draw in (rn.viz.log_comparison, rn.viz.plot_comparison):
        with pytest.raises(rn.ParameterError, match="measured and predicted"):
            draw(tmp_path / "no", t, measured, predicted[:, 1:], edges)
        with pytest.raises(rn.ParameterError, match="beyond 0 to 8"):
            draw(tmp_path / "no", t, measured, predicted, edges + 1)
        with pytest.raises(rn.ParameterError, match="no marker"):
            draw(tmp_path / "no", t, measured, np.full_like(predicted, np.nan), edges)


# -- figures --------------------------------------------------------------------------------
def pixels(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return imread(path)[..., :3]


def drawn(path: Path) -> bool:
    """Whether a figure has a decent size, ink and several colours."""
    image = pixels(path)
    shades = len(np.unique(image.reshape(-1, 3).round(2), axis=0))
    return min(image.shape[:2]) > 400 and float(image.var()) > 1e-3 and shades > 20


def test_figures_show_something(traj, recording, tmp_path):
    assert drawn(rn.viz.plot_shapes(traj, tmp_path / "shapes.png"))
    assert drawn(rn.viz.plot_shapes(traj, tmp_path / "two.png", times=[0.0, 0.5]))
    assert drawn(rn.viz.plot_position(traj, tmp_path / "position.png"))
    path = rn.viz.plot_comparison(tmp_path / "cmp.png", *recording, title="one mm off", free=[2, 3, 4])
    assert drawn(path)


def test_the_figure_states_the_speed_of_what_travels_only():
    import matplotlib.figure

    from rodnet.viz.plots import _position_axes

    def labels(velocity, swing):
        t = np.linspace(0.0, 10.0, 101)
        x = np.array([[0.0, 0, 0], [1, 0, 0]]) + np.zeros((101, 1, 1))
        x[..., 0] += velocity * t[:, None]
        x[..., 2] += swing * np.sin(2.0 * t)[:, None]
        rods = [{"name": "a", "kind": "rod", "nodes": [0, 1], "edges": [0], "radius": [0.01]}]
        header = {"graph": {"edges": [[0, 1]], "rods": rods}, "dt": 0.1}
        zero = np.zeros((101, 1))
        arrays = {"time": t, "position": x, "velocity": 0 * x, "twist": zero, "twist_rate": zero}
        ax = matplotlib.figure.Figure().subplots()
        _position_axes(ax, rn.Trajectory(arrays, header))
        return " ".join(text.get_text() for text in ax.get_legend().get_texts())

    assert "2 mm/s" in labels(2e-3, 0.0)
    assert "mm/s" not in labels(0.0, 0.1)
    assert "mm/s" not in labels(0.0, 0.0)


def test_shapes_of_any_extent_are_drawn(traj, tmp_path):
    straight = np.zeros_like(traj.x)
    straight[..., 2] = np.linspace(0.0, 1.0, traj.x.shape[1])
    away = traj.x + np.linspace(0.0, 10.0, len(traj))[:, None, None]
    for name, x in (("straight", straight), ("away", away)):
        odd = rn.Trajectory({**traj._arrays, "position": x}, traj.header)
        assert drawn(rn.viz.plot_shapes(odd, tmp_path / f"{name}.png"))


# -- files and imports ----------------------------------------------------------------------
def test_an_unwritable_picture_is_refused(traj, recording, tmp_path):
    sim = rn.Simulation(arm(rn.Gravity()), dt=1e-2)
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "run.rrd"):
        for write in (
            lambda p: rn.viz.log_rerun(traj, p),
            lambda p: rn.viz.debug(sim, p),
            lambda p: rn.viz.log_comparison(p, *recording),
            lambda p: rn.viz.plot_shapes(traj, p),
            lambda p: rn.viz.plot_position(traj, p),
            lambda p: rn.viz.plot_comparison(p, *recording),
        ):
            with pytest.raises(rn.OutputError, match="directory"):
                write(path)


def test_values_get_prefixes():
    assert si(2.6e-4, "N") == "0.26 mN" and si(1.3e-4, "N") == "130 µN"
    assert si(0.0123, "N") == "12.3 mN"
    assert si(0.01, "m") == "10 mm" and si(1.0, "m") == "1 m"
    assert si(2.5e4, "N") == "25 kN" and si(0.0, "N") == "0 N"


def test_heavy_libraries_load_on_first_use():
    code = "import sys, rodnet; rodnet.viz.debug; print('rerun' in sys.modules, 'matplotlib' in sys.modules)"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert out.stdout.split() == ["False", "False"]
