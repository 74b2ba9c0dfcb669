"""Bending measured in the frame half way between two edges: as stiff in a twisted rod as in any other."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class MidframeBending(Term):
    """Linear bending, E = sum 1/2 EI/dl (kappa / cos(tau/2) - kappa0)^2; takes the place of `Bending`.

    `Bending` averages the directors of two edges, and where these are twisted against each other by tau the average is
    shorter by cos(tau/2): so is the curvature. Here it is not, and a mesh bends right that turns by much from
    edge to edge. A twist of half a turn between two edges is beyond any force.
    """

    kind = "energy"
    default_name = "bending"
    source = "docs, theory: energies; cf. Bergou et al. 2010, whose averages it normalises"
    once = True
    claims: ClassVar[set[str]] = {"conservative", "objective"}

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        return _BoundMidframe(self, model)


class _BoundMidframe(BoundTerm):
    def __init__(self, term: MidframeBending, model: Model) -> None:
        from rodnet.terms.midframe_kernels import midframe_stress

        super().__init__(term)
        self.springs = np.ascontiguousarray(model.springs_on(term.on), dtype=np.int64)
        self.kernel = midframe_stress

    def stress(self, ev: Evaluation) -> None:
        m = ev.model
        self.kernel(self.springs, m.spring_stiffness, ev.eps, m.eps0, ev.stress, ev.modulus)

    def energy(self, ev: Evaluation) -> float:
        s = self.springs
        bend = ev.eps[s, :2] / np.cos(0.5 * ev.eps[s, 2:]) - ev.model.eps0[s, :2]
        return float(0.5 * np.einsum("si,sij,sj->", bend, ev.model.spring_stiffness[s, :2, :2], bend))
