"""Recordings for the rerun viewer: a trajectory, and a recording beside its simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError, ParameterError
from rodnet.terms.constraints import Constraint
from rodnet.viz.comparison import check_comparison
from rodnet.viz.rerun_log import FORCE, HELD, MEASURED, SERIES, SOFT, STIFF, Log, open_viewer, si
from rodnet.viz.solids import log_bodies

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

FRAMES = 1500  # at most so many frames by default
TRAIL = 48  # points of a trail
STOUT = 0.2  # a stiff part is drawn no thicker than this share of its length


def _log_rods(log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any]) -> None:
    """Rods as polylines with their radii, and the nodes where they are joined."""
    rods = traj.rods.values()
    thickness: dict[int, list[float]] = {}
    for rod in rods:
        stiff = rod.kind == "rigid"
        radius = float(np.median(rod.radius))
        if stiff:
            path = np.linalg.norm(np.diff(traj.x[0, rod.nodes], axis=0), axis=1).sum()
            radius = min(radius, STOUT * float(path))
        entity = f"robot/{'rigid' if stiff else 'rods'}/{rod.name}"
        log.strips(entity, columns, traj.x[frames][:, rod.nodes], radius, STIFF if stiff else SOFT)
        for node in rod.nodes:
            thickness.setdefault(int(node), []).append(radius)
    # as thick as the second thickest rod that meets there, and a little more
    joints = {node: 1.15 * sorted(radii)[-2] for node, radii in thickness.items() if len(radii) > 1}
    if joints:
        radii = np.broadcast_to(list(joints.values()), (len(frames), len(joints)))
        log.points("robot/joints", columns, traj.x[frames][:, list(joints)], radii, STIFF)


def _log_trails(log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any]) -> None:
    """Where the free ends have been lately: over a tenth of the run, or on a way as long as the robot."""
    degree = np.bincount(traj.edges.ravel(), minlength=traj.x.shape[1])
    ends = [(r.name, n) for r in traj.rods.values() for n in (r.nodes[0], r.nodes[-1]) if degree[n] == 1]
    size = float(np.linalg.norm(np.ptp(traj.x[0], axis=0)))
    for name, node in ends[:24]:
        way = float(np.linalg.norm(np.diff(traj.x[:, node], axis=0), axis=1).sum())
        if way < 1e-3 * size:
            continue
        states = max(int(len(traj) * min(0.1, size / way)), 2)
        back = np.unique(np.linspace(0, states, min(TRAIL, states + 1)).astype(int))
        window = np.maximum(frames[:, None] - back, 0)
        color = (*SERIES[5], 150)
        log.strips(f"robot/trails/{name}_{node}", columns, traj.x[window, node], size / 600, color)


def _parameter_table(robot: Any) -> list[str]:
    """Markdown rows, parameters of one kind and value together (``tail0.E, tail1.E``)."""
    rows: dict[tuple[str, str], list[str]] = {}
    for path, p in robot.parameters.items():
        try:
            value = f"{float(p.value):.6g}"
        except (TypeError, ValueError):
            value = "a function" if callable(p.value) else str(np.round(np.asarray(p.value, dtype=object), 6))
        text = f"{value} {'' if p.unit == '1' else p.unit}".replace("|", "\\|").replace("\n", " ")
        rows.setdefault((path.rpartition(".")[2], text), []).append(path)
    table = [f"| {', '.join(paths)} | {text} |" for (_, text), paths in rows.items()]
    return ["| parameter | value |", "|---|---|", *table]


def _log_actions(log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any]) -> str | None:
    """Drag and contact as arrows, and the nodes that constraints hold; return what lengths of arrows stand for."""
    robot, x = traj.robot, traj.x[frames]
    if robot is None:
        return None
    size = float(np.linalg.norm(np.ptp(traj.x[0], axis=0)))
    held = [t.held_nodes(robot.graph) for t in robot.terms if isinstance(t, Constraint)]
    if held:
        nodes = np.unique(np.concatenate(held))
        around = [robot.graph.radius[(robot.graph.edges == n).any(axis=1)].max(initial=0.0) for n in nodes]
        radii = np.maximum(1.3 * np.array(around), size / 100)
        log.points("robot/held", columns, x[:, nodes], np.broadcast_to(radii, (len(x), len(nodes))), HELD)
    legend = []
    for kind, color in (("drag", FORCE), ("contact", SERIES[3])):
        names = [t.name for t in robot.terms if t.kind == kind]
        force = sum((traj.term_forces(name, frames) for name in names), np.zeros_like(x))
        # a start from rest may begin with a spike: the run as a whole sets the scale
        largest = float(np.quantile(np.linalg.norm(force, axis=2).max(axis=1), 0.95)) if names else 0.0
        if not (largest > 0.0 and math.isfinite(largest)):
            continue
        scale = size / 3.0 / largest
        log.arrows(f"robot/{kind}", columns, x, force * scale, color, size / 350)
        unit = 10.0 ** math.floor(math.log10(size / 3.0))
        legend.append(f"{kind}: {si(unit, 'm')} of arrow = {si(unit / scale, 'N')}")
    return ", ".join(legend) or None


def log_rerun(
    traj: Trajectory,
    path: str | Path,
    *,
    every: int | None = None,
    meshes: Mapping[str, Any] | None = None,
    spawn: bool = False,
) -> Path:
    """Write a trajectory for the rerun viewer (``rodnet view FILE.rrd``).

    Rods as polylines with their radii (``robot/rods/...``), stiff parts in grey (``robot/rigid/...``), rigid
    bodies as meshes that move (``robot/bodies/...``), joints, held nodes, trails of the free ends, drag
    forces as arrows (``robot/drag``), energies and powers by term over time, a description, and a layout
    that opens on all of it. Of a trajectory loaded without its robot, what needs the robot is left out.
    Timelines: ``time`` [s] and ``step``.

    Parameters
    ----------
    traj : Trajectory
        What to show.
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
        If ``every`` is not a positive integer, or ``meshes`` names no rigid body or holds no mesh.
    """
    if every is not None and (every != int(every) or every < 1):
        raise ParameterError(f"log_rerun: every = {every!r} must be a positive integer")
    step = int(every) if every else max(1, -(-len(traj) // FRAMES))
    frames = np.arange(0, len(traj), step)
    with Log(path, "run") as log:
        columns = log.times(traj.t[frames], frames)
        _log_rods(log, traj, frames, columns)
        log_bodies(log, traj, frames, columns, meshes or {})
        _log_trails(log, traj, frames, columns)
        scale = _log_actions(log, traj, frames, columns)
        plots: dict[str, str] = {}
        colors: dict[str, tuple[int, int, int]] = {}
        for label, unit in (("energies", "J"), ("powers", "W")):
            try:
                table = getattr(traj, label)
            except OutputError:  # a file that was cut off, without the robot
                continue
            plots[f"{label} [{unit}]"] = f"/{label}"
            for name, values in table.items():
                color = colors.setdefault(name, SERIES[len(colors) % len(SERIES)])
                log.series(f"{label}/{name}", columns, values[frames], name, color)
        log.about(_description(traj, frames, scale))
        shape, follow = _opening(traj, frames)
        title = f"robot ({scale})" if scale else "robot"
        log.blueprint(plots, shape, title=title, follow=follow)
    if spawn:
        open_viewer(log.path)
    return log.path


def _opening(traj: Trajectory, frames: np.ndarray) -> tuple[np.ndarray, str | None]:
    """What the 3D view opens on: the whole way, or of a long one the robot, which the eye follows."""
    way = traj.x[frames[:: max(1, len(frames) // 50)]]
    size, extent = (float(np.linalg.norm(np.ptp(x.reshape(-1, 3), axis=0))) for x in (way[0], way))
    if extent < 3.0 * size:
        return way.reshape(-1, 3), None
    rod = next(iter(traj.rods.values()))
    return way[0], f"/robot/{'rigid' if rod.kind == 'rigid' else 'rods'}/{rod.name}"


def _description(traj: Trajectory, frames: np.ndarray, scale: str | None) -> str:
    kinds = [rod.kind for rod in traj.rods.values()]
    legend = ["Orange: soft rods.", "Light blue: where free ends have been."]
    if len(traj.rods) > 1:
        legend.insert(
            1, "Grey: joints and stiff parts (drawn thinner if thicker than a fifth of their length)."
        )
    if traj.robot is not None and any(t.kind == "constraint" for t in traj.robot.terms):
        legend.append("Pink: held nodes.")
    if scale:
        legend.append(f"Green arrows: drag forces; purple: contact forces ({scale}).")
    lines = [
        f"Soft rods: {kinds.count('rod')}, stiff parts: {kinds.count('rigid')}, nodes: {traj.x.shape[1]}, "
        f"edges: {len(traj.edges)}. {len(frames)} of {len(traj)} states, t = {traj.t[0]:g} to {traj.t[-1]:g} s "
        f"({traj.status}), dt = {traj.dt:g} s, {traj.header.get('stepper', '')}.",
        "",
        " ".join(legend),
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
            _log_rods(log, traj, nearest, columns)
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
