"""A head in Stokes flow: drag force and torque on one node and one edge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import GraphError, TermError
from rodnet.kinematics.frames import material_frames, unit
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import edge_dofs

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class StokesHead(Term):
    """Stokes drag of a head: F = -6 pi mu a C1 v on a node, T = -8 pi mu a^3 C2 dtheta/dt on an edge.

    Parameters
    ----------
    at : str
        The node, e.g. ``"head:1"``.
    viscosity : float or Parameter
        Dynamic viscosity [Pa s].
    radius : float or Parameter
        Radius a of the head [m].
    C1, C2 : float or Parameter
        Shape factors of force and torque [1]; 1 is a sphere.
    shape : array_like, shape (6, 6), optional
        Resistance of a head of any shape for unit viscosity, about the node, in the axes of the figure as it
        is built, replacing radius, C1 and C2: blocks in [m], [m^2], [m^3], see `rodnet.stokes_resistance`.
    edge : str, optional
        The edge whose twist feels the torque; by default the one before the node on its rod.
    resistance : array_like, shape (6, 6), optional
        Full resistance matrix in the edge's material frame (m1, m2, t), from (velocity, angular
        velocity) to (force, torque), replacing C1 and C2: blocks in [N s/m], [N s], [N m s].
    """

    kind = "drag"
    default_name = "head"
    source = "Du et al., refined Stokes drag and torque; Happel & Brenner 1983 (6 x 6 resistance)"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, Any]] = {"viscosity": 1.0, "radius": 0.02}

    viscosity = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="dynamic viscosity")
    radius = Parameter(None, unit="m", bounds=(0, None), doc="radius of the head")
    C1 = Parameter(1.0, unit="1", bounds=(0, None), doc="shape factor of the drag force")
    C2 = Parameter(1.0, unit="1", bounds=(0, None), doc="shape factor of the drag torque")

    def __init__(
        self,
        *,
        at: str,
        edge: str | None = None,
        shape: Any = None,
        resistance: Any = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(at, name=name or at.split(":")[0].split(".")[0], **parameters)
        self.at, self.edge = at, edge
        self.shape, self.resistance = (
            _matrix(name, R) for name, R in (("shape", shape), ("resistance", resistance))
        )
        known = self.viscosity.value is not None
        if shape is not None and (resistance is not None or not known):
            raise TermError("StokesHead: shape= goes with viscosity=, and not with resistance=")
        if shape is None and resistance is None and not (known and self.radius.value is not None):
            raise TermError("StokesHead: give viscosity= and radius= or shape=, or else resistance=")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the node and the edge."""
        node = model.graph.node(self.at)
        edge = model.graph.edge_indices(self.edge)[0] if self.edge else edge_before(model, self.at, node)
        if self.shape is None and self.resistance is None:
            return _BoundSphere(self, model, node, int(edge))
        if node not in model.edges[edge]:
            raise TermError(f"StokesHead '{self.name}': the edge '{self.edge}' does not end at '{self.at}'")
        return _BoundResistance(self, model, node, int(edge))

    def matrix(self, frame: np.ndarray) -> np.ndarray:
        """Resistance in the material frame of the edge, whose directors are the columns of ``frame``."""
        if self.resistance is not None:
            return self.resistance
        turn = np.kron(np.eye(2), frame)
        return self.values().viscosity * turn.T @ self.shape @ turn


def _matrix(name: str, given: Any) -> np.ndarray | None:
    """Return the checked 6 x 6 matrix."""
    if given is None:
        return None
    R = np.array(given, dtype=float)
    if R.shape != (6, 6) or not np.all(np.isfinite(R)):
        raise TermError(f"StokesHead: {name} must be a finite 6 x 6 matrix")
    if np.linalg.eigvalsh(R + R.T).min() < -1e-12 * np.abs(R).max():
        raise TermError(f"StokesHead: {name} must be positive semi-definite: a passive head takes energy out")
    return R


def _drawn(graph: RodGraph, edge: int) -> np.ndarray:
    """Material frame of an edge as the figure is built, in whose axes a shape is told, wherever a run begins."""
    drawn = graph.drawn
    along = unit(drawn.x0[drawn.edges[edge, 1]] - drawn.x0[drawn.edges[edge, 0]])
    return material_frames(along[None], drawn.d1[edge][None], np.zeros(1))[0]


def edge_before(model: Model, at: str, node: int) -> int:
    """Return the edge that ends at a node on the rod that the selector names, or starts there."""
    graph = model.graph
    for name in graph.rod_names(at):
        rod = graph.rods[name]
        hit = np.flatnonzero(rod.nodes == node)
        if len(hit):
            return int(rod.edges[max(int(hit[0]) - 1, 0)])
    raise GraphError(f"selector '{at}' names no node of a rod")


class _BoundSphere(BoundTerm):
    def __init__(self, term: StokesHead, model: Model, node: int, edge: int) -> None:
        super().__init__(term)
        p = term.values()
        self.edge = np.array([edge])
        self.force = np.array([6.0 * np.pi * p.viscosity * p.radius * p.C1])
        self.torque = np.array([8.0 * np.pi * p.viscosity * p.radius**3 * p.C2])
        self.dofs = (3 * node + np.arange(3)).astype(np.int32)
        self.spun_dofs = edge_dofs(model, self.edge)
        self.stencils = [self.dofs[:, None], self.spun_dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        from rodnet.packed import Packed
        from rodnet.terms.drag import kernels

        super().find_slots(pattern, stencils)
        self.kernel = kernels.sphere_drag
        self.packed = Packed(kernels.NODE, self.force, self.dofs, self.slots[0])
        self.packed_spun = Packed(kernels.SPUN, self.torque, self.edge, self.spun_dofs, self.slots[1])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        packed, spun = self.packed.table, self.packed_spun.table
        return self.kernel(packed, spun, ev.state, ev.rates, ev.cv, F, data, jac)


class _BoundResistance(BoundTerm):
    """Full 6 x 6 resistance; derivatives by central differences over the seven rates and positions."""

    def __init__(self, term: StokesHead, model: Model, node: int, edge: int) -> None:
        super().__init__(term)
        frame = np.eye(3) if term.shape is None else _drawn(model.graph, edge)
        self.R = np.ascontiguousarray(term.matrix(frame), dtype=float)
        self.ends = model.edges[edge]
        self.edge, self.local = edge, int(np.flatnonzero(self.ends == node)[0])
        self.dofs = edge_dofs(model, np.array([edge]))[0]
        self.stencils = [self.dofs[None, :]]

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        from rodnet.terms.drag.kernels import resistance

        i, j = self.ends
        q = np.concatenate([ev.x[i], ev.x[j], [ev.theta[self.edge]]])
        rates = np.concatenate([ev.v[i], ev.v[j], [ev.w[self.edge]]])
        steps = np.array([1e-6 * ev.L[self.edge], 1e-6, 1e-3 * max(float(np.abs(rates).max()), 1e-6)])
        slots = self.slots[0][0] if jac else ev.model.no_slots[0]
        return resistance(
            self.R, self.local, q, rates, ev.ts[self.edge], ev.d1s[self.edge], ev.cv, steps,
            self.dofs, F, slots, data, jac,
        )  # fmt: skip
