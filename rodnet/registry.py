"""What is installed: built-in terms and robots, and those of plug-ins (entry points).

A plug-in is a package that names its classes in ``pyproject.toml``::

    [project.entry-points."rodnet.terms"]
    quadratic = "rodnet_quadratic:Quadratic"

Groups: ``rodnet.terms`` (`Term` classes), ``rodnet.candidates`` (further explanations that a diagnosis
may try), ``rodnet.robots`` (functions that return a `Robot`; a function's attribute ``metrics``, if it has
one, evaluates a trajectory). Nothing is imported before it is asked for, and a plug-in that cannot be
loaded is reported by a `RuntimeWarning` and left out.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any

from rodnet import built_in
from rodnet.errors import RodnetError
from rodnet.parameters import Parameter, Parametrised

KINDS = ("energy", "drag", "load", "contact", "actuator", "constraint")

# id -> module and class; the ids that reports use
_BUILT_IN = {
    "rodnet.terms": built_in.TERMS,
    "rodnet.robots": built_in.ROBOTS,
    "rodnet.candidates": built_in.CANDIDATES,
}
_NOUNS = {"rodnet.terms": "term", "rodnet.robots": "robot", "rodnet.candidates": "candidate"}


class RegistryError(RodnetError, LookupError):
    """Nothing of that name is installed."""


@dataclass(frozen=True)
class Record:
    """Something that is installed.

    Attributes
    ----------
    id : str
        Its fixed name, e.g. ``"resistive-force"``.
    object : type or callable
        The class of a term or candidate; the function that makes a robot.
    kind : str
        ``"energy"``, ``"drag"``, ``"load"``, ``"contact"``, ``"actuator"``, ``"constraint"``, ``"candidate"`` or
        ``"robot"``.
    parameters : tuple of Parameter
        What it declares: name, unit, default value, bounds, null value, doc.
    source : str
        Where the law comes from (paper, equation).
    distribution : str
        The package that it comes from, with its version.
    summary : str
        First line of its docstring.
    """

    id: str
    object: Any
    kind: str
    parameters: tuple[Parameter, ...]
    source: str
    distribution: str
    summary: str

    @property
    def name(self) -> str:
        """What a term is called if nobody names it: the first part of its parameters' paths."""
        return getattr(self.object, "default_name", "") or getattr(self.object, "__name__", self.id).lower()

    @property
    def arguments(self) -> list[str]:
        """What its constructor takes besides parameters and a name."""
        if not (isinstance(self.object, type) and issubclass(self.object, Parametrised)):
            return []
        return [k for k in self.object.arguments() if k != "name" and k not in self.object.declared()]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON; an open bound is None."""
        finite = lambda bound: bound if abs(bound) != float("inf") else None  # noqa: E731
        owner = self.object if hasattr(self.object, "__qualname__") else type(self.object)
        told = {k: getattr(self.object, k) for k in ("group", "falsifier") if self.kind == "candidate"}
        return {
            "id": self.id,
            "class": f"{owner.__module__}.{owner.__qualname__}",
            "kind": self.kind,
            "name": self.name,
            "arguments": self.arguments,
            "summary": self.summary,
            "source": self.source,
            "distribution": self.distribution,
            **told,
            "parameters": [
                {
                    "name": p.name,
                    "unit": p.unit,
                    "default": p.value if p.value is None or isinstance(p.value, float) else p.value.tolist(),
                    "bounds": [finite(b) for b in p.bounds],
                    "null": p.null,
                    "kind": p.kind,
                    "doc": p.doc,
                }
                for p in self.parameters
            ],
        }


def terms() -> Mapping[str, Record]:
    """Every energy, drag law, load, contact, actuator and constraint that is installed, by id."""
    return _all("rodnet.terms")


def robots() -> Mapping[str, Record]:
    """Every robot that is installed, by id."""
    return _all("rodnet.robots")


def candidates() -> Mapping[str, Record]:
    """What a diagnosis can try, by id: candidates, and terms that vanish at a null value and belong to none of them."""
    found = _all("rodnet.candidates")
    covered = {cls for r in found.values() for cls in getattr(r.object, "terms", ())}
    vanishing = {
        k: r
        for k, r in terms().items()
        if r.object not in covered
        and k not in found
        and k not in (*built_in.NUMERICAL, *built_in.UNNAMED)
        and _vanishes(r.object)
    }
    return MappingProxyType({**found, **vanishing})


def _vanishes(cls: type) -> bool:
    """Whether a term can be added everywhere, needing nothing but the null values of its strengths."""
    nulls = {k: p.null for k, p in cls.declared().items() if p.null is not None and p.kind == "strength"}  # type: ignore[attr-defined]
    try:
        cls(**nulls)
    except (RodnetError, TypeError):
        return False
    return bool(nulls) and all(cls.declared()[k].value is not None for k in nulls)  # type: ignore[attr-defined]


def term(name: str) -> type:
    """Return the class of a term by its id, e.g. ``rn.term("resistive-force")``.

    Raises
    ------
    RegistryError
        If there is none of that name; lists what there is, close matches first.
    """
    return _find("rodnet.terms", name).object


def robot(name: str) -> Callable[..., Any]:
    """Return the function that makes a robot, by its id, e.g. ``"flagellated"``.

    Raises
    ------
    RegistryError
        If there is none of that name; lists what there is, close matches first.
    """
    return _find("rodnet.robots", name).object


def providers() -> set[str]:
    """Top-level modules of what is installed: rodnet's own, and those of plug-ins."""
    points = (p for group in _BUILT_IN for p in _entry_points(group).values())
    return {"rodnet", *(p.module.partition(".")[0] for p in points)}


def id_of(cls: type) -> Record | None:
    """Return the record of a class of terms; None if it is not registered."""
    return next((record for record in terms().values() if record.object is cls), None)


def plug_ins() -> list[str]:
    """Return the modules of all that is installed beside rodnet, as plug-ins announce them."""
    points = (point for group in _BUILT_IN for point in _entry_points(group).values())
    return sorted({point.module for point in points})


# -- finding and loading ------------------------------------------------------------------
@cache
def _entry_points(group: str) -> Mapping[str, EntryPoint]:
    """Entry points of a group by name, not loaded; the built-ins and then the first package keep a name."""
    found: dict[str, EntryPoint] = {}
    taken = {name: "rodnet" for name in _BUILT_IN[group]}
    for point in sorted(entry_points(group=group), key=lambda p: (p.name, _package(p), p.value)):
        if point.name in found and found[point.name].value == point.value:
            continue  # one package, found twice on the path
        if point.name in taken:
            _warn(
                f"the {_NOUNS[group]} '{point.name}' of {_package(point)} is left out: "
                f"{taken[point.name]} has one of that name"
            )
            continue
        found[point.name], taken[point.name] = point, _package(point)
    return MappingProxyType(found)


@cache
def _load(group: str, name: str) -> Record | None:
    """Load one record; None, with a warning, if it is a plug-in that cannot be loaded."""
    built_in = _BUILT_IN[group].get(name)
    if built_in is not None:
        module, _, attribute = built_in.partition(":")
        import rodnet

        return _record(
            group, name, getattr(importlib.import_module(module), attribute), f"rodnet {rodnet.__version__}"
        )
    point = _entry_points(group)[name]
    try:
        return _record(group, name, _checked(group, name, point.load()), _package(point))
    except (Exception, SystemExit) as error:  # whatever a stranger's module does when it is imported
        _warn(
            f"the {_NOUNS[group]} '{name}' of {_package(point)} is left out, {point.value} cannot be loaded: "
            f"{type(error).__name__}: {error}"
        )
        return None


@cache
def _all(group: str) -> Mapping[str, Record]:
    records = [_load(group, name) for name in (*_BUILT_IN[group], *_entry_points(group))]
    return MappingProxyType({r.id: r for r in records if r is not None})


def _find(group: str, name: str) -> Record:
    known = (*_BUILT_IN[group], *_entry_points(group))
    record = _load(group, name) if name in known else None
    if record is not None:
        return record
    noun, there = _NOUNS[group], list(_all(group))
    close = difflib.get_close_matches(str(name).lower().replace("_", "-"), there, n=3)
    hint = f"did you mean {' or '.join(map(repr, close))}? " if close else ""
    raise RegistryError(f"no {noun} is called {name!r}; {hint}Installed are {', '.join(there)}.")


def _checked(group: str, name: str, found: Any) -> Any:
    if group == "rodnet.terms":
        from rodnet.terms.base import Term

        if not (isinstance(found, type) and issubclass(found, Term)):
            raise TypeError(f"{found!r} is not a subclass of rodnet.Term")
        if found.kind not in KINDS:
            raise TypeError(f"its kind is {found.kind!r}; kinds are {', '.join(KINDS)}")
    elif group == "rodnet.candidates":
        from rodnet.diagnosis.candidate import as_family

        return as_family(name, found)
    elif not callable(found):
        raise TypeError(f"{found!r} cannot be called")
    return found


def _record(group: str, name: str, found: Any, distribution: str) -> Record:
    if group == "rodnet.candidates":
        parameters = *found.strength, *found.shape
        return Record(name, found, "candidate", parameters, "", distribution, found.title)
    declared = found.declared() if isinstance(found, type) and issubclass(found, Parametrised) else {}
    kind = found.kind if group == "rodnet.terms" else _NOUNS[group]
    summary = (inspect.getdoc(found) or "").partition("\n")[0]
    source = getattr(found, "source", "")
    return Record(name, found, kind, tuple(declared.values()), source, distribution, summary)


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "an unknown package"


def _warn(message: str) -> None:
    warnings.warn(message, RuntimeWarning, stacklevel=2)
