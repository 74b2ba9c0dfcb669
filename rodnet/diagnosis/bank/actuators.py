"""Candidates about what drives a robot: gains, delays, droop, friction, offsets of grips."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rodnet.diagnosis.bank.making import SHARE, unchanged
from rodnet.diagnosis.candidate import Candidate, Family, with_term
from rodnet.diagnosis.measures import Measures
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.actuators import CurvatureWave, Motor
from rodnet.terms.base import Term
from rodnet.terms.constraints import PrescribedMotion
from rodnet.terms.drives import DCMotor, SlowCurvature
from rodnet.terms.grasp import Grasp
from rodnet.terms.imperfect import ImperfectGrasp, ImperfectMotion
from rodnet.terms.tendons import Tendon

# what is commanded of each class, of which a gain is a share; a motor's angle may be any function of time
COMMANDS: dict[type[Term], tuple[str, ...]] = {
    Motor: ("rpm", "angle"), DCMotor: ("rpm",), CurvatureWave: ("amplitude",), SlowCurvature: ("curvature",),
    Tendon: ("tension", "pull"),
}  # fmt: skip
LOOKED_AT = np.linspace(0.0, 3.0, 31)  # [s] when a grip's orientation is looked at
TURNS = 1e-9, 2.8  # [rad] angles between which a rotation has an axis
DROOP = (
    0.05  # a change of speed worth considering, of the speed, under a moment that bends a rod by one radian
)


def replaced(
    robot: Robot, name: str, cls: type[Term], options: tuple[tuple[str, Any], ...] = ()
) -> Robot | None:
    """Return a robot with a term of another class in the place of ``name``, with its arguments and parameters.

    It may be of that class already, for another of its effects.
    """
    for k, term in enumerate(robot.terms):
        if term.name == name:
            args, given = term._given
            made = cls(*args, **{**given, **dict(options), "name": name})
            for key, parameter in term.parameter_items():
                if key not in dict(options):
                    setattr(made, key, parameter)  # shared, if it was
            return with_term(robot, k, made)
    return None


def _family(
    id: str,
    title: str,
    falsifier: str,
    find: Callable[[Robot], Iterator[tuple[Any, ...]]],
    parameters: tuple[Parameter, ...],
    scale: Callable[[Robot, float, str], dict[str, float]] | None = None,
    terms: tuple[type[Term], ...] = (),
) -> Family:
    """A family with one candidate for each term that ``find`` yields.

    That is: term, build, names of its strengths and, if there are any, of what shapes it.
    """

    def make(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
        for term, build, names, *shape in find(robot):
            yield Candidate(
                id=f"{id}@{term.name}",
                title=f"{title} ({term.name})",
                group="actuator",
                build=build,
                strength=tuple(f"{term.name}.{name}" for name in names),
                shape=tuple(f"{term.name}.{name}" for found in shape for name in found),
                priors={f"{term.name}.{name}": SHARE for found in shape for name in found},
                falsifier=falsifier,
                scale=None if scale is None else _Scaled(scale, term.name),
            )

    return Family(id, title, "actuator", falsifier, make, parameters, (), terms)


class _Scaled:
    """Scales by name, of the term they are about."""

    def __init__(self, function: Callable[[Robot, float, str], dict[str, float]], name: str) -> None:
        self.function, self.name = function, name

    def __call__(self, robot: Robot, duration: float) -> dict[str, float]:
        found = self.function(robot, duration, self.name)
        return {f"{self.name}.{key}": value for key, value in found.items()}


def _commanded(robot: Robot) -> Iterator[tuple[Term, Any, tuple[str, ...]]]:
    for term in robot.terms:
        commands = [getattr(term, name) for name in COMMANDS.get(type(term), ())]
        if _exact(term) and any(c if callable(c) else c is not None and c.value for c in commands):
            yield term, unchanged, ("gain",)
        if type(term) is PrescribedMotion:
            moves = {"gain": term.displacement is not None, "turning": _turns(term)}
            names = tuple(name for name, does in moves.items() if does)
            if names:
                yield term, partial(replaced, name=term.name, cls=ImperfectMotion), names


def _exact(term: Term) -> bool:
    """Whether what a term is commanded is as it is told: what is off already is no null value."""
    gain = getattr(term, "gain", None)
    return isinstance(gain, Parameter) and gain.value == 0.0


def _turns(term: PrescribedMotion) -> bool:
    """Whether a prescribed motion turns, and by less than half a turn: then it has an axis to turn about further."""
    if term.rotation is None:
        return False
    angles = Rotation.from_matrix([term.rotation(t) for t in LOOKED_AT]).magnitude()
    return bool(TURNS[0] < angles.max() < TURNS[1])


def _late(robot: Robot) -> Iterator[tuple[Any, ...]]:
    for term in robot.terms:
        if type(term) is Motor and term.rpm.value is not None:
            yield term, partial(replaced, name=term.name, cls=DCMotor), ("lag",)
        if type(term) is CurvatureWave and term.lag.value == 0.0:
            yield term, unchanged, ("lag",)
        if type(term) in (PrescribedMotion, Grasp):
            cls = ImperfectMotion if type(term) is PrescribedMotion else ImperfectGrasp
            options = (("spread", SHARE[0]),)
            yield term, partial(replaced, name=term.name, cls=cls, options=options), ("lag",), ("spread",)


def _drooping(robot: Robot) -> Iterator[tuple[Term, Any, tuple[str, ...]]]:
    moment = Measures.of(robot, 1.0).moment
    for term in robot.terms:
        if type(term) is Motor and term.rpm.value is not None:
            options = (("stall_torque", moment),)
            yield term, partial(replaced, name=term.name, cls=DCMotor, options=options), ("no_load_rpm",)


def _rubbing(robot: Robot) -> Iterator[tuple[Term, Any, tuple[str, ...]]]:
    for term in robot.terms:
        if type(term) is Tendon and term.friction.value == 0.0:
            yield term, unchanged, ("friction",)


def _gripped(robot: Robot) -> Iterator[tuple[Term, Any, tuple[str, ...]]]:
    for term in robot.terms:
        if type(term) in (PrescribedMotion, Grasp):
            cls = ImperfectMotion if type(term) is PrescribedMotion else ImperfectGrasp
            yield term, partial(replaced, name=term.name, cls=cls), ("shift_x", "shift_y", "shift_z")


def _droop(robot: Robot, duration: float, name: str) -> dict[str, float]:
    return {"no_load_rpm": DROOP * abs(float(robot.parameters[f"{name}.rpm"].value)) or 1.0}


gain = _family(
    "drive-gain",
    "a drive that is stronger or weaker than commanded",
    "the error grows in proportion to the command, and is gone without it",
    _commanded,
    (
        Motor.declared()["gain"],
        ImperfectMotion.declared()["turning"],
    ),
    terms=(Motor, CurvatureWave, SlowCurvature, ImperfectMotion),
)
lag = _family(
    "drive-lag",
    "a drive that runs late",
    "the error is largest where the command changes fastest, and the sooner it changes the larger",
    _late,
    (DCMotor.declared()["lag"],),
    terms=(CurvatureWave, ImperfectGrasp),
)
droop = _family(
    "motor-droop",
    "a motor that slows down under load",
    "without load the motor runs as commanded; the speed falls in proportion to the torque",
    _drooping,
    (DCMotor.declared()["no_load_rpm"],),
    _droop,
    (DCMotor,),
)
tendon_friction = _family(
    "tendon-friction",
    "friction of a tendon at its eyelets",
    "the robot's shape at one tension depends on whether the tension was larger or smaller before",
    _rubbing,
    (Tendon.declared()["friction"],),
    terms=(Tendon,),
)
grasp_offset = _family(
    "grasp-offset",
    "a grip that holds the rod beside the place where it was measured",
    "the rod near the grip is shifted by one vector, which turns with the grip, at rest, too",
    _gripped,
    tuple(ImperfectGrasp.declared()[f"shift_{axis}"] for axis in "xyz"),
)
