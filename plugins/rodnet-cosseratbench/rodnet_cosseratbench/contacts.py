"""Contact terms of a scenario: obstacles, rods with each other and with themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
from cosseratbench.scenario import Cylinder, Obstacle, Plane, Rod, Scenario

import rodnet as rn
from rodnet.graph.rod_graph import RodGraph

REACH = 0.005  # over the radius: rods rest within so much of each other's surfaces
FIRMNESS = 0.03  # stiffness x reach over EA
SLIP = 1e-4  # speed below which what should stick creeps, over a rod's length [1/s]
DEEPEST = 0.5  # a shape that cuts into something by more of its radius begins inside


def contact_terms(scenario: Scenario, graph: RodGraph) -> list[rn.Term]:
    """Contact terms of a scenario.

    Raises
    ------
    NotImplementedError
        For rods with different friction that may touch each other, and rods that begin inside an obstacle.
    """
    terms: list[rn.Term] = []
    for index, rod in enumerate(scenario.rods):
        for k, obstacle in enumerate(scenario.obstacles):
            terms.append(_obstacle(obstacle, rod, f"rod{index}", _name(index, k), graph))
    if len(scenario.rods) > 1 or scenario.self_contact:
        terms.append(_rods(scenario, graph))
    return terms


def _name(index: int, k: int) -> str:
    return f"rod{index}_on_{k}"


def corner_cut(x: np.ndarray) -> float:
    """How far the chords between nodes lie inside the curve through them, at most [m].

    In the middle between two nodes, a cubic through these and the next ones is off the chord by
    (x1 + x2 - x0 - x3) / 16. What a rod is bent over lies on the inner side and would meet the chord first.

    Parameters
    ----------
    x : ndarray, shape (n, 3)
        Positions of a rod's nodes [m].
    """
    if len(x) < 4:
        return 0.0
    return float(np.linalg.norm(x[1:-2] + x[2:-1] - x[:-3] - x[3:], axis=1).max() / 16.0)


def _options(rod: Rod, friction: float, radius: float) -> dict[str, float]:
    reach = REACH * radius
    stiffness = FIRMNESS * rod.material.youngs_modulus * rod.area / reach
    return {"friction": friction, "reach": reach, "stiffness": stiffness, "slip": SLIP * rod.length}


def _obstacle(obstacle: Obstacle, rod: Rod, on: str, name: str, graph: RodGraph) -> rn.Term:
    options = _options(rod, max(obstacle.friction, rod.friction), rod.radius)
    x = graph.x0[graph.rods[on].nodes]
    thinner = max(rod.radius - corner_cut(x), DEEPEST * rod.radius)
    if isinstance(obstacle, Plane):
        normal = obstacle.unit_normal
        clearance = float(((x - np.asarray(obstacle.point)) @ normal).min())
        radius = _touching_radius(thinner, clearance, options["reach"], on)
        return rn.PlaneContact(obstacle.point, normal, on=on, name=name, rod_radius=radius, **options)
    center, axis = np.asarray(obstacle.center, dtype=float), obstacle.unit_axis
    clearance = _distance(x, center, axis) - obstacle.radius
    radius = _touching_radius(thinner, clearance, options["reach"], on)
    ends = center, center + axis
    return rn.TubeContact(ends, obstacle.radius, inside=False, on=on, name=name, rod_radius=radius, **options)


def _touching_radius(radius: float, clearance: float, reach: float, on: str) -> float:
    """Radius by which a rod touches an obstacle: smaller if it begins closer, for contact then begins there."""
    if clearance - 0.5 * reach >= radius:
        return radius
    if clearance < DEEPEST * radius:
        raise NotImplementedError(f"{on} begins inside an obstacle, with its axis {clearance:.3g} m from it")
    return clearance - 0.5 * reach


def _distance(x: np.ndarray, point: np.ndarray, axis: np.ndarray) -> float:
    """Distance between a polyline and a line."""
    across = (x - point) - ((x - point) @ axis)[:, None] * axis
    a, e = across[:-1], np.diff(across, axis=0)
    square = np.sum(e * e, axis=1)
    s = np.clip(-np.sum(a * e, axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return float(np.linalg.norm(a + s[:, None] * e, axis=1).min())


def _rods(scenario: Scenario, graph: RodGraph) -> rn.Term:
    """Contact of rods with each other and themselves; rods of one thickness touch along their curves."""
    friction, radii = ({getattr(rod, name) for rod in scenario.rods} for name in ("friction", "radius"))
    if len(friction) > 1:
        raise NotImplementedError("rods of different friction that may touch each other")
    weak = min(scenario.rods, key=lambda rod: rod.material.youngs_modulus * rod.area)
    options = _options(weak, friction.pop(), 2.0 * min(radii))
    if len(radii) == 1:
        radius = radii.pop()
        cut = max(corner_cut(graph.x0[rod.nodes]) for rod in graph.rods.values())
        options["rod_radius"] = max(radius - cut, DEEPEST * radius)
    return rn.RodContact(name="rods", **options)


def bound_cylinders(sim: rn.Simulation, scenario: Scenario) -> list[tuple[Any, Cylinder]]:
    """Contact terms of a simulation with cylinders, bound, and these."""
    names = {
        _name(i, k): obstacle
        for i in range(len(scenario.rods))
        for k, obstacle in enumerate(scenario.obstacles)
        if isinstance(obstacle, Cylinder)
    }
    return [(b, names[b.term.name]) for b in sim.model.bound if b.term.name in names]


def refuse_beyond_ends(sim: rn.Simulation, cylinders: list[tuple[Any, Cylinder]]) -> None:
    """Raise if a rod touches a cylinder beyond its ends, where rodnet's goes on and there is nothing to touch.

    Raises
    ------
    NotImplementedError
        For a rod that does.
    """
    x = sim.observe().x
    for bound, cylinder in cylinders:
        touching = bound.edge[bound.gaps(x) < bound.law[:, 1]]
        middle = x[sim.model.graph.edges[touching]].mean(axis=1)
        along = (middle - np.asarray(cylinder.center)) @ cylinder.unit_axis
        if np.any(np.abs(along) > 0.5 * cylinder.length):
            raise NotImplementedError("a rod that touches the end of a cylinder, or passes beyond it")
