"""Constraints: clamps, hinges and prescribed motion, imposed exactly by elimination."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.graph.joint_specs import Joint, JointSpec, joint_spec, pivot
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.prescribed import Motions, PrescribedState

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.solve.model import Model


class Constraint(Term):
    """Prescribed positions, and optionally a prescribed orientation.

    Subclasses override ``position(self, t, x0, p)`` (shape (n, 3) [m] for the initial positions
    ``x0`` of the held nodes) and ``orientation(self, t, p)`` (rotation matrix (3, 3) from the initial
    to the current orientation), and say in ``holds`` which of them counts. Both must be pure and
    smooth in time: the framework differences them for velocities and accelerations.

    Attributes
    ----------
    holds : set
        ``{"position"}``, ``{"position", "orientation"}``.
    held_axes : (3,) of bool
        Along which axes positions are held.
    wall_arm : float
        Length of a wall's ghost edges over those that they continue [1].
    carries : bool
        Whether what hangs on it alone begins where it is moved to at the start, instead of where it is drawn.

    Parameters
    ----------
    at : str or sequence of str
        Held nodes. An orientation held at a single node is a wall: the node's edges join it through
        their own half edges. An orientation held on edges (``"cable:0-1"``) turns them as one body, and one
        held at a node of a rigid body the whole body.
    """

    kind = "constraint"
    default_name = "constraint"
    holds: ClassVar[set[str]] = {"position"}
    held_axes: tuple[bool, bool, bool] = (True, True, True)
    wall_arm: ClassVar[float] = 1.0
    carries: ClassVar[bool] = False

    def __init__(self, *, at: Any, name: str | None = None, **parameters: Any) -> None:
        super().__init__(at, name=name, **parameters)
        self.motions = Motions()

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the held nodes [m], shape (n, 3); by default they turn about the first one."""
        return turned(x0, np.asarray(self.orientation(t, p)))

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3)."""
        return np.eye(3)

    def held_nodes(self, graph: Any) -> np.ndarray:
        """Return the nodes whose positions are prescribed."""
        return graph.nodes(self.on)

    def held_edges(self, graph: Any) -> np.ndarray:
        """Return the edges whose twist is prescribed: those between held nodes, if orientation is held."""
        if "orientation" not in self.holds:
            return np.zeros(0, dtype=np.int64)
        held = np.zeros(graph.node_count, dtype=bool)
        held[self.held_nodes(graph)] = True
        turned = held[graph.edges].all(axis=1)
        for body in self.moved_bodies(graph):
            turned[body.edges] = True
        return np.flatnonzero(turned)

    def moved_bodies(self, graph: Any) -> list[Any]:
        """Return the rigid bodies that the constraint moves: those it holds at a node, if orientation is held."""
        if "orientation" not in self.holds:
            return []
        nodes = self.held_nodes(graph)
        return [body for body in graph.bodies if np.isin(body.nodes, nodes).any()]

    def walls(self, graph: Any) -> list[int]:
        """Return the nodes that get ghost edges: single held nodes with a held orientation."""
        if "orientation" not in self.holds:
            return []
        turned = set(graph.edges[self.held_edges(graph)].ravel().tolist())  # rigid bodies among them
        return [int(n) for n in self.held_nodes(graph) if int(n) not in turned]

    def pivots(self, graph: RodGraph) -> list[Joint]:
        """Hinges about held axes; none by default."""
        return []

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the nodes and edges."""
        return BoundConstraint(self, model)


def turned(x0: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Places after a rotation about the first of them [m], shape (n, 3); of many rotations (m, n, 3)."""
    if len(x0) == 1:
        return np.broadcast_to(x0, (*R.shape[:-2], 1, 3)).copy()
    return x0[:1] + (x0 - x0[:1]) @ np.swapaxes(R, -1, -2)


class BoundConstraint(BoundTerm):
    """Prescribed degrees of freedom of one constraint, as functions of time.

    Attributes
    ----------
    nodes, edges : ndarray
        Nodes with prescribed positions and edges with a prescribed frame, ghosts included.
    dofs : ndarray
        Their degrees of freedom, positions first.
    placed : ndarray of bool, shape (n, 3)
        Which coordinates of the nodes are prescribed; those of nodes that keep a free one are not eliminated.
    """

    def __init__(self, term: Constraint, model: Model) -> None:
        super().__init__(term)
        self.law = term
        self.p = term.values()
        self._turns: dict[float, np.ndarray] = {}
        graph = model.graph
        self.inner = term.held_nodes(graph)
        self.x0: np.ndarray = model.x0[self.inner]
        nodes = set(term.walls(graph))
        walls = [ghost for ghost in model.ghosts if ghost.root in nodes]
        mine = {joint.node for joint in term.pivots(graph)}
        walls += [ghost for ghost in model.pivots if ghost.root in mine]
        # what turns about a held node: far nodes of walls and of hinges' axes, and the rest of rigid bodies
        carried = [(w.node, w.root) for w in walls]
        moved = term.moved_bodies(graph)
        for body, masses, centre in zip(graph.bodies, model.mass_nodes, model.centre_nodes, strict=True):
            if any(body is other for other in moved):
                root = next(n for n in self.inner if n in body.nodes)
                carried += [(n, root) for n in (*np.setdiff1d(body.nodes, self.inner), *masses, centre)]
        self.nodes: np.ndarray = np.concatenate(
            [self.inner, np.array([n for n, _ in carried], dtype=np.int64)]
        )
        self.edges: np.ndarray = np.concatenate(
            [term.held_edges(graph), np.array([w.edge for w in walls], dtype=np.int64)]
        )
        self.root = [int(np.flatnonzero(self.inner == root)[0]) for _, root in carried]
        self.arm: np.ndarray = np.array([model.x0[n] - model.x0[root] for n, root in carried]).reshape(-1, 3)
        self.frames0: np.ndarray = model.frames0[self.edges]
        self.placed: np.ndarray = np.ones((len(self.nodes), 3), dtype=bool)
        self.placed[: len(self.inner)] = term.held_axes
        self.eliminated: np.ndarray = np.tile(np.all(self.placed, axis=1, keepdims=True), 3)
        coordinates = (3 * self.nodes[:, None] + np.arange(3))[self.eliminated]
        self.dofs: np.ndarray = np.concatenate([coordinates, model.twist0 + self.edges])
        # prescribed, but not eliminated, and the force there at the last evaluation [N]
        self.across_dofs = (3 * self.nodes[:, None] + np.arange(3))[self.placed & ~self.eliminated]
        self.across = np.zeros(len(self.across_dofs))
        if not len(self.nodes):
            raise TermError(f"constraint '{term.name}' at {term.on} holds no node")
        own = (getattr(function, "__func__", function) for function in (term.position, term.orientation))
        self.moving = tuple(own) != (Constraint.position, Constraint.orientation)
        if "orientation" in term.holds:
            R = np.asarray(term.orientation(0.0, self.p), dtype=float)
            if R.shape != (3, 3) or np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
                raise TermError(f"constraint '{term.name}': orientation must return a rotation matrix (3, 3)")
        try:
            check = np.asarray(term.position(0.0, self.x0, self.p), dtype=float)
        except ValueError as error:
            raise TermError(f"constraint '{term.name}': position at t = 0 fails: {error}") from error
        if check.shape != self.x0.shape or not np.all(np.isfinite(check)):
            raise TermError(
                f"constraint '{term.name}': position must return finite values of shape {self.x0.shape}"
            )
        if self.moving:
            self.state = PrescribedState(self, model)

    def positions(self, t: float) -> np.ndarray:
        """Prescribed positions of ``nodes`` [m], shape (n, 3)."""
        inner = np.asarray(self.law.position(t, self.x0, self.p), dtype=float)
        if not self.root:
            return inner
        return np.concatenate([inner, inner[self.root] + self.arm @ self._turned(t).T])

    def _turned(self, t: float) -> np.ndarray:
        """Prescribed rotation, shape (3, 3); remembered, for it is asked for once for each of what follows it."""
        found = self._turns.get(t)
        if found is None:
            if len(self._turns) > 3:
                self._turns.clear()
            found = self._turns[t] = np.asarray(self.law.orientation(t, self.p), dtype=float)
        return found

    def together(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Positions, directors and rotations at many times, (m, n, 3), (m, e, 3), (m, 3, 3); None if it can't."""
        law = self.law
        # what inherits it may move otherwise
        if not isinstance(law, PrescribedMotion) or "many" not in vars(type(law)):
            return None
        try:
            inner, R = law.many(times, self.x0, self.p)
        except Exception:
            if law.splined:
                raise
            return None  # a function may end before times that another run came to, and this one will not
        back = np.swapaxes(R, 1, 2)
        carried = [inner[:, self.root] + self.arm @ back] if self.root else []
        return np.concatenate([inner, *carried], axis=1), self.frames0[:, :, 0] @ back, R

    def jump(self) -> float:
        """Largest displacement of a node at t = 0 [m], that of a wall's far nodes as of near ones."""
        moved = np.abs(self.positions(0.0) - np.vstack([self.x0, self.x0[self.root] + self.arm]))
        moved[len(self.inner) :] /= self.law.wall_arm
        return float(moved.max())

    def directors(self, t: float) -> np.ndarray:
        """Prescribed first material directors of ``edges``, shape (n, 3)."""
        return self.frames0[:, :, 0] @ self._turned(t).T

    def turning(self, t: float, h: float) -> np.ndarray:
        """Rate of the prescribed rotation [rad/s], shape (3,)."""
        rate = (self._turned(t + h) - self._turned(t - h)) @ self._turned(t).T / (2.0 * h)
        return 0.5 * np.array([rate[2, 1] - rate[1, 2], rate[0, 2] - rate[2, 0], rate[1, 0] - rate[0, 1]])


class Hinge(Constraint):
    """A hinge on the surroundings: the positions of nodes are held; what is there turns freely, or about an axis.

    Parameters
    ----------
    at : str or sequence of str
        The nodes.
    axis : (3,), optional
        The axis about which the edges at each node turn, welded to one another; a ball hinge by default.
    stiffness : float
        With ``axis``: of the hinge's spring [N m/rad], an energy of the term `JointElasticity`.
    angle : float
        Where that spring is at rest, against the initial shape, by the right hand about the axis [rad].
    """

    default_name = "hinge"
    source = "essential boundary condition; docs, theory: springs and joints (joints that turn)"

    def __init__(
        self,
        *,
        at: Any,
        axis: Any = None,
        stiffness: float | None = None,
        angle: float = 0.0,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(at=at, name=name, **parameters)
        self.spec: JointSpec | None = None
        if axis is not None:
            self.spec = joint_spec(str(at), "hinge", (), axis, stiffness, None, angle)
        elif stiffness is not None or angle:
            raise TermError(
                f"hinge '{self.name}': a spring needs the axis that it turns about, axis=(x, y, z)"
            )

    def pivots(self, graph: RodGraph) -> list[Joint]:
        """Hinges about the axis, one at each node."""
        if self.spec is None:
            return []
        nodes = self.held_nodes(graph).tolist()
        return [pivot(graph, n, replace(self.spec, at=graph.node_name(n))) for n in nodes]


class Clamp(Constraint):
    """A wall: position and orientation of a rod's end (or of edges) are held at their initial values.

    The wall acts through the half edge next to it, k = 2 EI / l, which keeps the discretisation
    second order; holding two nodes instead would lose half an edge of length.
    """

    default_name = "clamp"
    source = "docs, theory: springs and joints"
    holds: ClassVar[set[str]] = {"position", "orientation"}


class PrescribedMotion(Constraint):
    """Nodes that follow given functions of time.

    Parameters
    ----------
    at : str or sequence of str
        The nodes, or an edge (``"rod:0-1"``).
    position : callable, optional
        ``position(t)`` gives the displacement of the held nodes from their initial positions [m],
        shape (3,), e.g. a smoothed recording (`rodnet.smooth_motion`).
    orientation : callable, optional
        ``orientation(t)`` gives the rotation from the initial orientation: a matrix (3, 3), a quaternion
        (x, y, z, w) or a `scipy.spatial.transform.Rotation`. Without it the nodes are only moved and the
        rod may turn about them.
    """

    default_name = "motion"
    source = "essential boundary condition"
    example: ClassVar[dict[str, Any]] = {"position": lambda t: np.array([0.01 * np.sin(t), 0.0, 0.0])}

    def __init__(
        self,
        *,
        at: Any,
        position: Callable[[float], np.ndarray] | None = None,
        orientation: Callable[[float], np.ndarray] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(at=at, name=name, **parameters)
        if position is None and orientation is None:
            raise TermError("PrescribedMotion: give position=, orientation= or both as functions of time")
        from rodnet.terms.functions import Remembered, rotation_matrix

        matrix = partial(rotation_matrix, owner=f"constraint '{self.name}': orientation")
        #: functions of time: displacement [m] and rotation matrix, or None
        self.displacement = None if position is None else Remembered(position)
        self.rotation = None if orientation is None else Remembered(orientation, matrix)
        self.holds = {"position"} if orientation is None else {"position", "orientation"}  # type: ignore[misc]

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the held nodes [m], shape (n, 3)."""
        turned = super().position(t, x0, p)
        return turned if self.displacement is None else turned + self.displacement(t)

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3)."""
        return np.eye(3) if self.rotation is None else self.rotation(t)

    @property
    def splined(self) -> bool:
        """Whether it is made of splines alone, which can be asked for any time."""
        return all(function is None or function.splined for function in (self.displacement, self.rotation))

    def many(self, times: np.ndarray, x0: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Positions and rotations at many times, shapes (m, n, 3) and (m, 3, 3)."""
        R = self.rotations(times)
        x = turned(x0, R)
        return (x if self.displacement is None else x + self.displacement.many(times)[:, None]), R

    def rotations(self, times: np.ndarray) -> np.ndarray:
        """What is prescribed of the orientation at many times, shape (m, 3, 3)."""
        if self.rotation is None:
            return np.broadcast_to(np.eye(3), (len(times), 3, 3))
        return self.rotation.many(times)
