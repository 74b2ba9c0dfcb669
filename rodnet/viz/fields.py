"""Quantities along a robot as colours: internal forces, and what laws with memory remember."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.terms.drag.line import DragModel
from rodnet.viz.colours import shades
from rodnet.viz.rerun_log import SERIES, Log, si

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

CELLS = 400_000  # cells in a recording, all frames together; with more, not every frame shows them
FAINT = 0.02  # of the largest change: less is not shown of the medium


def log_internal(
    log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any], root: str, plots: dict[str, str]
) -> tuple[list[str], list[str]]:
    """Tension along the rods and moments at the springs as colours, and the largest over time.

    Returns
    -------
    hidden, legend : list of str
        Entities that are hidden at first, and what colours stand for.
    """
    if traj.robot is None:
        return [], []
    internal, x, graph = traj.internal, traj.x[frames], traj.robot.graph
    name = root.removeprefix("robot").strip("/")
    at = lambda table: f"{table}/{name}" if name else table  # noqa: E731
    hidden, legend = [], []
    soft = np.flatnonzero(np.isfinite(graph.EA))
    tension = internal.tension[frames][:, soft]
    largest = float(np.abs(tension).max(initial=0.0))
    if largest > 0.0:
        hidden.append(f"{root}/internal/tension")
        ends, radius = x[:, graph.edges[soft]], np.broadcast_to(1.15 * graph.radius[soft], tension.shape)
        log.segments(hidden[-1], columns, ends, radius, shades(0.5 + 0.5 * tension / largest))
        legend.append(
            f"internal/tension: blue {si(-largest, 'N')} (compression), grey none, red {si(largest, 'N')} (tension)"
        )
        log.series(
            f"{at('internal_forces')}/tension", columns, tension.max(axis=1), f"{name} tension", SERIES[1]
        )
        log.series(
            f"{at('internal_forces')}/compression",
            columns,
            -tension.min(axis=1),
            f"{name} compression",
            SERIES[0],
        )
        plots["largest tension and compression [N]"] = "/internal_forces"
    around = np.zeros(traj.x.shape[1])
    np.maximum.at(around, graph.edges, graph.radius[:, None])
    springs = np.flatnonzero(internal.spring_node < len(around))
    nodes = internal.spring_node[springs]
    bending = np.linalg.norm(internal.bending[frames][:, springs], axis=2)
    torque = np.abs(internal.torque[frames][:, springs])
    for kind, values, color in (("bending", bending, SERIES[4]), ("torque", torque, SERIES[2])):
        largest = float(values.max(initial=0.0))
        if not largest > 0.0:
            continue
        hidden.append(f"{root}/internal/{kind}")
        radii = np.broadcast_to(1.3 * around[nodes], values.shape)
        log.points(hidden[-1], columns, x[:, nodes], radii, shades(values / largest))
        legend.append(f"internal/{kind}: blue none, red {si(largest, 'N m')}")
        log.series(f"{at('internal_moments')}/{kind}", columns, values.max(axis=1), f"{name} {kind}", color)
        plots["largest bending moment and torque [N m]"] = "/internal_moments"
    return hidden, legend


def log_memories(
    log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any], root: str
) -> tuple[list[str], list[str]]:
    """What drag laws with memory remember: at the nodes, and in the medium's cells.

    Returns
    -------
    hidden, legend : list of str
        Entities that are hidden at first, and what colours stand for.
    """
    hidden: list[str] = []
    legend: list[str] = []
    if traj.robot is None:
        return hidden, legend
    for i, b in enumerate(traj._replay.model.bound):
        law: Any = b.term
        if not isinstance(law, DragModel) or not law.memory_size:
            continue
        nodes, values = node_memory(traj, i, frames)
        around = np.zeros(traj.x.shape[1])
        np.maximum.at(around, traj.edges, traj.robot.graph.radius[:, None])
        names = law.memory_names or tuple(f"m{k}" for k in range(law.memory_size))
        in_medium = law.memory_frame == "medium"
        cells = [traj.medium(law.name, k) for k in frames] if in_medium else []
        for k, name in enumerate(names):
            value = values[:, :, k]
            every = np.concatenate([value.ravel(), *(m[:, k] for _, m in cells)])
            low, high = float(every.min()), float(every.max())
            if not high > low:
                continue
            entities = [f"{root}/memory/{law.name}/{name}"]
            radii = np.broadcast_to(1.4 * around[nodes], value.shape)
            color = shades((value - low) / (high - low))
            log.points(entities[0], columns, traj.x[frames][:, nodes], radii, color)
            if in_medium:
                entities.append(f"{root}/medium/{law.name}/{name}")
                untouched = float(b.field.untouched[k])
                _log_cells(
                    log, entities[1], traj.t, frames, cells, k, (low, high), untouched, float(law.cell or 0.0)
                )
            hidden += entities if k else []
            legend.append(f"memory {law.name}/{name}: blue {low:.3g}, red {high:.3g}")
    return hidden, legend


def node_memory(traj: Trajectory, i: int, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the i-th term, a drag law with memory, remembers at its nodes: that of its sites, on average.

    Where the medium holds the memory, it is what the law finds at the node.

    Returns
    -------
    nodes : ndarray, shape (n,)
        The nodes.
    values : ndarray, shape (T, n, memory_size)
        The memory.
    """
    b: Any = traj._replay.model.bound[i]
    law = b.term
    nodes, place, count = np.unique(b.sites.node, return_inverse=True, return_counts=True)
    values = np.zeros((len(frames), len(nodes), law.memory_size))
    for row, k in zip(values, frames.tolist(), strict=True):
        memory = traj._memory(i, k)
        assert memory is not None
        if law.memory_frame == "medium":
            b.accept(traj._replay.model, memory)
            row[:] = b.field.gather(traj.x[k, nodes])[0]
        else:
            np.add.at(row, place, memory[:, : law.memory_size] / count[place, None])
    return nodes, values


def _log_cells(
    log: Log,
    entity: str,
    t: np.ndarray,
    frames: np.ndarray,
    cells: list[tuple[np.ndarray, np.ndarray]],
    k: int,
    limits: tuple[float, float],
    untouched: float,
    size: float,
) -> None:
    """Cells of the medium that remember something, coloured by their k-th memory."""
    change = max((float(np.abs(m[:, k] - untouched).max(initial=0.0)) for _, m in cells), default=0.0)
    kept = [np.abs(m[:, k] - untouched) > FAINT * change for _, m in cells]
    step = max(1, -(-sum(int(some.sum()) for some in kept) // CELLS))
    shown = [(x[some], m[some, k]) for (x, m), some in zip(cells[::step], kept[::step], strict=True)]
    count = max(len(x) for x, _ in shown)
    at, value = np.full((len(shown), count, 3), np.nan), np.full((len(shown), count), np.nan)
    for row, (x, m) in enumerate(shown):
        at[row, : len(x)], value[row, : len(x)] = x, m
    low, high = limits
    columns = log.times(t[frames[::step]], frames[::step])
    log.points(entity, columns, at, 0.2 * size, shades((value - low) / (high - low)))
