"""Added mass: the inertia of the fluid that a rod pushes aside, Lighthill's reactive force."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class AddedMass(Term):
    """Inertia of the fluid around rods: kinetic energy 1/2 m_a v_n^2 per unit length, at rest far away.

    m_a = coefficient density pi r^2, v_n is the velocity across the rod. The forces are those of
    Lagrange's equations for that energy, so momentum and energy are kept: -d(m_a v_n)/dt on the rod, and what
    the energy's change with the rod's direction and length exerts on it (Munk's moment; Lighthill's tail force).

    Parameters
    ----------
    density : float or Parameter
        Density of the fluid [kg/m^3].
    coefficient : float or Parameter
        Mass of fluid moved over that displaced [1]; 1 for a cylinder in unbounded potential flow.
    """

    kind = "load"
    default_name = "fluid"
    source = (
        "Lighthill 1971, Proc. R. Soc. B 179, 125; Candelier, Boyer & Leroyer 2011, J. Fluid Mech. 668, 196"
    )
    claims: ClassVar[set[str]] = {"objective"}
    density = Parameter(1000.0, unit="kg/m^3", bounds=(0, None), null=0.0, doc="density of the fluid")
    coefficient = Parameter(1.0, unit="1", bounds=(0, None), null=0.0, doc="added-mass coefficient")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges that ``on`` names."""
        return _BoundAddedMass(self, model)


class _BoundAddedMass(BoundTerm):
    inertial = True

    def __init__(self, term: AddedMass, model: Model) -> None:
        super().__init__(term)
        graph = model.graph
        self.index = graph.edge_indices(term.on)
        p = term.values(len(self.index))
        area = np.pi * graph.radius[self.index] ** 2
        # each half edge moves with its own node
        self.half = 0.5 * np.ravel(p.coefficient) * np.ravel(p.density) * area
        axes = np.arange(3)
        ends = model.edges[self.index]
        self.dofs = np.concatenate([3 * ends[:, :1] + axes, 3 * ends[:, 1:] + axes], axis=1).astype(np.int32)
        self.stencils = [self.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Find the places of the edges' matrices."""
        from rodnet.packed import Packed
        from rodnet.terms.added_mass_kernel import HALVES, added_mass

        super().find_slots(pattern, stencils)
        self.kernel = added_mass
        self.packed = Packed(HALVES, self.half, self.dofs, self.slots[0])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        return self.kernel(self.packed.table, ev.q, ev.rates, ev.a, ev.cv, ev.ca, F, data, jac)

    def energy(self, ev: Evaluation) -> float:
        """Kinetic energy of the fluid [J]."""
        ends = ev.v[ev.model.edges[self.index]]
        along = np.einsum("nki,ni->nk", ends, ev.T[self.index])
        across = np.sum(ends**2, axis=2) - along**2
        return 0.5 * float(np.sum((self.half * ev.L[self.index])[:, None] * across))

    def momentum(self, ev: Evaluation) -> np.ndarray:
        """Momentum of the fluid [kg m/s], shape (3,)."""
        ends, t = ev.v[ev.model.edges[self.index]].sum(axis=1), ev.T[self.index]
        across = ends - np.sum(ends * t, axis=1, keepdims=True) * t
        return (self.half * ev.L[self.index]) @ across
