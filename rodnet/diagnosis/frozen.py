"""Effects as they were tried, as plain values: another recording must not make other ones of them.

What a candidate is made with may come from the robot that the search began with: the point that a thread leads to,
the level from which a depth counts, the bounds of where a wall may be. With the robot of another recording it would be
another effect, to which the fitted values do not belong.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from rodnet.diagnosis.candidate import Candidate, add_terms
from rodnet.errors import CaseError, GraphError
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.sweeps.job import importable

Plain = dict[str, Any]


class _Unfit(Exception):
    """Something that is no plain value."""


def freeze(candidate: Candidate) -> str | Plain:
    """Return an effect as JSON takes it: the terms that it adds with all that they are made with, else its id.

    So are the laws of a case, which has them, and what an instrument or the robot has already, at its null value.
    """
    build = candidate.build
    if not (isinstance(build, partial) and build.func is add_terms):
        return candidate.id
    if not all(_installed(cls) for cls, _ in build.keywords["parts"]):  # a case knows its own by their ids
        return candidate.id
    shared: list[Parameter] = []
    try:
        terms = [
            {
                "class": f"{cls.__module__}:{cls.__qualname__}",
                "options": {k: _plain(v, shared) for k, v in options.items()},
            }
            for cls, options in build.keywords["parts"]
        ]
        told = [_declared(parameter) for parameter in shared]
    except _Unfit:
        return candidate.id
    return {"id": candidate.id, "terms": terms, "parameters": told}


def thaw(effect: Mapping[str, Any], robot: Robot) -> Robot:
    """Return a robot with the terms of an effect that was `freeze`-d; one without the rods that they act on as it is.

    Raises
    ------
    CaseError
        If the effect cannot be read, or a class of its terms is not installed.
    """
    try:
        shared = [_parameter(told) for told in effect["parameters"]]
        parts = [
            (_class(term["class"]), {k: _value(v, shared) for k, v in term["options"].items()})
            for term in effect["terms"]
        ]
    except (KeyError, TypeError, AttributeError) as error:
        raise CaseError(f"a fitted model has an effect in it that cannot be read: {error}") from None
    try:
        for _, options in parts:
            if "on" in options:
                robot.graph.edge_indices(options["on"])
            for node in _names(options.get("at")):
                robot.graph.node(node)
    except GraphError:
        return robot
    built = add_terms(robot, parts)
    return robot if built is None else built


def _plain(value: Any, shared: list[Parameter]) -> Any:
    """A value as JSON takes it; parameters by their numbers, for several options may be one."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Parameter):
        if not any(value is one for one in shared):
            shared.append(value)
        return {"parameter": next(k for k, one in enumerate(shared) if one is value)}
    if isinstance(value, float | np.floating | np.integer) and np.isfinite(value):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, tuple | list):
        return [_plain(v, shared) for v in value]
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and np.isfinite(value).all():
        return value.tolist()
    raise _Unfit


def _declared(parameter: Parameter) -> Plain:
    if parameter.prior is not None:
        raise _Unfit
    bounds = [bound if np.isfinite(bound) else None for bound in parameter.bounds]
    return {
        "value": _plain(parameter.value, []), "unit": parameter.unit, "bounds": bounds, "null": parameter.null,
        "kind": parameter.kind, "doc": parameter.doc,
    }  # fmt: skip


def _parameter(told: Mapping[str, Any]) -> Parameter:
    low, high = told["bounds"]
    rest = {key: told[key] for key in ("null", "kind", "doc")}
    return Parameter(told["value"], told["unit"], bounds=(low, high), **rest)


def _value(told: Any, shared: list[Parameter]) -> Any:
    if isinstance(told, list):
        return tuple(_value(v, shared) for v in told)
    return shared[told["parameter"]] if isinstance(told, Mapping) else told


def _installed(cls: type) -> bool:
    """Whether any process can import a class by its name."""
    module = sys.modules.get(cls.__module__)
    return (
        module is not None
        and cls.__module__ != "__main__"
        and "<" not in cls.__qualname__
        and importable(module)
    )


def _names(at: Any) -> list[str]:
    """Names of nodes, of what may be a number."""
    given = [at] if isinstance(at, str) else at if isinstance(at, tuple) else []
    return [name for name in given if isinstance(name, str)]


def _class(name: str) -> Any:
    module, _, path = name.partition(":")
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        raise CaseError(
            f"a fitted model has a term of '{name}' in it, which is not installed: {error}"
        ) from None
    for part in path.split("."):
        found = getattr(found, part)
    return found
