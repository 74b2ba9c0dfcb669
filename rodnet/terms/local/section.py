"""Linear elasticity of a section that is not round: stiffnesses that differ by direction, and couple."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.linalg import expm

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.local.stiffness import BoundStiffness
from rodnet.terms.spring_moments import runs_against

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class SectionStiffness(Term):
    """What the stiffness of a rod's section is changed by in each direction, as an energy of its own.

    E = sum 1/2 (strain - natural strain)^T D (exp(A) - 1) D (strain - natural strain) of the strains (kappa1, kappa2,
    tau), with the roots D of the springs' own stiffnesses and a symmetric matrix A of the parameters. Stiffnesses
    that are diagonal become D exp(A) D, which is positive definite whatever A is.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    first, second, twist : float or Parameter
        Changes of the logarithms of the bending stiffnesses towards m1 and m2 and of the twisting stiffness [1].
    skew : float or Parameter
        Coupling of both bendings: principal axes beside the directors [1].
    first_twist, second_twist : float or Parameter
        Couplings of bending and twisting, of fibres that wind around a rod [1].
    """

    kind = "energy"
    default_name = "section"
    source = "the general quadratic energy of bending and twisting; docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    example: ClassVar[dict[str, float]] = {
        "first": 0.4, "second": -0.3, "twist": 0.2, "skew": 0.2, "first_twist": 0.1, "second_twist": -0.2,
    }  # fmt: skip
    first = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="change of the logarithm of EI1")
    second = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="change of the logarithm of EI2")
    twist = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="change of the logarithm of GJ")
    skew = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="coupling of both bendings")
    first_twist = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="coupling of kappa1 and twist")
    second_twist = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="coupling of kappa2 and twist")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        self.check_numbers()
        return _BoundSection(self, model)


class _BoundSection(BoundTerm):
    def __init__(self, term: SectionStiffness, model: Model) -> None:
        super().__init__(term)
        p: Any = term.values()
        self.springs = model.springs_on(term.on)
        A = np.array(
            [
                [p.first, p.skew, p.first_twist],
                [p.skew, p.second, p.second_twist],
                [p.first_twist, p.second_twist, p.twist],
            ]
        )
        # where a stencil runs against its rod, kappa2 has the other sign
        way = np.where(runs_against(model, self.springs)[:, None], [1.0, -1.0, 1.0], 1.0)
        self.change = (expm(A) - np.eye(3)) * way[:, :, None] * way[:, None, :]

    def _stiffness(self, model: Model) -> np.ndarray:
        own = model.spring_stiffness[self.springs]
        roots = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
        return np.asarray(roots[:, :, None] * self.change * roots[:, None, :])

    def spring_stiffness(self, model: Model) -> np.ndarray:
        out = np.zeros((model.spring_count, 3, 3))
        out[self.springs] = self._stiffness(model)
        return out

    def energy(self, ev: Evaluation) -> float:
        strain = (ev.eps - ev.model.eps0)[self.springs]
        return float(0.5 * np.einsum("si,sij,sj->", strain, self._stiffness(ev.model), strain))


def stiffness_left(model: Model, springs: np.ndarray) -> np.ndarray:
    """Stiffness [N m] of a rod's springs with all that changes a rod, whatever energy it has, shape (n, 3, 3).

    Parameters
    ----------
    model : Model
        The model.
    springs : ndarray of int, shape (n,)
        Its springs.
    """
    K = model.spring_stiffness[springs]
    for bound in model.bound:
        if isinstance(bound, BoundStiffness | _BoundSection):
            K = K + bound.spring_stiffness(model)[springs]
    return np.asarray(K)
