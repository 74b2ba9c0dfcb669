"""Elastic energies: strain (geometry, ours) times material (energy density, anybody's three lines)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class EnergyModel(Term):
    """An elastic law: an energy per unit natural length as a function of a strain.

    Subclasses set ``strain`` and implement ``psi``.

    Attributes
    ----------
    strain : {"stretch", "curvature", "twist"}
        ``"stretch"``: eps, shape (n,) [1], on edges; ``"curvature"``: shape (n, 2) [1/m], and
        ``"twist"``: shape (n,) [rad/m], on springs, both as deviations from the natural shape.

    Notes
    -----
    ``psi(self, strain, p)`` returns the density [J/m] and its first and second derivatives,
    shapes (n,), like the strain, and (n,) or (n, 2, 2) (``"curvature"`` also takes (n, 2) for a
    diagonal). ``strain`` has the attributes ``eps``, ``kappa`` or ``tau``, and ``EA``, ``EI1``,
    ``EI2``, ``GJ``, ``length`` (shape (n,)) of the sites. It must be pure.
    """

    kind = "energy"
    strain: ClassVar[str] = "curvature"
    claims: ClassVar[set[str]] = {"conservative", "objective"}

    def psi(self, strain: Any, p: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energy density [J/m] and its two derivatives by the strain."""
        raise TermError(f"{type(self).__name__} must implement psi(self, strain, p)")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges (stretch) or springs (curvature, twist) that ``on`` names."""
        if self.strain not in ("stretch", "curvature", "twist"):
            raise TermError(
                f"{type(self).__name__}.strain = {self.strain!r}; it is 'stretch', 'curvature' or 'twist'"
            )
        return _BoundStretchLaw(self, model) if self.strain == "stretch" else _BoundSpringLaw(self, model)


class _BoundStretchLaw(BoundTerm):
    """Evaluates a user's stretch law and adds to the edge stresses."""

    def __init__(self, term: EnergyModel, model: Model) -> None:
        super().__init__(term)
        self.index = model.graph.edge_indices(term.on)
        self.p = term.values(len(self.index))
        self.fixed = {"EA": model.graph.EA[self.index], "length": model.graph.rest_length[self.index]}

    def _psi(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        strain = SimpleNamespace(eps=ev.stretch[self.index], **self.fixed)
        return self.term.psi(strain, self.p)  # type: ignore[attr-defined]

    def stress(self, ev: Evaluation) -> None:
        _, first, second = self._psi(ev)
        np.add.at(ev.stretch_stress, self.index, first)
        np.add.at(ev.stretch_modulus, self.index, second)

    def energy(self, ev: Evaluation) -> float:
        return float(np.sum(self._psi(ev)[0] * self.fixed["length"]))


class _BoundSpringLaw(BoundTerm):
    """Evaluates a user's curvature or twist law per unit length and adds to the spring stresses."""

    def __init__(self, term: EnergyModel, model: Model) -> None:
        super().__init__(term)
        self.index = model.springs_on(term.on)
        self.p = term.values(len(self.index))
        length = model.spring_length[self.index]
        stiff = model.spring_stiffness[self.index]
        self.cols = [0, 1] if term.strain == "curvature" else [2]
        # the stencil of a wall after a rod's end runs against the rod, which changes the sign of kappa2
        against = (model.edge1[self.index] >= model.graph.edge_count) & (model.sign2[self.index] < 0)
        self.turn = np.where(against[:, None], [1.0, -1.0, 1.0], 1.0)
        self.fixed = {
            "EI1": stiff[:, 0, 0] * length,
            "EI2": stiff[:, 1, 1] * length,
            "GJ": stiff[:, 2, 2] * length,
            "length": length,
        }

    def _psi(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        strain = self.turn * (ev.eps[self.index] - ev.model.eps0[self.index]) / self.fixed["length"][:, None]
        site = SimpleNamespace(kappa=strain[:, :2], tau=strain[:, 2], **self.fixed)
        value, first, second = self.term.psi(site, self.p)  # type: ignore[attr-defined]
        n, k = len(self.index), len(self.cols)
        turn = self.turn[:, self.cols]
        first = turn * np.asarray(first, dtype=float).reshape(n, k)
        second = np.asarray(second, dtype=float)
        if second.size == n * k * k and second.ndim != 2:
            second = second.reshape(n, k, k)
        else:
            second = np.broadcast_to(second.reshape(n, -1), (n, k))[:, :, None] * np.eye(k)
        return value, first, turn[:, :, None] * second * turn[:, None, :]

    def stress(self, ev: Evaluation) -> None:
        _, first, second = self._psi(ev)
        for a, i in enumerate(self.cols):
            ev.stress[self.index, i] += first[:, a]
            for b, j in enumerate(self.cols):
                ev.modulus[self.index, i, j] += second[:, a, b] / self.fixed["length"]

    def energy(self, ev: Evaluation) -> float:
        return float(np.sum(self._psi(ev)[0] * self.fixed["length"]))


class Stretching(Term):
    """Linear stretching, E = sum 1/2 EA eps^2 l0 (paper, stretching energy)."""

    kind = "energy"
    default_name = "stretching"
    source = "Du et al., stretching energy; Bergou et al. 2010"
    once = True
    claims: ClassVar[set[str]] = {"conservative", "objective"}

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges that ``on`` names."""
        return _BoundStretching(self, model)


class _BoundStretching(BoundTerm):
    def __init__(self, term: Stretching, model: Model) -> None:
        super().__init__(term)
        index = model.graph.edge_indices(term.on)
        self.EA = np.zeros(model.edge_count)
        yields = np.isfinite(model.graph.EA[index])  # rigid bodies do not
        self.EA[index[yields]] = model.graph.EA[index[yields]]
        self.axial_stiffness = self.EA

    def energy(self, ev: Evaluation) -> float:
        return float(0.5 * np.sum(self.EA * ev.stretch**2 * ev.model.rest_length))


class _SpringEnergy(Term):
    """Quadratic energy of some entries of the springs' stiffness."""

    kind = "energy"
    once = True
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    mask: ClassVar[np.ndarray] = np.zeros((3, 3))

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        return _BoundSpringEnergy(self, model)


class _BoundSpringEnergy(BoundTerm):
    def __init__(self, term: _SpringEnergy, model: Model) -> None:
        super().__init__(term)
        self.on = np.zeros((model.spring_count, 1, 1), dtype=bool)
        self.on[model.springs_on(term.on)] = True
        self.mask = term.mask

    def spring_stiffness(self, model: Model) -> np.ndarray:
        return self.on * self.mask * model.spring_stiffness

    def energy(self, ev: Evaluation) -> float:
        strain = ev.eps - ev.model.eps0
        return float(0.5 * np.einsum("si,sij,sj->", strain, self.spring_stiffness(ev.model), strain))


class Bending(_SpringEnergy):
    """Linear bending, E = sum 1/2 EI/dl (kappa - kappa0)^2 (paper, bending energy).

    The stiffness of a spring is that of its two half edges in series, in both directions of
    bending (EI1 for kappa1, EI2 for kappa2).
    """

    default_name = "bending"
    source = "Du et al., bending energy; Bergou et al. 2010"
    mask = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])


class Twisting(_SpringEnergy):
    """Linear twisting, E = sum 1/2 GJ/dl (tau - tau0)^2 (paper, twisting energy).

    At a corner the bend of one half edge is the twist of the other: the coupling is included here.
    """

    default_name = "twisting"
    source = "Du et al., twisting energy; Bergou et al. 2010"
    mask = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
