"""A clamp that slides along an axis: a bushing, the far clamp of a testing machine under a weight."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.base import BoundTerm
from rodnet.terms.constraints import BoundConstraint, PrescribedMotion

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class Slider(PrescribedMotion):
    """A clamp that is free along one axis: it holds an end's direction and its position across the axis.

    Like any clamp it acts through the half edge next to it. Along the axis the end goes where the
    forces on it send it, without friction.

    Parameters
    ----------
    at : str or sequence of str
        Single nodes, e.g. ``"rod.end"``; each slides by itself.
    axis : (3,)
        The axis, along x, y or z.
    position : callable, optional
        ``position(t)`` gives the displacement of the clamp [m], shape (3,); what lies along the axis counts for
        nothing.
    orientation : callable, optional
        ``orientation(t)`` gives its rotation from the initial orientation, as in `PrescribedMotion`.

    Raises
    ------
    TermError
        If the axis is not one of the coordinate axes, or (when the robot is made) an edge or a rigid body
        would have to slide as one.
    """

    default_name = "slider"
    source = "essential boundary condition; docs, theory: constraints"
    # a wall's direction is that of its ghost edge, whose far node stays: so far that sliding does not turn it
    wall_arm: ClassVar[float] = 1e9
    example: ClassVar[dict[str, Any]] = {"axis": (1.0, 0.0, 0.0)}

    def __init__(
        self,
        *,
        at: Any,
        axis: Any,
        position: Callable[[float], np.ndarray] | None = None,
        orientation: Callable[[float], np.ndarray] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        still = (lambda t: np.eye(3)) if orientation is None else orientation
        super().__init__(at=at, position=position, orientation=still, name=name, **parameters)
        try:
            along = np.array(axis, dtype=float)
        except (TypeError, ValueError):
            along = np.zeros(0)
        if along.shape != (3,) or np.count_nonzero(along) != 1 or not np.all(np.isfinite(along)):
            raise TermError(
                f"slider '{self.name}': axis = {axis!r} must point along x, y or z, e.g. (1, 0, 0); turn the "
                "drawing so that it does"
            )
        self.held_axes = tuple(bool(a == 0.0) for a in along)  # type: ignore[assignment]

    def bind(self, model: Any) -> BoundTerm:
        """Bind to the nodes."""
        graph = model.graph
        if len(self.held_edges(graph)) or self.moved_bodies(graph):
            raise TermError(
                f"slider '{self.name}' at {self.on} holds both ends of an edge, or a rigid body, whose nodes would "
                "slide by themselves; name single nodes, e.g. 'rod.end'"
            )
        return _BoundSlider(self, model)


class _BoundSlider(BoundConstraint):
    """Puts k (x - prescribed x) = 0 in the place of the balance of forces across the axis.

    The three coordinates of a node are eliminated together or not at all. These have no mass, so that the
    equations are these and nothing else; as Newton's method begins where they hold, they always do.
    """

    replacing = True

    def __init__(self, term: Slider, model: Model) -> None:
        super().__init__(term, model)
        graph = model.graph
        model.mass[self.across_dofs] = 0.0
        nodes = self.across_dofs // 3
        self.stiffness = np.array([_stiffest(graph, n) for n in nodes])
        self.stencils = [self.across_dofs[:, None]]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Find all entries of the rows that are replaced."""
        self.rows = stencils[0].ravel()
        if np.any(self.rows < 0):
            raise TermError(
                f"slider '{self.term.name}' at {self.term.on}: another constraint holds the node, or it belongs to a "
                "rigid body; keep one of them, or name the end of a rod that is free"
            )
        self.diagonal = pattern.places(stencils[0]).ravel()
        columns = [pattern.indices[pattern.indptr[i] : pattern.indptr[i + 1]] for i in self.rows]
        places = [pattern.places(np.array([[i]]), c[None]) for i, c in zip(self.rows, columns, strict=True)]
        self.cleared = np.concatenate([np.zeros(0, dtype=np.int32), *(p.ravel() for p in places)])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        d = self.across_dofs
        self.across = -F[d]
        target = self.positions(ev.t)[self.placed & ~self.eliminated]
        F[d] = -self.stiffness * (ev.q[d] - target)
        if jac:
            data[self.cleared] = 0.0
            data[self.diagonal] = self.stiffness
        return 0.0


def _stiffest(graph: Any, node: int) -> float:
    """Largest axial stiffness EA / l of the edges at a node [N/m]."""
    at = (graph.edges == node).any(axis=1)
    stiff = np.where(np.isfinite(graph.EA), graph.EA, 0.0)[at] / graph.rest_length[at]
    return float(stiff.max()) or 1.0
