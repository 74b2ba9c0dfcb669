"""Candidates about joints, roots and grips: they give, or do not point where they were drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rodnet.diagnosis.bank.making import SHARE, Added
from rodnet.diagnosis.candidate import Candidate, Family, free_parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.constraints import Constraint
from rodnet.terms.joints import JointElasticity
from rodnet.terms.local.joints import JointCompliance
from rodnet.terms.local.natural import NaturalAngle

MANY = 8  # joints, beyond which they are one candidate


def roots(robot: Robot) -> Iterator[tuple[str, list[str]]]:
    """Constraints that hold an orientation, by name, and the nodes at whose springs rods leave them."""
    graph = robot.graph
    for term in robot.terms:
        if not isinstance(term, Constraint) or "orientation" not in term.holds:
            continue
        nodes = set(term.walls(graph))
        held = np.zeros(graph.edge_count, dtype=bool)
        held[term.held_edges(graph)] = True
        one = held[graph.springs.edge1] != held[graph.springs.edge2]
        nodes |= set(graph.springs.node[one].tolist())
        if nodes:
            yield term.name, [graph.node_name(int(n)) for n in sorted(nodes)]


def welds(robot: Robot) -> list[str]:
    """Nodes at which springs join different rods, other than those of constraints."""
    graph = robot.graph
    number = np.zeros(graph.edge_count, dtype=int)
    for k, rod in enumerate(graph.rods.values()):
        number[rod.edges] = k
    springs = graph.springs
    soft = ~(graph.rigid[springs.edge1] & graph.rigid[springs.edge2])
    nodes = np.unique(springs.node[(number[springs.edge1] != number[springs.edge2]) & soft])
    held = [n for t in robot.terms if isinstance(t, Constraint) for n in t.held_nodes(graph)]
    return [graph.node_name(int(n)) for n in nodes if n not in held]


def _give(robot: Robot, duration: float, on: str) -> dict[str, float]:
    return {"length": 0.02 * max(rod.length for rod in robot.graph.rods.values())}


compliance = Added(
    id="root-compliance",
    title="a root or grip that gives",
    group="joint",
    falsifier="the rod turns at its root in proportion to the moment there, and straight behind it",
    cls=JointCompliance,
    strength=("length",),
    shape=("twist",),
    options={"length": 0.0},
    known={"twist": SHARE},  # a hinge gives in bending alone, a soft sleeve in both
    scale=_give,
)
direction = Added(
    id="root-direction",
    title="a root or grip that points elsewhere",
    group="joint",
    falsifier="the whole rod is turned about its root by one angle, loaded or not, and the angle turns with the root",
    cls=NaturalAngle,
    strength=("bend1", "bend2"),
)
twist = Added(
    id="grasp-twist",
    title="a rod that is turned about its axis in its root or grip",
    group="joint",
    falsifier="what bends the rod out of its plane changes sides when the grip is turned by half a turn",
    cls=NaturalAngle,
    strength=("twist",),
)


class _AtRoots:
    """Makes one candidate for each constraint that holds an orientation."""

    def __init__(self, made: Added) -> None:
        self.made = made

    def __call__(self, robot: Robot, instruments: Sequence[Observation] = ()) -> Iterator[Candidate]:
        for name, nodes in roots(robot):
            yield self.made.called(robot, name, {"at": nodes})


def _at_roots(made: Added) -> Family:
    return replace(made.family(), make=_AtRoots(made))


root_compliance = _at_roots(compliance)
root_direction = _at_roots(direction)
grasp_twist = _at_roots(twist)

weld = replace(
    compliance,
    id="joint-compliance",
    title="a joint that gives",
    falsifier="the angle between the rods at the joint changes in proportion to the moment there",
)


def _joints(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    nodes = welds(robot)
    if len(nodes) > MANY:
        yield weld.called(robot, "", {"at": nodes})
    else:
        for node in nodes:
            yield weld.called(robot, node, {"at": node})
    for term in robot.terms:  # of hinges and elastic joints, which have a stiffness
        if isinstance(term, JointElasticity) and any(j.stiffness is not None for j in robot.graph.joints):
            path = f"{term.name}.scale"
            yield Candidate(
                id=f"joint-compliance@{term.name}",
                title=f"another stiffness of the joints ({term.name})",
                group="joint",
                build=partial(free_parameter, path=path),
                strength=(path,),
                falsifier=weld.falsifier,
            )


joint_compliance = replace(weld.family(), make=_joints)
