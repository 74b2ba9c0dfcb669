"""What is more likely a mistake than meant, units, tendons that fold, motors that turn in vain: told, never refused."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import PlausibilityWarning
from rodnet.graph.rod_graph import RodGraph
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.joint_frames import initial_twists
from rodnet.terms.actuators import _BoundTwist
from rodnet.terms.dissipation import KelvinVoigt
from rodnet.terms.drag.line import DragModel
from rodnet.terms.friction import DryFriction
from rodnet.terms.tendons import _BoundTendon

if TYPE_CHECKING:
    from rodnet.solve.model import Model

THICK = 0.25  # radius of a rod [m]; one of 1 mm, given in mm, is 1
SOFT = 50.0  # Young's modulus [Pa]; the softest gels have some hundreds
LIGHT = 10.0  # density [kg/m^3]; water in g/cm^3 is 1


def doubts(graph: RodGraph) -> list[str]:
    """Return what looks like a mistake in the units of a robot, a sentence each.

    Parameters
    ----------
    graph : RodGraph
        The robot's rods.
    """
    found = []
    for rod in graph.rods.values():
        if rod.material is None:
            continue
        spec, r = graph.figure.specs[rod.name], float(np.median(graph.radius[rod.edges]))
        length, E, rho = rod.length / len(rod.edges), *(float(np.min(spec.property(k))) for k in ("E", "rho"))
        if r > THICK:
            found.append(
                f"the radius of '{rod.name}' is {r:.3g} m; if lengths are in millimetres, multiply by 1e-3"
            )
        elif length < r and rod.named is None:  # edges in two, to see what the mesh does, were whole before
            found.append(
                f"the edges of '{rod.name}' are {length:.3g} m long and its radius is {r:.3g} m, so that an edge is no "
                "rod: check the units of both (m), or use fewer edges"
            )
        if E < SOFT:
            found.append(f"Young's modulus of '{rod.name}' is {E:.3g} Pa; if it is in MPa, multiply by 1e6")
        if rho < LIGHT:
            found.append(
                f"the density of '{rod.name}' is {rho:.3g} kg/m^3; if it is in g/cm^3, multiply by 1e3"
            )
    return found


def warn_of_units(graph: RodGraph, level: int = 3) -> None:
    """Warn of units that do not seem to be meant; of the first few rods, if it is many."""
    found = doubts(graph)
    if found:
        more = f" (and {len(found) - 2} more)" if len(found) > 2 else ""
        warnings.warn("; ".join(found[:2]) + more, PlausibilityWarning, stacklevel=level + 1)


# -- tendons that fold --------------------------------------------------------------------------
FOLD = 0.05  # turn of an edge at which two eyelets on it pass each other [rad]


def folding_tendons(model: Model) -> list[str]:
    """Return which tendons run backwards between two eyelets as soon as the robot bends a little, a sentence each.

    Beside the axis of a rod that bends, eyelets move along it by their offset times the turn.
    """
    found = []
    for tendon in (b for b in model.bound if isinstance(b, _BoundTendon)):
        arm = np.linalg.norm(
            tendon.offsets.sum(axis=1)[:, :2], axis=1
        )  # an inner node's is shared by two edges
        beside = np.minimum(arm[:-1], arm[1:])
        turns = np.any(tendon.edges[:-1] != tendon.edges[1:], axis=1)  # else both turn together
        short = np.flatnonzero((tendon.natural < FOLD * beside) & turns)
        if len(short):
            k = int(short[0])
            gap, off = tendon.natural[k], beside[k]
            found.append(
                f"tendon '{tendon.term.name}': eyelets {k} and {k + 1} of its route are {gap:.2g} m apart and "
                f"{off:.2g} m beside the axis, so that a turn of {gap / off:.1g} rad makes it run backwards between "
                "them; leave one of them out of route="
            )
    return found


def warn_of_folding_tendons(model: Model, level: int = 3) -> None:
    """Warn of tendons whose eyelets are too close together."""
    for sentence in folding_tendons(model):
        warnings.warn(sentence, PlausibilityWarning, stacklevel=level + 1)


# -- what a motor turns in vain ---------------------------------------------------------------
IN_LINE = 1e-6  # distance from the axis of a motor, over the length of an edge, of what lies in it [1]


def idle_motors(model: Model, q: np.ndarray) -> list[str]:
    """Return which motors turn a part that meets no torque of the medium at all, a sentence each.

    A part that lies in the motor's axis moves nothing when it spins, so laws of drag along rods alone leave it
    free: it takes all of the motor's speed, and the rest of the robot stands still.

    Parameters
    ----------
    model : Model
        The robot, bound.
    q : ndarray, shape (dof_count,)
        Its initial state.
    """
    motors = [b for b in model.bound if isinstance(b, _BoundTwist)]
    media = any(isinstance(term, DragModel) for term in model.robot.terms)
    unsure = any(term.kind == "contact" for term in model.robot.terms) or model.bodies is not None
    if not motors or not media or unsure:
        return []
    found = []
    for motor in motors:
        pair = int(model.edge1[motor.spring]), int(model.edge2[motor.spring])
        if max(pair) >= model.graph.edge_count:
            continue
        for edge in pair:
            spun = _in_line(model, motor.spring, edge)
            if spun is not None and _spins_freely(model, q, edge, spun):
                part = model.graph.edge_name(edge).partition(":")[0]
                found.append(
                    f"motor '{motor.term.name}' turns '{part}', which lies in its axis and meets no torque about it: "
                    "it will spin freely and the rest stand still; give the drag law axial_torque=True, or the part a "
                    "rodnet.StokesHead"
                )
                break
    return found


def warn_of_idle_motors(model: Model, q: np.ndarray, level: int = 3) -> None:
    """Warn of motors that turn a part that nothing holds."""
    for sentence in idle_motors(model, q):
        warnings.warn(sentence, PlausibilityWarning, stacklevel=level + 1)


def _in_line(model: Model, motor: int, start: int) -> list[int] | None:
    """Edges of the side of a motor that an edge is of, if all of them lie in its axis; else None."""
    node, x, edges = int(model.spring_node[motor]), model.x0, model.edges[: model.graph.edge_count]
    axis, limit = model.t0[start], IN_LINE * model.rest_length[start]
    here = np.flatnonzero(model.spring_node == node)
    links = [{int(model.edge1[s]), int(model.edge2[s])} for s in here if s != motor]
    side, new = [start], [start]
    while new:
        edge = new.pop()
        for end in edges[edge].tolist():
            away = x[end] - x[node]
            if np.linalg.norm(away - (away @ axis) * axis) > limit:
                return None
            if end == node:
                near = [e for link in links if edge in link for e in link]
            else:
                near = np.flatnonzero((edges == end).any(axis=1)).tolist()
            fresh = [e for e in near if e not in side]
            side += fresh
            new += fresh
    return side


def _spins_freely(model: Model, q: np.ndarray, edge: int, side: list[int]) -> bool:
    """Whether no term but those inside the robot resists the spin of edges that lie in one line."""
    twists = model.twist0 + np.array(side)
    places = (3 * model.edges[side].ravel()[:, None] + np.arange(3)).ravel()
    free = np.zeros(model.dof_count, dtype=bool)
    free[model.free] = True
    if not free[twists].all() or not free[places].all():
        return False
    rates = np.zeros(model.dof_count)
    rates[twists] = np.sign(model.t0[side] @ model.t0[edge])
    ev = Evaluation(model)
    ev.set_source(model.t0, model.d10, initial_twists(model), q)
    ev.update(q, rates, 0.0, 1.0, 0.0, False)
    inner = KelvinVoigt, DryFriction
    outer = [b for b in model.bound if b.term.kind in ("drag", "load") and not isinstance(b.term, inner)]
    return all(not b.forces(ev)[twists].any() for b in outer)
