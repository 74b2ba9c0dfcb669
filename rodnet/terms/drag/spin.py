"""Drag on the spin of rods about their own axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import edge_dofs

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class SpinDrag(Term):
    """Torque of a viscous medium on rods that spin about their axes, -4 pi viscosity r^2 dtheta/dt per unit length.

    That which ``ResistiveForce(axial_torque=True)`` has, as a term of its own with a viscosity of its own.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    viscosity : float or Parameter
        Viscosity of the medium beside the rod [Pa s].
    """

    kind = "drag"
    default_name = "spin_drag"
    source = "rotating cylinder in a viscous fluid (Lamb 1932)"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, float]] = {"viscosity": 1.0}
    viscosity = Parameter(0.0, unit="Pa s", bounds=(0, None), null=0.0, doc="viscosity that the spin feels")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges that ``on`` names."""
        self.check_numbers()
        return _BoundSpin(self, model)


class _BoundSpin(BoundTerm):
    def __init__(self, term: SpinDrag, model: Model) -> None:
        super().__init__(term)
        graph = model.graph
        self.edges = np.ascontiguousarray(graph.edge_indices(term.on), dtype=np.int64)
        area = graph.radius[self.edges] ** 2 * graph.rest_length[self.edges]
        self.spin = np.ascontiguousarray(4.0 * np.pi * term.values().viscosity * area)
        self.spun = np.ascontiguousarray(edge_dofs(model, self.edges))
        self.stencils = [self.spun]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        from rodnet.packed import Packed
        from rodnet.terms.drag import kernels

        super().find_slots(pattern, stencils)
        self.packed = Packed(kernels.SPUN, self.spin, self.edges, self.spun, self.slots[0])
        self.kernel = kernels.spin_drag

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.spin.any():
            self.kernel(self.packed.table, ev.state, ev.cv, F, data, jac)
        return 0.0
