"""A step seen from inside: directors, springs, prescribed degrees of freedom, Newton's iterates."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rodnet.kinematics.frames import material_frames, transport, unit
from rodnet.viz.rerun_log import FORCE, MEASURED, SOFT, STIFF, Log

if TYPE_CHECKING:
    from rodnet.simulation import Simulation

AXES = ((220, 50, 47), (38, 139, 210), (133, 153, 0))  # m1, m2, t
HELD = (204, 121, 167)


def debug(sim: Simulation, path: str | Path | None = None) -> Path:
    """Write an ``.rrd`` of the next step of a simulation, which itself is left as it is.

    Shows the directors of every edge, the springs with their moments, the prescribed nodes and the
    walls' ghost edges, the residual of every degree of freedom, and the iterates of Newton's method
    on the timeline ``iteration``. `ConvergenceError` writes one by itself.

    Parameters
    ----------
    sim : Simulation
        The simulation, at the state before the step.
    path : path, optional
        The file; by default ``rodnet-debug-....rrd`` in the current directory, or a temporary one.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    m, state = sim.model, sim.state
    _, report = sim.newton.step(
        state, sim.stepper, state.t + sim.dt, sim.dt, sim.observe().sensors, sim.inputs, keep_history=True
    )
    for bound, memory in zip(m.bound, state.memories, strict=True):
        if memory is not None:
            bound.restore(m, memory)
    log = Log(path or _default_path(), "debug")
    iterates = report.history or [(state.q, np.zeros(m.dof_count))]
    count = len(iterates)
    columns = [log.rr.TimeColumn("iteration", sequence=np.arange(count))]
    x = np.stack([q[: m.twist0].reshape(-1, 3) for q, _ in iterates])
    edge = float(m.rest_length.min())
    _log_shape(log, sim, columns, x, edge)
    _log_frames(log, sim, columns, iterates, x, edge)
    _log_residual(log, sim, columns, iterates, x)
    held = (
        np.unique(np.concatenate([c.nodes for c in m.constraints]))
        if m.constraints
        else np.zeros(0, dtype=int)
    )
    if len(held):
        log.points("robot/prescribed", columns, x[:, held], 0.35 * edge, HELD)
    worst = m.dof_name(report.worst) if report.worst >= 0 else "none"
    log.about(
        f"# The step from t = {state.t:g} s to {state.t + sim.dt:g} s\n\n{report.status.value}, "
        f"{report.iterations} iterations, largest scaled residual {report.residual:.3g} at {worst}.\n\n"
        "Red, blue, green arrows: m1, m2, t. Dots: springs, sized by their moment. "
        "Purple: prescribed nodes and walls. Green arrows at nodes: residual forces."
    )
    log.blueprint({"residual (log10, scaled)": "/residual"}, x[0])
    return log.close()


def _default_path() -> Path:
    folder = Path.cwd() if os.access(Path.cwd(), os.W_OK) else Path(tempfile.gettempdir())
    handle, name = tempfile.mkstemp(prefix="rodnet-debug-", suffix=".rrd", dir=folder)
    os.close(handle)
    return Path(name)


def _log_shape(log: Log, sim: Simulation, columns, x, edge) -> None:
    m = sim.model
    for rod in m.graph.rods.values():
        color = STIFF if rod.kind == "rigid" else SOFT
        log.strips(f"robot/rods/{rod.name}", columns, x[:, rod.nodes], 0.06 * edge, color)
    for ghost in m.ghosts.values():
        name = m.graph.node_name(ghost.root).replace(":", "_")
        log.strips(f"robot/walls/{name}", columns, x[:, m.edges[ghost.edge]], 0.1 * edge, HELD)


def _log_frames(log: Log, sim: Simulation, columns, iterates, x, edge) -> None:
    m, state = sim.model, sim.state
    e = x[:, m.edges[:, 1]] - x[:, m.edges[:, 0]]
    tangents = unit(e)
    d1 = transport(state.directors[None], state.tangents[None], tangents)
    theta = np.stack([q[m.twist0 :] for q, _ in iterates])
    frames = material_frames(tangents, np.nan_to_num(d1), theta)
    middle = 0.5 * (x[:, m.edges[:, 0]] + x[:, m.edges[:, 1]])
    for k, name in enumerate(("m1", "m2", "t")):
        log.arrows(
            f"robot/directors/{name}", columns, middle, 0.6 * edge * frames[..., k], AXES[k], 0.04 * edge
        )
    moment = np.linalg.norm(sim.newton.ev.spring_moments(), axis=1)
    sizes = 0.08 * edge + 0.22 * edge * moment / max(float(np.nan_to_num(moment).max(initial=0.0)), 1e-300)
    nodes = x[:, m.spring_node]
    rr = log.rr
    log.rec.log("robot/springs", rr.Points3D.from_fields(colors=[MEASURED]), static=True)
    flat = rr.Points3D.columns(
        positions=nodes.reshape(-1, 3).astype(np.float32),
        radii=np.tile(np.nan_to_num(sizes), len(x)).astype(np.float32),
    )
    log.rec.send_columns("robot/springs", columns, flat.partition(np.full(len(x), nodes.shape[1])))


def _log_residual(log: Log, sim: Simulation, columns, iterates, x) -> None:
    m = sim.model
    r = np.stack([r for _, r in iterates])
    r[:, m.held] = 0.0
    force = r[:, : m.twist0].reshape(len(r), -1, 3)
    length = np.linalg.norm(force, axis=2)
    largest = length.max(axis=1, initial=0.0)[:, None, None]
    shown = np.nan_to_num(force / np.where(largest > 0.0, largest, 1.0)) * 0.1 * m.graph.size
    log.arrows("robot/residual", columns, x, shown, FORCE, 0.002 * m.graph.size)
    scales = getattr(sim.newton, "_scales", (1.0, 1.0))
    parts = (
        ("forces", largest[:, 0, 0] / scales[0]),
        ("moments", np.abs(r[:, m.twist0 :]).max(axis=1, initial=0.0) / scales[1]),
    )
    for (name, values), color in zip(parts, (MEASURED, SOFT), strict=True):
        log.series(
            f"residual/{name}", columns, np.log10(np.maximum(np.nan_to_num(values), 1e-20)), name, color
        )
    # the whole residual, one bar per degree of freedom, at every iterate
    for k, row in enumerate(r):
        log.rec.set_time("iteration", sequence=k)
        log.rec.log("residual_by_dof", log.rr.BarChart(np.abs(np.nan_to_num(row))))
