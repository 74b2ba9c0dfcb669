"""Columns of changes of what a run begins with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.steppers import make_stepper
from rodnet.tangent.variation import STEP, Variation, stencil
from rodnet.terms.constraints import Constraint
from rodnet.terms.drag.stokes import StokesHead
from rodnet.terms.local.earlier import BalancedStart, EarlierSet
from rodnet.terms.tendons import Tendon


def by_start(
    robot: Robot, name: str, change: Mapping[str, Any], options: Mapping[str, Any], remembers: bool = True
) -> Variation:
    """Column of a change of the initial state: displacements ``x`` [m] and velocities ``v`` [m/s] of all nodes, and
    angles ``turn`` [rad] of the directors about edges that nothing holds, of robots without joints and bodies.

    Raises
    ------
    ParameterError
        If it is none, or of another shape.
    """
    shape = robot.graph.x0.shape
    unknown = sorted(set(change) - {"x", "v", "turn"})
    if unknown or not change:
        raise ParameterError(
            f"initial '{name}' has {', '.join(unknown) or 'nothing'}; give 'x' [m], 'v' [m/s] or 'turn' [rad]"
        )
    dx, dv = (np.zeros(shape) if change.get(k) is None else np.asarray(change[k], dtype=float) for k in "xv")
    for key, array in (("x", dx), ("v", dv)):
        if array.shape != shape or not np.all(np.isfinite(array)):
            raise ParameterError(
                f"initial '{name}': {key} must be finite and of shape {shape}, one row per node, got {array.shape}"
            )
    turn = change.get("turn")
    acts, graph = _felt(robot, dx, turn), robot.graph
    # directors are carried along by parallel transport, unless joints or bodies turn with them; memories may begin with
    # where the robot does
    rates = make_stepper(options.get("stepper", "euler")).needs_acceleration
    begun = remembers and (bool(dx.any()) or turn is not None)
    plain = not (graph.joints or graph.bodies or rates or begun)
    if plain and not acts:
        return Variation(name, "1", 0.0, (), acts=False, start=(dx, dv), turn=turn)
    shortest = float(graph.rest_length.min())
    start = (
        np.zeros(shape) if options.get("velocity") is None else np.asarray(options["velocity"], dtype=float)
    )
    of_v = max(np.abs(start).max(), shortest)
    largest = max(float(np.abs(dx).max()) / shortest, float(np.abs(dv).max()) / of_v)
    step = STEP / largest if largest > 0.0 else STEP
    near = []
    for weight, place in stencil(0.0, step, (-np.inf, np.inf)):
        posed = graph.with_positions(graph.x0 + place * dx) if dx.any() else graph
        posed = posed if turn is None else posed.twisted(place * turn)
        other = robot if posed is graph else Robot(posed, robot.terms, robot.sensors)
        near.append((weight, Simulation(other, **{**options, "velocity": start + place * dv})))
    return Variation(name, "1", 0.0, tuple(near), acts=acts)


def _felt(robot: Robot, dx: np.ndarray, turn: np.ndarray | None = None) -> bool:
    """Whether a change of the initial positions changes more than where a run begins.

    What is held is held where it was, directions of walls, joints and bodies are as they were, and tendons are
    as long: only these terms of rodnet look at the initial positions, those that are defined by the shape at the start,
    and heads of a shape of their own; those of others may.
    """
    graph = robot.graph
    defined = any(
        isinstance(t, EarlierSet | BalancedStart)
        or (isinstance(t, StokesHead) and t.shape is not None and graph.figure is None)
        for t in robot.terms
    )
    if defined:
        return bool(dx.any()) or turn is not None
    known = np.zeros(graph.node_count, dtype=bool)
    for term in robot.terms:
        if not type(term).__module__.startswith("rodnet.") or isinstance(term, Tendon):
            return bool(dx.any())
        if isinstance(term, Constraint):
            known[term.held_nodes(graph)] = True
            for node in (*term.walls(graph), *(joint.node for joint in term.pivots(graph))):
                known[graph.edges[(graph.edges == node).any(axis=1)]] = True
    for joint in graph.joints:
        known[graph.edges[(graph.edges == joint.node).any(axis=1)]] = True
    for body in graph.bodies:
        known[body.nodes] = True
    return bool(dx[known].any())
