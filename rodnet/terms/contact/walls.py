"""Contact of rods with walls: planes, the inside of tubes, the outside of cylinders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm
from rodnet.terms.contact.base import Contact, bending_forces, edge_radii, law_table

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

SOURCE = "Li et al. 2020 (incremental potential contact), eqs 6 and 15"


def _points(owner: str, value: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise TermError(f"{owner} = {value!r} must be {what}, finite, of shape {shape}")
    return array


class PlaneContact(Contact):
    """A plane that nodes rest and slide on.

    Parameters
    ----------
    point : (3,)
        A point of the plane [m].
    normal : (3,)
        Its normal, towards the side where the rods are; of any length.
    on : str or sequence of str
        The rods or nodes that feel it.
    **options
        ``friction``, ``stiffness``, ``reach``, ``slip``, ``rod_radius`` (see `Contact`) and ``name``.

    Raises
    ------
    TermError
        If the normal is zero, or (when the robot is made) a node begins behind the plane.
    """

    default_name = "plane"
    source = SOURCE
    example: ClassVar[dict[str, Any]] = {
        "point": (0.0, 0.0, -0.5),
        "reach": 2.0,
        "friction": 0.4,
        "slip": 0.05,
    }

    def __init__(self, point: Any, normal: Any = (0.0, 0.0, 1.0), *, on: Any = "*", **options: Any) -> None:
        super().__init__(on, **options)
        self.point = _points("PlaneContact: point", point, (3,), "a point")
        self.normal = _points("PlaneContact: normal", normal, (3,), "a vector")
        if not np.linalg.norm(self.normal) > 0.0:
            raise TermError("PlaneContact: the normal is zero; give a vector towards the rods' side")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the nodes that ``on`` names."""
        from rodnet.terms.contact.wall_kernels import PLANE

        normal = self.normal / np.linalg.norm(self.normal)
        return _BoundWall(self, model, PLANE, 0.0, self.point, normal)


class TubeContact(Contact):
    """A round tube without ends that rods lie in, or a cylinder that they lie on or are drawn round.

    Parameters
    ----------
    axis : (2, 3)
        Two points of its axis [m].
    radius : float or Parameter
        Its radius, of the side that is touched [m].
    inside : bool
        Whether rods are inside.
    on : str or sequence of str
        The rods that feel it.
    **options
        ``friction``, ``stiffness``, ``reach``, ``slip``, ``rod_radius`` (see `Contact`) and ``name``.

    Raises
    ------
    TermError
        If the axis has no direction, a rod does not fit into the tube, or (when the robot is made) a rod
        begins on the wrong side.
    """

    default_name = "tube"
    source = SOURCE
    radius = Parameter(None, unit="m", bounds=(1e-9, None), kind="shape", doc="radius of the touched side")
    example: ClassVar[dict[str, Any]] = {
        "axis": ((0.0, 0.0, 0.0), (1.0, 0.1, 0.0)), "radius": 0.6, "reach": 0.9, "friction": 0.4, "slip": 0.05,
    }  # fmt: skip

    def __init__(self, axis: Any, radius: Any, *, inside: bool = True, on: Any = "*", **options: Any) -> None:
        super().__init__(on, radius=radius, **options)
        self.axis, self.inside = _points("TubeContact: axis", axis, (2, 3), "two points"), bool(inside)
        if not np.linalg.norm(self.axis[1] - self.axis[0]) > 0.0:
            raise TermError("TubeContact: the two points of the axis are the same; give two that differ")
        if self.radius.value is None or np.ndim(self.radius.value):
            raise TermError(f"TubeContact: radius = {radius!r} must be one length [m]")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the nodes (inside) or edges (outside) of the rods that ``on`` names."""
        from rodnet.terms.contact.wall_kernels import INSIDE, OUTSIDE

        direction = self.axis[1] - self.axis[0]
        kind = INSIDE if self.inside else OUTSIDE
        return _BoundWall(
            self, model, kind, float(self.radius.value), self.axis[0], direction / np.linalg.norm(direction)
        )


class _BoundWall(BoundTerm):
    """A wall's sites: nodes, or edges where free space is not convex."""

    def __init__(
        self, term: Contact, model: Model, kind: int, size: float, point: np.ndarray, axis: np.ndarray
    ) -> None:
        from rodnet.terms.contact import wall_kernels

        super().__init__(term)
        self.kernels, self.kind, self.size, self.point, self.axis = wall_kernels, kind, size, point, axis
        graph, radii, bending = model.graph, edge_radii(term, model.graph), bending_forces(model.graph)
        if kind == wall_kernels.OUTSIDE:
            edges = graph.edge_indices(term.on)
            self.nodes, self.radius, bending = (
                graph.edges[edges].astype(np.int32),
                radii[edges],
                bending[edges],
            )
        else:
            nodes = graph.nodes(term.on)
            self.nodes = nodes[:, None].astype(np.int32)
            thick, soft = np.zeros(graph.node_count), np.full(graph.node_count, np.inf)
            for end in (0, 1):
                np.maximum.at(thick, graph.edges[:, end], radii)
                np.minimum.at(soft, graph.edges[:, end], bending)
            self.radius, bending = thick[nodes], soft[nodes]
        self.law = law_table(term.values(len(self.nodes)), self.radius, bending)
        self.graph, self.x0 = graph, model.x0
        self.dofs = (3 * self.nodes[:, :, None] + np.arange(3, dtype=np.int32)).reshape(len(self.nodes), -1)
        self.stencils = [self.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Leave out what is held on all sides, and refuse what begins behind the wall."""
        from rodnet.packed import Packed

        free = (stencils[0] >= 0).any(axis=1)
        super().find_slots(pattern, [np.ascontiguousarray(stencils[0][free])])
        keep = lambda a: np.ascontiguousarray(a[free])  # noqa: E731
        self.nodes, self.radius, self.law = keep(self.nodes), keep(self.radius), keep(self.law)
        self.packed = Packed(
            self.kernels.WALL, self.law, self.nodes, self.radius, self.point, self.axis, self.slots[0]
        )
        gaps = self.gaps(self.x0)
        if len(gaps) and not gaps.min() > 0.0:
            k = int(np.argmin(gaps))
            raise TermError(
                f"contact '{self.term.name}': node '{self.graph.node_name(int(self.nodes[k, 0]))}' begins "
                f"{-gaps[k]:.3g} m behind the wall (its radius of {self.radius[k]:.3g} m counted); move the rod or "
                "the wall, or choose with on= what may touch it"
            )
        del self.x0

    def gaps(self, x: np.ndarray) -> np.ndarray:
        """Gap between the wall and every site [m], for node positions ``x``."""
        gaps = np.empty(len(self.nodes))
        self.kernels.wall_gaps(self.kind, self.size, self.packed.table, x, gaps)
        return gaps

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        grip = 0.0 if self.at_rest else 1.0
        return self.kernels.wall_forces(
            self.kind, self.size, grip, self.packed.table, ev.state, ev.cv, F, data, jac
        )

    def largest_step(self, x: np.ndarray, dx: np.ndarray) -> float:
        return self.kernels.wall_step(self.kind, self.size, self.packed.table, x, dx)

    def energy(self, ev: Evaluation) -> float:
        return self.kernels.wall_energy(self.kind, self.size, self.packed.table, ev.state)
