"""The builder: a robot drawn as a stick figure of named rods and stiff parts."""

from __future__ import annotations

import copy
import itertools
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.assembly import build_graph
from rodnet.graph.bodies import BodySpec, check_body
from rodnet.graph.material import Material, Section, circular
from rodnet.graph.polyline import distribute_edges
from rodnet.graph.rod_graph import RodGraph
from rodnet.graph.selectors import check_name, parse
from rodnet.memory import release

Point = str | Sequence[float] | np.ndarray


@dataclass
class RodSpec:
    """What the user said of one rod or stiff part; `build_graph` turns it into arrays."""

    name: str
    kind: str
    nodes: list[int]
    material: Material | None = None
    sections: list[Section] = field(default_factory=list)
    root: str = "clamped"
    natural: str | dict[str, Any] = "initial"
    director: np.ndarray | None = None
    mass: float | None = None
    radius: float | None = None
    stiffening: tuple[float, float] = (1e2, 1e4)
    closed: bool = False

    @property
    def edge_count(self) -> int:
        """Number of edges."""
        return len(self.nodes) if self.closed else len(self.nodes) - 1


class StickFigure:
    """Draw rods (`rod`) and stiff parts (`rigid`); equal references share a node; then `build`.

    A point is a coordinate triple [m] or a reference to a node that exists: ``"head.end"``,
    ``"tail0:3"``. Where several edges meet, they are welded: `joint` declares a hub edge.

    Examples
    --------
    >>> import rodnet as rn
    >>> fig = rn.StickFigure()
    >>> _ = fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=10, material=rn.Material(E=1e6), radius=2e-3)
    >>> fig.build()
    RodGraph(1 rods, 11 nodes, 10 edges, 9 springs)
    """

    def __init__(self) -> None:
        self._coordinates = array("d")  # of all nodes, one after the other
        self.specs: dict[str, RodSpec] = {}
        self.hubs: dict[int, tuple[str, int]] = {}
        self.bodies: dict[str, BodySpec] = {}
        self.group_names: dict[str, tuple[str, ...]] = {}

    def rod(
        self,
        name: str,
        points: Sequence[Point],
        *,
        material: Material,
        radius: float | Sequence[float] | None = None,
        section: Section | None = None,
        edges: int | None = None,
        root: str = "clamped",
        natural: str = "initial",
        natural_curvature: Any = None,
        natural_twist: Any = None,
        director: Sequence[float] | None = None,
        closed: bool = False,
    ) -> Self:
        """Add a soft rod along a polyline.

        Parameters
        ----------
        name : str
            Its name; globs in selectors match it.
        points : sequence of (3,) coordinates [m] or node references
            The polyline; its first and last points may be references.
        material : Material
            Elastic material and density.
        radius : float or array_like, shape (edges,)
            Radius of a solid circular section [m]; or give ``section``.
        section : Section
            Any cross-section (`circular`, `hollow`, `elliptic`).
        edges : int, optional
            Number of edges, spread along the polyline; by default the points are the nodes.
        root : {"clamped", "rigid"}
            Compliance of the joint at the rod's start: the rod's own half edge (the converged
            clamp), or none at all (the paper's stiff rim).
        natural : {"initial", "straight"}
            The undeformed shape; or give ``natural_curvature`` (kappa1, kappa2) [1/m], shape (2,)
            or (edges - 1, 2), and ``natural_twist`` [rad/m].
        director : (3,), optional
            Direction of m1 at the start (made normal to the rod); matters for elliptic sections.
        closed : bool
            Join the end to the start: a ring.

        Raises
        ------
        GraphError
            For a duplicate or illegal name, an unknown reference, a bad radius or count.
        """
        self._new_name(name)
        if (radius is None) == (section is None):
            raise GraphError(f"rod '{name}': give either radius= or section=")
        if root not in ("clamped", "rigid"):
            raise GraphError(f"rod '{name}': root must be 'clamped' or 'rigid', not {root!r}")
        if natural not in ("initial", "straight"):
            raise GraphError(f"rod '{name}': natural must be 'initial' or 'straight', not {natural!r}")
        if not isinstance(material, Material):
            raise GraphError(
                f"rod '{name}': material must be a rodnet.Material, got {type(material).__name__}"
            )
        nodes = self._polyline(name, points, edges, closed)
        count = len(nodes) if closed else len(nodes) - 1
        if section is not None:
            sections = [section] * count
        else:
            values = np.asarray(radius, dtype=float)
            if values.ndim and len(values) != count:
                raise GraphError(f"rod '{name}': radius has {len(values)} values for {count} edges")
            try:
                made = {r: circular(r) for r in np.unique(values).tolist()}
                sections = [made[r] for r in np.broadcast_to(values, count).tolist()]
            except GraphError as error:
                raise GraphError(f"rod '{name}': {error}") from None
        if director is not None and not (np.shape(director) == (3,) and np.all(np.isfinite(director))):
            raise GraphError(f"rod '{name}': director = {director!r} must be a finite vector (x, y, z)")
        shape: str | dict[str, Any] = natural
        if natural_curvature is not None or natural_twist is not None:
            shape = {
                "curvature": np.zeros(2)
                if natural_curvature is None
                else np.asarray(natural_curvature, dtype=float),
                "twist": np.asarray(0.0 if natural_twist is None else natural_twist, dtype=float),
            }
            if not all(np.all(np.isfinite(v)) for v in shape.values()):
                raise GraphError(f"rod '{name}': natural curvature and twist must be finite")
        self.specs[name] = RodSpec(
            name,
            "rod",
            nodes,
            material,
            sections,
            root,
            shape,
            None if director is None else np.asarray(director, dtype=float),
            closed=closed,
        )
        return self

    def rigid(
        self,
        name: str,
        points: Sequence[Point],
        *,
        mass: float | None = None,
        radius: float | None = None,
        stiffening: tuple[float, float] = (1e2, 1e4),
    ) -> Self:
        """Add a stiff part: edges that are much stiffer than the soft rods (the paper's head and disc).

        Parameters
        ----------
        name : str
            Its name.
        points : sequence of (3,) coordinates [m] or node references
            Its nodes.
        mass : float, optional
            Total mass [kg], spread along its length; by default that of the stiffest soft rod's section.
        radius : float, optional
            Outer radius [m], for rotary inertia and pictures; by default that of the stiffest soft rod.
        stiffening : (float, float)
            Multiples of the stiffest soft rod's EA and of its EI and GJ.

        Raises
        ------
        GraphError
            For a duplicate or illegal name, an unknown reference, a mass or radius that is not positive.
        """
        self._new_name(name)
        try:
            axial, angular = stiffening
        except (TypeError, ValueError):
            raise GraphError(
                f"rigid part '{name}': stiffening = {stiffening!r} must be a pair of factors"
            ) from None
        for label, value in (
            ("mass", mass),
            ("radius", radius),
            ("stiffening", axial),
            ("stiffening", angular),
        ):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise GraphError(f"rigid part '{name}': {label} = {value!r} must be positive and finite")
        nodes = self._polyline(name, points, None, False)
        self.specs[name] = RodSpec(name, "rigid", nodes, mass=mass, radius=radius, stiffening=stiffening)
        return self

    def body(
        self,
        parts: str | Sequence[str],
        *,
        name: str | None = None,
        mass: float | None = None,
        com: Sequence[float] | np.ndarray | None = None,
        inertia: Sequence[float] | np.ndarray | None = None,
    ) -> Self:
        """Make stiff parts one true rigid body of six degrees of freedom (docs, theory: rigid bodies).

        Rods, motors, drag, loads and constraints act on its nodes and edges as on any others. The parts
        need not touch.

        Parameters
        ----------
        parts : str or sequence of str
            Stiff parts that `rigid` has drawn.
        name : str, optional
            Name of the body, which selectors understand; by default that of its first part.
        mass : float, optional
            Mass [kg]; by default that of its parts.
        com : (3,), optional
            Centre of mass in the drawing [m]; by default that of the parts.
        inertia : (3,) or (3, 3), optional
            Moments of inertia about the centre of mass, in the axes of the drawing [kg m^2]; by default
            those of the parts as uniform cylinders of their radius.

        Raises
        ------
        GraphError
            For a part that is unknown, soft, or in another body, and for impossible values.
        """
        spec = check_body(self, parts, name, mass, com, inertia)
        if spec.name != spec.parts[0]:
            self.group(spec.name, spec.parts)
        self.bodies[spec.name] = spec
        return self

    def joint(self, at: str, *, hub: str) -> Self:
        """Declare the hub edge of a joint: every other edge there is paired with it alone.

        Parameters
        ----------
        at : str
            The node, e.g. ``"head.end"``.
        hub : str
            The edge that carries the joint, e.g. ``"head:1-2"``.
        """
        node = self._reference(at)
        spec, k = self._find_edge(hub)
        if node not in (spec.nodes[k], spec.nodes[(k + 1) % len(spec.nodes)]):
            raise GraphError(f"joint at '{at}': the hub edge '{hub}' does not end there")
        self.hubs[node] = (spec.name, k)
        return self

    def group(self, name: str, rods: Iterable[str]) -> Self:
        """Give several rods a common name that selectors understand."""
        self._new_name(name)
        members = tuple(rods)
        for rod in members:
            if rod not in self.specs:
                raise GraphError(f"group '{name}': there is no rod '{rod}'; add the rods first")
        self.group_names[name] = members
        return self

    def build(self) -> RodGraph:
        """Validate the figure and return the immutable `RodGraph`.

        Raises
        ------
        GraphError
            For edges without length, coincident nodes that are not joined, no soft rod to take the
            stiffness of stiff parts from, or values that are not finite; the message names the rod.
        """
        if not self.specs:
            raise GraphError("the stick figure is empty; add a rod with fig.rod(...)")
        graph = build_graph(self._kept())
        release(graph.dof_count)
        return graph

    def with_material(self, name: str, **changes: float) -> StickFigure:
        """Return a copy in which one rod has other material constants (``E``, ``nu``, ``rho``)."""
        other = self._kept()
        spec = other.specs[name]
        if spec.material is None:
            raise GraphError(f"'{name}' is a stiff part and has no material")
        spec.material = replace(spec.material, **changes)
        return other

    def _kept(self) -> StickFigure:
        """Return a copy that later drawing does not change."""
        other = StickFigure()
        other._coordinates = self._coordinates[:]
        other.specs = {
            name: replace(spec, natural=copy.deepcopy(spec.natural)) for name, spec in self.specs.items()
        }
        other.hubs, other.group_names = dict(self.hubs), dict(self.group_names)
        other.bodies = dict(self.bodies)
        return other

    @property
    def points(self) -> np.ndarray:
        """Positions of all nodes [m], shape (N, 3)."""
        return np.array(self._coordinates).reshape(-1, 3)

    # -- points and names -----------------------------------------------------------------
    def _new_name(self, name: str) -> None:
        check_name(name)
        if name in self.specs or name in self.group_names:
            raise GraphError(f"the name '{name}' is taken; every rod and group needs its own")

    def _reference(self, text: str) -> int:
        selector = parse(text)
        spec = self.specs.get(selector.glob)
        if spec is None:
            raise GraphError(
                f"'{text}': there is no rod '{selector.glob}' yet; known are {', '.join(self.specs) or 'none'}"
            )
        if selector.end is not None:
            return spec.nodes[0 if selector.end == "start" else -1]
        if selector.node is not None and selector.node2 is None:
            if selector.node >= len(spec.nodes):
                raise GraphError(f"'{text}': rod '{spec.name}' has nodes 0 to {len(spec.nodes) - 1}")
            return spec.nodes[selector.node]
        raise GraphError(
            f"'{text}' is not a node reference; write '{spec.name}.start', '{spec.name}.end' or '{spec.name}:3'"
        )

    def _find_edge(self, text: str) -> tuple[RodSpec, int]:
        selector = parse(text)
        spec = self.specs.get(selector.glob)
        if spec is None or selector.node is None or selector.node2 != selector.node + 1:
            raise GraphError(f"'{text}' names no edge; write e.g. 'head:1-2'")
        if selector.node >= spec.edge_count:
            raise GraphError(f"'{text}': '{spec.name}' has {spec.edge_count} edges")
        return spec, selector.node

    def _polyline(self, name: str, points: Sequence[Point], edges: int | None, closed: bool) -> list[int]:
        if len(points) < 2:
            raise GraphError(f"'{name}' needs at least two points")
        ids: list[int | None] = []
        coordinates = []
        for point in points:
            if isinstance(point, str):
                node = self._reference(point)
                ids.append(node)
                coordinates.append(np.array(self._coordinates[3 * node : 3 * node + 3]))
                continue
            xyz = np.asarray(point, dtype=float)
            if xyz.shape != (3,) or not np.all(np.isfinite(xyz)):
                raise GraphError(
                    f"'{name}': {point!r} is not a finite point (x, y, z) [m] nor a reference like 'rod.end'"
                )
            ids.append(None)
            coordinates.append(xyz)
        line = np.array(coordinates)
        if closed:
            line = np.vstack([line, line[:1]])
        zero = np.flatnonzero(np.linalg.norm(np.diff(line, axis=0), axis=1) <= 0.0)
        if len(zero):
            raise GraphError(
                f"'{name}' has an edge of zero length between its points {zero[0]} and {zero[0] + 1}; remove one"
            )
        if edges is not None:
            if isinstance(edges, bool | str) or not np.isfinite(edges) or int(edges) != edges or edges < 1:
                raise GraphError(f"'{name}': edges = {edges!r} must be a positive integer")
            if any(i is not None for i in ids[1:-1]):
                raise GraphError(f"'{name}': with edges=, only its first and last points may be references")
            line = distribute_edges(line, int(edges))
            inner: list[int | None] = [None] * (len(line) - 2)
            ids = [ids[0], *inner] if closed else [ids[0], *inner, ids[-1]]
        new = [known is None for known in ids]
        count = itertools.count(len(self._coordinates) // 3)
        out = [next(count) if known is None else known for known in ids]
        self._coordinates.frombytes(np.ascontiguousarray(line[: len(ids)][new]).tobytes())
        if len(set(out)) != len(out):
            raise GraphError(
                f"'{name}' visits the same node twice; draw it as several rods, or use closed=True for a ring"
            )
        return out
