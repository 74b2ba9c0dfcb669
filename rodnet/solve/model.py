"""A robot made ready for computing: numbered degrees of freedom, bound terms, pattern, buffers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.joints import Springs, make_springs
from rodnet.kinematics.frames import cross, material_frames, transport, unit
from rodnet.solve.linear import LinearSolver
from rodnet.solve.pattern import build_pattern, elimination_blocks
from rodnet.terms.constraints import BoundConstraint, Constraint

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.terms.base import BoundTerm


class Unmeasured(dict[str, Any]):
    """Sensor readings before the first step: every sensor reads zero."""

    def __missing__(self, key: str) -> float:
        return 0.0


class Ghost(NamedTuple):
    """A ghost edge, the part of a wall that continues one edge: its far node, its edge, the held node."""

    node: int
    edge: int
    root: int


class Model:
    """A `Robot` bound for computing.

    Walls add ghost nodes and edges after those of the graph. Positions come first in the vector of
    degrees of freedom, then twist angles: ``q = [x_0, ..., theta_0, ...]`` (paper, kinematics).

    Attributes
    ----------
    dof_count : int
        Number of degrees of freedom, ghosts included.
    free, held : ndarray
        Degrees of freedom that are unknown and that constraints prescribe.
    mass : ndarray, shape (dof_count,)
        Lumped masses [kg] and rotary inertias [kg m^2].
    bound : list of BoundTerm
        The robot's terms, in its order.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.graph = robot, robot.graph
        self.no_sensors = Unmeasured()
        self.no_slots = np.zeros((1, 1, 1), dtype=np.int32)
        self._extend_by_ghosts()
        self._number()
        self.stiffness_version = 0  # counts changes of spring_stiffness
        self.bound: list[BoundTerm] = [term.bind(self) for term in robot.terms]
        self.constraints = [b for b in self.bound if isinstance(b, BoundConstraint)]
        self._eliminate()
        self._analyse()

    # -- set-up ---------------------------------------------------------------------------
    def _extend_by_ghosts(self) -> None:
        graph = self.graph
        t0 = unit(graph.x0[graph.edges[:, 1]] - graph.x0[graph.edges[:, 0]])
        frames = material_frames(t0, graph.d1, np.zeros(graph.edge_count))
        compliance = 0.5 * graph.rest_length[:, None] / np.stack([graph.EI2, graph.EI1, graph.GJ], axis=1)
        walls = [n for term in self.robot.terms if isinstance(term, Constraint) for n in term.walls(graph)]
        if len(set(walls)) != len(walls):
            twice = next(n for n in walls if walls.count(n) > 1)
            raise GraphError(f"node '{graph.node_name(twice)}' is clamped twice; keep one of the constraints")
        self.ghosts: list[Ghost] = []
        x, edges, frame, pairs = [graph.x0], [graph.edges], [frames], []
        for n in walls:
            for e in np.flatnonzero((graph.edges == n).any(axis=1)):
                ghost = Ghost(graph.node_count + len(self.ghosts), graph.edge_count + len(self.ghosts), n)
                self.ghosts.append(ghost)
                outward = 1.0 if graph.edges[e, 0] == n else -1.0
                x.append((graph.x0[n] - outward * graph.rest_length[e] * t0[e])[None])
                edges.append(np.array([[ghost.node, n]]))
                frame.append((frames[e] @ np.diag([1.0, outward, outward]))[None])
                pairs.append((ghost.edge, int(e), n, 1.0))
        self.x0, self.edges, self.frames0 = np.vstack(x), np.vstack(edges), np.concatenate(frame)
        ghosts = len(self.ghosts)
        pad = lambda a, value=0.0: np.concatenate([a, np.full(ghosts, value)])  # noqa: E731
        lengths = np.linalg.norm(self.x0[self.edges[:, 1]] - self.x0[self.edges[:, 0]], axis=1)
        self.rest_length = np.concatenate([graph.rest_length, lengths[graph.edge_count :]])
        self.node_mass, self.edge_inertia = pad(graph.node_mass), pad(graph.edge_inertia)
        self.t0, self.d10 = (
            np.ascontiguousarray(self.frames0[:, :, 2]),
            np.ascontiguousarray(self.frames0[:, :, 0]),
        )
        # a wall takes the place of the joint at its node: each edge joins it by its own half edge
        kept = ~np.isin(graph.springs.node, walls)
        springs = graph.springs.take(np.flatnonzero(kept))
        if pairs:
            rigid = np.vstack([compliance, np.zeros((ghosts, 3))])
            half = np.concatenate([graph.half_natural, np.tile(np.eye(3), (ghosts, 1, 1))])
            lengths = np.concatenate([graph.rest_length, np.zeros(ghosts)])  # a wall has no length of its own
            walled = make_springs(pairs, self.edges, lengths, self.frames0, rigid, half, {}, {})
            springs = Springs.concatenate([springs, walled])
        self._take_springs(springs)

    def _take_springs(self, springs: Springs) -> None:
        as_int = lambda a: np.ascontiguousarray(a, dtype=np.int64)  # noqa: E731
        self.edge1, self.edge2, self.spring_node = (
            as_int(a) for a in (springs.edge1, springs.edge2, springs.node)
        )
        self.sign1, self.sign2 = springs.sign1.copy(), springs.sign2.copy()
        self.flip1, self.flip2 = springs.flip1.copy(), springs.flip2.copy()
        self.Q1, self.Q2 = springs.Q1.copy(), springs.Q2.copy()
        self.compliance1, self.compliance2 = springs.compliance1, springs.compliance2
        self.spring_weight, self.spring_length = springs.weight, springs.length
        self.spring_stiffness = springs.stiffness.copy()
        self.eps0 = np.zeros((len(springs), 3))

    def _number(self) -> None:
        axes = np.arange(3)
        self.node_count, self.edge_count, self.spring_count = len(self.x0), len(self.edges), len(self.edge1)
        self.twist0 = 3 * self.node_count
        self.dof_count = self.twist0 + self.edge_count
        positions = 3 * np.arange(self.node_count)[:, None] + axes
        self.stretch_dofs = np.concatenate([positions[self.edges[:, 0]], positions[self.edges[:, 1]]], axis=1)
        outer1 = np.where(self.sign1 > 0, self.edges[self.edge1, 0], self.edges[self.edge1, 1])
        outer2 = np.where(self.sign2 > 0, self.edges[self.edge2, 1], self.edges[self.edge2, 0])
        twist1, twist2 = (self.twist0 + e[:, None] for e in (self.edge1, self.edge2))
        self.spring_dofs = np.concatenate(
            [positions[outer1], twist1, positions[self.spring_node], twist2, positions[outer2]], axis=1
        )
        self.mass = np.concatenate([np.repeat(self.node_mass, 3), self.edge_inertia])

    def springs_on(self, selectors: Any) -> np.ndarray:
        """Springs whose edges are all named by the selectors; walls count with the edge they hold."""
        mask = np.ones(self.edge_count, dtype=bool)
        mask[: self.graph.edge_count] = False
        mask[self.graph.edge_indices(selectors)] = True
        return np.flatnonzero(mask[self.edge1] & mask[self.edge2])

    def _eliminate(self) -> None:
        owner = np.full(self.dof_count, -1)
        for k, constraint in enumerate(self.constraints):
            clash = constraint.dofs[owner[constraint.dofs] >= 0]
            if len(clash):
                other = self.constraints[owner[clash[0]]].term.name
                raise GraphError(
                    f"{self.dof_name(int(clash[0]))} is prescribed twice, by '{other}' and by '{constraint.term.name}'"
                )
            owner[constraint.dofs] = k
        self.free, self.held = np.flatnonzero(owner < 0), np.flatnonzero(owner >= 0)
        self.reduced = np.full(self.dof_count, -1)
        self.reduced[self.free] = np.arange(len(self.free))

    def _analyse(self) -> None:
        """Find the sparsity pattern, every term's slots in it, and the order of elimination."""
        stencils = [self.stretch_dofs, self.spring_dofs, *(s for b in self.bound for s in b.stencils)]
        pattern = build_pattern(len(self.free), [self.reduced[s] for s in stencils])
        self.pattern = pattern
        slots = iter(pattern.slots)
        self.stretch_slots, self.spring_slots = next(slots), next(slots)
        for b in self.bound:
            b.slots = [next(slots) for _ in b.stencils]
        self.diagonal = np.full(self.dof_count, pattern.nnz, dtype=np.int64)
        self.diagonal[self.free] = pattern.diagonal
        self.data, self.scrap = np.zeros(pattern.nnz + 1), np.zeros(pattern.nnz + 1)
        blocks = elimination_blocks(
            self.edges, self.reduced[: self.twist0].reshape(-1, 3), self.reduced[self.twist0 :]
        )
        self.solver = LinearSolver(pattern, blocks)

    def dof_name(self, dof: int) -> str:
        """Name of a degree of freedom for people, by rod."""
        graph = self.graph
        if dof < self.twist0:
            node = dof // 3
            if node < graph.node_count:
                return f"{'xyz'[dof % 3]} of {graph.node_name(node)}"
            root = next(g.root for g in self.ghosts if g.node == node)
            return f"the wall at {graph.node_name(root)}"
        edge = dof - self.twist0
        if edge < graph.edge_count:
            return f"the twist of {graph.edge_name(edge)}"
        return f"the wall at {graph.node_name(next(g.root for g in self.ghosts if g.edge == edge))}"

    # -- prescribed motion ----------------------------------------------------------------
    def prescribe(
        self, q: np.ndarray, t: float, theta_near: np.ndarray, source: tuple[np.ndarray, np.ndarray]
    ) -> None:
        """Set the prescribed positions and twist angles of ``q`` at time ``t``.

        A twist angle is the angle from the transported reference director to the prescribed one,
        unwrapped to the turn nearest ``theta_near``: prescribing the angle itself would inject twist.
        """
        x, theta = q[: self.twist0].reshape(-1, 3), q[self.twist0 :]
        for c in self.constraints:
            x[c.nodes] = c.positions(t)
        for c in self.constraints:
            if not len(c.edges):
                continue
            e = c.edges
            tangent = unit(x[self.edges[e, 1]] - x[self.edges[e, 0]])
            d1 = transport(source[1][e], source[0][e], tangent)
            m1 = c.directors(t)
            angle = np.arctan2(np.sum(m1 * cross(tangent, d1), axis=1), np.sum(m1 * d1, axis=1))
            turns = np.round((theta_near[e] - angle) / (2.0 * np.pi))
            theta[e] = angle + 2.0 * np.pi * turns

    def prescribed_rates(self, q: np.ndarray, t: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations of the prescribed degrees of freedom, by central differences."""
        v, a = np.zeros(self.dof_count), np.zeros(self.dof_count)
        h = max(1e-2 * dt, 1e-5)
        x = q[: self.twist0].reshape(-1, 3)
        for c in self.constraints:
            before, now, after = (c.positions(t + s * h) for s in (-1.0, 0.0, 1.0))
            dofs = c.dofs[: 3 * len(c.nodes)]
            v[dofs] = ((after - before) / (2.0 * h)).ravel()
            a[dofs] = ((after - 2.0 * now + before) / h**2).ravel()
            if len(c.edges):
                tangent = unit(x[self.edges[c.edges, 1]] - x[self.edges[c.edges, 0]])
                v[self.twist0 + c.edges] = c.spins(t, h, tangent)
        return v, a


class Evaluation:
    """Everything that is known at one state: geometry, strains, stresses, forces, Jacobian.

    Attributes
    ----------
    x, v : ndarray, shape (node_count, 3)
        Positions [m] and velocities [m/s].
    theta, w : ndarray, shape (edge_count,)
        Twist angles [rad] and their rates [rad/s].
    L, T, M1, M2 : ndarray
        Lengths [m], tangents and material directors of the edges.
    eps : ndarray, shape (spring_count, 3)
        Strains (kappa1, kappa2, tau) of the springs [rad], relative to the natural shape.
    stretch : ndarray, shape (edge_count,)
        Axial strain of the edges.
    stress, modulus : ndarray
        Derivatives of the energy by the springs' strains [N m]; likewise ``stretch_stress`` [N].
    F : ndarray, shape (dof_count,)
        Sum of all forces, -dE/dq included.
    cv : float
        Derivative of the velocity by the position that the stepper imposes [1/s].
    """

    def __init__(self, model: Model) -> None:
        n, e, s = model.node_count, model.edge_count, model.spring_count
        self.model = model
        self.t = self.dt = self.cv = 0.0
        self.x, self.v = np.zeros((n, 3)), np.zeros((n, 3))
        self.theta, self.w = np.zeros(e), np.zeros(e)
        self.ts, self.d1s = model.t0.copy(), model.d10.copy()
        self.tau_ref = np.zeros(s)
        self.L = np.zeros(e)
        self.T, self.M1, self.M2, self.S = (np.zeros((e, 3)) for _ in range(4))
        self.stretch, self.stretch_stress, self.stretch_modulus = (np.zeros(e) for _ in range(3))
        self.eps, self.stress = np.zeros((s, 3)), np.zeros((s, 3))
        self.modulus = np.zeros((s, 3, 3))
        self.F = np.zeros(model.dof_count)
        self.rates = np.zeros(model.dof_count)
        self.fold = 2.0  # smallest 1 + cos(turning angle)
        self.force_scale = self.moment_scale = 0.0

    def set_source(self, tangents: np.ndarray, directors: np.ndarray, tau: np.ndarray) -> None:
        """Take the frames and twists of the last accepted state."""
        self.ts, self.d1s, self.tau_ref = tangents, directors, tau

    def update(self, q: np.ndarray, v: np.ndarray, t: float, dt: float, cv: float, jac: bool) -> bool:
        """Evaluate everything at ``q`` with rates ``v``; with ``jac`` also fill ``model.data``.

        Returns False for a folded state, where forces are not defined.
        """
        from rodnet.kinematics import kernels

        m = self.model
        self.t, self.dt, self.cv, self.rates = t, dt, cv, v
        self.x, self.theta = q[: m.twist0].reshape(-1, 3), q[m.twist0 :]
        self.v, self.w = v[: m.twist0].reshape(-1, 3), v[m.twist0 :]
        shortest, turned = kernels.edge_frames(
            self.x, self.theta, m.edges, self.ts, self.d1s, self.L, self.T, self.M1, self.M2, self.S
        )
        self.fold = kernels.spring_strains(
            m.edge1, m.edge2, m.Q1, m.Q2, self.T, self.M1, self.M2, self.tau_ref, self.eps
        )
        if not (shortest > 0.0 and min(turned, self.fold) > kernels.FOLD):
            self.fold = min(self.fold, turned)
            return False
        np.divide(self.L, m.rest_length, out=self.stretch)
        self.stretch -= 1.0
        for array in (self.stretch_stress, self.stretch_modulus, self.stress, self.modulus, self.F):
            array[...] = 0.0
        data = m.data if jac else m.scrap
        if jac:
            data[:] = 0.0
        for b in m.bound:
            b.stress(self)
        F = self.F
        tension = kernels.stretch_forces(
            m.edges, m.rest_length, self.L, self.T, self.stretch_stress, self.stretch_modulus,
            m.stretch_dofs, F, m.stretch_slots, data, jac,
        )  # fmt: skip
        force, moment = kernels.spring_forces(
            m.edge1, m.edge2, m.Q1, m.Q2, m.sign1, m.sign2, m.spring_dofs, self.L, self.T, self.M1, self.M2,
            self.S, self.ts, self.eps, self.stress, self.modulus, F, m.spring_slots, data, jac,
        )  # fmt: skip
        largest = max(tension, force)
        for b in m.bound:
            largest = max(largest, b.add(self, F, data, jac))
        self.force_scale, self.moment_scale = largest, moment
        return True

    def spring_moments(self) -> np.ndarray:
        """Moment vector of each spring, dE = moment . (rotation of edge 2 - of edge 1), shape (S, 3) [N m]."""
        from rodnet.kinematics.strains import strain_gradients

        m = self.model
        frames = np.stack([self.M1, self.M2, self.T], axis=-1)
        G = strain_gradients(frames[m.edge1] @ m.Q1, frames[m.edge2] @ m.Q2)
        return np.einsum("sk,ski->si", self.stress, G)
