"""Joints, roots and grips that give: compliance where the model has a rigid connection."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.local.natural import springs_at
from rodnet.terms.local.stiffness import BoundStiffness

if TYPE_CHECKING:
    from rodnet.solve.model import Model


class JointCompliance(Term):
    """A joint, a root or a grip that gives, as much as ``length`` of the rod beside it would: 1/k' = 1/k + length/EI.

    All bend-twist springs at the node become softer, that of a wall included. EI is that of the
    softest edge there, so the length says the same on every mesh, and beside a rigid part.

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
        share = 1.0 / (1.0 + self.values().length * ratio) - 1.0
        return BoundStiffness(self, model, springs, share)
