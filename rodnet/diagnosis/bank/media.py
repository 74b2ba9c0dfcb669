"""Candidates about the medium: what its drag depends on beside what the model says."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rodnet.diagnosis.bank.making import Added, places
from rodnet.diagnosis.candidate import Candidate
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
