"""From a scenario of cosseratbench to a robot of rodnet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cosseratbench.scenario import End, EndCondition, Motion, Plane, Rod, Scenario

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
        Any scenario of the suite whose ends slide along x, y or z (see `upright`).
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
    terms: list[rn.Term] = [rn.Stretching(), rn.MidframeBending(), rn.Twisting()]
    if not scenario.quasi_static:
        terms.append(rn.ConsistentMass())
    weight = float(np.linalg.norm(scenario.gravity))
    if weight > 0.0:
        terms.append(rn.Gravity(g=weight, direction=scenario.gravity))
    if damping > 0.0:
        terms.append(rn.MassDamping(rate=damping))
    for index, rod in enumerate(scenario.rods):
        terms += _loads(rod, rod_name(index)) + _ends(rod, rod_name(index), n_elements)
    return rn.Robot(graph, terms + contact_terms(scenario, graph))


def upright(scenario: Scenario) -> np.ndarray:
    """Rotation (3, 3) that brings the directions along which ends slide to coordinate axes.

    Raises
    ------
    NotImplementedError
        If there is none: ends that slide along directions which are neither parallel nor normal to each other.
    """
    motions = (rod.motion(end) for rod in scenario.rods for end in End)
    axes = [m.axis for m in motions if m is not None and m.slides_along is not None]
    basis: list[np.ndarray] = []
    for axis in axes:
        along = np.abs([axis @ other for other in basis])
        if not np.any(along > 1.0 - 1e-12):
            if np.any(along > 1e-6):
                raise NotImplementedError(
                    "ends that slide along directions neither parallel nor normal to each other"
                )
            basis.append(axis)
    if all(np.count_nonzero(np.abs(axis) > 1e-12) == 1 for axis in basis):
        return np.eye(3)
    # the directions, completed to a right-handed frame
    q, _ = np.linalg.qr(np.column_stack([*basis, np.eye(3)]))
    q[:, : len(basis)] = np.column_stack(basis)
    q[:, 2] = np.cross(q[:, 0], q[:, 1])
    return q.T


def turned(scenario: Scenario, turn: np.ndarray) -> Scenario:
    """The same scenario in axes that are turned by a rotation (3, 3)."""
    v = lambda a: tuple((turn @ np.asarray(a, dtype=float)).tolist())  # noqa: E731
    each = lambda rows: tuple(v(row) for row in rows)  # noqa: E731

    def motion(m: Motion | None) -> Motion | None:
        if m is None:
            return None
        along = None if m.slides_along is None else v(m.axis)
        if along is not None:  # exactly along a coordinate axis
            along = tuple(np.where(np.abs(along) > 0.5, np.sign(along), 0.0).tolist())
            keep = [i for i in range(3) if along[i]]
            shift, spin = (np.array(each(rows)) for rows in (m.displacement, m.rotation))
            shift[:, keep] = 0.0
            spin[:, [i for i in range(3) if i not in keep]] = 0.0
            return replace(
                m, displacement=tuple(map(tuple, shift)), rotation=tuple(map(tuple, spin)), slides_along=along
            )
        return replace(m, displacement=each(m.displacement), rotation=each(m.rotation))

    rods = tuple(
        replace(
            rod,
            centerline=each(rod.centerline),
            normal=v(rod.normal),
            loads=tuple(replace(load, force=v(load.force)) for load in rod.loads),
            start_motion=motion(rod.start_motion),
            end_motion=motion(rod.end_motion),
        )
        for rod in scenario.rods
    )
    obstacles = tuple(
        replace(o, point=v(o.point), normal=v(o.normal))
        if isinstance(o, Plane)
        else replace(o, center=v(o.center), axis=v(o.axis))
        for o in scenario.obstacles
    )
    return replace(scenario, rods=rods, obstacles=obstacles, gravity=v(scenario.gravity))


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
            lean = _smallest_rotation(nodes[first + 1] - nodes[first], points[first + 1] - points[first])
            terms.append(_clamp(at, held, rod.motion(end), lean))
    return terms


def _clamp(at: str, name: str, motion: Motion | None, lean: np.ndarray) -> rn.Term:
    """A clamp, at rest or driven, whose direction is turned against the edge's by ``lean``."""
    if motion is None:
        return rn.PrescribedMotion(at=at, orientation=lambda t: lean, name=name)
    turn = lambda t: motion.pose(max(t, 0.0))[1] @ lean  # noqa: E731
    shift = lambda t: motion.pose(max(t, 0.0))[0]  # noqa: E731
    if motion.slides_along is not None:
        return rn.Slider(at=at, axis=motion.axis, position=shift, orientation=turn, name=name)
    return rn.PrescribedMotion(at=at, position=shift, orientation=turn, name=name)


def _smallest_rotation(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Matrix of the smallest rotation that takes one direction to another."""
    from rodnet.kinematics.frames import transport, unit

    return transport(np.eye(3), unit(old), unit(new)).T
