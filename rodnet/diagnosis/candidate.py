"""Candidate explanations: parametrised edits of a robot with a null value, at which they are the identity.

A `Candidate` is one edit of one robot. A `Family` makes them: one for a robot, or one for each rod, joint, grip or
motor that it could be about. Families and candidates announce themselves by entry points of the group
``rodnet.candidates``; every installed term with a null value that none of them uses is a candidate as it is.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rodnet.diagnosis.measures import Measures
from rodnet.errors import CaseError, RodnetError
from rodnet.inference.quantities import instrument_path
from rodnet.names import meant
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.tangent.columns import find, find_indexed
from rodnet.terms.base import Term
from rodnet.terms.drag.changed import flow_of
from rodnet.terms.drag.line import DragModel

GROUPS = ("medium", "load", "rod", "joint", "actuator", "observation", "marker")

Build = Callable[[Robot], Robot | None]
Bank = Callable[[Robot, float], Mapping[str, tuple[float, ...]]]
Scale = Callable[[Robot, float], Mapping[str, float]]


@dataclass(frozen=True)
class Candidate:
    """One explanation of why a robot moves otherwise than its model: an edit that is the identity at its null value.

    Attributes
    ----------
    id : str
        What reports call it, ``"stiffness-defect@tail1"``: the family's id, and what it is on.
    title : str
        In words.
    group : str
        ``"medium"``, ``"load"``, ``"rod"``, ``"joint"``, ``"actuator"``, ``"observation"`` or ``"marker"``.
    build : callable
        ``build(robot) -> Robot``: the robot with the effect in it, at its null value; None where there is nothing
        that it applies to, or where the effect is in it already.
    strength : tuple of str
        Paths of the built robot's (or an observation's) parameters whose null values remove the effect.
    shape : tuple of str
        Paths of parameters that shape it: place, width, onset, exponent, regularisation speed.
    falsifier : str
        What would be otherwise if this were so, in one sentence.
    bank : callable or None
        ``bank(robot, duration) -> {path: values}``: values of shape parameters to scan, for the robot that was built
        and recordings of so many seconds.
    scale : callable or None
        ``scale(robot, duration) -> {path: change}``: changes of the strengths that are worth considering.
    observe : bool
        Whether it is about an instrument: then the paths are those of observations.
    whole : bool
        Whether it changes all that an instrument sees alike: it explains nothing where what holds or drives the robot
        was seen by the same instrument.
    place, onset : str or None
        Which shape parameter is a place along a rod [fraction of its length], and which is a time [s].
    priors : mapping
        What is known beforehand of parameters, (value, standard deviation) by path.
    usual : bool
        Whether ``scale`` is a tenth of what its author takes for usual: then it is tried at that, too.
    family, on : str
        The two parts of the id; ``on`` is empty for what is everywhere.
    """

    id: str
    title: str
    group: str
    build: Build
    strength: tuple[str, ...]
    falsifier: str
    shape: tuple[str, ...] = ()
    bank: Bank | None = None
    scale: Scale | None = None
    observe: bool = False
    whole: bool = False
    place: str | None = None
    onset: str | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    usual: bool = False
    family: str = ""
    on: str = ""

    def __post_init__(self) -> None:
        if self.group not in GROUPS:
            raise CaseError(
                f"candidate '{self.id}': its group is {self.group!r}; groups are {', '.join(GROUPS)}"
            )
        if not self.strength:
            raise CaseError(f"candidate '{self.id}' has no strength: give the path of what vanishes")
        if not self.family:
            family, _, on = self.id.partition("@")
            object.__setattr__(self, "family", family)
            object.__setattr__(self, "on", self.on or on)

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of all its parameters, strengths first."""
        return (*self.strength, *self.shape)

    @property
    def size(self) -> int:
        """Number of its parameters that count: not what shapes it a little and is known beforehand."""
        return len(self.strength) + sum(path not in self.priors for path in self.shape)

    def parameters(self, robot: Robot, instruments: Sequence[Observation] = ()) -> dict[str, Parameter]:
        """Return its parameters by path: those of the robot that was built, or of the instruments.

        Raises
        ------
        ParameterError
            If there is none of a path.
        """
        found: dict[str, Parameter] = {}
        for path in self.paths:
            place = instrument_path(instruments, path)
            if place is not None:
                found[path] = getattr(instruments[place[0]], place[1])
                continue
            indexed = find_indexed(robot, path)
            found[path] = robot.parameters[indexed[0]] if indexed else next(iter(find(robot, path).values()))
        return found

    def nulls(self, robot: Robot, instruments: Sequence[Observation] = ()) -> dict[str, float]:
        """Return the null value of each strength, of the robot that was built.

        Raises
        ------
        CaseError
            If one has none.
        """
        found = self.parameters(robot, instruments)
        for path in self.strength:
            if found[path].null is None:
                raise CaseError(
                    f"candidate '{self.id}': '{path}' has no null value; give Parameter(null=...)"
                )
        return {path: float(found[path].null) for path in self.strength}  # type: ignore[arg-type]

    def scales(
        self, robot: Robot, duration: float, instruments: Sequence[Observation] = ()
    ) -> dict[str, float]:
        """Return a change worth considering for each strength, of the robot that was built.

        What ``scale`` does not tell is a twentieth of the distance between bounds, or derived from the unit.
        """
        told = {} if self.scale is None else dict(self.scale(robot, duration))
        measures = Measures.of(robot, duration)
        for path, parameter in self.parameters(robot, instruments).items():
            if path in self.strength and path not in told:
                told[path] = measures.scale(parameter)
        return told

    def values(self, robot: Robot, duration: float) -> dict[str, tuple[float, ...]]:
        """Return the values of shape parameters to scan, of the robot that was built; none for what is not scanned."""
        return {} if self.bank is None else {k: tuple(v) for k, v in self.bank(robot, duration).items()}


Make = Callable[[Robot, Sequence[Observation]], Iterable[Candidate]]


@dataclass(frozen=True)
class Family:
    """Candidates of one kind, for any robot.

    Attributes
    ----------
    id : str
        What reports call it.
    title, group, falsifier : str
        As of its candidates.
    make : callable
        ``make(robot, instruments)`` returns those that a robot has.
    strength, shape : tuple of Parameter
        What it is described by, for lists.
    terms : tuple of type
        Classes of terms that it uses, which then are no candidates by themselves.
    """

    id: str
    title: str
    group: str
    falsifier: str
    make: Make
    strength: tuple[Parameter, ...] = ()
    shape: tuple[Parameter, ...] = ()
    terms: tuple[type[Term], ...] = field(default=())

    def __call__(self, robot: Robot, instruments: Sequence[Observation] = ()) -> list[Candidate]:
        """Return the candidates of this kind that a robot has."""
        return list(self.make(robot, instruments))


def candidates(
    robot: Robot, instruments: Sequence[Observation] = (), only: Sequence[str] | None = None
) -> list[Candidate]:
    """Return the explanations that are installed and apply to a robot, those of plug-ins included.

    Parameters
    ----------
    robot : Robot
        The robot.
    instruments : sequence of Observation
        What observes it, for explanations about instruments.
    only : sequence of str, optional
        Ids of families or candidates; by default all.

    Raises
    ------
    CaseError
        For an id in ``only`` that there is none of, and for two candidates of one id.
    """
    from rodnet import registry

    records = registry.candidates()
    wanted = None if only is None else [name.partition("@")[0] for name in only]
    unknown = [] if wanted is None else [name for name in wanted if name not in records]
    if unknown:
        raise CaseError(
            f"no candidate is called {unknown[0]!r}; {meant(unknown[0], records)}"
            "`rodnet terms --candidates` lists them"
        )
    found: dict[str, Candidate] = {}
    for name, record in records.items():
        if wanted is not None and name not in wanted:
            continue
        for one in as_family(name, record.object)(robot, instruments):
            named = only is None or one.id in only or one.family in only
            if named and applies(one, robot, instruments):
                if one.id in found:
                    raise CaseError(f"two candidates are called '{one.id}'; ids must be different")
                found[one.id] = one
    return list(found.values())


def applies(candidate: Candidate, robot: Robot, instruments: Sequence[Observation] = ()) -> bool:
    """Whether a robot can have an explanation: it can be built, and has the parameters."""
    from rodnet.solve.model import Model

    try:
        built = candidate.build(robot)
        if built is None:
            return False
        candidate.nulls(built, instruments)
        Model(built)  # where a term cannot act, it says so
    except RodnetError:
        return False
    return True


def as_family(name: str, found: Any) -> Family:
    """Return what somebody registered, or listed in a case, as a family.

    Parameters
    ----------
    name : str
        Its id.
    found : Family, Candidate, Term class or callable
        A callable ``(robot, instruments)`` returns candidates.

    Raises
    ------
    CaseError
        If it is none of these.
    """
    if isinstance(found, Family):
        return found
    if isinstance(found, Candidate):
        return Family(found.id, found.title, found.group, found.falsifier, _Only((found,)))
    if isinstance(found, type) and issubclass(found, Term):
        from rodnet.diagnosis.bank.anything import term_family

        return term_family(name, found)
    if callable(found):
        title = (inspect.getdoc(found) or name).partition("\n")[0]
        return Family(name, title, "medium", "", found)
    raise CaseError(
        f"'{name}' is no candidate: give a Candidate, a Family, a class of terms with a null value, or a function "
        f"(robot, instruments) that returns candidates, not {type(found).__name__}"
    )


@dataclass(frozen=True)
class _Only:
    """Candidates that do not depend on the robot."""

    candidates: tuple[Candidate, ...]

    def __call__(self, robot: Robot, instruments: Sequence[Observation]) -> tuple[Candidate, ...]:
        return self.candidates


def add_terms(robot: Robot, parts: Sequence[tuple[type[Term], Mapping[str, Any]]]) -> Robot | None:
    """Return a robot with more terms, ``cls(**options)`` each; None if it has one of these names already.

    With `functools.partial` it is the ``build`` of most candidates. Drag laws are of the robot's own medium: where that
    flows, against it.
    """
    names = {term.name for term in robot.terms}
    if any(options["name"] in names for _, options in parts):
        return None
    flow = flow_of(robot)

    def own(cls: type[Term]) -> dict[str, Any]:
        local = issubclass(cls, DragModel) and cls.of_medium and cls.memory_frame == "body"
        return {"flow": flow} if local and flow is not None else {}

    return robot.extended([cls(**{**own(cls), **options}) for cls, options in parts])


def free_parameter(robot: Robot, path: str) -> Robot | None:
    """Return a robot one of whose terms has a parameter of its own, whose null value is what it is now.

    ``path`` is that of a number. A parameter that other terms share stays as it is with them.
    """
    owner, _, name = path.rpartition(".")
    terms = list(robot.terms)
    for k, term in enumerate(terms):
        if term.name == owner:
            old: Parameter = getattr(term, name)
            if old.value is None or np.ndim(old.value):
                return None
            new = old.with_value(old.value)
            new.null, new.kind = old.value, "strength"
            return with_term(robot, k, with_parameter(term, name, new))
    return None


def with_parameter(term: Term, name: str, parameter: Parameter) -> Term:
    """Return a copy of a term with another parameter."""
    import copy

    other = copy.copy(term)
    setattr(other, name, parameter)
    return other


def with_term(robot: Robot, number: int, term: Term) -> Robot:
    """Return a robot with another term in a place of its list."""
    terms = list(robot.terms)
    terms[number] = term
    return Robot(robot.graph, terms, robot.sensors)
