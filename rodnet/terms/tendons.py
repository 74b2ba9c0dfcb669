"""Tendons: lines through eyelets on the robot, pulled with a tension or by a length, with friction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.actuators import Actuator, _BoundActuator
from rodnet.terms.base import BoundTerm
from rodnet.terms.drag.line import edge_dofs

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.trajectory import Trajectory

SLACK = 1e-6  # of a tendon's length, over which it becomes taut


class Tendon(Actuator):
    """A tendon that runs straight from eyelet to eyelet, from its drive to its anchor.

    The drive is at the first point of the route and the anchor at the last. Either the tension at the
    drive is given, or the length that it has drawn in; then the tendon is a spring that can only pull.
    At each eyelet between, friction takes from the tension what the tendon's turn there and its
    sliding say (capstan): T' = T exp(-friction turn) while it slides towards the drive, T exp(+friction turn)
    on the way back, and in between after a reversal, by Dahl's law. No cycle gives energy back.

    Parameters
    ----------
    route : sequence
        Points that it runs through: a node ``"arm:3"``; with an offset in the material frame (m1, m2) or
        (m1, m2, t) [m], ``("arm:3", (0.01, 0.0))``; all nodes of a rod, ``("arm", offset)`` with one offset
        or one for each node; or a point fixed in space, ``(x, y, z)``. An eyelet on a node that is clamped
        belongs to the wall. A finer mesh (`Robot.refined`) adds no eyelets.
    tension : float or Parameter
        Tension at the drive [N].
    pull : float or Parameter
        Instead of it: length drawn in by the drive [m].
    stiffness : float or Parameter
        Axial stiffness EA of the tendon [N], needed with ``pull``.
    friction : float or Parameter
        Coefficient of friction at the eyelets [1].
    reach : float or Parameter
        Pre-sliding scale of the friction [m], at the largest friction that an eyelet has known.
    gain : float or Parameter
        Relative change of ``tension`` or ``pull``, of a drive that does not do quite what it is told [1].
    schedule : callable, optional
        A factor on ``tension`` or ``pull`` as a function of time.
    """

    default_name = "tendon"
    source = "virtual work of straight segments; Euler-Eytelwein (capstan), Dahl 1968 (pre-sliding)"
    tension = Parameter(None, unit="N", bounds=(0, None), null=0.0, doc="tension at the drive")
    pull = Parameter(None, unit="m", null=0.0, doc="length drawn in by the drive")
    stiffness = Parameter(None, unit="N", bounds=(0, None), kind="shape", doc="axial stiffness of the tendon")
    friction = Parameter(
        0.0, unit="1", bounds=(0, None), null=0.0, kind="shape", doc="coefficient of friction at the eyelets"
    )
    reach = Parameter(1e-4, unit="m", bounds=(1e-9, None), kind="shape", doc="pre-sliding scale of friction")
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of what is commanded")
    example: ClassVar[dict[str, Any]] = {
        "route": [("rod.start", (0.0, 4e-3)), ("rod:1", (0.0, 4e-3)), ("rod:2", (1e-3, 4e-3)), "rod:3"],
        "tension": 30.0,
        "friction": 0.3,
        "reach": 2e-3,
    }

    def __init__(
        self,
        *,
        route: Sequence[Any],
        schedule: Callable[[float], float] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__("*", name=name, **parameters)
        self.route, self.schedule = list(route), schedule
        if (self.tension.value is None) == (self.pull.value is None):
            raise TermError(f"tendon '{self.name}': give tension= or pull=")
        if self.pull.value is not None and not self.stiffness.value:
            raise TermError(f"tendon '{self.name}': pull= needs stiffness=, the tendon's EA [N]")

    @property
    def drives(self) -> str:  # type: ignore[override]
        """What is commanded, ``"tension"`` or ``"pull"``."""
        return "pull" if self.tension.value is None else "tension"

    def command(self, t: float, sensors: Any, p: Any) -> float:
        """Tension [N] or length drawn in [m]; see ``drives``."""
        value = (1.0 + p.gain) * (p.pull if self.tension.value is None else p.tension)
        return value if self.schedule is None else value * self.schedule(t)

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the eyelets."""
        self.check_numbers()
        return _BoundTendon(self, model)

    def tensions(self, traj: Trajectory) -> np.ndarray:
        """Tension of every segment over a trajectory [N], shape (T, segments), from drive to anchor."""
        names = [] if traj.robot is None else [term.name for term in traj.robot.terms]
        if self.name not in names:
            raise TermError(f"no tendon '{self.name}' pulled the robot of this trajectory")
        k = names.index(self.name)
        memory = np.array([traj.state(i).memories[k] for i in range(len(traj))])
        segments = (memory.shape[1] + 3) // 7  # see _BoundTendon
        return memory[:, -segments:]


class _Route:
    """Eyelets of a tendon as arrays."""

    def __init__(self, term: Tendon, model: Model) -> None:
        self.nodes: list[int] = []
        self.edges: list[tuple[int, int]] = []
        self.offsets: list[np.ndarray] = []
        self.fixed: list[np.ndarray] = []
        self.name = term.name
        for item in term.route:
            self._take(item, model)
        if len(self.nodes) < 2:
            raise TermError(
                f"tendon '{self.name}' runs through {len(self.nodes)} points; it needs two or more"
            )

    def _take(self, item: Any, model: Model) -> None:
        point, place, offset = None, "", np.zeros((1, 3))
        try:
            if isinstance(item, str):
                place = item
            elif isinstance(item[0], str):
                place, given = item
                offset = np.atleast_2d(np.asarray(given, dtype=float))
            else:
                point = np.asarray(item, dtype=float).reshape(3)
        except (TypeError, ValueError, IndexError):
            raise self._bad(item) from None
        if point is not None:
            self._add(-1, (-1, -1), np.zeros((2, 3)), point)
            return
        nodes = model.graph.drawn_nodes(place)
        rows, columns = offset.shape if offset.ndim == 2 else (0, 0)
        if rows not in (1, len(nodes)) or columns not in (2, 3):
            raise TermError(
                f"tendon '{self.name}': offsets at '{place}' must be one or {len(nodes)} vectors of 2 or 3 "
                f"components, not of shape {offset.shape}"
            )
        full = np.zeros((len(nodes), 3))
        full[:, :columns] = offset
        for node, arm in zip(nodes, full, strict=True):
            self._mount(place, int(node), arm, model)

    def _mount(self, place: str, node: int, arm: np.ndarray, model: Model) -> None:
        """Mount an eyelet on the wall at a node, or on the edges of its rod there, half on each."""
        own = self._edges(place, node, model)
        walls = [ghost.edge for ghost in model.ghosts if ghost.root == node]
        # where several rods are held, each has a wall of its own
        walls = [w for w in walls if np.isin(model.edge2[model.edge1 == w], own).any()] or walls
        if walls:
            # the wall's edge runs towards the node: at a rod's end against the rod
            against = np.sum(model.t0[walls[0]] * model.t0[own[0]]) < 0.0
            self._add(
                node, (walls[0], -1), np.stack([arm * ([1, -1, -1] if against else [1, 1, 1]), 0 * arm])
            )
            return
        found = own
        second = found[1] if len(found) > 1 else -1
        self._add(node, (found[0], second), np.stack([arm, arm]) / len(found))

    def _edges(self, place: str, node: int, model: Model) -> list[int]:
        graph = model.graph
        for name in graph.rod_names(place):
            rod = graph.rods[name]
            found = [int(e) for e in rod.edges if node in graph.edges[e]]
            if found:
                return found
        raise self._bad(place)

    def _add(
        self, node: int, edges: tuple[int, int], offsets: np.ndarray, fixed: Any = (0.0, 0.0, 0.0)
    ) -> None:
        if not (np.all(np.isfinite(offsets)) and np.all(np.isfinite(fixed))):
            raise TermError(f"tendon '{self.name}': a point of its route is not finite")
        self.nodes.append(node)
        self.edges.append(edges)
        self.offsets.append(offsets)
        self.fixed.append(np.asarray(fixed, dtype=float))

    def _bad(self, item: Any) -> TermError:
        return TermError(
            f"tendon '{self.name}': {item!r} is no point of a route; give 'rod:3', ('rod:3', (m1, m2)), "
            "('rod', offsets) or a point (x, y, z)"
        )


class _BoundTendon(_BoundActuator):
    """The memory is the command; drops of tension and stiffnesses at the eyelets, segment lengths; these before the
    last step; and tensions.
    """

    def __init__(self, term: Tendon, model: Model) -> None:
        from rodnet.terms import tendon_friction, tendon_kernels

        super().__init__(term)
        self.kernels, self.friction, self.law = tendon_kernels, tendon_friction, term
        route = _Route(term, model)
        self.nodes, self.edges = np.array(route.nodes), np.array(route.edges).reshape(-1, 2)
        self.offsets, self.fixed = np.array(route.offsets), np.array(route.fixed)
        count = len(self.nodes)
        self.count = count - 1
        self.dofs = self._dofs(model)
        self.stencils = [np.concatenate([self.dofs[:-1], self.dofs[1:]], axis=1)]
        # a tension that depends on the whole tendon's shape couples all of its eyelets
        self.coupled = term.drives == "pull" or self.p.friction > 0.0
        if self.coupled:
            every, place = np.unique(self.dofs, return_inverse=True)
            self.place = place.reshape(self.dofs.shape)
            self.stencils.append(every[None].astype(np.int32))
            self.rows = np.zeros((self.count, len(every)))  # changes of the tensions
        self.p_, self.P = np.zeros((count, 3)), np.zeros((count, 3, tendon_kernels.EYELET))
        self.length, self.u = np.zeros(self.count), np.zeros((self.count, 3))
        T = model.t0
        M2 = np.cross(T, model.d10)
        zero = np.zeros_like(T)
        tendon_kernels.place_eyelets(
            self.nodes, self.edges, self.offsets, self.fixed, model.x0, model.d10, M2, T, zero,
            model.rest_length, self.p_, self.P,
        )  # fmt: skip
        if not tendon_kernels.segments(self.p_, self.length, self.u) > 0.0:
            raise TermError(f"tendon '{term.name}': two points of its route in sequence are the same place")
        self.natural = self.length.copy()
        self.value = self._checked(0.0, model.no_sensors)
        past = np.concatenate([np.zeros(2 * (count - 2)), self.length])
        tension, state, *_ = self._tensions(self.length, self._turns()[0], past, False)
        past[: 2 * (count - 2)] = state
        self.memory = np.concatenate([[self.value], past, past, tension])

    def _dofs(self, model: Model) -> np.ndarray:
        """Degrees of freedom of each eyelet, shape (K, 17); where one has none, some of the tendon's."""
        axes, some = np.arange(3), 3 * max(int(self.nodes.max()), 0)
        dofs = np.full((len(self.nodes), 17), some)
        for k, node in enumerate(self.nodes):
            if node >= 0:
                dofs[k, :3] = 3 * node + axes
            for a, edge in enumerate(self.edges[k]):
                if edge >= 0:
                    dofs[k, 3 + 7 * a : 10 + 7 * a] = edge_dofs(model, np.array([edge]))[0]
        return dofs.astype(np.int32)

    # -- the step -------------------------------------------------------------------------
    def _checked(self, t: float, sensors: Any) -> float:
        value = float(self.actuator.command(t, sensors, self.p))
        if not math.isfinite(value) or (self.law.drives == "tension" and value < 0.0):
            raise TermError(
                f"tendon '{self.law.name}' is commanded a {self.law.drives} of {value} at t = {t:g} s"
            )
        return value

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        self._take(inputs)
        self.value = self._checked(t, sensors)

    @property
    def constants(self) -> tuple[Any, ...]:
        """What its tensions depend on besides positions and memory."""
        return self.p, self.natural, self.law

    @property
    def _past(self) -> np.ndarray:
        """Drops, stiffnesses (n - 1 each) and segment lengths (n) at the last accepted state."""
        assert self.memory is not None
        return self.memory[1 : 3 * self.count - 1]

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        self._place(ev)
        tension, state, *_ = self._tensions(self.length, self._turns()[0], self._past, False)
        return np.concatenate([[self.value], state, self.length, self._past, tension])

    def path_dependence(self, memory: np.ndarray | None) -> str:
        assert memory is not None
        tension = memory[-self.count :]
        if not np.ptp(tension) > 1e-9 * np.abs(tension).max():
            return ""
        least, most = tension.min(), tension.max()
        return f"friction holds tendon '{self.law.name}' at its eyelets, at tensions from {least:.3g} to {most:.3g} N"

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory = memory

    def restore(self, model: Model, memory: np.ndarray) -> None:
        super().restore(model, memory)
        self.value = float(memory[0])

    def rewind(self) -> None:
        assert self.memory is not None
        n = 3 * self.count - 2
        self.memory = self.memory.copy()
        self.memory[1 : 1 + n] = self.memory[1 + n : 1 + 2 * n]

    # -- forces ---------------------------------------------------------------------------
    def _place(self, ev: Evaluation) -> None:
        self.kernels.place_eyelets(
            self.nodes,
            self.edges,
            self.offsets,
            self.fixed,
            ev.x,
            ev.M1,
            ev.M2,
            ev.T,
            ev.S,
            ev.L,
            self.p_,
            self.P,
        )
        self.kernels.segments(self.p_, self.length, self.u)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        self._place(ev)
        turns, normals = self._turns()
        tension, _, by_length, by_turn = self._tensions(self.length, turns, self._past, jac and self.coupled)
        largest = self.kernels.pull(
            self.nodes, self.edges, self.offsets, self.dofs, ev.M1, ev.M2, ev.T, ev.S, ev.ts, ev.L, self.P,
            self.length, self.u, tension, F, self.slots[0] if jac else ev.model.no_slots, data, jac,
        )  # fmt: skip
        if jac and self.coupled:
            slots = self.slots[1][0]
            self.kernels.couple(
                self.place, self.P, self.length, self.u, *normals, by_length, by_turn, self.rows, slots, data
            )
        return largest

    def _turns(self) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Angle by which the tendon turns at each inner eyelet, and minus its derivatives by both directions."""
        one, two = self.u[:-1], self.u[1:]
        cos = np.sum(one * two, axis=1, keepdims=True)
        across, back = two - cos * one, one - cos * two
        sin = np.linalg.norm(across, axis=1, keepdims=True)
        safe = np.where(sin > 1e-9, sin, np.inf)  # a straight tendon has no direction to turn to
        return np.arctan2(sin, cos)[:, 0], (across / safe, back / safe)

    def _tensions(
        self, length: np.ndarray, turns: np.ndarray, past: np.ndarray, derivatives: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Tension of each segment, drops and stiffnesses, and derivatives of tensions by lengths and turns."""
        p, n = self.p, self.count
        # what slides through an eyelet towards the drive is what the way beyond it gets shorter
        slips = np.cumsum((past[2 * n - 2 :] - length)[::-1])[::-1][1:]
        state, tension, by = np.empty((2, n - 1)), np.empty(n), np.zeros((n, 2 * n))
        given = turns, p.friction, past[: n - 1], past[n - 1 : 2 * n - 2], slips, p.reach, tension, *state
        if self.law.drives == "tension":
            self.friction.chain(self.value, *given, derivatives, by)
            return tension, state.ravel(), by[:, :n], by[:, n:-1]
        total = float(self.natural.sum())
        excess = float(length.sum()) - total + self.value
        root = math.hypot(excess, SLACK * total)
        self.friction.drawn_tension(0.5 * (excess + root), self.natural, p.stiffness, *given, by)
        # the tension at the drive follows, so that the stretches still make up for the excess
        stretch = self.natural @ by / p.stiffness
        by_length, by_turn, base = by[:, :n], by[:, n:-1], by[:, -1:] / stretch[-1]
        wanted = 0.5 * (1.0 + excess / root) - stretch[:n]
        return tension, state.ravel(), by_length + base * wanted, by_turn - base * stretch[n:-1]

    def changes(
        self,
        length: np.ndarray,
        turns: np.ndarray,
        tension: np.ndarray,
        past: np.ndarray,
        d_length: np.ndarray,
        d_turns: np.ndarray,
        d_past: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of what `_tensions` gives, tensions (n, k) and state (2 n - 2, k), at one and the same command."""
        p, n, k = self.p, self.count, d_length.shape[1]
        slips = np.cumsum((past[2 * n - 2 :] - length)[::-1])[::-1][1:]
        d_slips = np.cumsum((d_past[2 * n - 2 :] - d_length)[::-1], axis=0)[::-1][1:]
        out, state = np.zeros((n, k)), np.empty((2, n - 1, k))
        given = tension, turns, p.friction, past[: n - 1], past[n - 1 : 2 * n - 2], slips, p.reach
        moved = d_turns, d_past[: n - 1], d_past[n - 1 : 2 * n - 2], d_slips
        self.friction.chain_changes(*given, *moved, out, *state)
        if self.law.drives == "pull":
            total = float(self.natural.sum())
            excess = float(length.sum()) - total + self.value
            longer = 0.5 * (1.0 + excess / math.hypot(excess, SLACK * total)) * d_length.sum(axis=0)
            by, none = np.eye(n, 1), np.zeros((6, n - 1, 1))
            self.friction.chain_changes(*given, *none[:4], by, *none[4:])  # all follow the one at the drive
            out[0] = (p.stiffness * longer - self.natural @ out) / (self.natural @ by)
            self.friction.chain_changes(*given, *moved, out, *state)
        return out, state.reshape(2 * n - 2, k)
