"""Candidates about the medium: laws of drag that the model's lacks."""

from __future__ import annotations

from rodnet.diagnosis.bank.making import Added
from rodnet.diagnosis.measures import Measures
from rodnet.robot import Robot
from rodnet.terms.drag.nonlinear import BinghamForce


def _creep(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    speed = Measures.of(robot, duration).speed
    return {"speed": (0.01 * speed, 0.1 * speed)}


yield_stress = Added(
    id="yield",
    title="a yield stress of the medium",
    group="medium",
    falsifier="slow motion meets almost as much force as fast motion, and a load below the threshold moves nothing",
    cls=BinghamForce,
    strength=("yield_stress",),
    shape=("speed",),
    options={"viscosity": 0.0, "yield_stress": 0.0, "zeta_t": 0.0, "zeta_n": 0.0},
    more=lambda robot, on: {"speed": 0.03 * Measures.of(robot, 1.0).speed},
    bank=_creep,
).family()
