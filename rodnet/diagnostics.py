"""What a trajectory implies: energies, powers, internal forces, reactions, by replaying its states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rodnet.kinematics.strains import edge_couple
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.terms.constraints import BoundConstraint

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.trajectory import Trajectory


@dataclass(frozen=True)
class Internal:
    """Internal forces and moments, on the graph's edges and at its springs.

    Attributes
    ----------
    tension : ndarray, shape (T, E)
        Axial force of each edge, positive in tension [N].
    shear : ndarray, shape (T, E, 3)
        Force across the edge that its end exerts on its start [N], so that n = tension t + shear is
        the internal force and each node is in balance with what flows in and out.
    moment : ndarray, shape (T, S, 3)
        Moment at each bend-twist spring in space [N m]: what its second edge exerts on the first;
        the first exerts minus this on the second.
    bending, torque : ndarray, shapes (T, S, 2) and (T, S)
        Moments conjugate to the curvatures (kappa1, kappa2), and to the twist [N m].
    spring_node, spring_edges : ndarray, shapes (S,) and (S, 2)
        Where each spring is (ghost springs of walls included, at the held node).
    """

    tension: np.ndarray
    shear: np.ndarray
    moment: np.ndarray
    bending: np.ndarray
    torque: np.ndarray
    spring_node: np.ndarray
    spring_edges: np.ndarray
    graph: RodGraph

    def along(self, rod: str) -> RodForces:
        """Return forces and moments over the arc length of one rod.

        Raises
        ------
        GraphError
            If there is no such rod.
        """
        name = self.graph.rod_names(rod)[0]
        edges, nodes = self.graph.rods[name].edges, self.graph.rods[name].nodes
        ends = np.concatenate([[0.0], np.cumsum(self.graph.rest_length[edges])])
        # springs between two edges of the rod, and walls at its ends
        mine = np.isin(self.spring_edges, edges) | (self.spring_edges >= self.graph.edge_count)
        springs = np.flatnonzero(mine.all(axis=1) & np.isin(self.spring_edges, edges).any(axis=1))
        place = {int(n): k for k, n in reversed(list(enumerate(nodes)))}
        springs = springs[np.argsort([place[int(n)] for n in self.spring_node[springs]], kind="stable")]
        return RodForces(
            0.5 * (ends[:-1] + ends[1:]),
            self.tension[:, edges],
            self.shear[:, edges],
            np.array([ends[place[int(n)]] for n in self.spring_node[springs]]),
            self.moment[:, springs],
            self.bending[:, springs],
            self.torque[:, springs],
        )


@dataclass(frozen=True)
class RodForces:
    """Internal forces and moments of one rod over its arc length.

    Attributes
    ----------
    s_edge : ndarray, shape (e,)
        Arc length of the edges' middles [m].
    tension, shear : ndarray, shapes (T, e) and (T, e, 3)
        Axial force and shear force [N] of the edges.
    s_node : ndarray, shape (n,)
        Arc length of the springs [m]: inner nodes, and ends that a wall holds.
    moment, bending, torque : ndarray, shapes (T, n, 3), (T, n, 2) and (T, n)
        Moment in space, bending moments and torque at the springs [N m].
    """

    s_edge: np.ndarray
    tension: np.ndarray
    shear: np.ndarray
    s_node: np.ndarray
    moment: np.ndarray
    bending: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class Reaction:
    """What a constraint exerts on the robot.

    Attributes
    ----------
    force, moment : ndarray, shape (T, 3)
        Total force [N], and moment about ``point`` [N m].
    point : ndarray, shape (T, 3)
        The first held node [m].
    nodal : ndarray, shape (T, n, 3)
        Force on each held node [N], those of a wall's far nodes included.
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray
    nodal: np.ndarray


class Replay:
    """Evaluates every recorded state once and keeps the results."""

    def __init__(self, traj: Trajectory) -> None:
        assert traj.robot is not None
        self.traj, self.model = traj, Model(traj.robot)
        self._run()

    def _states(self):
        """Yield each evaluated state; its frames are its own source, so there is no holonomy."""
        m, ev = self.model, Evaluation(self.model)
        for k in range(len(self.traj)):
            state = self.traj.state(k)
            for b, memory in zip(m.bound, state.memories, strict=True):
                if memory is not None:
                    b.restore(m, memory)
                    b.rewind()
            ev.set_source(state.tangents, state.directors, state.tau)
            ev.update(state.q, state.v, state.t, self.traj.dt, 0.0, False)
            yield k, state, ev

    def _run(self) -> None:
        m, count, traj = self.model, len(self.traj), self.traj
        energy_terms = [b for b in m.bound if b.term.kind == "energy"]
        others = [b for b in m.bound if b.term.kind not in ("energy", "constraint")]
        zeros = lambda *shape: np.zeros((count, *shape))  # noqa: E731
        self.energies = {b.term.name: zeros() for b in energy_terms} | {"kinetic": zeros()}
        held = [b for b in m.bound if isinstance(b, BoundConstraint)]
        self.powers = {b.term.name: zeros() for b in [*others, *held]}
        self.powers |= {"elastic": zeros(), "kinetic": zeros()}
        tension, force = zeros(m.edge_count), zeros(m.edge_count, 3)
        moment, stress = zeros(m.spring_count, 3), zeros(m.spring_count, 3)
        nodal = {c.term.name: zeros(len(c.nodes), 3) for c in held}
        torque = {c.term.name: zeros(3) for c in held}
        point = {c.term.name: zeros(3) for c in held}
        for k, state, ev in self._states():
            for b in energy_terms:
                self.energies[b.term.name][k] = b.energy(ev)
            self.energies["kinetic"][k] = 0.5 * np.sum(m.mass * state.v**2)
            self.powers["kinetic"][k] = np.sum(m.mass * state.a * state.v)
            loads, actuated = np.zeros(m.dof_count), 0.0
            for b in others:
                power = b.power(ev)
                self.powers[b.term.name][k] = power
                if b.term.kind == "actuator":
                    actuated += power
                else:
                    loads += b.forces(ev)
            # actuators act through the natural shape: what they put in is part of the elastic forces' power
            self.powers["elastic"][k] = float((ev.F - loads) @ state.v) - actuated
            residual = m.mass * state.a - ev.F
            for c in held:
                name = c.term.name
                self.powers[name][k] = float(residual[c.dofs] @ state.v[c.dofs])
                n = 3 * len(c.nodes)
                nodal[name][k] = residual[c.dofs[:n]].reshape(-1, 3)
                x = ev.x[c.nodes]
                point[name][k] = x[0]
                torque[name][k] = np.cross(x - x[0], nodal[name][k]).sum(axis=0)
                torque[name][k] += residual[c.dofs[n:]] @ ev.T[c.edges]
            moments = ev.spring_moments()
            moment[k], stress[k] = moments, ev.stress
            tension[k] = ev.stretch_stress
            for edge, sign in ((m.edge2, 1.0), (m.edge1, -1.0)):
                couple = edge_couple(moments, ev.T[edge], ev.S[edge], ev.L[edge])
                np.add.at(force[k], edge, sign * couple)
        e = len(traj.edges)
        self.internal = Internal(
            tension[:, :e],
            force[:, :e],
            moment,
            stress[:, :, :2],
            stress[:, :, 2],
            m.spring_node,
            np.stack([m.edge1, m.edge2], axis=1),
            m.graph,
        )
        self.reactions = {
            c.term.name: Reaction(
                nodal[c.term.name].sum(axis=1), torque[c.term.name], point[c.term.name], nodal[c.term.name]
            )
            for c in held
        }

    def term_forces(self, name: str) -> np.ndarray:
        """Forces of one term on the graph's nodes, shape (T, N, 3) [N]."""
        names = [b.term.name for b in self.model.bound]
        if name not in names:
            raise KeyError(f"no term is named {name!r}; there are {', '.join(names)}")
        bound = self.model.bound[names.index(name)]
        n = self.model.graph.node_count
        return np.stack([bound.forces(ev)[: 3 * n].reshape(-1, 3) for _, _, ev in self._states()])
