"""Forces that turn with the robot: thrusters, jets, a gripper's push."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.kinematics.frames import cross
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import edge_dofs
from rodnet.terms.drag.stokes import edge_before
from rodnet.terms.loads import _vector

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class FollowerForce(Term):
    """A force on a node that keeps its direction in the material frame of an edge.

    It is not conservative: a column under it flutters (Beck 1952) where a dead load would buckle it.

    Parameters
    ----------
    at : str
        The node, e.g. ``"rod.end"``.
    force : (3,) or callable
        Components along (m1, m2, t) of the edge [N], constant or a function of time.
    edge : str, optional
        The edge whose frame it follows; by default the one before the node on its rod.
    """

    kind = "load"
    default_name = "follower"
    source = "follower load; Beck 1952"
    claims: ClassVar[set[str]] = {"objective"}
    scale = Parameter(1.0, unit="1", null=0.0, doc="factor on the force")
    example: ClassVar[dict[str, Any]] = {"force": (0.3, -0.2, 1.0)}

    def __init__(
        self,
        *,
        at: str,
        force: Any,
        edge: str | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(at, name=name, **parameters)
        self.at, self.edge = at, edge
        self.vector: Callable[[float], np.ndarray] = _vector("FollowerForce: force", force, "N")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the node and the edge."""
        self.check_numbers()
        graph = model.graph
        node = graph.node(self.at)
        edge = graph.edge_indices(self.edge) if self.edge else np.array([edge_before(model, self.at, node)])
        if len(edge) != 1:
            raise TermError(
                f"load '{self.name}': edge='{self.edge}' must name one edge, it names {len(edge)}"
            )
        return _BoundFollower(self, model, node, int(edge[0]))


class _BoundFollower(BoundTerm):
    def __init__(self, term: FollowerForce, model: Model, node: int, edge: int) -> None:
        super().__init__(term)
        self.law, self.edge = term, edge
        self.scale = float(term.values().scale)
        self.rows = 3 * node + np.arange(3)
        self.stencils = [np.concatenate([self.rows, edge_dofs(model, np.array([edge]))[0]])[None]]

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        e = self.edge
        m1, m2, m3 = self.scale * self.law.vector(ev.t)
        f = m1 * ev.M1[e] + m2 * ev.M2[e] + m3 * ev.T[e]
        F[self.rows] += f
        if jac:
            # df = w x f with the rotation w = t x de / l + (dtheta - S.de / l) t of the edge's frame
            about = cross(ev.T[e], f)
            by_edge = (np.outer(f, -ev.T[e]) + (f @ ev.T[e]) * np.eye(3)).T - np.outer(about, ev.S[e])
            by_edge /= ev.L[e]
            slots = self.slots[0][0, :3]
            np.add.at(data, slots[:, 3:6], by_edge)
            np.subtract.at(data, slots[:, 6:9], by_edge)
            np.subtract.at(data, slots[:, 9], about)
        return float(np.abs(f).max())
