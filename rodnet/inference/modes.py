"""Smooth changes of a robot's initial state: its softest modes of vibration."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from rodnet.errors import ParameterError
from rodnet.robot import Robot
from rodnet.solve.statics import stiffness_matrix

FLOOR = 1e-9  # of the largest inertia of its kind, where there is none


def soft_modes(robot: Robot, count: int) -> np.ndarray:
    """Displacements of the nodes that cost the least elastic energy for the mass that they move.

    They are smooth along rods, keep lengths, leave alone what is held and stiff, and of a free robot the
    first ones are its rigid motions. Each has the rms displacement 1 over the free nodes.

    Parameters
    ----------
    robot : Robot
        At its initial position.
    count : int
        How many.

    Returns
    -------
    ndarray, shape (count, N, 3)
        [1]; times an amplitude in metres, or in metres per second.

    Raises
    ------
    ParameterError
        If the robot has fewer, or is partly a rigid body.
    """
    from rodnet.solve.model import Model

    if robot.graph.bodies:
        raise ParameterError(
            "initial.position and initial.velocity are of rods; this robot has rigid bodies: use initial.offset"
        )
    K, free = stiffness_matrix(robot)
    model = Model(robot)
    nodes = 3 * robot.graph.node_count
    translations = int(np.count_nonzero(free < nodes))
    if not 0 < count <= translations:
        raise ParameterError(
            f"modes = {count} must be from 1 to {translations}, what the robot's nodes can do"
        )
    mass = np.asarray(model.mass[free], dtype=float)
    for kind in (free < nodes, free >= nodes):
        if kind.any():
            mass[kind] = np.maximum(mass[kind], FLOOR * mass[kind].max())
    dense = K.toarray()
    _, vectors = eigh(0.5 * (dense + dense.T), np.diag(mass), subset_by_index=[0, len(free) - 1])
    found: list[np.ndarray] = []
    for vector in vectors.T:
        shape = np.zeros(model.dof_count)
        shape[free] = vector
        moved = shape[:nodes].reshape(-1, 3)
        rms = np.sqrt((moved**2).sum() / (translations / 3.0))
        # a mode of twist moves no node
        if rms**2 * mass[free < nodes].mean() * translations < 1e-3:
            continue
        biggest = moved.flat[int(np.argmax(np.abs(moved)))]
        found.append(moved / rms * np.sign(biggest))
        if len(found) == count:
            break
    if len(found) < count:
        raise ParameterError(f"modes = {count}, but only {len(found)} modes of this robot move its nodes")
    return np.array(found)
