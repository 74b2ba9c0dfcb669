"""A stick figure as tables of a file: what `StickFigure.rod`, `rigid`, `joint` and `group` were told, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rodnet.errors import RobotFileError, RodnetError
from rodnet.graph.joint_specs import JointSpec
from rodnet.graph.material import Material, Section, circular, elliptic, hollow
from rodnet.graph.rod_spec import RodSpec, Taper
from rodnet.graph.stick_figure import StickFigure

Table = dict[str, Any]
MOMENTS = ("area", "I1", "I2", "J", "radius")
CONSTANTS = ("E", "nu", "rho")
ROD = {
    "name", "points", "edges", "material", "radius", "section", "root", "natural", "natural_curvature",
    "natural_twist", "director", "closed",
}  # fmt: skip
RIGID = {"name", "points", "mass", "radius", "stiffening"}
JOINT = {"at", "kind", "hub", "of", "axis", "stiffness", "axes", "angle"}


def figure_tables(figure: StickFigure) -> Table:
    """Return the rods, joints and groups of a figure."""
    named: dict[int, str] = {}
    rods, x = [], figure.points.tolist()
    for spec in figure.specs.values():
        points = []
        for k, node in enumerate(spec.nodes):
            points.append(named[node] if node in named else x[node])
            named.setdefault(node, f"{spec.name}:{k}")
        rods.append({"name": spec.name, "kind": spec.kind, "points": points, **_options(spec)})
    joints = [{"at": named[node], "kind": "weld", "hub": _edge(hub)} for node, hub in figure.hubs.items()]
    joints += [_joint(spec) for spec in figure.joints.values()]
    return {"rod": rods, "joint": joints, "group": {k: list(v) for k, v in figure.group_names.items()}}


def _options(spec: RodSpec) -> Table:
    if spec.kind == "rigid":
        given = {"mass": spec.mass, "radius": spec.radius}
        return {k: float(v) for k, v in given.items() if v is not None} | {
            "stiffening": list(spec.stiffening)
        }
    table: Table = {"material": {k: _column(spec.property(k)) for k in CONSTANTS}}
    if all(section == circular(section.radius) for section in set(spec.sections)):
        table["radius"] = _column(np.array([section.radius for section in spec.sections]))
    else:
        rows = [{k: float(getattr(section, k)) for k in MOMENTS} for section in spec.sections]
        table["section"] = rows[0] if len(set(spec.sections)) == 1 else rows
    if spec.root != "clamped":
        table["root"] = spec.root
    if isinstance(spec.natural, dict):
        table |= {f"natural_{k}": v.tolist() for k, v in spec.natural.items()}
    elif spec.natural != "initial":
        table["natural"] = spec.natural
    if spec.director is not None:
        table["director"] = spec.director.tolist()
    return table | ({"closed": True} if spec.closed else {})


def _column(values: Any) -> Any:
    """One number if all are the same, else the list."""
    values = np.asarray(values, dtype=float)
    return float(values.flat[0]) if np.all(values == values.flat[0]) else values.tolist()


def _edge(edge: tuple[str, int]) -> str:
    return f"{edge[0]}:{edge[1]}-{edge[1] + 1}"


def _joint(spec: JointSpec) -> Table:
    table: Table = {"at": spec.at, "kind": spec.kind}
    if spec.of:
        table["of"] = [_edge(edge) for edge in spec.of]
    given = {k: v for k, v in spec.given.items() if v is not None and not (k == "angle" and v == 0.0)}
    return table | {k: np.asarray(v, dtype=float).tolist() for k, v in given.items()}


# -- and back -----------------------------------------------------------------------------
def draw(tables: Mapping[str, Any]) -> StickFigure:
    """Draw the figure that tables describe; arguments that they leave out have their usual defaults."""
    figure = StickFigure()
    for table in tables.get("rod", []):
        options, name = dict(table), f"rod {table.get('name', '?')!r}"
        kind = options.pop("kind", "rod")
        if kind not in ("rod", "rigid"):
            raise RobotFileError(f"{name}: its kind is 'rod' or 'rigid', not {kind!r}")
        check_keys(name, options, ROD if kind == "rod" else RIGID, ("name", "points"))
        if kind == "rigid":
            _drawn(name, figure.rigid, options)
            continue
        if "material" not in options:
            raise RobotFileError(
                f"{name} has no material; write material = {{E = 1e6, nu = 0.5, rho = 1000.0}}"
            )
        options["material"] = _material(name, options["material"])
        if isinstance(options.get("radius"), dict):
            options["radius"] = _made(name, Taper, options["radius"])
        if "section" in options:
            options["section"] = _section(name, options["section"])
        _drawn(name, figure.rod, options)
    for table in tables.get("joint", []):
        name = f"joint at {table.get('at', '?')!r}"
        check_keys(name, table, JOINT, ("at",))
        _drawn(name, figure.joint, table)
    for name, rods in tables.get("group", {}).items():
        figure.group(name, rods)
    return figure


def _drawn(name: str, draw: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Draw one part; words for numbers and the like are errors of the file."""
    try:
        draw(**options)
    except RodnetError:
        raise
    except (TypeError, ValueError, AttributeError) as error:
        raise RobotFileError(f"{name} cannot be drawn: {error}") from None


def check_keys(what: str, table: Mapping[str, Any], known: set[str], needed: tuple[str, ...] = ()) -> None:
    """Raise `RobotFileError` for keys of a table that mean nothing, or are missing."""
    unknown = sorted(set(table) - known)
    if unknown:
        raise RobotFileError(
            f"{what} has the unknown keys {', '.join(unknown)}; known are {', '.join(sorted(known))}"
        )
    for key in needed:
        if key not in table:
            raise RobotFileError(f"{what} has no '{key}'")


def _material(name: str, table: Any) -> Any:
    if not isinstance(table, dict):
        raise RobotFileError(f"{name}: material must be a table {{E = ..., nu = ..., rho = ...}}")
    check_keys(f"the material of {name}", table, set(CONSTANTS), ("E",))
    counts = {len(v) for v in table.values() if isinstance(v, list)}
    if not counts:
        return Material(**table)
    if len(counts) > 1:
        raise RobotFileError(f"{name}: the lists of its material have different lengths")
    rows = range(counts.pop())
    return [Material(**{k: v[e] if isinstance(v, list) else v for k, v in table.items()}) for e in rows]


def _section(name: str, table: Any) -> Any:
    if isinstance(table, list):
        return [_section(name, row) for row in table]
    if not isinstance(table, dict):
        raise RobotFileError(f"{name}: section must be a table, or a list of tables, one per edge")
    makers: dict[frozenset[str], Callable[..., Section]] = {
        frozenset(MOMENTS): Section,
        frozenset({"radius"}): circular,
        frozenset({"radius", "inner"}): hollow,
        frozenset({"a", "b"}): elliptic,
    }
    make = makers.get(frozenset(table))
    if make is None:
        forms = " or ".join("{" + ", ".join(sorted(form)) + "}" for form in makers)
        raise RobotFileError(f"{name}: a section is {forms}, not {{{', '.join(table)}}}")
    return make(**table)


def _made(name: str, make: Callable[..., Any], table: Mapping[str, Any]) -> Any:
    try:
        return make(**table)
    except TypeError:
        raise RobotFileError(f"{name}: a tapered radius is {{start = ..., end = ...}} [m]") from None
