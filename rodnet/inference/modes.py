"""Smooth changes of a robot's state: its softest modes of vibration."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from rodnet.errors import ParameterError
from rodnet.kinematics.frames import unit
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.steppers import State
from rodnet.terms.tendons import Tendon

FLOOR = 1e-9  # of the largest inertia of its kind, where there is none
# of an eigenvalue: what is nearer to another belongs with it, as do two that are nothing but round-off of the largest
TOGETHER, NOTHING = 0.05, 1e-13
# by which modes that belong together are told apart: directions that nothing singles out, in the first of which
# displacements count more, and places farther along the second
ASIDE, ALONG = np.array([0.28, 0.77, 0.57]), np.array([0.61, -0.35, 0.71])
COUNT = np.eye(3) + 2.0 * np.outer(ASIDE, ASIDE) + np.outer(ALONG, ALONG)
STRAIGHT = 1.0 - 1e-6  # cosine of the angle below which two edges are bent
STILL = 1e-3  # share of the kinetic energy of nodes below which a mode is one of twist


def soft_modes(robot: Robot, count: int, state: State | None = None) -> np.ndarray:
    """Displacements that cost the least elastic energy for the mass that they move.

    They are smooth along rods, keep lengths, leave alone what is held and stiff, move rigid bodies as such, and of
    a free robot the first ones are its rigid motions. Each has the rms displacement 1 over the length of the rods.
    They are the same on another mesh: of modes that cost the same (a straight rod's to either side) any combination is
    one, so these are told apart, and signs chosen, by a direction in space that nothing singles out.

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
    squares, vectors = eigh(stiffness, mass)
    graph, heavy = robot.graph, float(own[nodal].sum())
    nodes = 3 * graph.node_count
    lengths = np.bincount(graph.edges.ravel(), np.repeat(graph.rest_length, 2), graph.node_count)
    share = lengths / lengths.sum()
    away = graph.x0 - share @ graph.x0
    uneven = share * (1.0 + 0.4 * (away @ ALONG) / max(float(np.abs(away).max()), FLOOR))
    found: list[np.ndarray] = []
    least = NOTHING * float(np.abs(squares).max())
    ends = np.flatnonzero(np.diff(squares) > np.maximum(TOGETHER * squares[1:], least)) + 1
    for group in np.split(vectors, ends, axis=1):
        shapes = np.zeros((model.dof_count, group.shape[1]), order="F")
        shapes[free] = group
        if bodies is not None:
            for shape in shapes.T:
                bodies.spread(shape)
        moved = shapes[:nodes].reshape(-1, 3, group.shape[1])
        turns = np.linalg.eigh(np.einsum("n,nik,ij,njm->km", uneven, moved, COUNT, moved, optimize=True))[1]
        for shape in (shapes @ turns[:, ::-1]).T:
            moved = shape[:nodes].reshape(-1, 3)
            sizes = np.sum(moved**2, axis=1)
            rms = float(np.sqrt(share @ sizes))
            if rms**2 * heavy < STILL:
                continue
            found.append(shape / rms * (1.0 if (uneven * sizes) @ (moved @ ALONG) > 0.0 else -1.0))
            if len(found) == count:
                return np.array(found)
    raise ParameterError(f"modes = {count}, but only {len(found)} modes of this robot move its nodes")


def twist_mode(robot: Robot) -> np.ndarray | None:
    """The softest way in which rods can be twisted while their axes stay where they are.

    Nodes say nothing of it, and a bent rod that begins with another twist than it is at rest with swings as it
    untwists. It has the rms 1 over the length of the rods, and turns them more ahead than back.

    Returns
    -------
    ndarray, shape (edge_count,), or None
        Angles [1]. None where nothing bent can twist, as a straight rod's twist moves none of its nodes, and where
        joints, bodies or tendons hold on to the directors that are drawn.
    """
    graph = robot.graph
    foreign = any(not type(term).__module__.startswith("rodnet.") for term in robot.terms)
    if graph.joints or graph.bodies or foreign or any(isinstance(term, Tendon) for term in robot.terms):
        return None
    sim = Simulation(robot, 1.0)
    model = sim.model
    turning = np.flatnonzero(model.free >= model.twist0)
    if not len(turning) or not _bent(model):
        return None
    stiffness, mass = (matrix[np.ix_(turning, turning)] for matrix in _matrices(sim))
    own = np.diag(mass).copy()
    mass[np.diag_indices(len(own))] = np.maximum(own, FLOOR * max(float(own.max()), FLOOR))
    shape = np.zeros(model.edge_count)
    shape[model.free[turning] - model.twist0] = eigh(stiffness, mass, subset_by_index=[0, 0])[1][:, 0]
    share = graph.rest_length / graph.rest_length.sum()
    return np.asarray(shape / np.sqrt(share @ shape**2) * (1.0 if share @ shape > 0.0 else -1.0))


def _bent(model: Model) -> bool:
    """Whether edges that a spring joins enclose an angle."""
    x, edges = model.x0, model.edges
    along = unit(x[edges[:, 1]] - x[edges[:, 0]])
    return bool(np.any(np.abs(np.sum(along[model.edge1] * along[model.edge2], axis=1)) < STRAIGHT))


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
