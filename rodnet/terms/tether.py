"""A thread, a wire or a tube that is tied to a rod and to something fixed: it pulls, and gives as a spring does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import line_sites
from rodnet.terms.drag.local_law import LocalLaw
from rodnet.terms.local.stations import bump, half_edge_cells

if TYPE_CHECKING:
    from rodnet.solve.model import Model


def _pull(axis: str) -> Parameter:
    return Parameter(0.0, unit="N", null=0.0, doc=f"pull along {axis} when the rod is at the point there")


class Tether(Term):
    """A pull ``F - stiffness (x - point)`` at a place of a rod, spread over ``width`` beside it.

    That is any force that depends on where that place of the rod is, to first order. A spring without a length of
    its own, tied to ``point``, has no F; a weight on a thread over a pulley far away has nothing else.

    Parameters
    ----------
    on : str
        The rod.
    point : (3,), optional
        Where the pull is F [m]; by default the origin.
    stiffness : float or Parameter
        Force per distance, in all directions [N/m].
    fx, fy, fz : float or Parameter
        F [N].
    place, width : float or Parameter
        Place and half width, over the rod's length [1].

    Raises
    ------
    TermError
        If the point is no point, or it acts on more than one rod.
    """

    kind = "load"
    default_name = "tether"
    source = "Hooke's law, linear in the place; docs, terms: loads"
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, Any]] = {"stiffness": 0.5, "fz": 0.01, "place": 0.7}
    stiffness = Parameter(0.0, unit="N/m", bounds=(0, None), null=0.0, doc="force per distance")
    fx, fy, fz = (_pull(axis) for axis in "xyz")
    place = Parameter(0.5, unit="1", bounds=(0.0, 1.0), kind="shape", doc="place, over the rod's length")
    width = Parameter(
        0.03, unit="1", bounds=(1e-3, 1.0), kind="shape", doc="half width, over the rod's length"
    )

    def __init__(self, on: Any = "*", *, point: Any = (0.0, 0.0, 0.0), **options: Any) -> None:
        super().__init__(on, **options)
        self.point = np.array(point, dtype=float)
        if self.point.shape != (3,) or not np.isfinite(self.point).all():
            raise TermError(f"Tether: point = {point!r} must be a place (3,) [m]")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the rod, as a force per length that is linear in the place."""
        self.check_numbers()
        chosen = np.zeros(model.graph.edge_count, dtype=bool)
        chosen[model.graph.edge_indices(self.on)] = True
        rods = [name for name, rod in model.graph.rods.items() if chosen[rod.edges].any()]
        if len(rods) != 1:
            raise TermError(
                f"Tether '{self.name}': it is tied to one rod, not to {', '.join(rods)}; give on="
            )
        sites = line_sites(model, self.on, "edge")
        near = bump(half_edge_cells(model, sites.node, sites.edgeA), self.place.value, self.width.value)
        total = float(near @ sites.weight)
        if not total > 0.0:
            raise TermError(
                f"Tether '{self.name}': nothing of {self.on} is near place = {self.place.value:g}; move it, or let on= "
                "name more"
            )
        near /= total  # so that all of it pulls as told
        k, F = self.stiffness.value, np.array([p.value for p in (self.fx, self.fy, self.fz)])
        pull = F + k * self.point
        given = {f"g{a}": near * f for a, f in zip("xyz", pull, strict=True)}
        given |= {f"k{a}{a}": -k * near for a in "xyz"}
        return LocalLaw(self.on, name=self.name, **given).bind(model)
