"""What the bank's families are made with: terms added to a robot, one for all of it or one for each rod."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from rodnet.diagnosis.candidate import Candidate, Family, add_terms
from rodnet.graph.rod_graph import Rod
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.base import Term


def soft_rods(robot: Robot, edges: int = 3) -> list[Rod]:
    """Rods that bend, of so many edges or more."""
    graph = robot.graph
    return [rod for rod in graph.rods.values() if rod.material is not None and len(rod.edges) >= edges]


# mean and standard deviation of a share from 0 to 1 that some motions tell, and others (in a plane) do not
SHARE = 0.5, 0.4


@dataclass(frozen=True)
class Added:
    """Makes candidates that add a term.

    Attributes
    ----------
    id, title, group, falsifier : str
        As of the family; with rods the title is completed by the rod's name.
    cls : type
        The class of the term, whose name becomes the candidate's id.
    strength, shape : tuple of str
        Parameters of the term.
    options : mapping
        What the term is made with, strengths at their null values.
    rods : bool
        One for each rod that bends, or one on all rods.
    fits : callable or None
        ``fits(robot, on) -> bool``: whether a robot can have it; ``on`` is a rod or empty.
    more : callable or None
        ``more(robot, on) -> dict``: options that depend on the robot.
    bank, scale : callable or None
        As of a candidate, by name of the parameter instead of its path: ``bank(robot, duration, on)``.
    place, onset : str or None
        Names of the parameters.
    known : mapping
        What is known beforehand of parameters by name, (value, standard deviation); they begin at that value.
    """

    id: str
    title: str
    group: str
    falsifier: str
    cls: type[Term]
    strength: tuple[str, ...]
    shape: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    rods: bool = False
    fits: Callable[[Robot, str], bool] | None = None
    more: Callable[[Robot, str], Mapping[str, Any]] | None = None
    bank: Callable[[Robot, float, str], Mapping[str, Sequence[float]]] | None = None
    scale: Callable[[Robot, float, str], Mapping[str, float]] | None = None
    place: str | None = None
    onset: str | None = None
    known: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def family(self) -> Family:
        """Return the family."""
        own = self.cls.declared()
        strength, shape = (tuple(own[name] for name in names) for names in (self.strength, self.shape))
        return Family(self.id, self.title, self.group, self.falsifier, self, strength, shape, (self.cls,))

    def __call__(self, robot: Robot, instruments: Sequence[Observation] = ()) -> Iterator[Candidate]:
        """Return those that a robot has."""
        for on in [rod.name for rod in soft_rods(robot)] if self.rods else [""]:
            if self.fits is None or self.fits(robot, on):
                yield self.on(robot, on)

    def on(self, robot: Robot, on: str) -> Candidate:
        """Return the candidate on a rod, or on all of a robot."""
        return self.called(robot, on, {"on": on} if on else {})

    def called(self, robot: Robot, on: str, options: Mapping[str, Any]) -> Candidate:
        """Return the candidate whose id has ``on`` in it, and whose term takes more options."""
        name = f"{self.id}@{on}" if on else self.id
        begin = {parameter: value for parameter, (value, _) in self.known.items()}
        options = {**options, **self.options, **begin, "name": name}
        if self.more is not None:
            options |= self.more(robot, on)
        path = lambda parameter: f"{name}.{parameter}"  # noqa: E731
        return Candidate(
            id=name,
            title=f"{self.title} ({on})" if on else self.title,
            group=self.group,
            build=partial(add_terms, parts=((self.cls, options),)),
            strength=tuple(map(path, self.strength)),
            shape=tuple(map(path, self.shape)),
            falsifier=self.falsifier,
            bank=None if self.bank is None else Named(self.bank, name, on),
            scale=None if self.scale is None else Named(self.scale, name, on),
            place=None if self.place is None else path(self.place),
            onset=None if self.onset is None else path(self.onset),
            priors={path(p): told for p, told in self.known.items()},
            family=self.id,
            on=on,
        )


@dataclass(frozen=True)
class Named:
    """What a function tells by the names of parameters, by their paths."""

    function: Callable[[Robot, float, str], Mapping[str, Any]]
    name: str
    on: str

    def __call__(self, robot: Robot, duration: float) -> dict[str, Any]:
        found = self.function(robot, duration, self.on)
        return {f"{self.name}.{key}": value for key, value in found.items()}


def places(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    """Places along a rod to scan, and half widths, not below the mesh."""
    rod = robot.graph.rods[on]
    edge = float(robot.graph.rest_length[rod.edges].max() / rod.length)
    widths = sorted({max(0.05, 0.7 * edge), max(0.12, 0.7 * edge)})
    return {"place": tuple(np.round(np.linspace(0.05, 0.95, 10), 3).tolist()), "width": tuple(widths)}


def unchanged(robot: Robot) -> Robot:
    """Return the robot: it has the parameter already, at its null value."""
    return robot
