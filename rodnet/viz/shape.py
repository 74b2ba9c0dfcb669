"""What a robot looks like: rods, joints, held nodes, and the trails of its free ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.terms.constraints import Constraint
from rodnet.viz.rerun_log import HELD, SERIES, SOFT, STIFF, Log

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

TRAIL = 48  # points of a trail
STOUT = 0.2  # a stiff part is drawn no thicker than this share of its length


def log_rods(
    log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any], root: str = "robot", color: Any = SOFT
) -> None:
    """Rods as polylines with their radii, and the nodes where they are joined."""
    rods = traj.rods.values()
    thickness: dict[int, list[float]] = {}
    for rod in rods:
        stiff = rod.kind == "rigid"
        radius = float(np.median(rod.radius))
        if stiff:
            path = np.linalg.norm(np.diff(traj.x[0, rod.nodes], axis=0), axis=1).sum()
            radius = min(radius, STOUT * float(path))
        entity = f"{root}/{'rigid' if stiff else 'rods'}/{rod.name}"
        log.strips(entity, columns, traj.x[frames][:, rod.nodes], radius, STIFF if stiff else color)
        for node in rod.nodes:
            thickness.setdefault(int(node), []).append(radius)
    # as thick as the second thickest rod that meets there, and a little more
    joints = {node: 1.15 * sorted(radii)[-2] for node, radii in thickness.items() if len(radii) > 1}
    if joints:
        radii = np.broadcast_to(list(joints.values()), (len(frames), len(joints)))
        log.points(f"{root}/joints", columns, traj.x[frames][:, list(joints)], radii, STIFF)


def log_trails(log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any], root: str) -> None:
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
        log.strips(
            f"{root}/trails/{name}_{node}", columns, traj.x[window, node], size / 600, (*SERIES[5], 150)
        )


def log_held(log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any], root: str) -> None:
    """Nodes that constraints hold."""
    robot, x = traj.robot, traj.x[frames]
    held = (
        [] if robot is None else [t.held_nodes(robot.graph) for t in robot.terms if isinstance(t, Constraint)]
    )
    if robot is None or not held:
        return
    nodes = np.unique(np.concatenate(held))
    around = [robot.graph.radius[(robot.graph.edges == n).any(axis=1)].max(initial=0.0) for n in nodes]
    size = float(np.linalg.norm(np.ptp(traj.x[0], axis=0)))
    radii = np.maximum(1.3 * np.array(around), size / 100)
    log.points(f"{root}/held", columns, x[:, nodes], np.broadcast_to(radii, (len(x), len(nodes))), HELD)
