"""A stick figure as tables of a file: what `StickFigure.rod`, `rigid`, `joint` and `group` were told, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rodnet.errors import RobotFileError
from rodnet.files.schema import check_table, reading, shown
from rodnet.graph.bodies import BodySpec
from rodnet.graph.joint_specs import JointSpec
from rodnet.graph.material import Material, Section, circular, elliptic, hollow
from rodnet.graph.rod_spec import RodSpec, Taper
from rodnet.graph.stick_figure import StickFigure

Table = dict[str, Any]
MOMENTS = ("area", "I1", "I2", "J", "radius")
CONSTANTS = ("E", "nu", "rho")
NUMBER, LIST, TEXT, POINT = "a number", "a number or a list of numbers", "text", "three numbers [x, y, z]"
POINTS = "a list of points, each [x, y, z] or text as 'rod.end'"
ANY = "a number, or a list of numbers or of rows of numbers"
ROD = {
    "name": TEXT, "kind": TEXT, "points": POINTS, "edges": "a whole number", "material": "a table",
    "radius": "a number, a list with one per edge, or a table {start, end}",
    "section": "a table, or a list of tables", "root": TEXT, "natural": TEXT, "natural_curvature": ANY,
    "natural_twist": LIST, "director": POINT, "closed": "true or false",
    "length": NUMBER,
}  # fmt: skip
RIGID = {
    "name": TEXT, "kind": TEXT, "points": POINTS, "mass": NUMBER, "radius": NUMBER, "stiffening": "a pair of numbers",
}  # fmt: skip
BODY = {
    "name": TEXT, "parts": "text or a list of texts", "mass": NUMBER, "com": POINT,
    "inertia": "three numbers, or three rows of three",
}  # fmt: skip
JOINT = {
    "at": TEXT, "kind": TEXT, "hub": TEXT, "of": "text or a list of texts", "axis": POINT, "stiffness": LIST,
    "axes": "three rows of three numbers", "angle": NUMBER,
}  # fmt: skip


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
    bodies = [_body(spec) for spec in figure.bodies.values()]
    of_bodies = {spec.name for spec in figure.bodies.values() if spec.name not in spec.parts}
    groups = {k: list(v) for k, v in figure.group_names.items() if k not in of_bodies}
    return {"rod": rods, "body": bodies, "joint": joints, "group": groups}


def _body(spec: BodySpec) -> Table:
    given = {"mass": spec.mass, "com": spec.com, "inertia": spec.inertia}
    return {"name": spec.name, "parts": list(spec.parts)} | {
        k: np.asarray(v, dtype=float).tolist() for k, v in given.items() if v is not None
    }


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
    if spec.length is not None:
        table["length"] = spec.length
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
    for number, table in enumerate(tables.get("rod", []), 1):
        what = label("rod", table, "name", number)
        with reading(what):
            _draw_rod(figure, what, table)
    for number, table in enumerate(tables.get("body", []), 1):
        what = label("body", table, "name", number)
        check_table(what, table, BODY, ("parts",))
        with reading(what):
            figure.body(**table)
    for number, table in enumerate(tables.get("joint", []), 1):
        what = label("joint", table, "at", number)
        check_table(what, table, JOINT, ("at",))
        with reading(what):
            figure.joint(**table)
    groups = tables.get("group", {})
    check_table("[group]", groups, dict.fromkeys(groups, "a list of texts"))
    for name, rods in groups.items():
        with reading(f"[group] '{name}'"):
            figure.group(name, rods)
    return figure


def label(kind: str, table: Mapping[str, Any], key: str, number: int) -> str:
    """Name a table of a file, for messages."""
    name = table.get(key)
    return f"[[{kind}]] '{name}'" if isinstance(name, str) else f"[[{kind}]] number {number}"


def _draw_rod(figure: StickFigure, what: str, table: Mapping[str, Any]) -> None:
    kind = table.get("kind", "rod")
    if kind not in ("rod", "rigid"):
        raise RobotFileError(f"{what}: its kind is 'rod' or 'rigid', not {shown(kind)}")
    check_table(what, table, ROD if kind == "rod" else RIGID, ("name", "points"))
    options = {k: v for k, v in table.items() if k != "kind"}
    if kind == "rigid":
        figure.rigid(**options)
        return
    if "material" not in options:
        raise RobotFileError(f"{what} has no material; write material = {{E = 1e6, nu = 0.5, rho = 1000.0}}")
    options["material"] = _material(what, options["material"])
    if isinstance(options.get("radius"), dict):
        taper = f"{what}, radius"
        check_table(taper, options["radius"], {"start": NUMBER, "end": NUMBER}, ("start", "end"))
        options["radius"] = Taper(**options["radius"])
    if "section" in options:
        options["section"] = _section(what, options["section"])
    figure.rod(**options)


def _material(what: str, table: Mapping[str, Any]) -> Any:
    check_table(f"{what}, material", table, dict.fromkeys(CONSTANTS, LIST), ("E",))
    counts = {len(v) for v in table.values() if isinstance(v, list)}
    if not counts:
        return Material(**table)
    if len(counts) > 1:
        raise RobotFileError(f"{what}: the lists of its material have different lengths")
    rows = range(counts.pop())
    return [Material(**{k: v[e] if isinstance(v, list) else v for k, v in table.items()}) for e in rows]


def _section(what: str, table: Any) -> Any:
    if isinstance(table, list):
        return [_section(what, row) for row in table]
    makers: dict[frozenset[str], Callable[..., Section]] = {
        frozenset(MOMENTS): Section,
        frozenset({"radius"}): circular,
        frozenset({"radius", "inner"}): hollow,
        frozenset({"a", "b"}): elliptic,
    }
    make = makers.get(frozenset(table))
    if make is None:
        forms = " or ".join("{" + ", ".join(sorted(form)) + "}" for form in makers)
        raise RobotFileError(f"{what}: a section is {forms}, not {{{', '.join(table)}}}")
    check_table(f"{what}, section", table, dict.fromkeys(table, NUMBER))
    return make(**table)
