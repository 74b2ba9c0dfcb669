"""Candidates about the medium: what its drag depends on beside what the model says."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rodnet.diagnosis.bank.making import Added, places
from rodnet.diagnosis.candidate import Candidate, Family, with_term
from rodnet.diagnosis.measures import Measures
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.contact.elastic_wall import ElasticWall
from rodnet.terms.drag.changed import can_change
from rodnet.terms.drag.changes import (
    BackgroundFlow,
    DragAnisotropy,
    DragGradient,
    DragRegion,
    PowerLawChange,
    SwitchedDrag,
    WallDrag,
)
from rodnet.terms.drag.crowding import CrowdedForce
from rodnet.terms.drag.maxwell import MaxwellMedium
from rodnet.terms.drag.nonlinear import BinghamForce
from rodnet.terms.drag.resistive import ResistiveForce
from rodnet.terms.drag.spin import SpinDrag

SIDES = {
    "-z": (0.0, 0.0, 1.0), "+z": (0.0, 0.0, -1.0), "-x": (1.0, 0.0, 0.0), "+x": (-1.0, 0.0, 0.0),
    "-y": (0.0, 1.0, 0.0), "+y": (0.0, -1.0, 0.0),
}  # fmt: skip


def has_drag(robot: Robot, on: str) -> bool:
    """Whether a robot has a drag law that a change can look up."""
    return any(can_change(term) for term in robot.terms)


def has_none(robot: Robot, on: str) -> bool:
    """Whether it has none."""
    return not has_drag(robot, on)


def _slow(robot: Robot, on: str) -> dict[str, float]:
    return {"speed": 0.03 * Measures.of(robot, 1.0).speed}


def _creeps(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    speed = Measures.of(robot, duration).speed
    return {"speed": (0.01 * speed, 0.1 * speed)}


def _speeds(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    speed = Measures.of(robot, duration).speed
    return {"speed": (0.03 * speed, 0.3 * speed, 3.0 * speed)}


def _level(robot: Robot, on: str) -> dict[str, float]:
    return {"level": -float(robot.graph.x0[:, 2].mean())}


def _per_length(robot: Robot, duration: float, on: str) -> dict[str, float]:
    return {"gradient": 0.1 / Measures.of(robot, duration).length}


def _onsets(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    return {
        "onset": tuple(np.round(np.linspace(0.1, 0.9, 9) * duration, 6).tolist()),
        "ramp": (0.02 * duration,),
    }


def _times(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    return {"time": tuple((np.array((0.02, 0.06, 0.2, 0.6)) * duration).tolist())}


FARTHER = (
    1.0,
    1.4,
    2.0,
    2.8,
    4.0,
)  # distances at which rods may notice each other: what is within it may be a step
AT_ONCE = 0.15  # softness of a crowd that jams the medium, near enough to a step
BINGHAM: dict[str, Any] = {"viscosity": 0.0, "yield_stress": 0.0, "zeta_t": 0.0, "zeta_n": 0.0}

yield_stress = Added(
    id="yield",
    title="a yield stress of the medium",
    group="medium",
    falsifier="slow motion meets almost as much force as fast motion, more across rods than along them",
    cls=BinghamForce,
    strength=("yield_stress",),
    shape=("speed",),
    options=BINGHAM,
    more=_slow,
    bank=_creeps,
).family()

friction = Added(
    id="medium-friction",
    title="friction of the surroundings that does not depend on the rate",
    group="medium",
    falsifier="motion at half the speed meets the same force, as large along rods as across them",
    cls=BinghamForce,
    strength=("yield_stress",),
    shape=("speed",),
    options={**BINGHAM, "bearing": math.pi},  # as much across, 2 r bearing, as along, 2 pi r
    more=_slow,
    bank=_creeps,
).family()

power_law = Added(
    id="power-law",
    title="a medium that thins or thickens with the speed",
    group="medium",
    falsifier="doubling every speed multiplies the drag by less (or more) than the model says, by one factor",
    cls=PowerLawChange,
    strength=("exponent",),
    shape=("speed",),
    options={"exponent": 1.0},
    fits=has_drag,
    # the drag of the speeds that there are hardly changes with where the law begins
    more=lambda robot, on: {
        "speed": 0.1 * Measures.of(robot, 1.0).speed,
        "at": 0.5 * Measures.of(robot, 1.0).speed,
    },
    bank=_speeds,
).family()

anisotropy = Added(
    id="anisotropy",
    title="another ratio of the drag along rods to that across them",
    group="medium",
    falsifier="towing a straight rod along its axis needs another force than the model says, towing it across does not",
    cls=DragAnisotropy,
    strength=("along",),
    options={"along": 0.0},
    fits=has_drag,
).family()

drag_region = Added(
    id="drag-region",
    title="a part of a rod with more or less drag",
    group="medium",
    falsifier="that part of the rod lags behind its neighbours, in proportion to the speed, whichever way it moves",
    cls=DragRegion,
    strength=("gain",),
    shape=("place", "width"),
    options={"gain": 0.0},
    rods=True,
    fits=has_drag,
    bank=places,
    place="place",
).family()

depth = Added(
    id="depth",
    title="drag that changes with the depth",
    group="medium",
    falsifier="the same motion at another depth meets another drag",
    cls=DragGradient,
    strength=("gradient",),
    options={"gradient": 0.0},
    fits=has_drag,
    more=_level,
    scale=_per_length,
).family()

jam_onset = Added(
    id="jam-onset",
    title="a medium whose drag changes at a time: it jams, or loosens",
    group="medium",
    falsifier="before the onset the model is right, after it every motion is slower (or faster) by one factor",
    cls=SwitchedDrag,
    strength=("gain",),
    shape=("onset", "ramp"),
    options={"gain": 0.0},
    fits=has_drag,
    bank=_onsets,
    onset="onset",
).family()

flow = Added(
    id="flow",
    title="a current of the medium",
    group="medium",
    falsifier="a robot at rest drifts, faster where it lies across the current, and not in a medium that is stilled",
    cls=BackgroundFlow,
    strength=("u_x", "u_y", "u_z"),
    fits=has_drag,
).family()

viscoelastic = Added(
    id="viscoelastic-medium",
    title="a medium that is elastic for a while",
    group="medium",
    falsifier="what is moved and let go springs back a part of the way, less the longer it was held there",
    cls=MaxwellMedium,
    strength=("modulus",),
    shape=("time",),
    options={"modulus": 0.0},
    fits=has_drag,
    bank=_times,
).family()

axial_drag = Added(
    id="axial-drag",
    title="drag on the spin of rods about their own axes",
    group="medium",
    falsifier="a rod that spins faster needs more torque at its root, also where it is straight and stays in its place",
    cls=SpinDrag,
    strength=("viscosity",),
    options={"viscosity": 0.0},
).family()

viscous_drag = Added(
    id="viscous-drag",
    title="viscous drag, which the model has none of",
    group="medium",
    falsifier="vibrations decay faster, and slow motion lags, in proportion to the speed",
    cls=ResistiveForce,
    strength=("eta_n",),
    fits=has_none,
    # one parameter: as much along as across
    more=lambda robot, on: dict.fromkeys(
        ("eta_t", "eta_n"),
        Parameter(0.0, unit="Pa s", bounds=(0, None), null=0.0, doc="drag in every direction"),
    ),
).family()


def _nearest(robot: Robot, on: str) -> float:
    """Where a wall on some side is met first: at what of the robot is nearest to it [m]."""
    return float((robot.graph.x0 @ np.array(SIDES[on])).min())


def _short_of_it(robot: Robot, on: str, declared: Parameter) -> dict[str, Any]:
    """Rods begin short of it."""
    size, nearest = Measures.of(robot, 1.0).length, _nearest(robot, on)
    position = Parameter(
        nearest, unit="m", bounds=(-np.inf, nearest + 0.02 * size), kind="shape", doc=declared.doc
    )
    return {"normal": SIDES[on], "position": position}


def _farther_off(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    size = Measures.of(robot, duration).length
    away = np.array((0.0, 0.03, 0.06, 0.1, 0.15, 0.22, 0.3, 0.4))
    return {"position": tuple((_nearest(robot, on) - size * away).tolist())}


def _before_a_wall(robot: Robot, on: str) -> dict[str, Any]:
    near = 0.01 * Measures.of(robot, 1.0).length
    return _short_of_it(robot, on, WallDrag.declared()["position"]) | {"near": near}


def _steep_or_not(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    size = Measures.of(robot, duration).length
    away = np.array((0.0, 0.06, 0.15, 0.3))
    return {
        "position": tuple((_nearest(robot, on) - size * away).tolist()),
        "near": (0.01 * size, 0.06 * size),
    }


def _doubles(robot: Robot, duration: float, on: str) -> dict[str, float]:
    return {"reach": 0.01 * Measures.of(robot, duration).length}


_wall = Added(
    id="wall",
    title="a wall nearby, towards which the drag grows",
    group="medium",
    falsifier="the nearer to that side, the more drag; farther away from it the model is right",
    cls=WallDrag,
    strength=("reach",),
    shape=("position", "near"),
    options={"reach": 0.0},
    fits=has_drag,
    more=_before_a_wall,
    bank=_steep_or_not,
    scale=_doubles,
)


def _on_sides(made: Added, robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    """The candidate on each side that it fits to."""
    for side in SIDES:
        if made.fits is None or made.fits(robot, side):
            yield made.called(robot, side, {})


wall = replace(_wall.family(), make=partial(_on_sides, _wall))


def _before_an_obstacle(robot: Robot, on: str) -> dict[str, Any]:
    """Deeper in, it would be a bed of springs, which explains much that it isn't."""
    layer = 0.005 * Measures.of(robot, 1.0).length
    return _short_of_it(robot, on, ElasticWall.declared()["position"]) | {"layer": layer}


def _firm(robot: Robot, duration: float, on: str) -> dict[str, float]:
    m = Measures.of(robot, duration)
    return {"stiffness": m.force / m.length**2}


_obstacle = Added(
    id="obstacle",
    title="an obstacle that rods run into",
    group="medium",
    falsifier="short of it the model is right, whatever the speed; what is pressed against it is pushed back out",
    cls=ElasticWall,
    strength=("stiffness",),
    shape=("position",),
    options={"stiffness": 0.0},
    more=_before_an_obstacle,
    bank=_farther_off,
    scale=_firm,
)


obstacle = replace(_obstacle.family(), make=partial(_on_sides, _obstacle))


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
