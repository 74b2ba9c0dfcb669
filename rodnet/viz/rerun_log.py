"""Every rerun call of the package: trajectories, comparisons with recordings, single steps.

A recording file holds float32 positions: it is a view, not the record (that is the NetCDF file).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.storage import check_writable

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

SOFT, STIFF, FORCE, MEASURED = (213, 94, 0), (90, 90, 100), (0, 158, 115), (0, 114, 178)
SERIES = [
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (230, 159, 0),
    (86, 180, 233),
    (120, 120, 120),
]
FRAMES = 1500  # at most so many frames by default


class Log:
    """An ``.rrd`` file being written."""

    def __init__(self, path: str | Path, name: str) -> None:
        import rerun as rr

        self.path = check_writable(path)
        self.rr = rr
        self.rec = rr.RecordingStream("rodnet", recording_id=name)
        self.rec.save(str(self.path))
        self.rec.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def blueprint(self, plots: Mapping[str, str], shape: np.ndarray) -> None:
        """Open on a large 3D view that holds ``shape``, shape (n, 3), with time series beside it."""
        import rerun.blueprint as rrb

        series = [rrb.TimeSeriesView(origin=origin, name=name) for name, origin in plots.items()]
        low, high = np.nanmin(shape, axis=0), np.nanmax(shape, axis=0)
        middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
        eye = rrb.EyeControls3D(
            position=middle + 1.5 * size * np.array([0.35, -0.85, 0.4]),
            look_target=middle,
            eye_up=(0.0, 0.0, 1.0),
        )
        left = rrb.Spatial3DView(origin="/", contents=["/robot/**"], name="robot", eye_controls=eye)
        right = rrb.Vertical(*series, rrb.TextDocumentView(origin="/about", name="about"))
        self.rec.send_blueprint(
            rrb.Blueprint(
                rrb.Horizontal(left, right, column_shares=[3, 2]),
                rrb.TimePanel(state="collapsed"),
                collapse_panels=True,
            )
        )

    def about(self, text: str) -> None:
        """Add a description (Markdown)."""
        self.rec.log("about", self.rr.TextDocument(text, media_type="text/markdown"), static=True)

    def times(self, t: np.ndarray, steps: np.ndarray | None = None) -> list[Any]:
        """Time columns of some frames."""
        index = np.arange(len(t)) if steps is None else steps
        return [self.rr.TimeColumn("step", sequence=index), self.rr.TimeColumn("time", duration=t)]

    def strips(self, entity: str, columns: list[Any], lines: np.ndarray, radius: float, color: Any) -> None:
        """One polyline per frame, shape (T, n, 3)."""
        rr = self.rr
        self.rec.log(entity, rr.LineStrips3D.from_fields(radii=radius, colors=[color]), static=True)
        self.rec.send_columns(entity, columns, rr.LineStrips3D.columns(strips=lines.astype(np.float32)))

    def points(self, entity: str, columns: list[Any], x: np.ndarray, radius: float, color: Any) -> None:
        """Points of every frame, shape (T, n, 3)."""
        rr = self.rr
        self.rec.log(entity, rr.Points3D.from_fields(radii=radius, colors=[color]), static=True)
        flat = rr.Points3D.columns(positions=x.reshape(-1, 3).astype(np.float32))
        self.rec.send_columns(entity, columns, flat.partition(np.full(len(x), x.shape[1])))

    def arrows(
        self, entity: str, columns: list[Any], x: np.ndarray, vectors: np.ndarray, color: Any, radius: float
    ) -> None:
        """Arrows of every frame, shapes (T, n, 3)."""
        rr = self.rr
        self.rec.log(entity, rr.Arrows3D.from_fields(colors=[color], radii=radius), static=True)
        flat = rr.Arrows3D.columns(
            origins=x.reshape(-1, 3).astype(np.float32), vectors=vectors.reshape(-1, 3).astype(np.float32)
        )
        self.rec.send_columns(entity, columns, flat.partition(np.full(len(x), x.shape[1])))

    def series(self, entity: str, columns: list[Any], values: np.ndarray, name: str, color: Any) -> None:
        """One scalar per frame."""
        rr = self.rr
        self.rec.log(entity, rr.SeriesLines(names=name, colors=color), static=True)
        self.rec.send_columns(entity, columns, rr.Scalars.columns(scalars=np.asarray(values, dtype=float)))

    def close(self) -> Path:
        """Finish the file."""
        self.rec.flush()
        self.rec.disconnect()
        return self.path


def _log_rods(log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any]) -> None:
    for rod in traj.rods.values():
        stiff = rod.kind == "rigid"
        entity = f"robot/{'rigid' if stiff else 'rods'}/{rod.name}"
        radius = float(np.median(rod.radius)) * (0.35 if stiff and np.median(rod.radius) > 0.01 else 1.0)
        log.strips(entity, columns, traj.x[frames][:, rod.nodes], radius, STIFF if stiff else SOFT)


def log_rerun(traj: Trajectory, path: str | Path, *, every: int | None = None) -> Path:
    """Write a trajectory for the rerun viewer (``rodnet view FILE.rrd``).

    Rods as polylines with their radii, stiff parts in grey, drag forces as arrows, energies and
    powers by term over time, and a layout that opens on all of it.

    Parameters
    ----------
    traj : Trajectory
        What to show.
    path : path
        The ``.rrd`` file.
    every : int, optional
        Show every so many-th state; by default at most 1500.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    log = Log(path, Path(path).stem)
    every = every or max(1, -(-len(traj) // FRAMES))
    frames = np.arange(0, len(traj), every)
    columns = log.times(traj.t[frames], frames)
    _log_rods(log, traj, frames, columns)
    size = float(np.linalg.norm(np.ptp(traj.x[0], axis=0)))
    lines = [
        "# Robot",
        f"{len(traj.rods)} rods, {traj.x.shape[1]} nodes, dt = {traj.dt:g} s, {traj.header['stepper']}.",
        "",
    ]
    if traj.robot is not None:
        drags = [t.name for t in traj.robot.terms if t.kind == "drag"]
        if drags:
            force = np.sum([traj.term_forces(name)[frames] for name in drags], axis=0)
            largest = float(np.quantile(np.linalg.norm(force, axis=2).max(axis=1), 0.95)) or 1.0
            scale = size / 3.0 / largest
            log.arrows("robot/drag", columns, traj.x[frames], force * scale, FORCE, size / 400)
            lines.append(f"Green arrows: drag forces, 1 cm stands for {0.01 / scale:.3g} N.\n")
        lines += ["| parameter | value |", "|---|---|"]
        lines += [f"| {k} | {np.round(p.value, 6)} {p.unit} |" for k, p in traj.robot.parameters.items()]
    plots = {}
    for label, unit in (("energies", "J"), ("powers", "W")):
        try:
            table = getattr(traj, label)
        except OSError:
            continue
        plots[f"{label} [{unit}]"] = f"/{label}"
        for k, (name, values) in enumerate(table.items()):
            log.series(f"{label}/{name}", columns, values[frames], name, SERIES[k % len(SERIES)])
    lines += ["", "Orange: soft rods. Grey: stiff parts."]
    log.about("\n".join(lines))
    log.blueprint(plots, traj.x[[0, -1]].reshape(-1, 3))
    return log.close()


def log_comparison(
    path: str | Path,
    t: np.ndarray,
    measured: np.ndarray,
    predicted: np.ndarray,
    marker_edges: np.ndarray,
    traj: Trajectory | None = None,
) -> Path:
    """Write measured and predicted marker positions together, and their distance over time.

    Parameters
    ----------
    path : path
        The ``.rrd`` file.
    t : ndarray, shape (T,)
        Times [s].
    measured, predicted : ndarray, shape (T, M, 3)
        Marker positions [m].
    marker_edges : ndarray, shape (E, 2)
        Pairs of markers that are joined.
    traj : Trajectory, optional
        The simulation behind the prediction, shown with its rods.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    log = Log(path, Path(path).stem)
    columns = log.times(np.asarray(t, dtype=float))
    size = float(np.linalg.norm(np.nanmax(measured[0], axis=0) - np.nanmin(measured[0], axis=0)))
    for name, values, color in (("measured", measured, MEASURED), ("predicted", predicted, SOFT)):
        log.points(f"robot/{name}/markers", columns, values, size / 120, color)
        for k, (i, j) in enumerate(np.asarray(marker_edges)):
            if name == "measured":
                log.strips(f"robot/{name}/edge{k}", columns, values[:, [i, j]], size / 400, color)
    if traj is not None:
        frames = np.unique(np.searchsorted(traj.t, t).clip(0, len(traj) - 1))
        _log_rods(log, traj, frames, log.times(traj.t[frames]))
    distance = np.linalg.norm(predicted - measured, axis=2) * 1e3
    for m in range(distance.shape[1]):
        log.series(f"distance/marker{m:02d}", columns, distance[:, m], f"marker {m}", SERIES[m % len(SERIES)])
    log.about("Blue: measured markers. Orange: simulated. Plot: distance per marker [mm].")
    log.blueprint({"distance [mm]": "/distance"}, np.asarray(measured).reshape(-1, 3))
    return log.close()
