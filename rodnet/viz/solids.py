"""Rigid bodies as solids: their surfaces, and how they move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.kinematics.frames import cross, material_frames, unit
from rodnet.viz.rerun_log import STIFF, Log

if TYPE_CHECKING:
    from rodnet.graph.bodies import Body
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.trajectory import Trajectory

SIDES = 24  # of a cylinder


def log_bodies(
    log: Log, traj: Trajectory, frames: np.ndarray, columns: list[Any], meshes: Mapping[str, Any], root: str
) -> None:
    """Rigid bodies as meshes in the axes of the drawing, each with the transform that moves it.

    Parameters
    ----------
    meshes : mapping
        Surfaces by the names of bodies, for those that are not to be drawn as cylinders; see `as_mesh`.

    Raises
    ------
    ParameterError
        If a mesh is none.
    """
    bodies = () if traj.robot is None else traj.robot.graph.bodies
    for body in bodies:
        graph = traj.robot.graph  # type: ignore[union-attr]
        given = meshes.get(body.name)
        vertices, faces = cylinders(graph, body) if given is None else as_mesh(body.name, given)
        log.solid(f"{root}/bodies/{body.name}", columns, vertices, faces, *poses(traj, body, frames), STIFF)


def check_meshes(trajs: Iterable[Trajectory], meshes: Mapping[str, Any]) -> None:
    """Raise `ParameterError` if a mesh is for a body that no robot has."""
    names = {body.name: None for traj in trajs if traj.robot is not None for body in traj.robot.graph.bodies}
    for name in meshes:
        if name not in names:
            raise ParameterError(
                f"meshes: there is no rigid body '{name}'; there are {', '.join(names) or 'none'}"
            )


def as_mesh(name: str, given: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m] and faces (m, 3) of a `trimesh.Trimesh`, or of a pair of arrays."""
    pair = (given.vertices, given.faces) if hasattr(given, "vertices") else given
    try:
        vertices, faces = np.array(pair[0], dtype=float), np.array(pair[1], dtype=np.int64)
    except (TypeError, ValueError, IndexError):
        vertices, faces = np.zeros(0), np.zeros(0, dtype=np.int64)
    shaped = vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3
    if not (
        shaped
        and len(faces)
        and np.all(np.isfinite(vertices))
        and 0 <= faces.min() <= faces.max() < len(vertices)
    ):
        raise ParameterError(
            f"meshes: that of '{name}' must be a trimesh.Trimesh, or vertices (n, 3) [m] and faces (m, 3), in the axes "
            "of the drawing"
        )
    return vertices, faces


def cylinders(graph: RodGraph, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Surface of a body's edges as round cylinders of their radius, closed at the ends: vertices and faces."""
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    k, n = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    sides = np.concatenate([np.stack([k, n, SIDES + k], 1), np.stack([n, SIDES + n, SIDES + k], 1)])
    low, high = np.full(SIDES, 2 * SIDES), np.full(SIDES, 2 * SIDES + 1)
    faces = np.concatenate([sides, np.stack([n, k, low], 1), np.stack([SIDES + k, SIDES + n, high], 1)])
    vertices = []
    for e in body.edges:
        ends = graph.x0[graph.edges[e]]
        t = unit((ends[1] - ends[0])[None])[0]
        across = graph.d1[e], cross(t, graph.d1[e])
        ring = graph.radius[e] * (np.outer(np.cos(angle), across[0]) + np.outer(np.sin(angle), across[1]))
        vertices.append(np.concatenate([ends[0] + ring, ends[1] + ring, ends]))
    shifted = faces[None] + (2 * SIDES + 2) * np.arange(len(vertices))[:, None, None]
    return np.concatenate(vertices), shifted.reshape(-1, 3)


def poses(traj: Trajectory, body: Body, frames: Any = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Places p (T, 3) [m] and rotations R (T, 3, 3) of a body: a point X of the drawing is at R X + p."""
    graph = traj.robot.graph  # type: ignore[union-attr]
    e, (i, j) = body.edges[0], graph.edges[body.edges[0]]
    x = traj.x[frames]
    now = material_frames(unit(x[:, j] - x[:, i]), traj.directors[frames][:, e], traj.theta[frames][:, e])
    drawn = material_frames(unit((graph.x0[j] - graph.x0[i])[None]), graph.d1[e : e + 1], np.zeros(1))[0]
    R = now @ drawn.T
    return x[:, i] - R @ graph.x0[i], R
