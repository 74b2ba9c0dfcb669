"""A plane that gives: it pushes back by how deep a rod is in it, and rods may begin in it."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.drag.flow import direction_of
from rodnet.terms.drag.line import DragModel


class ElasticWall(DragModel):
    """A plane of springs without friction: force per length ``stiffness * depth`` along its normal.

    Winkler's foundation, on one side. Over ``layer`` the springs set in by and by, so that the force has a
    derivative everywhere: it is ``depth^2 / (2 layer)`` stiffnesses at first, ``depth - layer / 2`` below that. It
    is the axis that meets the wall, not the rod's surface. The stiffness may be zero, and a rod may begin in the wall:
    it is what a diagnosis looks for obstacles with that a model does not know of. For hard walls, and friction, there
    is `PlaneContact`.

    Parameters
    ----------
    normal : (3,)
        Direction out of the wall; by default up, from a floor.
    stiffness : float or Parameter
        Force per length and depth [N/m^2].
    position : float or Parameter
        Where the wall is along the normal [m].
    layer : float or Parameter
        Depth over which the springs set in [m].

    Raises
    ------
    TermError
        If the normal is no vector, or zero, or a flow is given.
    """

    kind = "contact"
    default_name = "elastic_wall"
    source = "Winkler 1867; docs, terms: contact"
    of_medium = False
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, Any]] = {"stiffness": 3.0, "position": 0.05, "layer": 0.02}
    stiffness = Parameter(0.0, unit="N/m^2", bounds=(0, None), null=0.0, doc="force per length and depth")
    position = Parameter(0.0, unit="m", kind="shape", doc="place of the wall along its normal")
    layer = Parameter(
        1e-3, unit="m", bounds=(1e-9, None), kind="shape", doc="depth over which the springs set in"
    )

    def __init__(self, on: Any = "*", *, normal: Any = (0.0, 0.0, 1.0), **options: Any) -> None:
        super().__init__(on, **options)
        if self.flow is not None:
            raise TermError("ElasticWall: flow= is for media; a wall does not move")
        self.normal = direction_of("ElasticWall: normal", normal)

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        depth = self._depth(site, p)
        into = np.minimum(depth, p.layer)
        return np.asarray(p.stiffness * (depth - into + 0.5 * into**2 / p.layer) * self.normal)

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Derivatives of the force by velocity, tangent and place, shape (n, 3, 3) each."""
        slope = -p.stiffness * np.minimum(self._depth(site, p) / p.layer, 1.0)
        nothing = np.zeros((len(site.x), 3, 3))
        return {
            "v": nothing,
            "tangent": nothing,
            "x": np.asarray(slope)[:, :, None] * np.outer(self.normal, self.normal),
        }

    def _depth(self, site: Any, p: Any) -> np.ndarray:
        """How deep the sites are in the wall [m], shape (n, 1); zero before it."""
        return np.maximum(p.position - (site.x @ self.normal)[:, None], 0.0)
