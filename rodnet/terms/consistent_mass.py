"""Mass spread along the edges instead of lumped at the nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class ConsistentMass(Term):
    """Inertia of edges as straight uniform bars, 1/6 m (v0^2 + v0.v1 + v1^2), for the lumped 1/4 m (v0^2 + v1^2).

    The consistent mass matrix of linear elements. Momentum is that of the lumped masses; an edge that turns
    has the moment of inertia m l^2 / 12 instead of m l^2 / 4.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    share : float or Parameter
        Share of the mass that is spread [1]: 1 for bars; at 1/2 the speed of waves along a rod has an error of
        fourth order instead of second.
    """

    kind = "load"
    default_name = "spread"
    source = "Archer 1963 (consistent mass); Goudreau & Taylor 1973 (its mean with the lumped one)"
    claims: ClassVar[set[str]] = {"objective"}
    share = Parameter(1.0, unit="1", bounds=(0, 1), null=0.0, doc="share of the mass that is spread")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges that ``on`` names."""
        self.check_numbers()
        return _BoundConsistentMass(self, model)


class _BoundConsistentMass(BoundTerm):
    inertial = True

    def __init__(self, term: ConsistentMass, model: Model) -> None:
        super().__init__(term)
        graph = model.graph
        index = graph.edge_indices(term.on)
        # what lumping has too much of, 1/12 m |v1 - v0|^2; once for every coordinate
        self.excess = np.repeat(term.values().share * graph.edge_mass[index] / 6.0, 3)
        self.dofs = (3 * model.edges[index][:, None, :] + np.arange(3)[:, None]).reshape(-1, 2)
        self.stencils = [self.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Find the places of both ends of every edge."""
        from rodnet.terms.consistent_mass_kernel import spread_inertia

        super().find_slots(pattern, stencils)
        self.kernel = spread_inertia

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.at_rest:
            return 0.0
        return self.kernel(self.excess, self.dofs, self.slots[0], ev.a, ev.ca, F, data, jac)

    def energy(self, ev: Evaluation) -> float:
        """Kinetic energy beyond that of the lumped masses [J]; negative."""
        return -0.5 * float(self.excess @ (ev.rates[self.dofs[:, 1]] - ev.rates[self.dofs[:, 0]]) ** 2)
