"""A robot made ready for computing: numbered degrees of freedom, bound terms, pattern, buffers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from rodnet.errors import GraphError
from rodnet.graph.joint_specs import root_factors
from rodnet.graph.joints import Pairs, Springs, make_springs
from rodnet.kinematics.frames import cross, material_frames, unit
from rodnet.memory import release
from rodnet.solve.bodies import Bodies
from rodnet.solve.dof_names import dof_name
from rodnet.solve.joint_frames import joint_ghosts
from rodnet.solve.linear import LinearSolver
from rodnet.solve.ordering import elimination_blocks, loop_blocks
from rodnet.solve.pattern import TRASH, build_pattern
from rodnet.solve.stiffness import check_stiffness
from rodnet.terms.base import Unmeasured
from rodnet.terms.constraints import BoundConstraint, Constraint

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.solve.body_motion import BodyMotion
    from rodnet.solve.evaluation import Evaluation
    from rodnet.terms.base import BoundTerm


class Ghost(NamedTuple):
    """A ghost edge, the part of a wall that continues one edge: its far node, its edge, the held node."""

    node: int
    edge: int
    root: int


def _overrides(bound: BoundTerm, method: str) -> bool:
    from rodnet.terms.base import BoundTerm

    return getattr(type(bound), method) is not getattr(BoundTerm, method)


class Model:
    """A `Robot` bound for computing.

    Walls add ghost nodes and edges after those of the graph, rigid bodies hidden nodes for their masses and centres.
    Positions come first in the vector of degrees of freedom, then twist angles: ``q = [x_0, ..., theta_0, ...]``
    (paper, kinematics), then three rotations for each rigid body.

    Attributes
    ----------
    dof_count : int
        Number of degrees of freedom, ghosts included.
    free, held : ndarray
        Degrees of freedom that are unknown and that constraints prescribe.
    mass : ndarray, shape (dof_count,)
        Lumped masses [kg] and rotary inertias [kg m^2]; zero on rigid bodies, which have their own.
    node_mass : ndarray, shape (node_count,)
        Lumped masses [kg], those of rigid bodies included.
    bodies : Bodies or None
        The rigid bodies that are free to move.
    bound : list of BoundTerm
        The robot's terms, in its order.
    """

    def __init__(self, robot: Robot) -> None:
        self.order = 1  # of the time stepper under way
        self.robot, self.graph = robot, robot.graph
        self.no_sensors, self.no_slots = Unmeasured(), np.zeros((1, 1, 1), dtype=np.int32)
        self._extend_by_ghosts()
        for term in robot.terms:
            term.add_masses(self)
        self._number()
        self.stiffness_version = 0  # counts changes of spring_stiffness
        self.bound: list[BoundTerm] = [term.bind(self) for term in robot.terms]
        del self.compliance1, self.compliance2  # large, and in the stiffnesses
        self.constraints = [b for b in self.bound if isinstance(b, BoundConstraint)]
        self.moving = [c for c in self.constraints if c.moving]
        self._sort_by_duty()
        bodies = Bodies(self) if self.graph.bodies else None
        self.bodies: Bodies | None = bodies if bodies is not None and bodies.count else None
        self._eliminate(bodies)
        self._analyse()

    # -- set-up ---------------------------------------------------------------------------
    def _extend_by_ghosts(self) -> None:
        graph = self.graph
        t0 = unit(drawn := graph.x0[graph.edges[:, 1]] - graph.x0[graph.edges[:, 0]])
        frames = material_frames(t0, graph.d1, np.zeros(graph.edge_count))
        holding = [term for term in self.robot.terms if isinstance(term, Constraint)]
        arms = [(n, term.wall_arm) for term in holding for n in term.walls(graph)]
        walls = [n for n, _ in arms]
        if len(set(walls)) != len(walls):
            twice = next(n for n in walls if walls.count(n) > 1)
            raise GraphError(f"node '{graph.node_name(twice)}' is clamped twice; keep one of the constraints")
        self.ghosts: list[Ghost] = []
        x, edges, frame, pairs = [graph.x0], [graph.edges], [frames], []
        for n, arm in arms:
            for e in np.flatnonzero((graph.edges == n).any(axis=1)):
                ghost = Ghost(graph.node_count + len(self.ghosts), graph.edge_count + len(self.ghosts), n)
                self.ghosts.append(ghost)
                outward = 1.0 if graph.edges[e, 0] == n else -1.0
                x.append((graph.x0[n] - outward * arm * drawn[e])[None])
                edges.append(np.array([[ghost.node, n]]))
                frame.append((frames[e] @ np.diag([1.0, outward, outward]))[None])
                pairs.append((ghost.edge, int(e), n, 1.0))
        pivots = [joint for term in holding for joint in term.pivots(graph)]
        joints = joint_ghosts(graph, pivots, len(self.ghosts), walls)
        self.joints, self.joint_laws = joints.frames, joints.laws
        if self.joints:
            x.append(joints.x)
            edges.append(joints.edges)
            frame.append(joints.directions)
        ghosts = len(self.ghosts) + len(joints.edges)
        self._add_masses(x)
        join = lambda parts: np.concatenate(parts) if len(parts) > 1 else parts[0]  # noqa: E731
        pad = lambda a, size: join([a, np.zeros(size - len(a))]) if size > len(a) else a  # noqa: E731
        self.x0, self.edges, frames0 = join(x), join(edges), join(frame)
        lengths = np.linalg.norm(self.x0[self.edges[:, 1]] - self.x0[self.edges[:, 0]], axis=1)
        self.rest_length = join([graph.rest_length, *([lengths[graph.edge_count :]] if ghosts else [])])
        self.node_mass = pad(graph.node_mass, len(self.x0))
        self.edge_inertia = pad(graph.edge_inertia, len(self.edges))
        for body, nodes in zip(graph.bodies, self.mass_nodes, strict=True):
            self.node_mass[nodes] = 0.25 * body.mass
        self.t0: np.ndarray = np.ascontiguousarray(frames0[:, :, 2])
        self.d10: np.ndarray = np.ascontiguousarray(frames0[:, :, 0])
        self.theta0 = np.concatenate([np.zeros(len(self.edges) - len(joints.theta)), joints.theta])
        # the directions of hinges that are held, as ghosts that a constraint prescribes
        self.pivots: list[Ghost] = [
            Ghost(int(frames.nodes[0]), int(frames.edges[0]), frames.joint.node)
            for frames in self.joints[len(graph.joints) :]
        ]
        # a wall takes the place of the joint at its node: each edge joins it by its own half edge
        kept = ~np.isin(graph.springs.node, [*walls, *(pivot.root for pivot in self.pivots)])
        springs = graph.springs if kept.all() else graph.springs.take(np.flatnonzero(kept))
        if pairs:
            welds = Pairs.of(pairs)
            rigid = np.vstack([graph.compliance, np.zeros((ghosts, 3))])
            half = np.concatenate([graph.half_natural, np.tile(np.eye(3), (ghosts, 1, 1))])
            lengths = np.concatenate([graph.rest_length, np.zeros(ghosts)])  # a wall has no length of its own
            roots = root_factors(graph, welds.edge2, welds.node)
            soft = rigid[welds.edge1], rigid[welds.edge2] / roots[:, None]
            walled = make_springs(welds, self.edges, lengths, frames0, soft, half)
            springs = Springs.concatenate([springs, walled])
        if self.joints:
            springs = Springs.concatenate([springs, *joints.springs])
        self._take_springs(springs)

    def _add_masses(self, x: list[np.ndarray]) -> None:
        """Add the hidden nodes of rigid bodies: four masses, and the centre of all that a body carries."""
        graph, count = self.graph, sum(map(len, x))
        hidden = count + np.arange(5 * len(graph.bodies)).reshape(-1, 5)
        self.mass_nodes, self.centre_nodes = hidden[:, :4], hidden[:, 4]
        # that centre is not known yet
        x += [np.vstack([body.mass_points(), body.com]) for body in graph.bodies]

    def _take_springs(self, springs: Springs) -> None:
        as_int = lambda a: np.ascontiguousarray(a, dtype=np.int64)  # noqa: E731
        self.edge1, self.edge2, self.spring_node = map(as_int, (springs.edge1, springs.edge2, springs.node))
        self.sign1, self.sign2 = springs.sign1.copy(), springs.sign2.copy()
        self.Q1, self.Q2 = springs.Q1, springs.Q2  # the graph's own: see `own_frames`
        self.compliance1, self.compliance2 = springs.compliance1, springs.compliance2
        self.spring_weight, self.spring_length = springs.weight, springs.length
        self.spring_stiffness = springs.stiffness.copy()
        # the joints' own springs come last and have a law of their own (`rodnet.terms.joints`)
        self.first_law = len(springs) - len(self.joint_laws)
        self.spring_stiffness[self.first_law :] = 0.0
        self.eps0 = np.zeros((len(springs), 3))
        self.driven = np.zeros(len(springs))  # what motors turn springs by, in all [rad]
        # what turns of the two edges about themselves and of a motor add to the twist of a spring; not so in the
        # joints' own, whose frames are free to turn
        self.spin = np.stack([-self.Q1[:, 2, 2], self.Q2[:, 2, 2], -np.ones(len(springs))], axis=1)
        self.spin[self.first_law :] = 0.0

    @property
    def frames0(self) -> np.ndarray:
        """Initial material frames of the edges, directors m1, m2, t as columns, shape (edge_count, 3, 3)."""
        return np.stack([self.d10, cross(self.t0, self.d10), self.t0], axis=-1)

    @property
    def start_frames(self) -> np.ndarray:
        """The same as a run begins: bodies of a hinge share a frame, about which its pose has turned some of them."""
        return material_frames(self.t0, self.d10, self.theta0)

    def own_frames(self) -> None:
        """Copy the springs' frames Q1 and Q2, for an actuator that will change them."""
        self.Q1, self.Q2 = self.Q1.copy(), self.Q2.copy()

    def _number(self) -> None:
        axes = np.arange(3)
        self.node_count, self.edge_count, self.spring_count = len(self.x0), len(self.edges), len(self.edge1)
        self.twist0 = 3 * self.node_count
        self.turn0 = self.twist0 + self.edge_count
        self.dof_count = self.turn0 + 3 * len(self.graph.bodies)
        positions = 3 * np.arange(self.node_count)[:, None] + axes
        stretch_dofs = np.concatenate([positions[self.edges[:, 0]], positions[self.edges[:, 1]]], axis=1)
        self.stretch_dofs = stretch_dofs.astype(np.int32)
        outer1 = np.where(self.sign1 > 0, self.edges[self.edge1, 0], self.edges[self.edge1, 1])
        outer2 = np.where(self.sign2 > 0, self.edges[self.edge2, 1], self.edges[self.edge2, 0])
        twist1, twist2 = (self.twist0 + e[:, None] for e in (self.edge1, self.edge2))
        self.spring_dofs = np.concatenate(
            [positions[outer1], twist1, positions[self.spring_node], twist2, positions[outer2]], axis=1
        ).astype(np.int32)
        rotations = np.zeros(self.dof_count - self.turn0)
        self.mass = np.concatenate([np.repeat(self.node_mass, 3), self.edge_inertia, rotations])

    def _sort_by_duty(self) -> None:
        """List the terms that a step has to call for each purpose, so that it asks no others."""
        does = lambda name: [b for b in self.bound if _overrides(b, name)]  # noqa: E731
        self.stressing, self.adding, self.beginning = does("stress"), does("add"), does("begin_step")
        self.adding.sort(key=lambda b: b.replacing)  # after all forces that it replaces
        self.coupling, self.bounding = does("coupling"), does("largest_step")
        self.remembering = [b for b in self.bound if b.memory is not None or _overrides(b, "next_memory")]
        axial = [b.axial_stiffness for b in self.bound if b.axial_stiffness is not None]
        self.axial_stiffness = np.sum(axial, axis=0) if axial else np.zeros(self.edge_count)
        self.summed_version, self.summed_stiffness = -1, np.zeros((0, 3, 3))

    def quadratic_stiffness(self) -> np.ndarray:
        """Sum of the stiffnesses of all quadratic energies of the springs, shape (spring_count, 3, 3)."""
        # at first, and when a motor turns an elliptic section
        if self.summed_version != self.stiffness_version:
            shared = self.summed_stiffness is self.spring_stiffness
            parts = [K for b in self.bound if (K := b.spring_stiffness(self)) is not None]
            self.summed_stiffness = np.sum(parts, axis=0) if parts else np.zeros((self.spring_count, 3, 3))
            if self.summed_version < 0:
                check_stiffness(self, self.summed_stiffness)
            if np.array_equal(
                self.summed_stiffness, self.spring_stiffness
            ):  # bending and twisting, everywhere
                self.summed_stiffness = self.spring_stiffness
            elif shared:  # evaluations go on using the old array as a buffer
                self.spring_stiffness = self.spring_stiffness.copy()
            self.summed_version = self.stiffness_version
        return self.summed_stiffness

    def springs_on(self, selectors: Any) -> np.ndarray:
        """Springs whose edges are all named by the selectors; walls count with the edge they hold."""
        mask = np.ones(self.edge_count, dtype=bool)
        mask[: self.graph.edge_count] = False
        mask[self.graph.edge_indices(selectors)] = True
        return np.flatnonzero((mask[self.edge1] & mask[self.edge2])[: self.first_law])

    def nodes_with_masses(self, selectors: Any) -> np.ndarray:
        """Nodes that the selectors name, and the hidden masses of the rigid bodies all of whose nodes they name."""
        nodes = self.graph.nodes(selectors)
        whole = [bool(np.isin(body.nodes, nodes).all()) for body in self.graph.bodies]
        return np.concatenate([nodes, self.mass_nodes[np.array(whole, dtype=bool)].ravel()])

    def _eliminate(self, bodies: Bodies | None) -> None:
        owner = np.full(self.dof_count, -1)
        for k, constraint in enumerate(self.constraints):
            clash = constraint.dofs[owner[constraint.dofs] >= 0]
            if len(clash):
                other = self.constraints[owner[clash[0]]].term.name
                raise GraphError(
                    f"{self.dof_name(int(clash[0]))} is prescribed twice, by '{other}' and by '{constraint.term.name}'"
                )
            owner[constraint.dofs] = k
        if bodies is not None:
            owner[bodies.held_turns] = len(self.constraints)
        self.held = np.flatnonzero(owner >= 0)
        if bodies is not None:
            owner[bodies.carried] = len(self.constraints)
        self.free: np.ndarray = np.flatnonzero(owner < 0).astype(np.int32)
        self.reduced: np.ndarray = np.full(self.dof_count, -1, dtype=np.int32)
        self.reduced[self.free] = np.arange(len(self.free), dtype=np.int32)

    def _analyse(self) -> None:
        """Find the sparsity pattern, every term's slots in it, and the order of elimination."""
        bodies, numbers, stretch = self.bodies, self.reduced, self.stretch_dofs
        if bodies is not None:  # their edges keep their length
            stretch = np.delete(stretch, bodies.edges, axis=0)
        stencils = [stretch, self.spring_dofs, *(s for b in self.bound for s in b.stencils)]
        if bodies is None:
            figure = self.edges, numbers[: self.twist0].reshape(-1, 3), numbers[self.twist0 : self.turn0]
            pattern = build_pattern(len(self.free), [numbers[s] for s in stencils])
        else:
            pattern = build_pattern(len(self.free), bodies.number(self, stencils))
            figure, numbers = bodies.contracted(self), bodies.numbers
        blocks = elimination_blocks(*figure) or loop_blocks(pattern, *figure)
        self.solver = LinearSolver(pattern, blocks)
        assert self.solver.pattern is not None
        pattern = self.solver.pattern  # from here on in the solver's order
        self.diagonal = pattern.diagonal
        side = 0
        if bodies is not None:
            pattern, side = bodies.extend(self, pattern, stencils), bodies.side_count
        stretch = numbers[self.stretch_dofs]
        if bodies is not None:
            stretch[bodies.edges] = -1
        self.stretch_slots: np.ndarray = pattern.triple_places(stretch, [0, 3])
        # of the columns (x0, theta1, x1, theta2, x2), one number for each
        spring_dofs = numbers[self.spring_dofs]
        slots = (
            pattern.triple_places(spring_dofs, [0, 4, 8]),
            pattern.places(spring_dofs, spring_dofs[:, [3, 7]]),
        )
        self.spring_slots: np.ndarray = np.ascontiguousarray(
            np.concatenate(slots, axis=2)[:, :, [0, 3, 1, 4, 2]]
        )
        for b in self.bound:
            b.find_slots(pattern, [numbers[s] for s in b.stencils])
            b.stencils = []  # large, and of no more use
        size = pattern.size + TRASH + side
        if blocks is not None:  # a block solver's values tell their rows and columns by themselves
            self.solver.pattern = None
        del pattern, slots, spring_dofs
        release(self.dof_count)
        # scrap: no Jacobian wanted
        self.data, self.scrap = np.zeros(size), np.zeros(1)

    def couple(self, ev: Evaluation) -> None:
        """Hand the solver what an evaluation's Jacobian has beside the pattern."""
        found = [entries for b in self.coupling if (entries := b.coupling(ev)) is not None]
        self.solver.extra = None
        if found:
            rows, columns, values = (np.concatenate(part) for part in zip(*found, strict=True))
            if ev.bodies is not None:
                self.solver.extra = ev.bodies.fold_entries(rows, columns, values)
                return
            rows, columns = self.reduced[rows], self.reduced[columns]
            free = (rows >= 0) & (columns >= 0)
            for b in (b for b in self.adding if b.replacing):
                free &= ~np.isin(rows, b.rows) & ~np.isin(columns, b.rows)
            self.solver.extra = csr_matrix((values[free], (rows[free], columns[free])), (len(self.free),) * 2)

    @property
    def movable(self) -> np.ndarray:
        """Whether each degree of freedom can move: it is free, or carried by a body that is; shape (dof_count,)."""
        movable = self.reduced >= 0
        if self.bodies is not None:
            movable[self.bodies.carried] = True
        return movable

    @property
    def shortest_free(self) -> float:
        """Length of the shortest edge of which an end is free [m]; one that is held as a whole is not stretched."""
        held = self.held[self.held < self.twist0] // 3
        free = ~np.isin(self.edges, held).all(axis=1)
        return float(self.rest_length[free].min() if free.any() else self.rest_length.min())

    def largest_step(self, q: np.ndarray, dq: np.ndarray, motion: BodyMotion | None = None) -> float:
        """Share in [0, 1] of the displacement ``dq`` from ``q`` that leaves every term defined.

        With rigid bodies, of which the displacement gives their own degrees of freedom, their ``motion`` says
        where what they carry comes to.
        """
        x = q[: self.twist0].reshape(-1, 3)
        if motion is not None:
            return motion.walk(x, q, dq, self.bounding)
        dx = dq[: self.twist0].reshape(-1, 3)
        return min((b.largest_step(x, dx) for b in self.bounding), default=1.0)

    def jacobian(self) -> csr_matrix:
        """Return the Jacobian that an evaluation has left in ``data``, over the free degrees of freedom."""
        return self.solver.matrix(self.data)

    @property
    def metric(self) -> np.ndarray:
        """Mass or moment of inertia of every degree of freedom, those of rigid bodies included."""
        if self.bodies is None:
            return self.mass
        metric = self.mass.copy()
        dofs, values = self.bodies.diagonal
        metric[dofs] = values
        return metric

    def dof_name(self, dof: int) -> str:
        """Name of a degree of freedom for people, by rod."""
        return dof_name(self, dof)

    # -- prescribed motion ----------------------------------------------------------------
    def prescribe(
        self, q: np.ndarray, t: float, theta_near: np.ndarray, source: tuple[np.ndarray, np.ndarray]
    ) -> None:
        """Set the prescribed positions and twist angles of ``q`` at time ``t``.

        A twist angle is the angle from the transported reference director to the prescribed one,
        unwrapped to the turn nearest ``theta_near``: prescribing the angle itself would inject twist.
        """
        for c in self.moving:
            c.state.place(q, t)
        for c in self.moving:
            c.state.orient(q, t, theta_near, source)

    def prescribed_rates(self, q: np.ndarray, t: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations of the prescribed degrees of freedom, by central differences."""
        v, a = np.zeros(self.dof_count), np.zeros(self.dof_count)
        h = self.span(dt)
        for c in self.moving:
            c.state.move(q, t, h, v, a)
        return v, a

    @staticmethod
    def span(dt: float) -> float:
        """Time [s] to either side of now that rates of prescribed motion are taken over."""
        return max(1e-2 * dt, 1e-5)
