"""Recordings for the rerun viewer: a trajectory, and a recording beside its simulation."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError, ParameterError
from rodnet.viz.comparison import check_comparison
from rodnet.viz.fields import log_internal, log_memories
from rodnet.viz.forces import arrow_scale, forces_of, log_forces, scale_text
from rodnet.viz.rerun_log import MEASURED, SERIES, SOFT, Log, open_viewer
from rodnet.viz.shape import log_held, log_rods, log_trails
from rodnet.viz.solids import check_meshes, log_bodies

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

FRAMES = 1500  # at most so many frames by default


def _parameter_table(robot: Any) -> list[str]:
    """Markdown rows, parameters of one kind and value together (``tail0.E, tail1.E``)."""
    rows: dict[tuple[str, str], list[str]] = {}
    for path, p in robot.parameters.items():
        values = None if p.value is None or callable(p.value) else np.asarray(p.value, dtype=float)
        if values is None:
            value = "not set" if p.value is None else "a function"
        elif values.size == 1:
            value = f"{values.item():.6g}"
        else:
            value = np.array2string(values, precision=6, threshold=12)
        text = f"{value} {'' if p.unit == '1' else p.unit}".replace("|", "\\|").replace("\n", " ")
        rows.setdefault((path.rpartition(".")[2], text), []).append(path)
    table = [f"| {', '.join(paths)} | {text} |" for (_, text), paths in rows.items()]
    return ["| parameter | value |", "|---|---|", *table]


def log_rerun(
    traj: Trajectory | Sequence[Trajectory] | Mapping[str, Trajectory],
    path: str | Path,
    *,
    every: int | None = None,
    meshes: Mapping[str, Any] | None = None,
    spawn: bool = False,
) -> Path:
    """Write one or several trajectories for the rerun viewer (``rodnet view FILE.rrd``).

    Rods as polylines with their radii (``robot/rods/...``), stiff parts in grey (``robot/rigid/...``), rigid
    bodies as meshes that move (``robot/bodies/...``), joints, held nodes, trails of the free ends, the forces
    of every drag, contact and load term as arrows of one scale (``robot/forces/NAME``; contacts where they
    act), what laws with memory remember as colours (``robot/memory/...`` at the nodes, ``robot/medium/...`` in
    the cells of the medium), internal forces and moments as colours (``robot/internal/...``), energies, powers
    and the largest internal forces over time, a description, and a layout that opens on what is seen at a
    glance: loads, internal forces and all but the first memory of a law are there to be switched on. Of a
    trajectory loaded without its robot, what needs the robot is left out. Timelines: ``time`` [s] and ``step``.

    Parameters
    ----------
    traj : Trajectory, or sequence or mapping of such
        What to show. Of several, each has its own branch ``robot/NAME``; a sequence names them 0, 1, ...
    path : path
        The ``.rrd`` file.
    every : int, optional
        Show every so many-th recorded state; by default so many that at most 1500 are shown.
    meshes : mapping, optional
        Surfaces of rigid bodies by their names, each a ``trimesh.Trimesh`` or vertices (n, 3) [m] and faces
        (m, 3) in the axes of the drawing; without one a body is drawn as the cylinders of its edges.
    spawn : bool
        Open the viewer on the file.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    ParameterError
        If ``every`` is not a positive integer, ``meshes`` names no rigid body or holds no mesh, there is no
        trajectory, or a name is not fit for an entity.
    """
    if every is not None and (every != int(every) or every < 1):
        raise ParameterError(f"log_rerun: every = {every!r} must be a positive integer")
    scenes = _scenes(traj, every)
    check_meshes((s.traj for s in scenes), meshes or {})
    size = max(s.size for s in scenes)
    forces = [forces_of(s.traj, s.frames) for s in scenes]
    scale = arrow_scale([f for found in forces for f in found], size)
    plots: dict[str, str] = {}
    colors: dict[str, tuple[int, int, int]] = {}
    hidden: list[str] = []
    about: list[str] = []
    with Log(path, "run") as log:
        for scene, found in zip(scenes, forces, strict=True):
            t, frames, root = scene.traj, scene.frames, scene.root
            columns = log.times(t.t[frames], frames)
            log_rods(log, t, frames, columns, root, scene.color)
            log_bodies(log, t, frames, columns, meshes or {}, root)
            log_trails(log, t, frames, columns, root)
            log_held(log, t, frames, columns, root)
            hidden += log_forces(log, found, columns, root, size, scale) if scale else []
            off, remembered = log_memories(log, t, frames, columns, root)
            _log_tables(log, scene, columns, plots, colors)
            inside, internal = log_internal(log, t, frames, columns, root, plots)
            hidden += off + inside
            acting = sorted({f.kind for f in found if np.nan_to_num(f.f).any()})
            about.append(_description(scene, acting, remembered + internal))
        text = f"All arrows: {scale_text(scale, size)}.\n\n" if scale else ""
        log.about(text + "\n\n".join(about))
        title = f"robot ({scale_text(scale, size)})" if scale else "robot"
        shape, follow = _opening(scenes)
        log.blueprint(plots, shape, title=title, follow=follow, hidden=hidden)
    if spawn:
        open_viewer(log.path)
    return log.path


@dataclass(frozen=True)
class _Scene:
    """One trajectory of a recording: its branch, the frames that are shown, and the colour of its soft rods."""

    traj: Trajectory
    name: str
    frames: np.ndarray
    color: Any

    @property
    def root(self) -> str:
        return f"robot/{self.name}" if self.name else "robot"

    @property
    def size(self) -> float:
        return float(np.linalg.norm(np.ptp(self.traj.x[0], axis=0)))


def _scenes(traj: Any, every: int | None) -> list[_Scene]:
    """Trajectories with their names; a single one has none."""
    if isinstance(traj, Mapping):
        named = [(str(name), t) for name, t in traj.items()]
    elif hasattr(traj, "header"):
        named = [("", traj)]
    else:
        named = [(str(k), t) for k, t in enumerate(traj)]
    if not named:
        raise ParameterError("log_rerun: no trajectory to show")
    colors = (SOFT, SERIES[0], *SERIES[2:4])
    scenes = []
    for k, (name, t) in enumerate(named):
        if len(named) > 1 and not re.fullmatch(r"[\w.-]+", name):
            raise ParameterError(
                f"log_rerun: the name {name!r} must consist of letters, digits, '_', '-' and '.'"
            )
        step = int(every) if every else max(1, -(-len(t) // FRAMES))
        scenes.append(_Scene(t, name, np.arange(0, len(t), step), colors[k % len(colors)]))
    return scenes


def _log_tables(log: Log, scene: _Scene, columns: list[Any], plots: dict, colors: dict) -> None:
    """Energies and powers by term over time."""
    for label, unit in (("energies", "J"), ("powers", "W")):
        try:
            table = getattr(scene.traj, label)
        except OutputError:  # a file that was cut off, without the robot
            continue
        plots[f"{label} [{unit}]"] = f"/{label}"
        for name, values in table.items():
            full = f"{scene.name} {name}".strip()
            color = colors.setdefault(full, SERIES[len(colors) % len(SERIES)])
            entity = "/".join(filter(None, (label, scene.name, name)))
            log.series(entity, columns, values[scene.frames], full, color)


def _opening(scenes: list[_Scene]) -> tuple[np.ndarray, str | None]:
    """What the 3D view opens on: the whole way, or of a long one the robots, the first of which the eye follows."""
    ways = [s.traj.x[s.frames[:: max(1, len(s.frames) // 50)]] for s in scenes]
    start = np.concatenate([way[0] for way in ways])
    everything = np.concatenate([way.reshape(-1, 3) for way in ways])
    size, extent = (float(np.linalg.norm(np.ptp(x, axis=0))) for x in (start, everything))
    if extent < 3.0 * size:
        return everything, None
    rod = next(iter(scenes[0].traj.rods.values()))
    return start, f"/{scenes[0].root}/{'rigid' if rod.kind == 'rigid' else 'rods'}/{rod.name}"


MEANING = {
    "drag": "Green arrows: drag.",
    "contact": "Purple arrows: contact.",
    "load": "Yellow arrows (off): loads.",
}


def _description(scene: _Scene, acting: list[str], legend: list[str]) -> str:
    traj, frames = scene.traj, scene.frames
    kinds = [rod.kind for rod in traj.rods.values()]
    colors = ["Soft rods in colour.", "Light blue: where free ends have been."]
    if len(traj.rods) > 1:
        colors.insert(
            1, "Grey: joints and stiff parts (drawn thinner if thicker than a fifth of their length)."
        )
    if traj.robot is not None and any(t.kind == "constraint" for t in traj.robot.terms):
        colors.append("Pink: held nodes.")
    colors += [MEANING[kind] for kind in acting]
    lines = [f"**{scene.name}**", ""] if scene.name else []
    lines += [
        f"Soft rods: {kinds.count('rod')}, stiff parts: {kinds.count('rigid')}, nodes: {traj.x.shape[1]}, "
        f"edges: {len(traj.edges)}. {len(frames)} of {len(traj)} states, t = {traj.t[0]:g} to {traj.t[-1]:g} s "
        f"({traj.status}), dt = {traj.dt:g} s, {traj.header.get('stepper', '')}.",
        "",
        " ".join(colors),
        "",
        *(f"- {entry}" for entry in legend),
        "",
    ]
    if traj.robot is not None:
        lines += _parameter_table(traj.robot)
    return "\n".join(lines)


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
        Marker positions [m]; NaN where a marker was lost.
    marker_edges : ndarray, shape (E, 2)
        Pairs of markers that are joined.
    traj : Trajectory, optional
        The simulation behind the prediction; its rods are then drawn instead of lines between markers.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    ParameterError
        If the shapes do not fit together.
    """
    t, measured, predicted, pairs = check_comparison(t, measured, predicted, marker_edges)
    low, high = np.nanmin(measured, axis=(0, 1)), np.nanmax(measured, axis=(0, 1))
    size = float(np.linalg.norm(high - low))
    with Log(path, "comparison") as log:
        columns = log.times(t)
        for name, values, color in (("measured", measured, MEASURED), ("predicted", predicted, SOFT)):
            log.points(f"robot/{name}/markers", columns, values, size / 150, color)
            if len(pairs) and (name == "measured" or traj is None):
                log.segments(f"robot/{name}/lines", columns, values[:, pairs], size / 500, color)
        if traj is not None:
            nearest = np.abs(traj.t[:, None] - t).argmin(axis=0)
            log_rods(log, traj, nearest, columns)
        distance = np.linalg.norm(predicted - measured, axis=2) * 1e3
        for m in range(distance.shape[1]):
            shade = SERIES[5] if m % 2 else SERIES[0]
            log.series(f"distance/marker{m:02d}", columns, distance[:, m], f"marker {m}", shade, 1.0)
        seen = np.isfinite(distance)
        mean = np.where(seen, distance, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        mean = np.where(seen.any(axis=1), mean, np.nan)
        log.series("distance/mean", columns, mean, "mean of all markers", SERIES[4], 4.0)
        log.about(
            f"**Blue**: measured markers. **Orange**: simulated.\n\n{len(t)} frames, {measured.shape[1]} "
            f"markers, t = {t[0]:g} to {t[-1]:g} s. Mean distance {np.nanmean(distance):.3g} mm over all "
            "markers and times (the thick line; thin lines: each marker)."
        )
        log.blueprint(
            {"distance [mm]": "/distance"},
            np.stack([low, high]),
            title="measured (blue) and simulated (orange)",
            legend=False,
        )
    return log.path
