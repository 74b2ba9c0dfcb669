"""Every rerun call of the package: the viewer's interface changes often, so it is used in this file alone.

What is shown is in `rodnet.viz.scenes` and `rodnet.viz.debug_step`. A recording file holds float32
positions: it is a view, not the record (that is the NetCDF file).
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np

from rodnet.errors import OutputError
from rodnet.storage import check_writable

# colours that colour-blind readers tell apart (Okabe and Ito 2008)
SOFT, STIFF, FORCE, MEASURED = (230, 130, 40), (120, 120, 132), (0, 180, 130), (40, 140, 220)
HELD, NOTE = (214, 120, 180), (240, 228, 66)
SERIES = [(0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233)]
SERIES += [(240, 228, 66), (140, 140, 140)]

SETTLE = 4.0  # time for the viewer to draw all of a file before its picture is taken [s]


class Log:
    """An ``.rrd`` file being written; a context manager, so that the file is always closed.

    Lost points (NaN) are left out. Times go in as columns, one row per frame (see `times`).

    Parameters
    ----------
    path : path
        The file.
    kind : str
        What it shows; files of one kind share the viewer's memory of how views were arranged.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """

    def __init__(self, path: str | Path, kind: str) -> None:
        self.path = check_writable(path)
        import rerun as rr

        self.rr = rr
        # an id of its own for every file: the viewer merges recordings that share one
        self.rec = rr.RecordingStream(f"rodnet {kind}")
        self.rec.save(str(self.path))
        self.rec.send_recording_name(self.path.stem)
        self.rec.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *error: object) -> None:
        self.rec.flush()
        self.rec.disconnect()

    # -- layout ---------------------------------------------------------------------------
    def blueprint(
        self,
        plots: Mapping[str, str],
        shape: np.ndarray,
        *,
        title: str = "robot",
        timeline: str = "time",
        bars: Mapping[str, str] | None = None,
        legend: bool = True,
        follow: str | None = None,
        hidden: Sequence[str] = (),
    ) -> None:
        """Open on a large 3D view with time series, bar charts and the description beside it.

        Parameters
        ----------
        plots, bars : mapping
            Entities by the names of their views.
        shape : ndarray, shape (n, 3)
            Points that the 3D view shows at the start [m].
        title, timeline : str
            Title of the 3D view, and the timeline to open on.
        legend : bool
            Whether time series have legends.
        follow : str, optional
            Entity that the eye follows.
        hidden : sequence of str
            Entities of the 3D view that are there to be switched on.
        """
        import rerun.blueprint as rrb

        low, high = np.nanmin(shape, axis=0), np.nanmax(shape, axis=0)
        middle, size = 0.5 * (low + high), max(float(np.linalg.norm(high - low)), 1e-9)
        eye = rrb.EyeControls3D(
            position=middle + 1.05 * size * np.array([0.35, -0.85, 0.4]),
            look_target=middle,
            eye_up=(0.0, 0.0, 1.0),
            tracking_entity=follow,
        )
        corner = rrb.PlotLegend("RightTop", visible=legend)
        series = [rrb.TimeSeriesView(origin=o, name=n, plot_legend=corner) for n, o in plots.items()]
        charts = [rrb.BarChartView(origin=o, name=n) for n, o in (bars or {}).items()]
        off: dict[Any, Any] = {f"/{entity}": rrb.EntityBehavior(visible=False) for entity in hidden}
        left = rrb.Spatial3DView(
            origin="/", contents=["/robot/**"], name=title, eye_controls=eye, overrides=off
        )
        right = rrb.Vertical(*series, *charts, rrb.TextDocumentView(origin="/about", name="about"))
        time = rrb.TimePanel(state="collapsed", timeline=timeline)
        layout = rrb.Horizontal(left, right, column_shares=[3, 2])
        self.rec.send_blueprint(rrb.Blueprint(layout, time, collapse_panels=True))

    def about(self, text: str) -> None:
        """Add a description (Markdown)."""
        self.rec.log("about", self.rr.TextDocument(text, media_type="text/markdown"), static=True)

    # -- columns --------------------------------------------------------------------------
    def times(self, t: np.ndarray, steps: np.ndarray | None = None) -> list[Any]:
        """Columns ``step`` [1] and ``time`` [s] of some frames."""
        index = np.arange(len(t)) if steps is None else steps
        return [self.rr.TimeColumn("step", sequence=index), self.rr.TimeColumn("time", duration=t)]

    def count(self, timeline: str, frames: int) -> list[Any]:
        """Column of a timeline that counts from zero."""
        return [self.rr.TimeColumn(timeline, sequence=np.arange(frames))]

    def strips(self, entity: str, columns: list[Any], lines: np.ndarray, radius: float, color: Any) -> None:
        """One polyline per frame, shape (T, n, 3)."""
        rr = self.rr
        self.rec.log(entity, rr.LineStrips3D.from_fields(radii=radius, colors=[color]), static=True)
        self.rec.send_columns(entity, columns, rr.LineStrips3D.columns(strips=lines.astype(np.float32)))

    def segments(self, entity: str, columns: list[Any], ends: np.ndarray, radius: Any, color: Any) -> None:
        """Lines of two points, shape (T, n, 2, 3); one colour, or one per line, shape (T, n, 3)."""
        kept = np.isfinite(ends).all(axis=(2, 3))
        fields: dict[str, Any] = {"strips": ends[kept].astype(np.float32)}
        self._send(entity, columns, self.rr.LineStrips3D, kept, fields, radius, color)

    def fixed(self, entity: str, lines: list[np.ndarray], radius: float, color: Any) -> None:
        """Polylines that do not change, shapes (n, 3)."""
        self.rec.log(entity, self.rr.LineStrips3D(lines, radii=radius, colors=[color]), static=True)

    def solid(
        self,
        entity: str,
        columns: list[Any],
        vertices: np.ndarray,
        faces: np.ndarray,
        places: np.ndarray,
        turns: np.ndarray,
        color: Any,
    ) -> None:
        """Triangle mesh that moves as one.

        Parameters
        ----------
        vertices, faces : ndarray, shapes (n, 3) and (m, 3)
            In its own axes [m].
        places, turns : ndarray, shapes (T, 3) and (T, 3, 3)
            Where its origin is [m], and how it is turned.
        """
        rr = self.rr
        corners = np.asarray(vertices)[np.asarray(faces)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        mesh = rr.Mesh3D(  # corners of its own for every face, which shows edges sharply
            vertex_positions=corners.reshape(-1, 3).astype(np.float32),
            vertex_normals=np.repeat(normals, 3, axis=0).astype(np.float32),
            triangle_indices=np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3),
            albedo_factor=color,
        )
        self.rec.log(entity, mesh, static=True)
        moved = rr.Transform3D.columns(translation=places.astype(np.float32), mat3x3=turns.astype(np.float32))
        self.rec.send_columns(entity, columns, moved)

    def points(
        self,
        entity: str,
        columns: list[Any],
        x: np.ndarray,
        radius: Any,
        color: Any,
        labels: list[str] | None = None,
    ) -> None:
        """Points, shape (T, n, 3); one radius and colour, or one per point, shapes (T, n) and (T, n, 3)."""
        kept = np.isfinite(x).all(axis=2)
        fields: dict[str, Any] = {"positions": x[kept].astype(np.float32)}
        if labels is not None:
            fields["labels"] = np.broadcast_to(labels, kept.shape)[kept]
        self._send(entity, columns, self.rr.Points3D, kept, fields, radius, color)

    def arrows(
        self, entity: str, columns: list[Any], x: np.ndarray, vectors: np.ndarray, color: Any, radius: float
    ) -> None:
        """Arrows from ``x``, shapes (T, n, 3); those of no length to speak of are left out."""
        kept = np.isfinite(x).all(axis=2) & np.isfinite(vectors).all(axis=2)
        length = np.linalg.norm(np.where(kept[..., None], vectors, 0.0), axis=2)
        kept &= length > 1e-3 * max(float(length.max(initial=0.0)), 1e-300)
        fields = {"origins": x[kept].astype(np.float32), "vectors": vectors[kept].astype(np.float32)}
        self._send(entity, columns, self.rr.Arrows3D, kept, fields, radius, color)

    def _send(self, entity, columns, archetype, kept, fields, radius, color) -> None:
        """Send what ``kept``, shape (T, n), names of every frame."""
        style: dict[str, Any] = {}
        for name, value, axes in (("radii", radius, 0), ("colors", color, 1)):
            value = np.asarray(value)
            if value.ndim > axes:
                fields[name] = np.ascontiguousarray(value[kept], dtype=np.float32 if axes == 0 else np.uint8)
            else:
                style[name] = value[None] if axes else float(value)
        if style:
            self.rec.log(entity, archetype.from_fields(**style), static=True)
        self.rec.send_columns(entity, columns, archetype.columns(**fields).partition(kept.sum(axis=1)))

    def series(
        self,
        entity: str,
        columns: list[Any],
        values: np.ndarray,
        name: str,
        color: Any,
        width: float = 1.5,
    ) -> None:
        """One scalar per frame, shape (T,)."""
        rr = self.rr
        self.rec.log(entity, rr.SeriesLines(names=name, colors=color, widths=width), static=True)
        self.rec.send_columns(entity, columns, rr.Scalars.columns(scalars=np.asarray(values, dtype=float)))

    def bars(self, entity: str, timeline: str, rows: np.ndarray, color: Any) -> None:
        """One bar chart per frame, shape (T, n)."""
        for k, row in enumerate(rows):
            self.rec.set_time(timeline, sequence=k)
            self.rec.log(entity, self.rr.BarChart(row, color=color))
        self.rec.reset_time()


def open_viewer(path: Path) -> None:
    """Open the viewer on a file, in a process of its own that outlives this one."""
    subprocess.Popen([sys.executable, "-m", "rerun", str(path)], start_new_session=True)


def snapshot(recording: str | Path, path: str | Path, *, time: float = 0.0, port: int = 9877) -> Path:
    """Take the viewer's own picture of a recording, without a window or a display (a PNG of 1920 x 1080).

    Parameters
    ----------
    recording, path : path
        The ``.rrd`` file, and the picture to write.
    time : float
        Time that is shown [s].
    port : int
        A free port for the viewer.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    OutputError
        If there is no such recording, the picture cannot be written, or the viewer took none: it needs a graphics
        driver, at least Mesa's in software (Debian: ``mesa-vulkan-drivers``).
    """
    source, target = Path(recording).resolve(), check_writable(path).resolve()
    if not source.is_file():
        raise OutputError(f"there is no recording '{recording}' to take a picture of")
    from rerun.experimental import ViewerClient

    target.unlink(missing_ok=True)
    try:
        viewer = ViewerClient.spawn(
            headless=True, port=port, hide_welcome_screen=True, executable_path=_viewer_program()
        )
        with viewer:
            viewer.open(str(source))
            viewer.set_time("time", duration=float(time), play_state="paused")
            sleep(SETTLE)  # data go on arriving after the file is open
            viewer.save_screenshot(str(target))
    except (RuntimeError, OSError, ValueError) as error:
        raise OutputError(f"the viewer took no picture of '{recording}': {error}") from error
    if not target.is_file():
        raise OutputError(f"the viewer took no picture of '{recording}'")
    return target


def _viewer_program() -> str | None:
    """The viewer that belongs to this Python, whatever the search path says."""
    program = Path(sys.executable).with_name("rerun")
    return str(program) if program.is_file() else None


def si(value: float, unit: str) -> str:
    """Return a value with three digits and a prefix, e.g. ``0.26 mN``."""
    if not (math.isfinite(value) and value):
        return f"{value:g} {unit}"
    power = min(max(math.floor(math.log10(abs(value)) / 3.0 + 0.25), -4), 3)
    return f"{value / 10.0 ** (3 * power):.3g} {'pnµm'[power] if power < 0 else ' kMG'[power].strip()}{unit}"
