"""What the user says of one rod, along its length: sections, materials and the natural shape, edge by edge."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.material import Material, Section, circular
from rodnet.parameters import is_number


@dataclass(frozen=True)
class Taper:
    """A radius that changes evenly from a rod's start to its end.

    Parameters
    ----------
    start, end : float
        Radii at the two ends [m].
    """

    start: float
    end: float

    def __post_init__(self) -> None:
        for radius in (self.start, self.end):
            if isinstance(radius, bool) or not isinstance(radius, int | float | np.number):
                raise GraphError(f"Taper: its radii must be two numbers [m], not {radius!r}")

    def __call__(self, fraction: np.ndarray) -> np.ndarray:
        """Radius at a fraction of the length [m]."""
        return self.start + (self.end - self.start) * fraction


# what can be changed of a rod by name: unit and bounds
UNITS: dict[str, tuple[str, tuple[float | None, float | None]]] = {
    "E": ("Pa", (0.0, None)),
    "nu": ("1", (-1.0, 0.5)),
    "rho": ("kg/m^3", (0.0, None)),
    "radius": ("m", (0.0, None)),
    "curvature1": ("1/m", (None, None)),
    "curvature2": ("1/m", (None, None)),
    "twist": ("rad/m", (None, None)),
    "length": ("m", (1e-9, None)),
}
# where numbers of the natural shape are
_NATURAL: dict[str, tuple[str, Any]] = {
    "curvature1": ("curvature", (..., 0)),
    "curvature2": ("curvature", (..., 1)),
    "twist": ("twist", ...),
}


@dataclass
class RodSpec:
    """What the user said of one rod or stiff part; `build_graph` turns it into arrays."""

    name: str
    kind: str
    nodes: array[int]  # a list takes five times the memory
    material: Material | tuple[Material, ...] | None = None
    sections: list[Section] = field(default_factory=list)
    root: str = "clamped"
    natural: str | dict[str, Any] = "initial"
    director: np.ndarray | None = None
    mass: float | None = None
    radius: float | None = None
    stiffening: tuple[float, float] = (1e2, 1e4)
    closed: bool = False
    line: np.ndarray | None = None  # what `edges` were spread along, (points, 3); None: its nodes
    taper: Taper | None = None  # what the sections were made from
    drawn: float = 1.0
    length: float | None = None

    @property
    def stretched(self) -> float:
        """Natural length of the edges over that which is drawn."""
        return 1.0 if self.length is None else self.length / self.drawn

    @property
    def edge_count(self) -> int:
        """Number of edges."""
        return len(self.nodes) if self.closed else len(self.nodes) - 1

    @property
    def properties(self) -> tuple[str, ...]:
        """Names of the numbers that can be changed: of the material, the section, a natural shape that is given."""
        if self.material is None:
            return ()
        natural = tuple(_NATURAL) if self.natural != "initial" else ()
        return ("E", "nu", "rho", "radius", *natural, "length")

    def property(self, name: str) -> Any:
        """A number of the rod, or an array.

        A constant of the material (``E``, ``nu``, ``rho``, ``G``) or the ``radius``, shape () or (edges,); the
        natural ``length``; of the natural shape ``curvature1``, ``curvature2`` or ``twist``, shape () or
        (inner nodes,).
        """
        if name == "radius":
            radii = np.array([section.radius for section in self.sections])
            return float(radii[0]) if np.all(radii == radii[0]) else radii
        if name == "length":
            return self.drawn if self.length is None else self.length
        if name in _NATURAL:
            value = (
                0.0 if isinstance(self.natural, str) else self.natural[_NATURAL[name][0]][_NATURAL[name][1]]
            )
            return np.asarray(value, dtype=float) if np.ndim(value) else float(value)
        if isinstance(self.material, tuple):
            return np.array([getattr(m, name) for m in self.material])
        return getattr(self.material, name)

    def with_properties(self, **changes: Any) -> RodSpec:
        """Return a copy with other values of `properties`; a section stays similar to itself."""
        spec = self
        for name, value in changes.items():
            spec = spec._with(name, value)
        return spec

    def _with(self, name: str, value: Any) -> RodSpec:
        if name == "radius":
            radii = np.broadcast_to(value, len(self.sections)).tolist()
            return replace(
                self, sections=[s.scaled(r / s.radius) for s, r in zip(self.sections, radii, strict=True)]
            )
        if name == "length":
            if np.ndim(value):
                raise GraphError(f"rod '{self.name}': length must be one number, not {value}")
            return replace(self, length=float(value))
        if name not in _NATURAL:
            return self.with_material(**{name: value})
        given = (
            self.natural
            if isinstance(self.natural, dict)
            else {"curvature": np.zeros(2), "twist": np.zeros(())}
        )
        key, place = _NATURAL[name]
        shape = np.broadcast_shapes(np.shape(given[key][place]), np.shape(value))
        if key == "curvature":
            shape = (*shape, 2)
        array = np.array(np.broadcast_to(given[key], shape), dtype=float)
        array[place] = value
        return replace(self, natural={**given, key: array})

    def with_material(self, **changes: Any) -> RodSpec:
        """Return a copy with other material constants; arrays have one value per edge."""
        if self.material is None:
            raise GraphError(f"'{self.name}' is a stiff part and has no material")
        if not isinstance(self.material, tuple) and not any(np.ndim(v) for v in changes.values()):
            return replace(self, material=replace(self.material, **changes))
        count = self.edge_count
        try:
            columns = {k: np.broadcast_to(v, count).tolist() for k, v in changes.items()}
        except ValueError:
            raise GraphError(
                f"rod '{self.name}': a material needs one value or {count}, one per edge"
            ) from None
        given = self.material if isinstance(self.material, tuple) else (self.material,) * count
        made = (replace(m, **{k: v[e] for k, v in columns.items()}) for e, m in enumerate(given))
        return replace(self, material=tuple(made))


def summary(specs: Iterable[RodSpec], bodies: Iterable[str], nodes: int) -> str:
    """What is drawn, in a line."""
    parts: dict[str, list[str]] = {"rod": [], "stiff part": [], "body": list(bodies)}
    for spec in specs:
        parts["stiff part" if spec.kind == "rigid" else "rod"].append(spec.name)
    told = [f"{what} {', '.join(names)}" for what, names in parts.items() if names]
    return f"{'; '.join(told) or 'empty'}; {nodes} nodes"


def sections_of(name: str, radius: Any, section: Any, s: np.ndarray) -> list[Section]:
    """Section of each edge.

    Parameters
    ----------
    name : str
        The rod.
    radius : float, sequence, callable, `Taper` or None
        Radius of solid circles [m]; a function takes the arc length [m].
    section : Section, sequence, callable or None
        Any section, instead.
    s : ndarray, shape (edges + 1,)
        Arc length of the nodes, and of the start of a ring once more [m].
    """
    count, middle = len(s) - 1, 0.5 * (s[:-1] + s[1:])
    if section is not None:
        found = _each(name, "section", section, middle, Section)
        return [found] * count if isinstance(found, Section) else list(found)
    if isinstance(radius, Taper):
        values = radius(middle / s[-1])
    elif callable(radius):
        values = np.array([radius(x) for x in middle], dtype=float)
    else:
        try:
            values = np.asarray(radius, dtype=float)
        except (TypeError, ValueError):
            raise GraphError(
                f"rod '{name}': radius = {radius!r} must be a number [m], or a list with one per edge"
            ) from None
    if values.ndim and values.shape != (count,):
        what = f"{len(values)} values" if values.ndim == 1 else f"shape {values.shape}"
        raise GraphError(f"rod '{name}': radius has {what} for {count} edges")
    try:
        made = {r: circular(r) for r in np.unique(values).tolist()}
    except GraphError as error:
        raise GraphError(f"rod '{name}': {error}") from None
    return [made[r] for r in np.broadcast_to(values, count).tolist()]


def material_of(name: str, material: Any, s: np.ndarray) -> Material | tuple[Material, ...]:
    """Material of a rod, or of each of its edges; a function takes the arc length [m]."""
    found = _each(name, "material", material, 0.5 * (s[:-1] + s[1:]), Material)
    return found if isinstance(found, Material) else tuple(found)


def _each(name: str, what: str, value: Any, middle: np.ndarray, kind: type) -> Any:
    """One object of a kind, or a list of one for each edge."""
    if isinstance(value, kind):
        return value
    if isinstance(value, Sequence) and not isinstance(value, str):
        found = list(value)
        if len(found) != len(middle):
            raise GraphError(f"rod '{name}': {what} has {len(found)} values for {len(middle)} edges")
    elif callable(value) and not isinstance(value, type):
        found = [value(float(x)) for x in middle]
    else:
        found = [value]
    for one in found:
        if not isinstance(one, kind):
            article = "a rodnet." + kind.__name__
            raise GraphError(f"rod '{name}': {what} must be {article}, got {type(one).__name__}")
    return found


def natural_length(name: str, length: Any) -> float | None:
    """Natural length of a rod [m], or None for that of the polyline."""
    if length is None:
        return None
    if not (is_number(length) and length > 0):
        raise GraphError(
            f"rod '{name}': length = {length!r} must be its natural length, a positive number [m]"
        )
    return float(length)


def natural_shape(name: str, natural: str, curvature: Any, twist: Any, s: np.ndarray, closed: bool) -> Any:
    """Natural shape: "initial", "straight", or curvature [1/m] and twist [rad/m] at the inner nodes."""
    if natural not in ("initial", "straight"):
        raise GraphError(f"rod '{name}': natural must be 'initial' or 'straight', not {natural!r}")
    if curvature is None and twist is None:
        return natural
    at = s[1:] if closed else s[1:-1] if len(s) > 2 else s[:1]
    shape = {
        "curvature": np.zeros(2) if curvature is None else _values(curvature, at),
        "twist": np.asarray(0.0) if twist is None else _values(twist, at),
    }
    n = len(at)
    if shape["curvature"].shape not in ((2,), (n, 2)) or shape["twist"].shape not in ((), (n,)):
        raise GraphError(
            f"rod '{name}': natural_curvature needs shape (2,) or ({n}, 2), natural_twist () or ({n},)"
        )
    if not all(np.all(np.isfinite(v)) for v in shape.values()):
        raise GraphError(f"rod '{name}': natural curvature and twist must be finite")
    return shape


def _values(given: Any | Callable[[float], Any], at: np.ndarray) -> np.ndarray:
    """Given values, or those of a function of the arc length."""
    return np.array([given(float(x)) for x in at] if callable(given) else given, dtype=float)
