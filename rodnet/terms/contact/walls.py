"""Contact of rods with walls: planes, the inside of tubes, the outside of cylinders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm
from rodnet.terms.contact.base import Contact, edge_radii, firmness, law_table
from rodnet.terms.drag.line import edge_dofs

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
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
        ``friction``, ``stiffness``, ``reach``, ``slip``, ``damping``, ``rod_radius`` (see `Contact`) and ``name``.

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
        """Bind to the rods or nodes that ``on`` names."""
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
        ``friction``, ``stiffness``, ``reach``, ``slip``, ``damping``, ``rod_radius`` (see `Contact`) and ``name``.

    Inside a tube the reach is at most the clearance, its radius less the rod's, so that nothing is pushed on the
    axis, where no direction is outward; by default it is at most half of that.

    Raises
    ------
    TermError
        If the axis has no direction, a rod does not fit into the tube, the reach is longer than the
        clearance, or (when the robot is made) a rod begins on the wrong side.
    """

    default_name = "tube"
    source = SOURCE
    radius = Parameter(None, unit="m", bounds=(1e-9, None), kind="shape", doc="radius of the touched side")
    example: ClassVar[dict[str, Any]] = {
        "axis": ((0.0, 0.0, -0.5), (1.0, 0.1, -0.5)), "radius": 0.9, "reach": 0.8, "stiffness": 0.1, "friction": 0.4,
        "slip": 0.05,
    }  # fmt: skip

    def __init__(self, axis: Any, radius: Any, *, inside: bool = True, on: Any = "*", **options: Any) -> None:
        super().__init__(on, radius=radius, **options)
        self.axis, self.inside = _points("TubeContact: axis", axis, (2, 3), "two points"), bool(inside)
        if not np.linalg.norm(self.axis[1] - self.axis[0]) > 0.0:
            raise TermError("TubeContact: the two points of the axis are the same; give two that differ")
        if self.radius.value is None or np.ndim(self.radius.value):
            raise TermError(f"TubeContact: radius = {radius!r} must be one length [m]")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the rods that ``on`` names."""
        from rodnet.terms.contact.wall_kernels import INSIDE, OUTSIDE

        direction = self.axis[1] - self.axis[0]
        kind = INSIDE if self.inside else OUTSIDE
        return _BoundWall(
            self, model, kind, float(self.radius.value), self.axis[0], direction / np.linalg.norm(direction)
        )


class _BoundWall(BoundTerm):
    """A wall's sites: both halves of edges, or whole edges where free space is not convex."""

    def __init__(
        self, term: Contact, model: Model, kind: int, size: float, point: np.ndarray, axis: np.ndarray
    ) -> None:
        from rodnet.terms.contact import wall_kernels
        from rodnet.terms.contact.law import stored_energy

        super().__init__(term)
        self.stored = stored_energy
        self.kernels, self.kind, self.size, self.point, self.axis = wall_kernels, kind, size, point, axis
        graph = model.graph
        if kind == wall_kernels.OUTSIDE:
            self.edge = graph.edge_indices(term.on).astype(np.int64)
            self.place = np.full(len(self.edge), -1.0)
        else:
            touching = np.isin(graph.edges, graph.nodes(term.on))
            self.edge, end = (a.astype(np.int64) for a in np.nonzero(touching))
            self.place = end.astype(float)
        self.radius = edge_radii(term, graph)[self.edge]
        clearance = size - self.radius if kind == wall_kernels.INSIDE else np.full(len(self.edge), np.inf)
        self._fit(graph, clearance, 0.0)
        self.law = law_table(
            term.values(len(self.edge)), self.radius, firmness(term, graph)[self.edge], clearance
        )
        self._fit(graph, clearance, self.law[:, 1])
        self.graph, self.x0, self.edges = graph, model.x0, model.edges
        self.dofs = edge_dofs(model, self.edge)
        self.stencils = [self.dofs]

    def _fit(self, graph: RodGraph, clearance: np.ndarray, reach: np.ndarray | float) -> None:
        """Refuse a clearance that is not above zero, or is below the reach."""
        wrong = np.flatnonzero(~((clearance > 0.0) & (clearance >= reach)))
        if not len(wrong):
            return
        k = int(wrong[np.argmin(clearance[wrong])])
        edge, room = graph.edge_name(int(self.edge[k])), clearance[k]
        if not room > 0.0:
            raise TermError(
                f"contact '{self.term.name}': the edge '{edge}' of radius {self.radius[k]:.3g} m does not fit into the "
                f"tube of radius {self.size:.3g} m; choose with on= what is in it"
            )
        raise TermError(
            f"contact '{self.term.name}': the reach of {self.law[k, 1]:.3g} m is longer than the clearance of "
            f"{room:.3g} m between the edge '{edge}' and the tube, so that it would be pushed even on the axis; give "
            f"reach= below {room:.3g}, or leave it out"
        )

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Leave out what is held, and refuse what begins behind the wall."""
        from rodnet.packed import Packed

        first, second = (stencils[0][:, k : k + 3] for k in (0, 3))
        at = np.where(self.place[:, None] == 0.0, first, second)
        free = (at >= 0).any(axis=1) | ((self.place < 0.0) & (first >= 0).any(axis=1))
        super().find_slots(pattern, [np.ascontiguousarray(stencils[0][free])])
        for name in ("edge", "place", "radius", "law", "dofs"):
            setattr(self, name, np.ascontiguousarray(getattr(self, name)[free]))
        self.packed = Packed(
            self.kernels.WALL, self.law, self.edge, self.place, self.radius, self.point, self.axis, self.dofs,
            self.slots[0],
        )  # fmt: skip
        gaps = self.gaps(self.x0)
        if len(gaps) and not gaps.min() > 0.0:
            k = int(np.argmin(gaps))
            end = int(self.place[k])
            node = self.graph.node_name(int(self.edges[self.edge[k], end]))
            culprit = f"node '{node}'" if end >= 0 else f"edge '{self.graph.edge_name(int(self.edge[k]))}'"
            raise TermError(
                f"contact '{self.term.name}': {culprit} begins {-gaps[k]:.3g} m behind the wall (its radius of "
                f"{self.radius[k]:.3g} m counted); move the rod or the wall, or choose with on= what may touch it"
            )
        del self.x0

    def gaps(self, x: np.ndarray) -> np.ndarray:
        """Gap between the wall and every site [m], for node positions ``x``."""
        gaps = np.empty(len(self.edge))
        self.kernels.wall_gaps(self.kind, self.size, self.packed.table, x, self.edges, gaps)
        return gaps

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        grip = 0.0 if self.at_rest else 1.0
        return self.kernels.wall_forces(
            self.kind, self.size, grip, self.packed.table, ev.state, ev.cv, F, data, jac
        )

    def largest_step(self, x: np.ndarray, dx: np.ndarray) -> float:
        return self.kernels.wall_step(self.kind, self.size, self.packed.table, x, dx, self.edges)

    def energy(self, ev: Evaluation) -> float:
        return self.stored(self.law, self.gaps(ev.x))
