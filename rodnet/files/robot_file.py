"""Saving a robot to a text file and loading it: figure, terms, shared parameters, sensors.

The schema is in the docs (reference, robot files). What is read back is the same robot to the last bit.
"""

from __future__ import annotations

import inspect
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import rodnet
from rodnet import registry
from rodnet.errors import OutputError, RobotFileError, RodnetError
from rodnet.files.figure_tables import Table, check_keys, draw, figure_tables
from rodnet.files.toml_text import toml_text
from rodnet.files.values import decode, encode
from rodnet.graph.rod_graph import RodGraph
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.storage import check_writable
from rodnet.terms.base import Term

FORMAT = "rodnet-robot-1"
TOP = {"format", "rodnet", "rod", "joint", "group", "shape", "parameter", "term", "sensor"}
COMMENTS = {
    "rod": "lengths in m, materials in Pa and kg/m^3; a point is (x, y, z) or a node that exists, 'rod:3'",
    "shape": "where the robot begins, if not as it is drawn",
    "parameter": "shared by several terms, or with bounds of their own",
}


def save(robot: Robot, path: str | Path) -> Path:
    """Write a robot to a TOML file; see `rodnet.Robot.save`."""
    text = toml_text(tables_of(robot), COMMENTS)
    path = check_writable(path)
    partial = path.with_name(path.name + ".part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)
    return path


def load(path: str | Path) -> Robot:
    """Read a robot from a TOML file; see `rodnet.Robot.load`."""
    return parse(read_text(path), path)


def read_text(path: str | Path) -> str:
    """Return the text of a file."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot read '{path}': {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotFileError(f"'{path}' is not a text file in UTF-8") from None


def parse(text: str, path: str | Path) -> Robot:
    """Build the robot that the text of a file describes."""
    try:
        return robot_of(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise RobotFileError(f"'{path}' is not TOML: {error}") from None
    except RodnetError as error:
        raise RobotFileError(f"'{path}': {error}") from error
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:  # e.g. text for a number
        raise RobotFileError(f"'{path}' does not describe a robot: {error}") from error


# -- a robot as tables ----------------------------------------------------------------------
def tables_of(robot: Robot) -> Table:
    """Return a robot as plain values."""
    graph = robot.graph
    if graph.figure is None:
        raise RobotFileError(
            "this robot's graph was not built by a StickFigure, so there is nothing to write"
        )
    shape: Table = {}
    if not np.array_equal(graph.figure.points, graph.x0):
        shape = {"positions": graph.x0.tolist(), "directors": graph.d1.tolist()}
    shared = _shared(robot)
    document = {
        "format": FORMAT,
        "rodnet": rodnet.__version__,
        **figure_tables(graph.figure),
        "shape": shape,
        "parameter": [_parameter_table(name, p) for name, p in shared.values()],
        "term": [_term_table(term, {k: name for k, (name, _) in shared.items()}) for term in robot.terms],
        "sensor": {k: encode(v, f"sensor '{k}'") for k, v in robot.sensors.items()},
    }
    return {k: v for k, v in document.items() if v}


def _shared(robot: Robot) -> dict[int, tuple[str, Parameter]]:
    """Parameters that need a table of their own, by identity, and the path that they go by."""
    seen: dict[int, tuple[str, Parameter]] = {}
    found: dict[int, tuple[str, Parameter]] = {}
    for term in robot.terms:
        declared = term.declared()
        for name, p in term.parameter_items():
            entry = seen.setdefault(id(p), (f"{term.name}.{name}", p))
            again = entry[0] != f"{term.name}.{name}"
            if again or _meaning(p) != _meaning(declared[name]):
                found[id(p)] = entry
    return found


def _meaning(p: Parameter) -> tuple[Any, ...]:
    """All of a parameter but its value."""
    return p.unit, p.bounds, p.null, p.kind, p.prior, p.doc, p.name


def _parameter_table(path: str, p: Parameter) -> Table:
    table: Table = {"id": path, "value": encode(p.value, f"parameter '{path}'"), "unit": p.unit}
    if p.bounds != (-np.inf, np.inf):
        table["bounds"] = [float(b) for b in p.bounds]
    if p.null is not None:
        table["null"] = float(p.null)
    table |= {"kind": p.kind, "name": p.name}
    if p.doc:
        table["doc"] = p.doc
    if p.prior is not None:
        frozen = all(hasattr(p.prior, name) for name in ("dist", "args", "kwds"))
        if not (frozen and hasattr(p.prior.dist, "name")):
            raise RobotFileError(f"parameter '{path}': its prior is not a frozen distribution of scipy.stats")
        what = f"the prior of parameter '{path}'"
        args, kwds = encode(list(p.prior.args), what), encode(dict(p.prior.kwds), what)
        table["prior"] = {"distribution": p.prior.dist.name, "args": args, **kwds}
    return table


def _term_table(term: Term, shared: Mapping[int, str]) -> Table:
    record = registry.id_of(type(term))
    if record is None:
        cls = f"{type(term).__module__}.{type(term).__qualname__}"
        raise RobotFileError(
            f"term '{term.name}': the class {cls} is not registered, so a file could not say which it is. Announce "
            "it in a package, as an entry point of the group rodnet.terms (docs, how to write a law)"
        )
    table: Table = {"id": record.id, "name": term.name}
    if not record.distribution.startswith("rodnet "):
        table["package"] = record.distribution
    for name, value in _arguments(term).items():
        if name not in term.declared() and name != "name" and value is not None:
            table[name] = encode(value, f"argument {name!r} of term '{term.name}'")
    for name, p in term.parameter_items():
        value = {"shared": shared[id(p)]} if id(p) in shared else p.value
        table[name] = encode(value, f"parameter '{term.name}.{name}'")
    return table


def _arguments(term: Term) -> Table:
    """What the term's constructor was given, by name."""
    args, kwargs = term._given
    signature = inspect.signature(type(term).__init__)
    given: Table = {}
    for name, value in signature.bind(None, *args, **kwargs).arguments.items():
        kind = signature.parameters[name].kind
        if kind is inspect.Parameter.VAR_KEYWORD:
            given |= value
        elif kind in (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.POSITIONAL_ONLY) and name != "self":
            raise RobotFileError(
                f"term '{term.name}' takes arguments without names, which a file cannot hold"
            )
        else:
            given[name] = value
    given.pop("self", None)
    return given


# -- and back -------------------------------------------------------------------------------
def robot_of(document: Mapping[str, Any]) -> Robot:
    """Build the robot that plain values describe."""
    form = document.get("format")
    if form != FORMAT:
        newer = isinstance(form, str) and form.startswith("rodnet-robot-")
        remedy = (
            "a newer rodnet wrote it; update rodnet" if newer else f'it should begin with format = "{FORMAT}"'
        )
        raise RobotFileError(f"not a robot of the format this rodnet reads (format = {form!r}): {remedy}")
    check_keys("the file", document, TOP)
    for key, value in document.items():
        single = key in ("group", "shape", "sensor")
        if key in ("format", "rodnet") or (isinstance(value, dict) if single else _is_list_of_tables(value)):
            continue
        raise RobotFileError(
            f"'{key}' must be a table, [{key}]" if single else f"'{key}' must be tables, [[{key}]]"
        )
    graph = _shaped(draw(document).build(), document.get("shape", {}))
    shared = {table.get("id"): _parameter(table) for table in document.get("parameter", [])}
    terms = [_term(table, shared) for table in document.get("term", [])]
    sensors = {k: decode(v, f"sensor '{k}'") for k, v in document.get("sensor", {}).items()}
    return Robot(graph, terms, sensors)


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(table, dict) for table in value)


def _shaped(graph: RodGraph, shape: Mapping[str, Any]) -> RodGraph:
    """The graph in its initial shape."""
    check_keys("[shape]", shape, {"positions", "directors"})
    if "positions" not in shape:
        return graph
    graph = graph.with_positions(np.array(shape["positions"], dtype=float))
    if "directors" not in shape:
        return graph
    d1 = np.array(shape["directors"], dtype=float)
    if d1.shape != graph.d1.shape:
        raise RobotFileError(f"[shape]: directors must be of shape {graph.d1.shape}, not {d1.shape}")
    return graph.with_directors(d1)


def _parameter(table: Mapping[str, Any]) -> Parameter:
    options = dict(table)
    known = {"id", "value", "unit", "bounds", "null", "kind", "name", "doc", "prior"}
    check_keys(f"parameter {table.get('id', '?')!r}", table, known, ("id", "value"))
    options.pop("id")
    if "bounds" in options:
        options["bounds"] = tuple(options["bounds"])
    if "prior" in options:
        import scipy.stats

        prior = dict(options["prior"])
        made = getattr(scipy.stats, str(prior.pop("distribution", "")), None)
        if not isinstance(made, scipy.stats.rv_continuous | scipy.stats.rv_discrete):
            raise RobotFileError(f"parameter '{table['id']}': its prior is no distribution of scipy.stats")
        options["prior"] = made(*prior.pop("args", []), **prior)
    return Parameter(options.pop("value"), **options)


def _term(table: Mapping[str, Any], shared: Mapping[Any, Parameter]) -> Term:
    options = dict(table)
    check_keys(f"term {table.get('id', '?')!r}", table, set(table), ("id",))
    name, package = options.pop("id"), options.pop("package", None)
    try:
        cls = registry.term(name)
    except registry.RegistryError as error:
        where = ""
        if package:
            where = f"; it comes from the package {package}, which is not installed: pip install {package.split()[0]}"
        raise RobotFileError(f"term '{name}' is unknown{where}. {error}") from None
    label = options.pop("name", None)
    what = f"term '{label or name}'"
    given: Table = {}
    for key, value in options.items():
        if isinstance(value, dict) and set(value) == {"shared"}:
            if value["shared"] not in shared:
                raise RobotFileError(f"{what}: there is no [[parameter]] with the id {value['shared']!r}")
            given[key] = shared[value["shared"]]
        else:
            given[key] = decode(value, f"{what}, {key}")
    try:
        term = cls(**given)
    except TypeError as error:
        raise RobotFileError(f"{what} cannot be made with {', '.join(given) or 'nothing'}: {error}") from None
    if label:
        term.name = label
    return term
