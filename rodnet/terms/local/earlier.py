"""What a rod had been through before a recording begins: a set that it had taken on, loads that it bears already."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.kinematics.frames import relative_strains
from rodnet.parameters import Parameter
from rodnet.terms.base import Term
from rodnet.terms.driven_curvature import BoundNatural, runs_against

if TYPE_CHECKING:
    from rodnet.solve.model import Model


class EarlierSet(Term):
    """A rod that had taken on a part of the shape in which it begins: natural strain = share times that of the start.

    What was held or coiled for long before a recording begins keeps its shape for as long as a recording lasts. Unlike
    a natural curvature it asks nobody how the rod is turned about its axis: the first frame shows its shape. Strains
    are counted from the natural shape that the rod has by the terms before this one.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    share : float or Parameter
        Part of the strain at the start that is natural [1].
    """

    kind = "energy"
    default_name = "earlier"
    source = "natural strains; docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    example: ClassVar[dict[str, float]] = {"share": 0.6}
    share = Parameter(0.0, unit="1", bounds=(-1.0, 1.0), null=0.0, doc="part of the strain that is natural")

    def bind(self, model: Model) -> BoundNatural:
        """Bind to the springs whose edges ``on`` names."""
        self.check_numbers()
        s, frames = model.springs_on(self.on), model.start_frames
        V, W = frames[model.edge1[s]] @ model.Q1[s], frames[model.edge2[s]] @ model.Q2[s]
        strain = relative_strains(V, W) - model.eps0[s]
        return _bound(self, model, s, float(self.values().share) * strain)


class BalancedStart(Term):
    """A rod that bears its loads at the start as it would at rest: natural strain less part of what bears them.

    Of all distributions of moments that hold the initial shape against its loads (gravity, as a rule) it is the one of
    least elastic energy; rods on a shape that is natural but for its sag (`EarlierSet`) stay where they are, while
    one without it begins by swinging through. It is taken to first order, and over the whole robot: all its
    rods bear the loads together; what nothing holds bears nothing.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    part : float or Parameter
        Part of the loads that is borne at the start [1]; 1 for what begins at rest.
    """

    kind = "energy"
    default_name = "balance"
    source = "least elastic energy (Castigliano 1879); docs, theory: what differs along a rod"
    claims: ClassVar[set[str]] = {"conservative"}
    example: ClassVar[dict[str, float]] = {"part": 0.8}
    part = Parameter(0.0, unit="1", bounds=(-1.0, 1.0), null=0.0, doc="part of the loads that is borne")

    def bind(self, model: Model) -> BoundNatural:
        """Bind to the springs whose edges ``on`` names."""
        from rodnet.solve.statics import bearing_strains  # which computes with whole robots

        self.check_numbers()
        s, part = model.springs_on(self.on), float(self.values().part)
        if part == 0.0:
            return _bound(self, model, s, np.zeros((len(s), 3)))
        bare = copy.copy(model.robot)
        bare.terms = tuple(term for term in bare.terms if not isinstance(term, BalancedStart))
        return _bound(self, model, s, -part * bearing_strains(bare)[s])


def _bound(term: Term, model: Model, springs: np.ndarray, strain: np.ndarray) -> BoundNatural:
    """Bind natural strains (n, 3) of the springs themselves, of whatever direction."""
    # those of a spring that runs against its rod are turned round by what binds them
    strain[runs_against(model, springs), 1] *= -1.0
    return BoundNatural(term, model, springs, strain)
