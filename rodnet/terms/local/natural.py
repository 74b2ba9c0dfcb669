"""Natural shapes that a rod has beside the drawn one: a bend all along it, a kink, an angle at a joint or a wall."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.driven_curvature import BoundNatural
from rodnet.terms.local.stations import bump, spring_cells

if TYPE_CHECKING:
    from rodnet.solve.model import Model


class NaturalCurvature(Term):
    """A natural curvature and twist beside those that were drawn: what a rod was bent to before it was used.

    Every elastic and damping law of the springs sees it. With ``place`` and ``width`` it is a kink: the
    values are then those in its middle, times exp(-(s - place)^2 / (2 width^2)).

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    kappa1, kappa2 : float or Parameter
        Natural curvatures, towards the material directors m1 and m2 [1/m].
    twist : float or Parameter
        Natural twist [rad/m].
    place, width : float or Parameter, optional
        Of a kink, over the rod's length [1]; both or none.
    """

    kind = "energy"
    default_name = "natural"
    source = "natural strains; docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    example: ClassVar[dict[str, float]] = {"kappa1": 3.0, "kappa2": -2.0, "twist": 1.0}
    kappa1 = Parameter(0.0, unit="1/m", null=0.0, doc="natural curvature towards m1")
    kappa2 = Parameter(0.0, unit="1/m", null=0.0, doc="natural curvature towards m2")
    twist = Parameter(0.0, unit="rad/m", null=0.0, doc="natural twist")
    place = Parameter(
        None, unit="1", bounds=(0.0, 1.0), kind="shape", doc="middle of a kink, over the rod's length"
    )
    width = Parameter(
        None, unit="1", bounds=(1e-3, 1.0), kind="shape", doc="its half width, over the rod's length"
    )

    def __init__(self, on: Any = "*", **options: Any) -> None:
        super().__init__(on, **options)
        if (self.place.value is None) != (self.width.value is None):
            raise TermError("NaturalCurvature: give both place= and width=, or neither")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        self.check_numbers()
        springs = model.springs_on(self.on)
        p = self.values()
        angles = model.spring_length[springs, None] * np.array([p.kappa1, p.kappa2, p.twist])
        if p.place is not None:
            angles = angles * bump(spring_cells(model, springs), p.place, p.width)[:, None]
        return BoundNatural(self, model, springs, angles)


class NaturalAngle(Term):
    """A natural angle between the edges that meet at a node: a joint or a wall that does not point where it was drawn.

    At a clamp it is the direction of the wall; beside an edge that a gripper holds, the direction and
    the twist of the rod in the gripper. All springs at the node get it.

    Parameters
    ----------
    at : str or sequence of str
        The nodes.
    bend1, bend2 : float or Parameter
        Angles towards the material directors m1 and m2, of the later edge against the one before [rad].
    twist : float or Parameter
        Angle about the rod's axis [rad].
    """

    kind = "energy"
    default_name = "angle"
    source = "natural strains; docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    example: ClassVar[dict[str, float]] = {"bend1": 0.1, "bend2": -0.2, "twist": 0.1}
    bend1 = Parameter(0.0, unit="rad", bounds=(-2.0, 2.0), null=0.0, doc="natural angle towards m1")
    bend2 = Parameter(0.0, unit="rad", bounds=(-2.0, 2.0), null=0.0, doc="natural angle towards m2")
    twist = Parameter(0.0, unit="rad", bounds=(-2.0, 2.0), null=0.0, doc="natural angle about the axis")

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
        p = self.values()
        return BoundNatural(self, model, springs, np.tile([p.bend1, p.bend2, p.twist], (len(springs), 1)))


def springs_at(model: Model, term: Term, at: Any) -> np.ndarray:
    """Springs at the nodes that ``at`` names, walls included; those of joints that turn are not of them.

    Raises
    ------
    TermError
        If there is none.
    """
    found = np.flatnonzero(np.isin(model.spring_node[: model.first_law], model.graph.nodes(at)))
    if not len(found):
        raise TermError(
            f"{type(term).__name__} at {at}: there is no bend-twist spring there (it ends a rod, or turns freely); "
            "choose a node between two edges, or one that is clamped"
        )
    return found
