"""From a scenario of cosseratbench to a robot of rodnet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cosseratbench.scenario import End, EndCondition, Motion, Rod, Scenario

import rodnet as rn
from rodnet.graph.rod_graph import RodGraph
from rodnet_cosseratbench.contacts import contact_terms


def rod_name(index: int) -> str:
    """Name of a scenario's rod in the robot."""
    return f"rod{index}"


def make_robot(scenario: Scenario, n_elements: int, *, damping: float = 0.0) -> rn.Robot:
    """Build the robot of a scenario, in its initial shape.

    Parameters
    ----------
    scenario : Scenario
        Any scenario of the suite.
    n_elements : int
        Edges per rod.
    damping : float
        Rate of damping in proportion to mass [1/s].

    Raises
    ------
    NotImplementedError
        If the scenario asks for what rodnet does not model; says what.
    """
    graph = _graph(scenario, n_elements)
    terms: list[rn.Term] = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    weight = float(np.linalg.norm(scenario.gravity))
    if weight > 0.0:
        terms.append(rn.Gravity(g=weight, direction=scenario.gravity))
    if damping > 0.0:
        terms.append(rn.MassDamping(rate=damping))
    for index, rod in enumerate(scenario.rods):
        terms += _loads(rod, rod_name(index)) + _ends(rod, rod_name(index), n_elements)
    return rn.Robot(graph, terms + contact_terms(scenario, graph))


def _graph(scenario: Scenario, n_elements: int) -> RodGraph:
    """Draw every rod unstretched, in the directions of its initial shape, then put it there.

    Directions and directors stay, so nothing is twisted; natural lengths are those along the rod.
    """
    fig, shape = rn.StickFigure(), []
    for index, rod in enumerate(scenario.rods):
        nodes = rod.nodes(n_elements)
        steps = np.diff(nodes, axis=0)
        steps *= rod.length / n_elements / np.linalg.norm(steps, axis=1, keepdims=True)
        rest = np.vstack([nodes[:1], nodes[0] + np.cumsum(steps, axis=0)])
        fig.rod(
            rod_name(index), rest, material=_material(rod), section=_section(rod), natural="straight",
            director=rod.directors(n_elements)[0],
        )  # fmt: skip
        shape.append(nodes)
    return fig.build().with_positions(np.concatenate(shape))


def _material(rod: Rod) -> rn.Material:
    return rn.Material(E=rod.material.youngs_modulus, nu=0.5, rho=rod.material.density)


def _section(rod: Rod) -> rn.Section:
    """Circle whose torsion constant makes up for any shear modulus, also one beyond Poisson's ratios."""
    circle = rn.circular(rod.radius)
    shear = rod.material.shear_modulus / _material(rod).G
    return rn.Section(circle.area, circle.I1, circle.I2, shear * circle.J, circle.radius)


def _loads(rod: Rod, name: str) -> list[rn.Term]:
    return [rn.PointForce(at=f"{name}.{load.at.value}", force=load.force) for load in rod.loads]


def _ends(rod: Rod, name: str, n_elements: int) -> list[rn.Term]:
    """Constraints of both ends."""
    terms: list[rn.Term] = []
    nodes, points = rod.nodes(n_elements), np.asarray(rod.centerline, dtype=float)
    for end in End:
        at, held = f"{name}.{end.value}", f"{name}_{end.value}"
        if rod.condition(end) is EndCondition.PINNED:
            terms.append(rn.Hinge(at=at, name=held))
        elif rod.condition(end) is EndCondition.CLAMPED:
            first = 0 if end is End.START else -2
            # a clamp holds the direction of the curve, from which the first edge, a chord, differs
            upright = _smallest_rotation(nodes[first + 1] - nodes[first], points[first + 1] - points[first])
            terms.append(_clamp(at, held, rod.motion(end), upright))
    return terms


def _clamp(at: str, name: str, motion: Motion | None, upright: np.ndarray) -> rn.Term:
    """A clamp, at rest or driven, whose direction is turned against the edge's by ``upright``."""
    if motion is None:
        return rn.PrescribedMotion(at=at, orientation=lambda t: upright, name=name)
    if motion.slides_along is not None:
        raise NotImplementedError("an end that slides along a direction")
    return rn.PrescribedMotion(
        at=at,
        position=lambda t: motion.pose(max(t, 0.0))[0],
        orientation=lambda t: motion.pose(max(t, 0.0))[1] @ upright,
        name=name,
    )


def _smallest_rotation(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Matrix of the smallest rotation that takes one direction to another."""
    from rodnet.kinematics.frames import transport, unit

    return transport(np.eye(3), unit(old), unit(new)).T


Pose = Callable[[float], np.ndarray]
