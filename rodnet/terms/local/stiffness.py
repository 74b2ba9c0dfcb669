"""Stiffness that differs along a rod: a soft or stiff spot, a gradient, a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.local.stations import mean_of_bump, spring_cells

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class StiffnessChange(Term):
    """What a rod's bending and twisting stiffness are changed by, as an energy of its own.

    Laws implement `share`, or `factors` where bending and twisting do not change in proportion.

    E = sum 1/2 share(s) K (strain - natural strain)^2 with the springs' own stiffness K. Twisting
    changes by ``twist`` times as much as bending.
    """

    kind = "energy"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    twist = Parameter(
        1.0,
        unit="1",
        bounds=(0, 1),
        kind="shape",
        doc="change of the twisting over that of the bending stiffness",
    )

    def share(self, cells: np.ndarray, p: Any) -> np.ndarray:
        """Change of the bending stiffness over itself, shape (n,), on cells (n, 2) of the rod's length."""
        raise TermError(f"{type(self).__name__} must implement share(self, cells, p)")

    def factors(self, cells: np.ndarray, p: Any) -> np.ndarray:
        """What is left of both bending stiffnesses and of the twisting stiffness, shape (n, 3)."""
        return np.asarray(1.0 + self.share(cells, p)[:, None] * np.array([1.0, 1.0, p.twist]))

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        self.check_numbers()
        return BoundStiffness(self, model, model.springs_on(self.on))


class BoundStiffness(BoundTerm):
    """A quadratic energy that is a part of that of some springs.

    Parameters
    ----------
    term : Term
        With a method ``factors`` of cells.
    model : Model
        The model.
    springs : ndarray of int, shape (n,)
        Its springs.
    factors : ndarray, shape (n, 3), optional
        What is left of their stiffnesses in bending and twisting; by default as the term says.
    """

    def __init__(
        self, term: Any, model: Model, springs: np.ndarray, factors: np.ndarray | None = None
    ) -> None:
        super().__init__(term)
        self.springs = springs
        if factors is None:
            factors = term.factors(spring_cells(model, springs), term.values())
        # as a product of roots, what is left is positive definite where springs couple bending and twisting, too
        roots = np.sqrt(factors)
        self.parts = roots[:, :, None] * roots[:, None, :] - 1.0

    def spring_stiffness(self, model: Model) -> np.ndarray:
        out = np.zeros((model.spring_count, 3, 3))
        out[self.springs] = self.parts * model.spring_stiffness[self.springs]
        return out

    def energy(self, ev: Evaluation) -> float:
        strain = (ev.eps - ev.model.eps0)[self.springs]
        K = self.parts * ev.model.spring_stiffness[self.springs]
        return float(0.5 * np.einsum("si,sij,sj->", strain, K, strain))


class StiffnessDefect(StiffnessChange):
    """A soft spot of a rod: its bending stiffness is EI (1 - loss exp(-(s - place)^2 / (2 width^2))).

    s runs from 0 to 1 along each rod that ``on`` names. A negative loss is a stiff spot. The twisting
    stiffness loses ``twist`` times as much. What a spring stands for is in series: the mean is that of the
    compliance, so that a spot turns under a moment by as much on every mesh, however narrow and soft it is.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    loss : float or Parameter
        Share of the stiffness that is lost in the middle of the spot [1].
    place, width : float or Parameter
        Its place and its half width at 61 % of the loss, over the rod's length [1].
    """

    default_name = "defect"
    source = "series of half edges; a smooth region, docs, theory: what differs along a rod"
    example: ClassVar[dict[str, float]] = {"loss": 0.4, "place": 0.4, "width": 0.2}
    loss = Parameter(
        0.0, unit="1", bounds=(-20.0, 0.99), null=0.0, doc="stiffness lost in the middle, over the whole"
    )
    place = Parameter(0.5, unit="1", bounds=(0.0, 1.0), kind="shape", doc="middle, over the rod's length")
    width = Parameter(
        0.05, unit="1", bounds=(1e-3, 1.0), kind="shape", doc="half width, over the rod's length"
    )

    def factors(self, cells: np.ndarray, p: Any) -> np.ndarray:
        """What is left of both bending stiffnesses and of the twisting stiffness, shape (n, 3): compliances add up."""
        bend, twist = (self._left(cells, p, loss) for loss in (p.loss, p.loss * p.twist))
        return np.stack([bend, bend, twist], axis=1)

    @staticmethod
    def _left(cells: np.ndarray, p: Any, loss: float) -> np.ndarray:
        more = mean_of_bump(lambda w: loss * w / (1.0 - loss * w), cells, p.place, p.width)
        return np.asarray(1.0 / (1.0 + more))


class StiffnessGradient(StiffnessChange):
    """A stiffness that changes along a rod, EI (1 + slope (s - 1/2)), from a taper or a material that varies.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    slope : float or Parameter
        Change from one end to the other, over the stiffness in the middle [1].
    """

    default_name = "stiffness_gradient"
    source = "docs, theory: what differs along a rod"
    example: ClassVar[dict[str, float]] = {"slope": 0.8}
    slope = Parameter(
        0.0, unit="1", bounds=(-1.98, 1.98), null=0.0, doc="change from start to end, over the mean"
    )

    def share(self, cells: np.ndarray, p: Any) -> np.ndarray:
        """Change of the bending stiffness over itself, shape (n,)."""
        return p.slope * (cells.mean(axis=1) - 0.5)


class StiffnessProfile(StiffnessChange):
    """A stiffness that varies smoothly along a rod, EI exp(sum_k a_k cos(k pi s)), k = 1 .. 4.

    s runs from 0 to 1 along each rod that ``on`` names. As a logarithm it is positive whatever the coefficients
    are; they have no part in its geometric mean, which is EI.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    half, whole, three, twice : float or Parameter
        Coefficients a_1 to a_4, of half a wave, a whole one, three halves and two along the rod [1].
    """

    default_name = "stiffness_profile"
    source = "cosine series of log EI; docs, theory: what differs along a rod"
    example: ClassVar[dict[str, float]] = {"half": 0.4, "whole": -0.3, "three": 0.2, "twice": 0.1}
    half = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="of half a wave along the rod")
    whole = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="of a whole wave")
    three = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="of three half waves")
    twice = Parameter(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="of two waves")

    def share(self, cells: np.ndarray, p: Any) -> np.ndarray:
        """Change of the bending stiffness over itself, shape (n,)."""
        phase = np.pi * cells.mean(axis=1)
        waves = enumerate((p.half, p.whole, p.three, p.twice), start=1)
        return np.expm1(sum(a * np.cos(k * phase) for k, a in waves))
