"""Candidates about loads: weight, buoyancy, the inertia of the fluid around."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from rodnet.diagnosis.bank.making import Added, unchanged
from rodnet.diagnosis.candidate import Candidate, Family, add_terms
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.added_mass import AddedMass
from rodnet.terms.loads import Gravity
from rodnet.terms.tether import Tether

# along the vertical as `rodnet.Gravity` has it: what falls has a positive g
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, -1.0)}


def _weights(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    """Along the vertical, one parameter; and across it, where a camera or a table is not level."""
    parts = {
        axis: (Gravity, {"g": 0.0, "direction": direction, "name": f"weight-{axis}"})
        for axis, direction in AXES.items()
    }
    for on, axes in (("", "z"), ("sideways", "xy")):
        yield Candidate(
            id=f"{gravity.id}@{on}" if on else gravity.id,
            title=f"{gravity.title} ({on})" if on else gravity.title,
            group="load",
            build=partial(add_terms, parts=tuple(parts[axis] for axis in axes)),
            strength=tuple(f"weight-{axis}.g" for axis in axes),
            falsifier=gravity.falsifier,
        )


gravity = Family(
    "gravity",
    "a uniform force on all mass: gravity that the model lacks, or a camera that is not level",
    "load",
    "turned on its side the robot is off in another direction of its own; heavier parts sag more",
    _weights,
    (Gravity.declared()["g"],),
    (),
    (Gravity,),
)


def _afloat(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    for term in robot.terms:
        if type(term) is Gravity and term.fluid_density.value == 0.0 and term.g.value:
            yield Candidate(
                id=f"buoyancy@{term.name}",
                title=f"{buoyancy.title} ({term.name})",
                group="load",
                build=unchanged,
                strength=(f"{term.name}.fluid_density",),
                falsifier=buoyancy.falsifier,
            )


buoyancy = Family(
    "buoyancy",
    "buoyancy of a fluid around",
    "load",
    "thick light parts rise against thin heavy ones; a robot of the same shape and twice the density is off by less",
    _afloat,
    (Gravity.declared()["fluid_density"],),
)

added_mass = Added(
    id="added-mass",
    title="the inertia of the fluid that rods push aside",
    group="load",
    falsifier="vibrations are slower than in air by the same factor for all of them, and not more damped",
    cls=AddedMass,
    strength=("density",),
    options={"density": 0.0},
).family()


def _ties(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    """Places along a rod that something may be tied to."""
    return {"place": tuple(np.linspace(0.1, 1.0, 10).round(3).tolist())}


def _knot(robot: Robot, on: str) -> dict[str, object]:
    """A width that the mesh can show; and the middle between the rod's ends, for F far away would be another number."""
    rod = robot.graph.rods[on]
    width = max(0.03, 0.7 * float(robot.graph.rest_length[rod.edges].max() / rod.length))
    return {"width": width, "point": tuple(robot.graph.x0[rod.nodes[[0, -1]]].mean(axis=0).tolist())}


tether = Added(
    id="tether",
    title="a thread or wire that pulls at a place",
    group="load",
    falsifier="untied, or moved away as a whole, the robot is off no more, or by what the distance adds to the pull",
    cls=Tether,
    strength=("stiffness", "fx", "fy", "fz"),
    shape=("place",),
    options={"stiffness": 0.0},
    rods=True,
    more=_knot,
    bank=_ties,
    place="place",
).family()
