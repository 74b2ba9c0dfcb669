"""Candidates about rods: stiffness, natural shape and mass that differ from what was drawn."""

from __future__ import annotations

from rodnet.diagnosis.bank.making import Added, places
from rodnet.diagnosis.measures import PART, Measures
from rodnet.robot import Robot
from rodnet.terms.local.natural import NaturalCurvature
from rodnet.terms.local.stiffness import StiffnessDefect


def _curvature(robot: Robot, duration: float, on: str) -> dict[str, float]:
    size = PART / robot.graph.rods[on].length if on else PART / Measures.of(robot, duration).length
    return {"kappa1": size, "kappa2": size}


stiffness_defect = Added(
    id="stiffness-defect",
    title="a soft spot of a rod",
    group="rod",
    falsifier="the rod bends more sharply at that place, by the same factor in every trial, whatever the load",
    cls=StiffnessDefect,
    strength=("loss",),
    shape=("place", "width"),
    options={"loss": 0.0},
    rods=True,
    bank=places,
    place="place",
).family()

natural_curvature = Added(
    id="natural-curvature",
    title="a natural curvature that was not drawn",
    group="rod",
    falsifier="the rod is bent without any load, and the bend turns with the rod when it is turned about its axis",
    cls=NaturalCurvature,
    strength=("kappa1", "kappa2"),
    rods=True,
    scale=_curvature,
).family()
