"""Rigid bodies of a model: which degrees of freedom they carry, and how a solver sees them.

Everything that tells a robot with bodies from one without is here, in `rodnet.solve.body_motion` and in their
kernels: a model, an evaluation and Newton's method call them if there are bodies, and do nothing else if not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from rodnet.errors import GraphError
from rodnet.solve.pattern import TRASH, Pattern, build_pattern

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class FoldPlan(NamedTuple):
    """How side entries of the Jacobian are added to those of the bodies, in groups.

    A group has the entries of one row in the columns that one body carries, or the entries of one column that is
    nobody's in the rows that one body carries.

    Attributes
    ----------
    start, entry : ndarray of int32, shapes (g + 1,) and (side,)
        ``entry[start[i]:start[i + 1]]`` are the places of the side entries of group i.
    member : ndarray of int32, shape (side,)
        Rows in C of the columns of these entries, or of their rows in a group of a column.
    whole : ndarray of int32, shape (g,)
        Row in C of the row of all entries of a group, -1 in groups of a row or a column that nobody carries.
    target, target_ptr : ndarray of int32, shapes (t,) and (g,)
        Places where each group's 6 or 6 x 6 values go; those of two bodies are shared.
    """

    start: np.ndarray
    entry: np.ndarray
    member: np.ndarray
    whole: np.ndarray
    target: np.ndarray
    target_ptr: np.ndarray


class Bodies:
    """The bodies of a model that are free to move, as arrays.

    Attributes
    ----------
    count : int
        Their number.
    names : list of str
        Their names.
    base, turn : ndarray of int, shape (count,)
        First degree of freedom of each base node's position and of each rotation vector.
    own : ndarray of int, shape (count, 6)
        All six of each body.
    carried : ndarray of int, shape (n,)
        Degrees of freedom that follow from the bodies', in the order of the rows of C.
    held_turns : ndarray of int
        Rotation vectors of bodies that a constraint moves, which stay zero.
    mass, centre, inertia : ndarray, shapes (count,), (count, 3), (count, 3, 3)
        With all that is carried: mass [kg], centre from the base [m], moments about the pivot [kg m^2], as drawn.
    floating : ndarray of int, shape (count,)
        Whether a body moves freely; its pivot is then its centre of mass, and otherwise the base, which is held.
    centre_dof : ndarray of int, shape (count,)
        First degree of freedom of each centre's hidden node.
    """

    count: int
    base: np.ndarray
    turn: np.ndarray
    own: np.ndarray
    carried: np.ndarray
    nodes: np.ndarray
    edges: np.ndarray
    node_ptr: np.ndarray
    edge_ptr: np.ndarray
    node_rows: np.ndarray
    edge_rows: np.ndarray
    body_of_row: np.ndarray
    first: np.ndarray
    frames0: np.ndarray
    arms0: np.ndarray
    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray
    floating: np.ndarray
    centre_dof: np.ndarray
    held_turns: np.ndarray
    own_places: np.ndarray
    owner: np.ndarray
    side: int
    units: np.ndarray
    plan: FoldPlan

    def __init__(self, model: Model) -> None:
        graph = model.graph
        rotations = model.twist0 + model.edge_count
        held_dofs: list[np.ndarray] = [c.dofs for c in model.constraints]
        held = np.zeros(model.dof_count, dtype=bool)
        held[np.concatenate([np.zeros(0, dtype=np.int64), *held_dofs])] = True
        free: list[int] = []
        bases: list[int] = []
        for k, body in enumerate(graph.bodies):
            fixed = body.nodes[held[3 * body.nodes]]
            if len(fixed) == len(body.nodes) and held[model.twist0 + body.edges].all():
                continue
            if len(fixed) > 1:
                raise GraphError(
                    f"positions of {len(fixed)} nodes of the rigid body '{body.name}' are prescribed, but not its "
                    "orientation: hold one node, or the whole body (rodnet.Clamp, orientation=)"
                )
            distance = np.linalg.norm(graph.x0[body.nodes] - body.com, axis=1)
            free.append(k)
            bases.append(int(fixed[0]) if len(fixed) else int(body.nodes[np.argmin(distance)]))
        self.bodies = [graph.bodies[k] for k in free]
        self.count, self.names = len(free), [b.name for b in self.bodies]
        self.base = 3 * np.array(bases, dtype=np.int32)
        self.turn = (rotations + 3 * np.array(free)).astype(np.int32)
        own = np.concatenate([self.base[:, None] + np.arange(3), self.turn[:, None] + np.arange(3)], axis=1)
        self.own = own.astype(np.int64)  # the six of each body
        turns = rotations + np.arange(3 * len(graph.bodies))
        self.held_turns = np.setdiff1d(turns, (self.turn[:, None] + np.arange(3)).ravel())
        self._carry(model, free, bases)
        self._weigh(model, bases, held)

    def _carry(self, model: Model, free: list[int], bases: list[int]) -> None:
        nodes, edges, rows, edge_rows, carried = [], [], [], [], []
        start = 0
        for k, base, body in zip(free, bases, self.bodies, strict=True):
            hidden = *model.mass_nodes[k], model.centre_nodes[k]
            mine = np.concatenate([body.nodes[body.nodes != base], hidden])
            dofs = np.concatenate([(3 * mine[:, None] + np.arange(3)).ravel(), model.twist0 + body.edges])
            nodes.append(mine)
            edges.append(body.edges)
            rows.append(start + 3 * np.arange(len(mine)))
            edge_rows.append(start + 3 * len(mine) + np.arange(len(body.edges)))
            carried.append(dofs)
            start += len(dofs)
        pointer = lambda parts: np.cumsum([0, *map(len, parts)]).astype(np.int32)  # noqa: E731
        join = lambda parts: np.concatenate([np.zeros(0, np.int64), *parts]).astype(np.int32)  # noqa: E731
        self.node_ptr, self.edge_ptr = pointer(nodes), pointer(edges)
        self.nodes, self.edges = join(nodes), join(edges)
        self.node_rows, self.edge_rows = join(rows), join(edge_rows)
        self.carried = join(carried)
        self.body_of_row = np.repeat(np.arange(self.count), [len(part) for part in carried])
        self.first = np.array([body.edges[0] for body in self.bodies], dtype=np.int32)
        self.frames0 = np.ascontiguousarray(model.frames0[self.first])
        at_base = np.repeat(np.array(bases, dtype=np.int64), np.diff(self.node_ptr))
        self.arms0 = model.x0[self.nodes] - model.x0[at_base]

    def _weigh(self, model: Model, bases: list[int], held: np.ndarray) -> None:
        """Sum up the point masses that the bodies carry, and take them from the model's."""
        self.mass, self.centre = np.zeros(self.count), np.zeros((self.count, 3))
        self.inertia = np.zeros((self.count, 3, 3))
        self.floating = np.array([not held[3 * base] for base in bases], dtype=np.int32)
        self.centre_dof = 3 * self.nodes[self.node_ptr[1:] - 1]
        for b, base in enumerate(bases):
            mine, last = slice(self.node_ptr[b], self.node_ptr[b + 1]), self.node_ptr[b + 1] - 1
            m, arms = model.node_mass[self.nodes[mine]], self.arms0[mine]
            self.mass[b] = m.sum() + model.node_mass[base]
            self.centre[b] = self.arms0[last] = m @ arms / self.mass[b]
            model.x0[self.nodes[last]] = model.x0[base] + self.centre[b]
            # about the centre if it is free to move, else about the base
            at = self.centre[b] if self.floating[b] else np.zeros(3)
            m, arms = np.append(m, model.node_mass[base]), np.vstack([arms, np.zeros(3)]) - at
            second = np.einsum("n,ni,nj->ij", m, arms, arms)
            self.inertia[b] = np.trace(second) * np.eye(3) - second
            model.mass[3 * base : 3 * base + 3] = 0.0
        model.mass[self.carried] = 0.0

    @property
    def diagonal(self) -> tuple[np.ndarray, np.ndarray]:
        """Degrees of freedom of the bodies, shape (6 count,), and a mass or mean moment of inertia for each."""
        moment = np.trace(self.inertia, axis1=1, axis2=2) / 3.0
        moment += self.mass * np.sum(self.centre**2, axis=1) * self.floating
        return self.own.ravel(), np.repeat(np.stack([self.mass, moment], axis=1), 3, axis=1).ravel()

    def _find_owners(self, model: Model) -> None:
        """Find the body next to each node along the edges; -1 for what is carried or held, or has no body."""
        edges, _, _ = self.contracted(model)
        self.owner = np.full(model.node_count, -1, dtype=np.int32)
        if not self.count:
            return
        links = coo_array((np.ones(len(edges)), edges.T), shape=(model.node_count,) * 2).tocsr()
        distance, _, nearest = dijkstra(
            links,
            directed=False,
            indices=self.base // 3,
            unweighted=True,
            min_only=True,
            return_predecessors=True,
        )
        free = np.all(model.reduced[: model.twist0].reshape(-1, 3) >= 0, axis=1)
        reached = np.isfinite(distance) & free
        body = {int(base) // 3: b for b, base in enumerate(self.base)}
        self.owner[reached] = [body[int(n)] for n in nearest[reached]]

    # -- the solver's view ------------------------------------------------------------------
    def contracted(self, model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Edges, position and twist unknowns of the robot with every body drawn together into its base.

        The unknowns of nodes have shape (N, 6): with the rotation of the body whose base a node is.
        """
        at = np.arange(model.node_count)
        of_node = np.repeat(np.arange(self.count), np.diff(self.node_ptr))
        at[self.nodes] = self.base[of_node] // 3
        kept = np.ones(model.edge_count, dtype=bool)
        kept[self.edges] = False
        unknowns = np.full((model.node_count, 6), -1, dtype=np.int64)
        unknowns[:, :3] = model.reduced[: model.twist0].reshape(-1, 3)
        turns = self.turn[:, None] + np.arange(3)
        unknowns[self.base // 3, 3:] = model.reduced[turns]
        twists = model.reduced[model.twist0 : model.twist0 + model.edge_count]
        return at[model.edges[kept]], unknowns, twists[kept]

    def number(self, model: Model, stencils: list[np.ndarray]) -> list[np.ndarray]:
        """Stencils in unknowns: carried degrees of freedom are replaced by those of their body."""
        self.unknowns = np.full((model.dof_count, 4), -1, dtype=np.int32)
        self.unknowns[:, 0] = model.reduced
        axis = np.full(len(self.carried), -1, dtype=np.int32)
        axis[self.node_rows[:, None] + np.arange(3)] = np.arange(3)
        self.units = (axis[:, None] == np.arange(3)).astype(float)
        body = self.body_of_row
        translated = axis >= 0
        self.unknowns[self.carried[translated], 0] = model.reduced[self.base[body] + axis][translated]
        self.unknowns[self.carried, 1:] = model.reduced[self.turn[body][:, None] + np.arange(3)]
        # numbers for places: unknowns first, then what is carried
        self.numbers = model.reduced.copy()
        self.numbers[self.carried] = len(model.free) + np.arange(len(self.carried), dtype=np.int32)
        out = [model.reduced[self.own]]
        for stencil in stencils:
            touched = np.any(self.unknowns[stencil, 1] >= 0, axis=1)
            out.append(model.reduced[stencil[~touched]])
            out.append(self.unknowns[stencil[touched]].reshape(int(touched.sum()), 4 * stencil.shape[1]))
        return out

    def extend(self, model: Model, pattern: Pattern, stencils: list[np.ndarray]) -> Pattern:
        """Pattern with places for what touches carried degrees of freedom, behind the solver's values."""
        free, size = pattern.n, pattern.size
        whole = build_pattern(free + len(self.carried), [self.numbers[s] for s in stencils])
        row = np.repeat(np.arange(whole.n), np.diff(whole.indptr))
        column = whole.indices
        carried = (row >= free) | (column >= free)
        # most hidden nodes are in no stencil: their diagonal stays zero
        used = np.zeros(whole.n + 1, dtype=bool)
        for s in stencils:
            used[self.numbers[s]] = True
        side = carried & used[row]
        storage = np.full(whole.nnz + 1, size, dtype=np.int32)
        inner = np.flatnonzero(~carried)
        storage[inner] = pattern.places(row[inner, None], column[inner, None])[:, 0, 0]
        self.side, self.side_count = size + TRASH, int(side.sum())
        storage[np.append(side, False)] = self.side + np.arange(self.side_count)
        self.plan = self._plan(model, pattern, row[side], column[side])
        self.own_places = pattern.places(model.reduced[self.own])
        self._find_owners(model)
        return Pattern(whole.n, whole.indptr, whole.indices, storage)

    def _plan(self, model: Model, pattern: Pattern, row: np.ndarray, column: np.ndarray) -> FoldPlan:
        free = pattern.n
        row_in_C, column_in_C = (np.where(k >= free, k - free, -1).astype(np.int32) for k in (row, column))
        body_of = np.append(self.body_of_row, -1)  # the last one is for -1
        rows, columns = body_of[row_in_C], body_of[column_in_C]
        # by row and the body of the column; by column and the body of the row where the column is nobody's
        single = columns < 0
        key = np.stack([np.where(single, rows, columns), np.where(single, column, row), single])
        order = np.lexsort(key).astype(np.int32)
        new = np.ones(len(row), dtype=bool)
        new[1:] = np.any(np.diff(key[:, order], axis=1) != 0, axis=0)
        start = np.flatnonzero(new)
        unknowns = model.reduced[self.own]
        target: list[np.ndarray] = []
        at: list[int] = []
        size, pairs = 0, dict[tuple[int, int], int]()
        for k in order[start].tolist():
            pair = (int(rows[k]), int(columns[k]))
            if min(pair) >= 0 and pair in pairs:
                at.append(pairs[pair])
                continue
            where = (
                unknowns[b] if b >= 0 else np.array([n[k]]) for b, n in zip(pair, (row, column), strict=True)
            )
            target.append(pattern.places(*(part[None] for part in where)).ravel())
            pairs[pair] = size
            at.append(size)
            size += target[-1].size
        return FoldPlan(
            np.append(start, len(row)).astype(np.int32),
            self.side + order,
            np.where(single, row_in_C, column_in_C)[order],
            np.where(single, -1, row_in_C)[order[start]],
            np.concatenate([np.zeros(0, np.int32), *target]).astype(np.int32),
            np.array(at, dtype=np.int32),
        )

    # -- motions ----------------------------------------------------------------------------
    def set_motion(self, model: Model, v: np.ndarray, spin: Mapping[str, np.ndarray]) -> None:
        """Set the rates of the bodies from node velocities, in place: the nearest rigid motion, or a given spin.

        Parameters
        ----------
        v : ndarray, shape (dof_count,)
            Rates of all degrees of freedom.
        spin : mapping
            Angular velocities [rad/s] by the names of bodies, about the centre of mass, which has the mean
            velocity of the nodes, or about a node whose motion is prescribed.
        """
        for b, body in enumerate(self.bodies):
            base, turn = self.own[b, :3], self.own[b, 3:]
            arms = model.x0[body.nodes] - model.x0[self.base[b] // 3]
            given, omega = v[3 * body.nodes[:, None] + np.arange(3)], spin.get(body.name)
            at, mean = np.zeros(3), v[base].copy()
            if model.reduced[base[0]] >= 0:
                at, mean = arms.mean(axis=0) if omega is None else self.centre[b], given.mean(axis=0)
            if omega is None:
                matrix = np.concatenate([-_skew(arm - at) for arm in arms])
                omega = np.linalg.lstsq(matrix, (given - mean).ravel(), rcond=1e-9)[0]
            v[base], v[turn] = mean - np.cross(omega, at), omega

    def set_accelerations(self, model: Model, ev: Evaluation, a: np.ndarray) -> None:
        """Accelerations that balance the forces of ``ev`` at an accepted state, in place.

        Parameters
        ----------
        ev : Evaluation
            Evaluated at a state that has just been accepted, whose rotation vectors are zero.
        a : ndarray, shape (dof_count,)
            Accelerations, with those that are prescribed.
        """
        motion = ev.bodies
        assert motion is not None
        motion.resist(a)  # what is there already: centrifugal, and prescribed
        for b, dofs in enumerate(self.own):
            centre, omega = motion.centre[b], ev.rates[dofs[3:]]
            moment = ev.F[dofs[3:]]
            if self.floating[b]:
                moment = moment - np.cross(centre, ev.F[dofs[:3]])
            alpha = np.linalg.lstsq(motion.about_pivot[b], moment, rcond=1e-14)[0]
            a[dofs[3:]] = alpha
            if self.floating[b]:
                swept = np.cross(alpha, centre) + np.cross(omega, np.cross(omega, centre))
                a[dofs[:3]] = ev.F[dofs[:3]] / self.mass[b] - swept
        self.sweep(model, ev, a)

    def _members(self, b: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and edges that a body carries."""
        return (
            self.nodes[self.node_ptr[b] : self.node_ptr[b + 1]],
            self.edges[self.edge_ptr[b] : self.edge_ptr[b + 1]],
        )

    def sweep(self, model: Model, ev: Evaluation, a: np.ndarray) -> None:
        """Complete accelerations of the bodies by those of what they carry, in place, at an accepted state."""
        for b, dofs in enumerate(self.own):
            nodes, edges = self._members(b)
            omega, alpha = ev.rates[dofs[3:]], a[dofs[3:]]
            arms = ev.x[nodes] - ev.x[self.base[b] // 3]
            turned = np.cross(alpha, arms) + np.cross(omega, np.cross(omega, arms))
            a[3 * nodes[:, None] + np.arange(3)] = a[dofs[:3]] + turned
            a[model.twist0 + edges] = ev.T[edges] @ alpha

    def gather(self, model: Model, ev: Evaluation, F: np.ndarray) -> None:
        """Add forces on what bodies carry to those on the bodies, in place, at an accepted state."""
        for b, dofs in enumerate(self.own):
            nodes, edges = self._members(b)
            arms, forces = ev.x[nodes] - ev.x[self.base[b] // 3], F[3 * nodes[:, None] + np.arange(3)]
            F[dofs[:3]] += forces.sum(axis=0)
            F[dofs[3:]] += np.cross(arms, forces).sum(axis=0) + F[model.twist0 + edges] @ ev.T[edges]

    def kinetic_energy(self, ev: Evaluation, v: np.ndarray) -> float:
        """Kinetic energy of all bodies at an accepted state with rates ``v`` [J]."""
        assert ev.bodies is not None
        total = 0.0
        for b, (mass, inertia) in enumerate(zip(self.mass, ev.bodies.about_pivot, strict=True)):
            omega = v[self.own[b, 3:]]
            V = v[self.centre_dof[b] : self.centre_dof[b] + 3] if self.floating[b] else np.zeros(3)
            if not self.floating[b]:  # moments are about the base, which may be moved
                V, centre = v[self.own[b, :3]], ev.bodies.centre[b]
                total += float(mass * V @ np.cross(omega, centre))
            total += float(0.5 * mass * V @ V + 0.5 * omega @ inertia @ omega)
        return total


def _skew(a: np.ndarray) -> np.ndarray:
    """Matrix of the vector product with ``a`` from the left."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
