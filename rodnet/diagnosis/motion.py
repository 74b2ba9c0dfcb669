"""How a model moves in a trial, and what its parts meet there: speed, curvature, spacing, depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from rodnet.diagnosis.force_field import Hats
from rodnet.errors import RodnetError
from rodnet.graph.rod_graph import RodGraph
from rodnet.inference.packing import unpack_trial
from rodnet.inference.shots import why
from rodnet.simulation import Simulation

FAR = 0.25  # of the longest rod: parts nearer along the body are no neighbours
FRAMES = 200  # of a motion that are kept
UNITS = {"speed": "m/s", "curvature": "1/m", "spacing": "m", "depth": "m", "time": "s"}


@dataclass(frozen=True)
class Motion:
    """A trial as a model predicts it.

    Attributes
    ----------
    t : ndarray, shape (F,)
        Times [s].
    x, v : ndarray, shape (F, N, 3)
        Positions [m] and velocities [m/s] of the nodes.
    """

    t: np.ndarray
    x: np.ndarray
    v: np.ndarray


def motion_of(packed: bytes, values: dict[str, float]) -> Motion | str:
    """Run a trial in any process; return how it moves, or why it cannot be simulated."""
    trial = unpack_trial(packed)
    robot, options = trial.robot_at(values)
    duration = float(trial.rec.t[-1])
    try:
        sim = Simulation(robot, **options)
        every = max(1, int(duration / sim.dt / FRAMES))
        traj = sim.run(duration, save_every=every)
    except RodnetError as error:
        return why(error)
    return Motion(traj.t, traj.x, traj.v)


def met(motion: Motion, graph: RodGraph, hats: Hats) -> dict[str, np.ndarray]:
    """What each hat meets, on average: arrays of shape (B, T) by the names of `UNITS`."""
    over = hats.weights(graph)
    over = over / np.maximum(over.sum(axis=0), 1e-300)
    when = np.stack([hats.at(t) for t in motion.t])
    when = when / np.maximum(when.sum(axis=0), 1e-300)
    depth = motion.x[0, :, 2].max() - motion.x[:, :, 2]
    fields = {
        "speed": np.linalg.norm(motion.v, axis=2),
        "curvature": curvature(motion.x, graph),
        "spacing": spacing(motion.x, graph),
        "depth": depth,
        "time": np.broadcast_to(motion.t[:, None], depth.shape),
    }
    return {name: np.einsum("fn,nb,ft->bt", field, over, when) for name, field in fields.items()}


def velocity(motion: Motion, graph: RodGraph, hats: Hats) -> np.ndarray:
    """Velocity that each hat meets, on average, shape (B, T, 3) [m/s]."""
    over = hats.weights(graph)
    over = over / np.maximum(over.sum(axis=0), 1e-300)
    when = np.stack([hats.at(t) for t in motion.t])
    return np.einsum("fna,nb,ft->bta", motion.v, over, when / np.maximum(when.sum(axis=0), 1e-300))


def curvature(x: np.ndarray, graph: RodGraph) -> np.ndarray:
    """Curvature at the nodes [1/m], shape (F, N): the angle between edges over their mean length."""
    found = np.zeros(x.shape[:2])
    for rod in graph.rods.values():
        if len(rod.edges) < 2:
            continue
        edges = np.diff(x[:, rod.nodes], axis=1)
        length = np.linalg.norm(edges, axis=2)
        t = edges / length[..., None]
        angle = np.arccos(np.clip(np.sum(t[:, 1:] * t[:, :-1], axis=2), -1.0, 1.0))
        inner = angle / (0.5 * (length[:, 1:] + length[:, :-1]))
        found[:, rod.nodes[1:-1]] = inner
        found[:, rod.nodes[0]] = np.maximum(found[:, rod.nodes[0]], inner[:, 0])
        found[:, rod.nodes[-1]] = np.maximum(found[:, rod.nodes[-1]], inner[:, -1])
    return found


def spacing(x: np.ndarray, graph: RodGraph) -> np.ndarray:
    """Distance of each node to the nearest part that is far along the body [m], shape (F, N)."""
    i, j = graph.edges.T
    count = graph.node_count
    along = dijkstra(csr_matrix((graph.rest_length, (i, j)), shape=(count, count)), directed=False)
    near = along < FAR * max(rod.length for rod in graph.rods.values())
    found = np.zeros(x.shape[:2])
    for k, frame in enumerate(x):
        apart = np.linalg.norm(frame[:, None] - frame[None], axis=2)
        apart[near] = np.inf
        found[k] = apart.min(axis=1)
    return np.where(np.isfinite(found), found, graph.size)
