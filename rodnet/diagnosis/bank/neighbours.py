"""Candidates about a medium that rods jam, or shield each other from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from rodnet.diagnosis.candidate import Candidate, Family, with_term
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.drag.crowding import CrowdedForce
from rodnet.terms.drag.resistive import ResistiveForce

# distances at which rods may notice each other, over the least: what is within may be a step, so they are close
FARTHER = (1.0, 1.4, 2.0, 2.8, 4.0)
AT_ONCE = 0.15  # softness of a crowd that jams the medium, near enough to a step


def crowd(robot: Robot, name: str, reach: float) -> Robot | None:
    """Return a robot whose law ``name`` of resistive force depends on neighbours within a distance [m]."""
    for k, term in enumerate(robot.terms):
        if term.name == name and type(term) is ResistiveForce:
            args, options = term._given
            made = CrowdedForce(*args, **{**options, "name": name, "crowding": 0.0, "range": reach})
            for key, parameter in term.parameter_items():
                setattr(made, key, parameter)  # shared, if it was
            return with_term(robot, k, made)
    return None


def crowdable(robot: Robot) -> list[ResistiveForce]:
    """Return the laws of a robot that may depend on neighbours."""
    return [t for t in robot.terms if type(t) is ResistiveForce and not t.axial_torque]


def _crowds(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    for law in crowdable(robot):
        found = reaches(robot, robot.graph.edge_indices(law.on))
        if not found:
            continue
        yield Candidate(
            id=f"neighbours@{law.name}",
            title=f"{neighbours.title} ({law.name})",
            group="medium",
            build=partial(crowd, name=law.name, reach=found[0]),
            strength=(f"{law.name}.crowding",),
            shape=(f"{law.name}.range", f"{law.name}.softness"),
            falsifier=neighbours.falsifier,
            bank=_Reaches(law.name, found),
        )


def reaches(robot: Robot, edges: np.ndarray) -> tuple[float, ...]:
    """Distances at which the rods of some edges may notice each other [m]: where they are nearest, or where they meet.

    Empty for one rod.
    """
    graph = robot.graph
    rods = [e for rod in graph.rods.values() if len(e := np.intersect1d(rod.edges, edges))]
    mine = [np.unique(graph.edges[e]) for e in rods]
    pairs = [(a, b) for k, a in enumerate(mine) for b in mine[:k]]
    apart = [(a, b) for a, b in pairs if not len(np.intersect1d(a, b))]
    gaps = [float(np.linalg.norm(graph.x0[a][:, None] - graph.x0[b], axis=2).min()) for a, b in apart]
    least = 2.0 * float(graph.rest_length[edges].max()) * (1.0 + 1e-9)  # what the mesh allows
    longest = max((float(graph.rest_length[e].sum()) for e in rods), default=0.0)
    met = [f * least for f in FARTHER if f * least < longest] if len(apart) < len(pairs) else []
    near = max(1.5 * min(gaps), least) if gaps else 0.0
    if not gaps or (met and near >= longest):
        return tuple(met)
    return tuple(sorted({near, FARTHER[1] * near, FARTHER[2] * near, *met}))


class _Reaches:
    """Distances at which rods notice each other, from the mesh's on, little by little or at once."""

    def __init__(self, name: str, reaches: tuple[float, ...]) -> None:
        self.name, self.reaches = name, reaches

    def __call__(self, robot: Robot, duration: float) -> dict[str, tuple[float, ...]]:
        return {f"{self.name}.range": self.reaches, f"{self.name}.softness": (1.0, AT_ONCE)}


neighbours = Family(
    "neighbours",
    "drag that grows (or shrinks) where rods are close to each other",
    "medium",
    "a robot of one straight rod moves as the model says; the nearer rods are to each other, the more it is off",
    _crowds,
    (CrowdedForce.declared()["crowding"],),
    (CrowdedForce.declared()["range"], CrowdedForce.declared()["softness"]),
    (CrowdedForce,),
)
