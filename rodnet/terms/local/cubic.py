"""Bending that stiffens or softens with the curvature."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.spring_moments import SpringMoments

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class CubicBending(Term):
    """What a cubic law of bending has beside the linear one: moment EI kappa (1 + hardening kappa^2) in all.

    Energy per length hardening / (4 EI) (EI1 kappa1^2 + EI2 kappa2^2)^2 with the mean EI; kappa is the
    curvature beyond the natural one.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    hardening : float or Parameter
        Relative change of the stiffness per squared curvature [m^2]; negative for rods that soften.
    """

    kind = "energy"
    default_name = "cubic"
    source = "first term of any symmetric law beyond Hooke's; docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    example: ClassVar[dict[str, float]] = {"hardening": 1e-3}
    hardening = Parameter(0.0, unit="m^2", null=0.0, doc="relative change of EI per squared curvature")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        self.check_numbers()
        return _BoundCubic(self, model)


class _BoundCubic(BoundTerm):
    def __init__(self, term: CubicBending, model: Model) -> None:
        super().__init__(term)
        self.hardening = float(term.values().hardening)
        self.moments = SpringMoments(model, model.springs_on(term.on))
        s = self.moments.springs
        self.length = model.spring_length[s]
        self.EI = np.diagonal(model.spring_stiffness[s], axis1=1, axis2=2)[:, :2] * self.length[:, None]
        self.stencils = [self.moments.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        self.moments.find_slots(pattern, stencils[0])

    def _state(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """EI kappa, twice the linear energy per length, and hardening over the mean EI."""
        s = self.moments.springs
        kappa = (ev.eps - ev.model.eps0)[s, :2] / self.length[:, None]
        linear = self.EI * kappa
        return linear, np.sum(linear * kappa, axis=1), self.hardening / self.EI.mean(axis=1)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.hardening == 0.0:
            return 0.0
        linear, a, h = self._state(ev)
        sigma = np.zeros((len(a), 3))
        sigma[:, :2] = (h * a)[:, None] * linear
        D = None
        if jac:
            D = np.zeros((len(a), 3, 3))
            D[:, :2, :2] = 2.0 * linear[:, :, None] * linear[:, None, :]
            D[:, [0, 1], [0, 1]] += a[:, None] * self.EI
            D *= (h / self.length)[:, None, None]
        return self.moments.add(ev, sigma, D, F, data)

    def energy(self, ev: Evaluation) -> float:
        _, a, h = self._state(ev)
        return float(0.25 * np.sum(h * a**2 * self.length))
