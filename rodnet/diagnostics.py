"""What a trajectory implies: energies, powers, internal forces, reactions, by replaying its states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.kinematics.frames import cross
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.solve.steppers import State
from rodnet.terms.base import BoundTerm
from rodnet.terms.constraints import BoundConstraint

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.trajectory import Trajectory


@dataclass(frozen=True)
class Internal:
    """Internal forces and moments, on the graph's edges and at its springs.

    Edges of rigid bodies have none: what holds a rigid body together is not determined.

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

    @classmethod
    def zeros(cls, states: int, nodes: int) -> Reaction:
        """Return a table to be filled, of so many states and held nodes."""
        force, moment, point = np.zeros((3, states, 3))
        return cls(force, moment, point, np.zeros((states, nodes, 3)))

    def measure(self, k: int, held: BoundConstraint, residual: np.ndarray, ev: Evaluation) -> None:
        """Fill in state ``k``, whose equations of motion leave the residual ``M a - F``."""
        n, x = np.count_nonzero(held.eliminated), ev.x[held.nodes]
        self.nodal[k][held.eliminated] = residual[held.dofs[:n]]
        self.nodal[k][held.placed & ~held.eliminated] = held.across
        self.force[k], self.point[k] = self.nodal[k].sum(axis=0), x[0]
        self.moment[k] = cross(x - x[0], self.nodal[k]).sum(axis=0)
        self.moment[k] += residual[held.dofs[n:]] @ ev.T[held.edges]


@dataclass(frozen=True)
class Balance:
    """Energies [J] and powers [W] by term, shape (T,), and the reactions of the constraints."""

    energies: dict[str, np.ndarray]
    powers: dict[str, np.ndarray]
    reactions: dict[str, Reaction]


class Replay:
    """Evaluates recorded states again, each for what is asked."""

    def __init__(self, traj: Trajectory) -> None:
        assert traj.robot is not None
        self.traj, self.model = traj, Model(traj.robot)

    def states(self, frames: Iterable[int]) -> Iterator[tuple[int, State, Evaluation]]:
        """Yield evaluated states; the frames of each are its own source, so there is no holonomy."""
        m, ev = self.model, Evaluation(self.model)
        for k in frames:
            state = self.traj.state(k)
            for b, memory in zip(m.bound, state.memories, strict=True):
                if memory is not None:
                    b.restore(m, memory)
                    b.rewind()
            ev.set_source(state.tangents, state.directors, state.tau, state.q)
            ev.a[:] = state.a
            ev.update(state.q, state.v, state.t, self.traj.dt, 0.0, False)
            yield k, state, ev

    @cached_property
    def balance(self) -> Balance:
        """Energies, powers and reactions of all states."""
        m, count = self.model, len(self.traj)
        energy_terms = [b for b in m.bound if b.term.kind == "energy"]
        actuators = [b for b in m.bound if b.term.kind == "actuator"]
        loads = [b for b in m.bound if b.term.kind not in ("energy", "actuator", "constraint")]
        held = [b for b in m.bound if isinstance(b, BoundConstraint)]
        energies = {b.term.name: np.zeros(count) for b in energy_terms}
        powers = {b.term.name: np.zeros(count) for b in (*actuators, *loads, *held)}
        elastic, kinetic, kinetic_power = np.zeros((3, count))
        reactions = {c.term.name: Reaction.zeros(count, len(c.nodes)) for c in held}
        for k, state, ev in self.states(range(count)):
            for b in energy_terms:
                energies[b.term.name][k] = b.energy(ev)
            v = state.v.copy()
            if ev.bodies is not None:
                ev.bodies.set_rigid(v)
            elastic[k] = ev.F @ v - sum(c.across @ v[c.across_dofs] for c in held)
            for b in loads:
                power = b.forces(ev) @ v
                elastic[k] -= power
                own = type(b).power is not BoundTerm.power
                powers[b.term.name][k] = b.power(ev) if own else power
            # actuators act through the natural shape: what they put in is part of the elastic forces' power
            for b in actuators:
                power = b.power(ev)
                elastic[k] -= power
                powers[b.term.name][k] = power
            if m.bodies is not None and ev.bodies is not None:
                kinetic[k] = m.bodies.kinetic_energy(ev, v)
                before = ev.F.copy()
                ev.bodies.resist(state.a)
                kinetic_power[k] = (before - ev.F) @ v
            if held:
                residual = m.mass * state.a - ev.F
                for c in held:
                    powers[c.term.name][k] = residual[c.dofs] @ state.v[c.dofs]
                    powers[c.term.name][k] += c.across @ state.v[c.across_dofs]
                    reactions[c.term.name].measure(k, c, residual, ev)
        v, a = self.traj.rates, self.traj.accelerations
        energies["kinetic"] = kinetic + 0.5 * np.einsum("td,td,d->t", v, v, m.mass)
        kinetic_power += np.einsum("td,td,d->t", a, v, m.mass)
        powers |= {"elastic": elastic, "kinetic": kinetic_power}
        return Balance(energies, powers, reactions)

    @cached_property
    def internal(self) -> Internal:
        """Internal forces and moments of all states."""
        from rodnet.kinematics.moments import shear_forces

        m, count, e = self.model, len(self.traj), len(self.traj.edges)
        tension, shear = np.zeros((count, m.edge_count)), np.zeros((count, m.edge_count, 3))
        moment, stress = np.zeros((2, count, m.spring_count, 3))
        for k, _, ev in self.states(range(count)):
            moment[k], stress[k], tension[k] = ev.spring_moments(), ev.stress, ev.stretch_stress
            shear_forces(m.edge1, m.edge2, ev.T, ev.S, ev.L, moment[k], shear[k])
        for body in m.graph.bodies:
            shear[:, body.edges] = 0.0
        pairs = np.stack([m.edge1, m.edge2], axis=1)
        return Internal(
            tension[:, :e],
            shear[:, :e],
            moment,
            stress[..., :2],
            stress[..., 2],
            m.spring_node,
            pairs,
            m.graph,
        )

    def term_forces(self, name: str, frames: Any = slice(None)) -> np.ndarray:
        """Forces of one term on the graph's nodes at the chosen states, shape (T, N, 3) [N]."""
        names = [b.term.name for b in self.model.bound]
        if name not in names:
            raise ParameterError(f"no term is named {name!r}; there are {', '.join(names)}")
        bound = self.model.bound[names.index(name)]
        chosen = np.arange(len(self.traj))[frames]
        force = np.zeros((*chosen.shape, self.model.graph.node_count, 3))
        rows = force.reshape(chosen.size, -1)
        for row, (_, _, ev) in zip(rows, self.states(chosen.ravel().tolist()), strict=True):
            row[:] = bound.forces(ev)[: len(row)]
        return force
