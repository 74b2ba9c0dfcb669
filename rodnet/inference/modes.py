"""Smooth changes of a robot's state: its softest modes of vibration."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from rodnet.errors import ParameterError
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.steppers import State

FLOOR = 1e-9  # of the largest inertia of its kind, where there is none
STILL = 1e-3  # share of the kinetic energy of nodes below which a mode is one of twist


def soft_modes(robot: Robot, count: int, state: State | None = None) -> np.ndarray:
    """Displacements that cost the least elastic energy for the mass that they move.

    They are smooth along rods, keep lengths, leave alone what is held and stiff, move rigid bodies as such, and of
    a free robot the first ones are its rigid motions. Each has the rms displacement 1 over the nodes that move.

    Parameters
    ----------
    robot : Robot
        The robot.
    count : int
        How many.
    state : State, optional
        About which; by default the initial one.

    Returns
    -------
    ndarray, shape (count, dof_count)
        [1], [rad/m]; times an amplitude in metres, or in metres per second. The first 3 N are the nodes'.

    Raises
    ------
    ParameterError
        If the robot has fewer.
    """
    sim = Simulation(robot, 1.0)
    if state is not None:
        sim.restore(state)
    model, bodies = sim.model, sim.newton.ev.bodies
    stiffness, mass = _matrices(sim)
    free = model.free
    own = np.diag(mass).copy()
    nodal = free < model.twist0
    for kind in (nodal, ~nodal):
        if kind.any():
            own[kind] = np.maximum(own[kind], FLOOR * own[kind].max())
    mass[np.diag_indices(len(own))] = own
    able = int(np.count_nonzero(nodal))
    if not 0 < count <= able:
        raise ParameterError(f"modes = {count} must be from 1 to {able}, what the robot's nodes can do")
    _, vectors = eigh(stiffness, mass)
    nodes, heavy = 3 * robot.graph.node_count, float(own[nodal].sum())
    found: list[np.ndarray] = []
    for vector in vectors.T:
        shape = np.zeros(model.dof_count)
        shape[free] = vector
        if bodies is not None:
            bodies.spread(shape)
        moved = np.abs(shape[:nodes]).reshape(-1, 3)
        rms = np.sqrt((moved**2).sum() / max(np.count_nonzero(model.movable[:nodes]) / 3.0, 1.0))
        if rms**2 * heavy < STILL:
            continue
        found.append(shape / rms * np.sign(shape[int(np.argmax(moved))]))
        if len(found) == count:
            return np.array(found)
    raise ParameterError(f"modes = {count}, but only {len(found)} modes of this robot move its nodes")


def _matrices(sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass over the free degrees of freedom, motors being as they are."""
    model, ev, state = sim.model, sim.newton.ev, sim.state
    for bound, memory in zip(model.bound, state.memories, strict=True):
        if memory is not None:
            bound.restore(model, memory)
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.a[:] = 0.0

    def jacobian(ca: float) -> np.ndarray:
        ev.ca = ca
        if ev.bodies is not None:
            ev.bodies.ca = ca if ca else -1.0
        ev.update(state.q, np.zeros(model.dof_count), state.t, 1.0, 0.0, True)
        return np.asarray(model.jacobian().toarray())

    K, M = jacobian(0.0), np.diag(np.asarray(model.mass[model.free], dtype=float))
    if ev.bodies is not None:  # they bring their own inertia
        M = M + jacobian(1.0) - K
    return 0.5 * (K + K.T), 0.5 * (M + M.T)
