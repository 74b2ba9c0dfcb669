"""Joints, roots and grips that give: compliance where the model has a rigid connection."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.local.natural import springs_at
from rodnet.terms.local.stiffness import BoundStiffness
from rodnet.terms.spring_moments import SpringMoments

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

NEAR = 1e-2  # squared strain below which a series is more accurate than the formula


class JointCompliance(Term):
    """A joint, a root or a grip that gives: it turns by M length/EI, as much as so much of the rod beside it would.

    All bend-twist springs at the node become softer, that of a wall included, 1/k' = 1/k + length/EI, and in twisting
    by so much of that as ``twist`` says, against their own stiffness. EI is that of the softest edge there, so the
    length says the same on every mesh, and beside a rigid part. However far it bends
    the angle is in proportion to the moment M, as a spring between half edges of the rod has it for small ones.

    Parameters
    ----------
    at : str or sequence of str
        The nodes: a clamped end, the inner node of an edge that a gripper holds, or where rods are joined.
    length : float or Parameter
        Length of rod that would give as much [m].
    twist : float or Parameter
        How much of it applies to twisting [1].
    """

    kind = "energy"
    default_name = "give"
    source = "springs in series; docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    example: ClassVar[dict[str, float]] = {"length": 0.01}
    length = Parameter(0.0, unit="m", bounds=(0, None), null=0.0, doc="length of rod that gives as much")
    twist = Parameter(1.0, unit="1", bounds=(0, 1), kind="shape", doc="share of it that twisting feels")

    def __init__(self, *, at: Any, name: str | None = None, **parameters: Any) -> None:
        super().__init__(at, name=name, **parameters)

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs at the nodes.

        Raises
        ------
        TermError
            If there is none.
        """
        self.check_numbers()
        springs = springs_at(model, self, self.on)
        stiffness = model.spring_stiffness[springs]
        k = 0.5 * (stiffness[:, 0, 0] + stiffness[:, 1, 1])
        EI = np.append(0.5 * (model.graph.EI1 + model.graph.EI2), np.full(len(model.edges), np.inf))
        softest = np.minimum(EI[model.edge1[springs]], EI[model.edge2[springs]])
        with np.errstate(invalid="ignore"):
            ratio = np.where(np.isfinite(softest), k / softest, 0.0)  # [1/m]
        return _BoundGive(self, model, springs, self.values().length * ratio)


class _BoundGive(BoundStiffness):
    """A softer spring, and what its energy has beyond the quadratic one.

    Parameters
    ----------
    give : ndarray, shape (n,)
        Compliances of the joints over those of their springs.
    """

    def __init__(self, term: Term, model: Model, springs: np.ndarray, give: np.ndarray) -> None:
        twist = term.values().twist  # in series as bending is
        super().__init__(term, model, springs, 1.0 / (1.0 + give[:, None] * np.array([1.0, 1.0, twist])))
        self.give = give
        self.moments = SpringMoments(model, springs)
        self.stencils = [self.moments.dofs]
        self.idle = not np.any(give > 0.0)

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        self.moments.find_slots(pattern, stencils[0])

    def _state(self, ev: Evaluation) -> tuple[np.ndarray, ...]:
        """Strains e, moments K e and stiffness K of the springs in bending, and the factors D, D', D''."""
        e = (ev.eps - ev.model.eps0)[self.springs, :2]
        K = ev.model.spring_stiffness[self.springs, :2, :2]
        return e, np.einsum("nij,nj->ni", K, e), K, beyond(np.sum(e**2, axis=1), self.give)

    def law(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """Moments beyond the quadratic energy's, shape (n, 3), and their derivatives by the strains, (n, 3, 3)."""
        e, m, K, (D, D1, D2) = self._state(ev)
        q = np.sum(m * e, axis=1)
        sigma, H = np.zeros((len(e), 3)), np.zeros((len(e), 3, 3))
        sigma[:, :2] = D[:, None] * m + (q * D1)[:, None] * e
        both = m[:, :, None] * e[:, None, :]
        H[:, :2, :2] = D[:, None, None] * K + 2.0 * D1[:, None, None] * (both + np.swapaxes(both, 1, 2))
        H[:, :2, :2] += (q * D1)[:, None, None] * np.eye(2)
        H[:, :2, :2] += 2.0 * (q * D2)[:, None, None] * e[:, :, None] * e[:, None, :]
        return sigma, H

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.idle:
            return 0.0
        sigma, H = self.law(ev)
        return self.moments.add(ev, sigma, H if jac else None, F, data)

    def energy(self, ev: Evaluation) -> float:
        e, m, _, (D, _, _) = self._state(ev)
        return super().energy(ev) + float(0.5 * np.sum(D * np.sum(m * e, axis=1)))


def beyond(s: np.ndarray, give: np.ndarray) -> np.ndarray:
    """What a spring in series with a joint has beyond its quadratic energy, over 1/2 e.K e, and its derivatives by s.

    Parameters
    ----------
    s : ndarray, shape (n,)
        Squared strain |e|^2; the strain is 2 tan(angle / 2).
    give : ndarray, shape (n,)
        Compliance of the joint over that of the spring.

    Returns
    -------
    ndarray, shape (3, n)
    """
    a = 1.0 / (1.0 + give)  # share of the angle that the spring takes
    c = give * a**2  # of the joint's energy, over the spring's at the same angle
    x = np.maximum(s, NEAR)
    u = np.sqrt(x)
    f = 2.0 * np.arctan(0.5 * u)
    f1 = 0.5 / (u + 0.25 * u * x)
    f2 = -(1.0 + 0.75 * x) * f1**2 / u
    T = np.tan(0.5 * a * f)
    F = 4.0 * T**2 + c * f**2
    Ff = 4.0 * a * T * (1.0 + T**2) + 2.0 * c * f
    Fff = 2.0 * a**2 * (1.0 + T**2) * (1.0 + 3.0 * T**2) + 2.0 * c
    F1, F2 = Ff * f1, Fff * f1**2 + Ff * f2
    exact = np.array([F / x - a, F1 / x - F / x**2, F2 / x - 2.0 * F1 / x**2 + 2.0 * F / x**3])
    one = (a**4 - a) / 6.0
    two = (23.0 * a - 40.0 * a**4 + 17.0 * a**6) / 720.0
    three = (154.0 * a**4 - 66.0 * a - 119.0 * a**6 + 31.0 * a**8) / 10080.0
    series = np.array(
        [
            ((three * s + two) * s + one) * s,
            (3.0 * three * s + 2.0 * two) * s + one,
            6.0 * three * s + 2.0 * two,
        ]
    )
    return np.where(s < NEAR, series, exact)
