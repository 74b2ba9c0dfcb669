"""The builder: a robot drawn as a stick figure of named rods and stiff parts."""

from __future__ import annotations

import copy
import itertools
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.assembly import build_graph
from rodnet.graph.bodies import BodySpec, check_body
from rodnet.graph.joint_specs import JointSpec, joint_spec
from rodnet.graph.material import Material, Section
from rodnet.graph.polyline import coordinates_of, laid_out
from rodnet.graph.references import edge_at, node_of
from rodnet.graph.rod_graph import RodGraph
from rodnet.graph.rod_spec import (
    RodSpec,
    Taper,
    material_of,
    natural_length,
    natural_shape,
    sections_of,
    summary,
)
from rodnet.graph.selectors import check_name
from rodnet.memory import release
from rodnet.parameters import is_number

Point = str | Sequence[float] | np.ndarray


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
        self.joints: dict[int, JointSpec] = {}
        self.group_names: dict[str, tuple[str, ...]] = {}

    def rod(
        self,
        name: str,
        points: Sequence[Point],
        *,
        material: Material | Sequence[Material] | Callable[[float], Material],
        radius: float | Sequence[float] | Taper | Callable[[float], float] | None = None,
        section: Section | Sequence[Section] | Callable[[float], Section] | None = None,
        edges: int | None = None,
        root: str = "clamped",
        natural: str = "initial",
        natural_curvature: Any = None,
        natural_twist: Any = None,
        director: Sequence[float] | None = None,
        closed: bool = False,
        length: float | None = None,
    ) -> Self:
        """Add a soft rod along a polyline.

        Parameters
        ----------
        name : str
            Its name; globs in selectors match it.
        points : sequence of (3,) coordinates [m] or node references
            The polyline; its first and last points may be references.
        material : Material, sequence of Material (edges,) or callable
            Elastic material and density. Here and below, a function takes the arc length [m] and is
            evaluated in the middle of each edge.
        radius : float, array_like (edges,), Taper or callable
            Radius of a solid circular section [m]; or give ``section``.
        section : Section, sequence of Section (edges,) or callable
            Any cross-section (`circular`, `hollow`, `elliptic`).
        edges : int, optional
            Number of edges, spread along the polyline; by default the points are the nodes.
        root : {"clamped", "rigid"}
            Compliance of the joint at the rod's start: the rod's own half edge (the converged
            clamp), or none at all (the paper's stiff rim).
        natural : {"initial", "straight"}
            The undeformed shape; or give ``natural_curvature`` (kappa1, kappa2) [1/m], shape (2,)
            or (edges - 1, 2), and ``natural_twist`` [rad/m]: values at the inner nodes, or functions of
            the arc length.
        director : (3,), optional
            Direction of m1 at the start (made normal to the rod); matters for elliptic sections.
        closed : bool
            Join the end to the start: a ring.
        length : float, optional
            Natural length [m], over which the rod is stretched or compressed evenly to what is drawn; by
            default that of the polyline.

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
        nodes, drawn = self._polyline(name, points, edges, closed)
        line = np.frombuffer(self._coordinates).reshape(-1, 3)[nodes + nodes[:1] if closed else nodes]
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        made = material_of(name, material, s)
        sections = sections_of(name, radius, section, s)
        if director is not None and not (np.shape(director) == (3,) and np.all(np.isfinite(director))):
            raise GraphError(f"rod '{name}': director = {director!r} must be a finite vector (x, y, z)")
        shape = natural_shape(name, natural, natural_curvature, natural_twist, s, closed)
        start = None if director is None else np.asarray(director, dtype=float)
        self.specs[name] = RodSpec(
            name, "rod", nodes, made, sections, root, shape, start, closed=closed,
            line=None if edges is None else drawn, taper=radius if isinstance(radius, Taper) else None,
            drawn=float(s[-1]), length=natural_length(name, length),
        )  # fmt: skip
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
        if np.shape(stiffening) != (2,):
            raise GraphError(f"rigid part '{name}': stiffening = {stiffening!r} must be a pair of factors")
        factors = [("stiffening", factor) for factor in stiffening]
        for label, value in (("mass", mass), ("radius", radius), *factors):
            if value is not None and not (is_number(value) and value > 0):
                raise GraphError(f"rigid part '{name}': {label} = {value!r} must be positive and finite")
        nodes, _ = self._polyline(name, points, None, False)
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
        volume: float | None = None,
        cob: Sequence[float] | np.ndarray | None = None,
        mesh: Any = None,
    ) -> Self:
        """Make stiff parts one true rigid body of six degrees of freedom (docs, theory: rigid bodies).

        Everything acts on its nodes and edges as on any others.

        Parameters
        ----------
        parts : str or sequence of str
            Stiff parts that `rigid` has drawn; they need not touch.
        name : str, optional
            Name of the body, which selectors understand; by default that of its first part.
        mass : float, optional
            Mass [kg]; by default that of its parts.
        com : (3,), optional
            Centre of mass in the drawing [m]; by default that of the parts.
        inertia : (3,) or (3, 3), optional
            Moments of inertia about the centre of mass, in the axes of the drawing [kg m^2]; by default
            those of the parts as uniform cylinders of their radius.
        volume : float, optional
            Volume that it displaces, for buoyancy [m^3]; by default that of the parts as cylinders.
        cob : (3,), optional
            Centre of that volume (of buoyancy) in the drawing [m]; by default the centre of mass.
        mesh : trimesh.Trimesh, optional
            Its closed surface, in the drawing's axes and metres. It gives mass (by its density), ``com``,
            ``inertia``, ``volume`` and ``cob``, as far as they are not given.

        Raises
        ------
        GraphError
            For a part that is unknown, soft, or in another body, for impossible values and open meshes.
        """
        spec = check_body(self, parts, name, mass, com, inertia, volume, cob, mesh)
        if spec.name != spec.parts[0]:
            self.group(spec.name, spec.parts)
        self.bodies[spec.name] = spec
        return self

    def joint(
        self,
        at: str,
        *,
        hub: str | None = None,
        kind: str = "weld",
        of: str | Iterable[str] = (),
        axis: Sequence[float] | None = None,
        stiffness: float | Sequence[float] | None = None,
        axes: Any = None,
        angle: float = 0.0,
    ) -> Self:
        """Say how the edges at a node are joined; without a word they are welded together.

        Draw all rods that meet there first.

        Parameters
        ----------
        at : str
            The node, e.g. ``"head.end"``.
        hub : str
            Of a weld: the edge that carries the joint, ``"head:1-2"``, or the rod that ends there, ``"head"``;
            every other edge there is paired with it alone.
        kind : {"weld", "rigid", "hinge", "ball", "elastic"}
            ``"rigid"``: a weld with a frame of its own, exact for any sections. ``"hinge"``: turns about
            ``axis``, as far as it likes. ``"ball"``: turns freely. ``"elastic"``: turns against a stiffness.
        of : str or sequence of str
            The rods (``"fore"``) or edges (``"fore:0-1"``) that turn, each by itself; what is left stays
            welded together. By default every edge turns against every other.
        axis : (3,), optional
            Axis of a hinge, or of the twist of an elastic joint, as drawn.
        stiffness : float or sequence of float, optional
            Of a hinge (zero by default), or of an elastic joint: the same about every axis,
            (bending, twist) with ``axis``, or about the three ``axes`` [N m/rad].
        axes : (3, 3), optional
            Axes of an elastic joint as rows, orthogonal unit vectors; x, y, z by default.
        angle : float
            Angle at which a hinge with a stiffness is at rest [rad], positive when what turns is turned by
            the right hand about ``axis`` against the rest.

        Raises
        ------
        GraphError
            For an unknown kind, a stiffness or axis that makes no sense, a second joint at a node.
        """
        node = node_of(self.specs, at)
        if kind == "weld":
            given = (axis is not None, stiffness is not None, axes is not None, angle != 0.0, of != ())
            if hub is None or any(given):
                raise GraphError(
                    f"joint at '{at}': a weld has a hub= and nothing else; or give another kind="
                )
            self.hubs[node] = edge_at(self.specs, at, node, hub, "the hub edge ")
            self.joints.pop(node, None)
            return self
        if hub is not None:
            raise GraphError(f"joint at '{at}': only a weld has a hub=; say what turns with of=")
        if node in self.joints:
            raise GraphError(
                f"joint at '{at}': there is one already, of kind '{self.joints[node].kind}'; to combine joints draw "
                "a short stiff edge between two nodes, fig.rigid(...)"
            )
        turning = tuple(edge_at(self.specs, at, node, text) for text in ([of] if isinstance(of, str) else of))
        self.joints[node] = joint_spec(at, kind, turning, axis, stiffness, axes, angle)
        self.hubs.pop(node, None)
        return self

    def group(self, name: str, rods: Iterable[str]) -> Self:
        """Give several rods a common name that selectors understand."""
        self._new_name(name)
        members = (rods,) if isinstance(rods, str) else tuple(rods)
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

    def with_material(self, name: str, **changes: Any) -> StickFigure:
        """Return a copy in which one rod has other values of `RodSpec.properties`, ``E`` and so on."""
        other = self._kept()
        other.specs[name] = other.specs[name].with_properties(**changes)
        return other

    def __repr__(self) -> str:
        return f"StickFigure({summary(self.specs.values(), self.bodies, len(self.points))}; build() makes the graph)"

    def _kept(self) -> StickFigure:
        """Return a copy that later drawing does not change."""
        other = StickFigure()
        other._coordinates = self._coordinates[:]
        other.specs = {
            name: replace(spec, natural=copy.deepcopy(spec.natural)) for name, spec in self.specs.items()
        }
        other.hubs, other.joints = dict(self.hubs), dict(self.joints)
        other.group_names, other.bodies = dict(self.group_names), dict(self.bodies)
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

    def _polyline(
        self, name: str, points: Sequence[Point], edges: int | None, closed: bool
    ) -> tuple[array[int], np.ndarray]:
        """Numbers of a rod's nodes, new ones included, and the points that it is drawn through."""
        if isinstance(points, str) or not np.iterable(points) or len(points) < 2:
            raise GraphError(
                f"'{name}' needs at least two points, a list [(x, y, z), ...] in metres, not {points!r}"
            )
        ids: list[int | None] = []
        coordinates = []
        for point in points:
            if isinstance(point, str):
                node = node_of(self.specs, point)
                ids.append(node)
                coordinates.append(np.array(self._coordinates[3 * node : 3 * node + 3]))
                continue
            ids.append(None)
            coordinates.append(coordinates_of(name, point))
        drawn = np.array(coordinates)
        line, ids = laid_out(name, drawn, ids, edges, closed)
        new = [known is None for known in ids]
        count = itertools.count(len(self._coordinates) // 3)
        out = [next(count) if known is None else known for known in ids]
        self._coordinates.frombytes(np.ascontiguousarray(line[: len(ids)][new]).tobytes())
        if len(set(out)) != len(out):
            raise GraphError(
                f"'{name}' visits the same node twice; draw it as several rods, or use closed=True for a ring"
            )
        return array("q", out), drawn
