"""What sensitivities are taken by: parameters of a robot by path, and changes of its initial state."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from rodnet.errors import ParameterError, PlausibilityWarning
from rodnet.names import listed, meant
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.steppers import make_stepper
from rodnet.tangent.compare import alike
from rodnet.tangent.starts import by_start
from rodnet.tangent.variation import STEP, Near, Variation, stencil
from rodnet.terms.actuators import _BoundActuator
from rodnet.terms.base import Term
from rodnet.terms.constraints import BoundConstraint

TINY = 1e-8  # of differences from nothing, relative


def find(robot: Robot, path: str) -> dict[str, Parameter]:
    """Parameters that a path names; a glob such as ``"tail*.E"`` may name several, which are one then.

    Raises
    ------
    ParameterError
        If there is none, or their values differ.
    """
    known = robot.parameters
    names = [path] if path in known else [name for name in known if fnmatchcase(name, path)]
    if not names:
        raise ParameterError(f"no parameter {path!r}; {meant(path, known)}{listed(known)}")
    found = {name: known[name] for name in names}
    for name, parameter in found.items():
        if np.ndim(parameter.value):
            raise ParameterError(
                f"'{name}' has {np.size(parameter.value)} values, one per site; sensitivities are by single numbers: "
                f"give one of them, '{name}[0]'"
            )
    values = [p.value for p in found.values()]
    if len(set(values)) > 1:
        raise ParameterError(f"'{path}' stands for {', '.join(names)}, whose values differ: {values}")
    return found


def find_indexed(robot: Robot, path: str) -> tuple[str, int] | None:
    """Path and index of one value of an array, ``"drag.viscosity[3]"``."""
    name, bracket, rest = path.partition("[")
    if not bracket or not rest.endswith("]") or name not in robot.parameters:
        return None
    try:
        index = int(rest[:-1])
    except ValueError:
        return None
    size = np.size(robot.parameters[name].value)
    if not np.ndim(robot.parameters[name].value) or not 0 <= index < size:
        raise ParameterError(f"'{path}': '{name}' has {size} values, numbered from 0")
    return name, index


def by_parameter(robot: Robot, path: str, scale: float | None, options: Mapping[str, Any]) -> Variation:
    """Column of a parameter of the robot.

    Parameters
    ----------
    robot : Robot
        The robot.
    path : str
        A path or a glob, or with an index one value of an array.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.
    options : mapping
        Of the `Simulation`.
    """
    indexed = find_indexed(robot, path)
    if indexed is None:
        found = find(robot, path)
        first = next(iter(found.values()))
        values: np.ndarray | None = None
        value = float(first.value)
    else:
        found = {indexed[0]: robot.parameters[indexed[0]]}
        first = found[indexed[0]]
        values = np.asarray(first.value, dtype=float)
        value = float(values.flat[indexed[1]])
    low = max(p.bounds[0] for p in found.values())
    high = min(p.bounds[1] for p in found.values())
    size = abs(value) or scale or 1.0
    robots = []
    for weight, place in stencil(value, STEP * size, (low, high)):
        given: Any = place
        if values is not None and indexed is not None:
            given = values.copy()
            given.flat[indexed[1]] = place
        robots.append((weight, robot._changed(dict.fromkeys(found, given))))
    near = [(weight, Near(Model(changed))) for weight, changed in robots]
    if _begin_alike([other.model for _, other in near], options):
        nothing = np.zeros(robot.graph.x0.shape)
        return Variation(path, first.unit, value, tuple(near), start=(nothing, nothing))
    with warnings.catch_warnings():  # what is implausible of them is of the robot itself, which was told
        warnings.simplefilter("ignore", PlausibilityWarning)
        sims = tuple((weight, Simulation(changed, **options)) for weight, changed in robots)
    return Variation(path, first.unit, value, sims)


def _begin_alike(models: Sequence[Model], options: Mapping[str, Any]) -> bool:
    """Whether simulations of models begin in the same state, for all that these say: then no run of them is set up."""
    one, *others = models
    if (
        one.bodies is not None
        or one.joints
        or make_stepper(options.get("stepper", "euler")).needs_acceleration
    ):
        return False
    places = all(
        np.array_equal(getattr(one, k), getattr(m, k)) for m in others for k in ("x0", "d10", "held")
    )
    known = [(b, c) for m in others for b, c in zip(one.bound, m.bound, strict=True)]
    return places and all(
        alike(b.memory, c.memory) and (alike(b, c) or not isinstance(b, BoundConstraint)) for b, c in known
    )


def by_added(robot: Robot, edited: Robot, path: str, scale: float | None) -> Variation:
    """Column of a parameter of terms that ``robot`` lacks, and which at its present value have no effect.

    As nothing comes of the null value, there is no round-off in the difference from it: a tiny step to one side does.

    Parameters
    ----------
    robot : Robot
        The robot that is simulated.
    edited : Robot
        The same with more terms.
    path : str
        Path of one number of these.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.
    """
    found = find(edited, path)
    first = next(iter(found.values()))
    value, step = float(first.value), TINY * (scale or 1.0)
    if value + step > first.bounds[1]:
        step = -step
    terms = _touched(robot, edited, dict.fromkeys(found, value + step))
    return Variation(path, first.unit, value, (), acts=False, added=((1.0 / (value + step - value), terms),))


def _touched(robot: Robot, edited: Robot, values: Mapping[str, float]) -> tuple[Term, ...]:
    """Terms that ``robot`` lacks and that have a changed parameter; the others have no effect."""
    names, before = {term.name for term in robot.terms}, set(map(id, edited.terms))
    return tuple(t for t in edited._changed(values).terms if t.name not in names and id(t) not in before)


def by_replaced(robot: Robot, edited: Robot, path: str, scale: float | None) -> Variation | None:
    """Column of a parameter of one term in the place of another that does the same at the parameter's present value.

    What it changes is a difference of two of its kind that would act beside the robot's own, each with its own memory.
    None where the robots differ by more than such a term.

    Parameters
    ----------
    robot : Robot
        The robot that is simulated.
    edited : Robot
        The same with the other term.
    path : str
        Path of one number of it.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.
    """
    if edited.graph is not robot.graph or len(edited.terms) != len(robot.terms):
        return None
    other = _differing(robot, edited)
    found = find(edited, path)
    first = next(iter(found.values()))
    value, added = float(first.value), []
    for weight, place in stencil(value, STEP * (abs(value) or scale or 1.0), first.bounds):
        changed = edited._changed(dict.fromkeys(found, place))
        if len(other) != 1 or _differing(edited, changed) != other:
            return None
        added.append((weight, (changed.terms[other[0]],)))
    return Variation(path, first.unit, value, (), acts=False, added=tuple(added))


def _differing(one: Robot, other: Robot) -> list[int]:
    return [k for k, (a, b) in enumerate(zip(one.terms, other.terms, strict=True)) if a is not b]


def by_edit(robot: Robot, edited: Robot, path: str, scale: float | None) -> Variation:
    """Column of a parameter of terms that ``robot`` lacks, which change its model but not how it begins."""
    found = find(edited, path)
    first = next(iter(found.values()))
    value, near = float(first.value), []
    for weight, place in stencil(value, STEP * (abs(value) or scale or 1.0), first.bounds):
        changed = copy.copy(robot)
        changed.terms = (*robot.terms, *_touched(robot, edited, dict.fromkeys(found, place)))
        near.append((weight, Near(Model(changed))))
    nothing = np.zeros(edited.graph.x0.shape)
    return Variation(path, first.unit, value, tuple(near), start=(nothing, nothing))


def make_columns(
    robot: Robot,
    parameters: Sequence[str] | Mapping[str, float],
    initial: Mapping[str, Mapping[str, Any]] | None,
    options: Mapping[str, Any],
    model: Model | None = None,
) -> list[Variation]:
    """All columns, parameters first; ``model`` is that of the robot, if there is one already.

    Raises
    ------
    ParameterError
        If there are none, or one is given twice.
    """
    if isinstance(parameters, str):
        parameters = [parameters]
    scales = dict(parameters) if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    if not isinstance(parameters, Mapping) and len(scales) < len(parameters):
        twice = next(p for p in parameters if list(parameters).count(p) > 1)
        raise ParameterError(f"the parameter '{twice}' is given twice")
    common = sorted(set(scales) & set(initial or {}))
    if common:
        raise ParameterError(f"'{common[0]}' names a parameter and a change of the initial state")
    if not scales and not initial:
        raise ParameterError(
            "there is nothing to take sensitivities by; give parameters=['tail*.E', ...] or initial={...}"
        )
    columns = [by_parameter(robot, path, scale, options) for path, scale in scales.items()]
    if not initial:
        return columns
    bound = (Model(robot) if model is None else model).bound
    remembers = any(b.memory is not None and not isinstance(b, _BoundActuator) for b in bound)
    return columns + [by_start(robot, n, change, options, remembers) for n, change in initial.items()]
