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
from rodnet.graph.polyline import laid_out
from rodnet.graph.rod_spec import RodSpec, Taper, sections_of
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
    "inertia": "three numbers, or three rows of three", "volume": NUMBER, "cob": POINT,
}  # fmt: skip
JOINT = {
    "at": TEXT, "kind": TEXT, "hub": TEXT, "of": "text or a list of texts", "axis": POINT, "stiffness": LIST,
    "axes": "three rows of three numbers", "angle": NUMBER,
}  # fmt: skip


def figure_tables(figure: StickFigure) -> Table:
    """Return the rods, joints and groups of a figure."""
    named: dict[int, str] = {}
    rods, x = [], figure.points
    for spec in figure.specs.values():
        rods.append({"name": spec.name, "kind": spec.kind, **_drawing(spec, x, named), **_options(spec, x)})
        for k, node in enumerate(spec.nodes):
            named.setdefault(node, _node(spec, k))
    joints: list[Table] = []
    for node, hub in figure.hubs.items():
        joints.append({"at": named[node], "kind": "weld", "hub": _edge(figure, node, hub)})
    joints += [_joint(figure, node, spec) for node, spec in figure.joints.items()]
    bodies = [_body(spec) for spec in figure.bodies.values()]
    of_bodies = {spec.name for spec in figure.bodies.values() if spec.name not in spec.parts}
    groups = {k: list(v) for k, v in figure.group_names.items() if k not in of_bodies}
    return {"rod": rods, "body": bodies, "joint": joints, "group": groups}


def _body(spec: BodySpec) -> Table:
    given = {k: getattr(spec, k) for k in ("mass", "com", "inertia", "volume", "cob")}
    return {"name": spec.name, "parts": list(spec.parts)} | {
        k: np.asarray(v, dtype=float).tolist() for k, v in given.items() if v is not None
    }


def _node(spec: RodSpec, k: int) -> str:
    """A node of a rod; its ends by their names, which stay when its number of edges is changed."""
    ends = {} if spec.closed else {0: ".start", len(spec.nodes) - 1: ".end"}
    return spec.name + ends.get(k, f":{k}")


def _drawing(spec: RodSpec, x: np.ndarray, named: Mapping[int, str]) -> Table:
    """Points that a rod was drawn through and its number of edges, or all of its nodes.

    The drawing is written if its nodes come out of it to the last bit.
    """
    line, nodes = spec.line, spec.nodes
    if line is None or not _comes_out(spec, line, x):
        return {"points": [named.get(node) or x[node].tolist() for node in nodes]}
    points: list[Any] = line.tolist()
    points[0] = named.get(nodes[0]) or points[0]
    if not spec.closed:
        points[-1] = named.get(nodes[-1]) or points[-1]
    return {"points": points, "edges": spec.edge_count}


def _comes_out(spec: RodSpec, line: np.ndarray, x: np.ndarray) -> bool:
    """Whether drawing a rod through these points again gives the nodes that it has."""
    again, _ = laid_out(spec.name, line, [None] * len(line), spec.edge_count, spec.closed)
    return np.array_equal(again, _path(spec, x))


def _path(spec: RodSpec, x: np.ndarray) -> np.ndarray:
    """Nodes of a rod, and of a ring its first once more [m]."""
    return x[[*spec.nodes, spec.nodes[0]] if spec.closed else spec.nodes]


def _radius(spec: RodSpec, x: np.ndarray) -> Any:
    """One radius [m], or a taper, or the radius of each edge."""
    if spec.taper is not None:
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(_path(spec, x), axis=0), axis=1))])
        if sections_of(spec.name, spec.taper, None, s) == spec.sections:
            return {"start": float(spec.taper.start), "end": float(spec.taper.end)}
    return _column(np.array([section.radius for section in spec.sections]))


def _options(spec: RodSpec, x: np.ndarray) -> Table:
    if spec.kind == "rigid":
        given = {"mass": spec.mass, "radius": spec.radius}
        return {k: float(v) for k, v in given.items() if v is not None} | {
            "stiffening": list(spec.stiffening)
        }
    table: Table = {"material": {k: _column(spec.property(k)) for k in CONSTANTS}}
    if all(section == circular(section.radius) for section in set(spec.sections)):
        table["radius"] = _radius(spec, x)
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


def _edge(figure: StickFigure, node: int, edge: tuple[str, int]) -> str:
    """An edge that ends at a node: the rod, if it ends there, else by number."""
    spec = figure.specs[edge[0]]
    if not spec.closed and node in (spec.nodes[0], spec.nodes[-1]):
        return spec.name
    return f"{spec.name}:{edge[1]}-{edge[1] + 1}"


def _joint(figure: StickFigure, node: int, spec: JointSpec) -> Table:
    table: Table = {"at": spec.at, "kind": spec.kind}
    if spec.of:
        table["of"] = [_edge(figure, node, edge) for edge in spec.of]
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
