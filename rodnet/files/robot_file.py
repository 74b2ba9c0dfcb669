"""Saving a robot to a text file and loading it: figure, terms, shared parameters, sensors.

The schema is in the docs (reference, robot files). What is read back is the same robot to the last bit.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import rodnet
from rodnet import registry
from rodnet.errors import RobotFileError
from rodnet.files.figure_tables import Table, draw, figure_tables, label
from rodnet.files.schema import check_table, plain_values, read_text, reading, shown
from rodnet.files.toml_text import toml_text
from rodnet.files.values import decode, encode
from rodnet.graph.bodies import Body
from rodnet.graph.rod_graph import RodGraph
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.storage import check_writable
from rodnet.terms.base import Term

FORMAT = "rodnet-robot-1"
TABLES = ("rod", "body", "joint", "parameter", "term")  # [[...]]
SINGLE = ("group", "shape", "sensor")  # [...]
TOP = (
    {"format": "text", "rodnet": "text"}
    | dict.fromkeys(TABLES, "tables")
    | dict.fromkeys(SINGLE, "one table")
)
SHAPE = {"positions": "rows of three numbers", "directors": "rows of three numbers", "bodies": "a table"}
BODY_SHAPE = {
    "com": "three numbers [x, y, z]",
    "inertia": "three rows of three numbers",
    "cob": "three numbers [x, y, z]",
}
PARAMETER = {
    "id": "text", "value": "a number or a list of numbers", "unit": "text", "bounds": "a pair of numbers",
    "null": "a number", "kind": "text", "name": "text", "doc": "text", "prior": "a table",
}  # fmt: skip
COMMENTS = {
    "rod": "lengths in m, materials in Pa and kg/m^3; a point is (x, y, z) or a node that exists, 'rod:3'",
    "shape": "where the robot begins, if not as it is drawn",
    "parameter": "shared by several terms, or with bounds of their own",
}


def save(robot: Robot, path: str | Path) -> Path:
    """Write a robot to a TOML file; see `rodnet.Robot.save`."""
    try:
        data = toml_text(tables_of(robot), COMMENTS).encode()
    except UnicodeEncodeError as error:
        bad = error.object[max(error.start - 20, 0) : error.end]
        raise RobotFileError(
            f"a name or text cannot be written in UTF-8: {bad!a}; use other letters"
        ) from None
    path = check_writable(path)
    partial = path.with_name(path.name + ".part")
    partial.write_bytes(data)
    os.replace(partial, path)
    return path


def load(path: str | Path) -> Robot:
    """Read a robot from a TOML file; see `rodnet.Robot.load`."""
    return parse(read_text(path), path)


def parse(text: str, path: str | Path) -> Robot:
    """Build the robot that the text of a file describes."""
    try:
        with reading("the file"):
            return robot_of(plain_values(text))
    except RobotFileError as error:
        raise RobotFileError(f"'{path}': {error}") from error.__cause__


# -- a robot as tables ----------------------------------------------------------------------
def tables_of(robot: Robot) -> Table:
    """Return a robot as plain values."""
    graph = robot.graph
    if graph.figure is None:
        raise RobotFileError(
            "this robot's graph was not built by a StickFigure, so there is nothing to write"
        )
    if any(rod.named is not None for rod in graph.rods.values()):
        raise RobotFileError(
            "a refined robot's selectors name places of the mesh that it was drawn with, which a file cannot say: "
            "write the robot as it was drawn, and refine it once it is read"
        )
    shared = _shared(robot)
    document = {
        "format": FORMAT,
        "rodnet": rodnet.__version__,
        **figure_tables(graph.figure),
        "shape": _shape_table(graph),
        "parameter": [_parameter_table(name, p) for name, p in shared.values()],
        "term": [_term_table(term, {k: name for k, (name, _) in shared.items()}) for term in robot.terms],
        "sensor": {k: encode(v, f"sensor '{k}'") for k, v in robot.sensors.items()},
    }
    return {k: v for k, v in document.items() if v}


def _shape_table(graph: RodGraph) -> Table:
    """Where the robot begins, if that is not where it is drawn."""
    drawn = graph.figure.build()
    pairs = [(graph.x0, drawn.x0), (graph.d1, drawn.d1)]
    pairs += [(a.inertia, b.inertia) for a, b in zip(graph.bodies, drawn.bodies, strict=True)]
    if all(np.array_equal(a, b) for a, b in pairs):
        return {}
    shape: Table = {"positions": graph.x0.tolist(), "directors": graph.d1.tolist()}
    bodies = {}
    for b in graph.bodies:
        bodies[b.name] = {"com": b.com.tolist(), "inertia": b.inertia.tolist()}
        if b.cob is not None:
            bodies[b.name]["cob"] = b.cob.tolist()
    return shape | ({"bodies": bodies} if bodies else {})


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
        raise RobotFileError(
            f"not a robot of the format this rodnet reads (format = {shown(form)}): {remedy}"
        )
    for key, value in document.items():
        if key in TABLES and not _is_list_of_tables(value):
            raise RobotFileError(f"'{key}' must be tables, each under a line [[{key}]]")
        if key in SINGLE and not isinstance(value, dict):
            raise RobotFileError(f"'{key}' must be one table, under a line [{key}]")
    check_table("the file", document, TOP)
    if "rod" not in document:
        raise RobotFileError("there are no rods in it; add at least one table [[rod]]")
    figure = draw(document)
    with reading("the figure"):
        graph = figure.build()
    with reading("[shape]"):
        graph = _shaped(graph, document.get("shape", {}))
    shared: dict[str, Parameter] = {}
    for number, table in enumerate(document.get("parameter", []), 1):
        what = label("parameter", table, "id", number)
        check_table(what, table, PARAMETER, ("id", "value"))
        if table["id"] in shared:
            raise RobotFileError(f"{what} is there twice; every parameter needs an id of its own")
        with reading(what):
            shared[table["id"]] = _parameter(what, table)
    terms = [_term(table, n, shared) for n, table in enumerate(document.get("term", []), 1)]
    sensors = {k: decode(v, f"[sensor] '{k}'") for k, v in document.get("sensor", {}).items()}
    with reading("the robot"):
        return Robot(graph, terms, sensors)


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(table, dict) for table in value)


def _shaped(graph: RodGraph, shape: Mapping[str, Any]) -> RodGraph:
    """The graph in its initial shape."""
    check_table("[shape]", shape, SHAPE)
    if "positions" not in shape:
        if shape:
            raise RobotFileError(f"[shape]: {', '.join(shape)} needs positions, one row per node")
        return graph
    positions = np.array(shape["positions"], dtype=float)
    if positions.shape != graph.x0.shape:
        raise RobotFileError(
            f"[shape]: positions must be finite and of shape {graph.x0.shape}, one row for each node, not "
            f"{positions.shape}; if a rod's edges were changed, take [shape] out: the robot then begins as drawn"
        )
    graph = graph.with_positions(positions)
    if "directors" in shape:
        d1 = np.array(shape["directors"], dtype=float)
        if d1.shape != graph.d1.shape:
            raise RobotFileError(f"[shape]: directors must be of shape {graph.d1.shape}, not {d1.shape}")
        graph = graph.with_directors(d1)
    bodies = shape.get("bodies", {})
    check_table("[shape] bodies", bodies, {body.name: "a table" for body in graph.bodies})
    for name, table in bodies.items():
        check_table(f"[shape] bodies, '{name}'", table, BODY_SHAPE, ("com", "inertia"))
    return replace(graph, bodies=tuple(_placed(b, bodies.get(b.name, {})) for b in graph.bodies))


def _placed(body: Body, table: Mapping[str, Any]) -> Body:
    """A rigid body with the centre and inertia that a table holds."""
    if not table:
        return body
    given: dict[str, Any] = {k: np.array(v, dtype=float) for k, v in table.items()}
    return replace(body, **given)


def _parameter(what: str, table: Mapping[str, Any]) -> Parameter:
    options = {k: v for k, v in table.items() if k != "id"}
    if "prior" in options:
        import scipy.stats

        prior = dict(options["prior"])
        distribution = prior.pop("distribution", None)
        made = getattr(scipy.stats, str(distribution), None)
        if not isinstance(made, scipy.stats.rv_continuous | scipy.stats.rv_discrete):
            raise RobotFileError(
                f"{what}, prior: distribution = {shown(distribution)} is none of scipy.stats; write e.g. "
                '{distribution = "norm", args = [1.0, 0.1]}'
            )
        try:
            options["prior"] = made(*prior.pop("args", []), **prior)
        except (TypeError, ValueError) as error:
            raise RobotFileError(
                f"{what}, prior: {distribution} does not take these arguments: {error}"
            ) from None
    return Parameter(options.pop("value"), **{"name": table["id"].rpartition(".")[2], **options})


def _term(table: Mapping[str, Any], number: int, shared: Mapping[str, Parameter]) -> Term:
    what = label("term", table, "name" if "name" in table else "id", number)
    options = {k: v for k, v in table.items() if k not in ("id", "name", "package")}
    if "id" not in table:
        raise RobotFileError(
            f"{what} has no 'id'; write one that `rodnet terms` lists, e.g. id = \"gravity\""
        )
    names = {k: table[k] for k in ("id", "name", "package") if k in table}
    check_table(what, names, dict.fromkeys(names, "text"))
    try:
        cls = registry.term(names["id"])
    except registry.RegistryError as error:
        where = ""
        if package := names.get("package"):
            where = f"; it comes from the package {package}, which is not installed: pip install {package.split()[0]}"
        raise RobotFileError(f"{what}: the id '{names['id']}' is unknown{where}: {error}") from None
    given: Table = {}
    for key, value in options.items():
        if isinstance(value, dict) and set(value) == {"shared"}:
            found = shared.get(value["shared"]) if isinstance(value["shared"], str) else None
            if found is None:
                raise RobotFileError(
                    f"{what}, {key}: there is no [[parameter]] with the id {shown(value['shared'])}; there are "
                    f"{', '.join(shared) or 'none'}"
                )
            given[key] = found
        else:
            given[key] = decode(value, f"{what}, {key}")
    usage: list[str] = cls.arguments()  # type: ignore[attr-defined]
    try:
        inspect.signature(cls.__init__).bind(None, **given)  # type: ignore[misc]
    except TypeError as error:
        raise RobotFileError(f"{what}: {error}; it takes {', '.join(usage)}") from None
    with reading(what):
        term = cls(**given)
        if name := names.get("name"):
            term.name = name
        return term
