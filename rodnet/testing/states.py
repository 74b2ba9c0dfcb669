"""Random states far from rest, and a robot's forces as plain functions of its state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rodnet.kinematics.frames import about_z, material_frames, rotation, transport, unit
from rodnet.robot import Robot
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.solve.steppers import State
from rodnet.testing.taylor import differences

TURN = np.radians(150.0)  # largest turning angle of a spring, and of an edge from its source frame
STRETCH = (0.3, 3.0)  # smallest and largest length of an edge against its natural length
STEP = 1e-4  # of differences, relative to an edge's length or to a typical speed


def random_shape(
    model: Model,
    rng: np.random.Generator,
    turn: float = TURN,
    stretch: tuple[float, float] = STRETCH,
    sweeps: int = 6,
) -> tuple[np.ndarray, np.ndarray]:
    """Node positions (node_count, 3) and material frames (edge_count, 3, 3) far from the initial ones.

    Nodes are moved and edges twisted at random, one by one, as far as every edge keeps its length
    within ``stretch`` times the natural one and every spring turns by less than ``turn`` from its
    natural shape. It works for any graph. Rigid bodies stay where they are.
    """
    x, frames, limit = model.x0.copy(), model.frames0.copy(), np.cos(turn)
    edges_at = [np.flatnonzero((model.edges == n).any(axis=1)) for n in range(model.node_count)]
    springs_at = [np.flatnonzero(np.isin(model.edge1, e) | np.isin(model.edge2, e)) for e in edges_at]

    def attempt(e: np.ndarray, s: np.ndarray, vectors: np.ndarray, twist: np.ndarray) -> bool:
        length = np.linalg.norm(vectors, axis=1)
        ratio = length / model.rest_length[e]
        if ratio.min() < stretch[0] or ratio.max() > stretch[1]:
            return False
        tangents = vectors / length[:, None]
        if np.any(np.sum(tangents * frames[e, :, 2], axis=1) < -0.9):
            return False
        old = frames[e].copy()
        frames[e] = material_frames(tangents, transport(old[:, :, 0], old[:, :, 2], tangents), twist)
        a = np.einsum("sij,sj->si", frames[model.edge1[s]], model.Q1[s, :, 2])
        b = np.einsum("sij,sj->si", frames[model.edge2[s]], model.Q2[s, :, 2])
        if np.all(np.sum(a * b, axis=1) > limit):
            return True
        frames[e] = old
        return False

    fixed = np.zeros(model.node_count, dtype=bool)
    for body in model.graph.bodies:
        fixed[body.nodes] = True
    for _ in range(sweeps):
        for n in rng.permutation(model.node_count):
            e = edges_at[n]
            if fixed[n] or not len(e):
                continue
            before = x[n].copy()
            x[n] += model.rest_length[e].mean() * rng.normal(size=3)
            vectors = x[model.edges[e, 1]] - x[model.edges[e, 0]]
            if not attempt(e, springs_at[n], vectors, rng.uniform(-2.0, 2.0, len(e))):
                x[n] = before
    return x, frames


class Probe:
    """A robot at a random state, away from the frames of its last accepted state.

    Attributes
    ----------
    model : Model
        The robot, bound.
    q, v : ndarray, shape (dof_count,)
        The state and its rates; read-only.
    source : tuple of ndarray
        Tangents and first directors that the reference frames are transported from, the turns
        of the springs' twists, and the degrees of freedom that rigid bodies are turned from.
    """

    def __init__(
        self,
        robot: Robot | Model,
        rng: np.random.Generator,
        *,
        turn: float = TURN,
        stretch: tuple[float, float] = STRETCH,
        source_turn: float = TURN,
        speed: float = 0.1,
        t: float = 0.3,
        dt: float = 1e-2,
        sensors: Mapping[str, Any] | None = None,
    ) -> None:
        self.model = model = robot if isinstance(robot, Model) else Model(robot)
        self.ev = Evaluation(model)
        self.t, self.dt, self.speed = t, dt, speed
        x, frames = random_shape(model, rng, turn, stretch)
        self.length = float(np.median(model.rest_length))
        spin = speed / self.length
        turns = model.dof_count - model.turn0
        parts = (speed, x.size), (spin, model.edge_count), (spin, turns)
        self.v = np.concatenate([size * rng.normal(size=count) for size, count in parts])
        # frames of a last accepted state from which every edge has turned and twisted
        tangents, axis = frames[:, :, 2], rng.normal(size=(model.edge_count, 3))
        normal = unit(axis - np.sum(axis * tangents, axis=1, keepdims=True) * tangents)
        back = rotation(rng.uniform(0.0, source_turn, (len(tangents), 1)) * normal)
        theta, phi = rng.uniform(-2.0, 2.0, model.edge_count), np.zeros(turns)
        for k, body in enumerate(model.graph.bodies):  # all edges of a body have turned alike
            phi[3 * k : 3 * k + 3] = rng.uniform(0.5, 1.0) * source_turn * unit(rng.normal(size=3))
            back[body.edges] = rotation(-phi[3 * k : 3 * k + 3])
        old = back @ frames @ about_z(-theta)
        self.q = np.concatenate([x.ravel(), theta, phi])
        if model.bodies is not None:
            self.q[np.setdiff1d(model.held, np.arange(model.turn0))] = 0.0
        self.source = old[:, :, 2].copy(), old[:, :, 0].copy(), np.zeros(model.spring_count), self.q.copy()
        for b in model.bound:
            b.begin_step(model, t, dt, sensors or model.no_sensors, {})
        ev = self.evaluate()
        self.q = ev.q.copy()
        if ev.bodies is not None:
            self.v = self.carried(self.v)
        self.source = *self.source[:2], ev.eps[:, 2].copy(), self.source[3]
        self._finish()

    @classmethod
    def between(
        cls, model: Model, before: State, after: State, *, speed: float, sensors: Mapping[str, Any]
    ) -> Probe:
        """A model at the end of a step of a simulation, ``after``, whose source is its beginning."""
        probe = cls.__new__(cls)
        probe.model, probe.ev = model, Evaluation(model)
        probe.t, probe.dt, probe.speed = after.t, after.t - before.t, speed
        probe.length = float(np.median(model.rest_length))
        probe.q, probe.v = after.q.copy(), after.v.copy()
        probe.source = before.tangents, before.directors, before.tau, before.q
        for b in model.bound:
            b.begin_step(model, probe.t, probe.dt, sensors or model.no_sensors, {})
        probe._finish()
        return probe

    def _finish(self) -> None:
        self.q.flags.writeable = self.v.flags.writeable = False
        # one unit of every degree of freedom is an edge's length, or one radian
        m = self.model
        self.units = np.concatenate([np.full(m.twist0, self.length), np.ones(m.dof_count - m.twist0)])

    def evaluate(
        self, q: np.ndarray | None = None, v: np.ndarray | None = None, cv: float = 0.0, jac: bool = False
    ) -> Evaluation:
        """Evaluate the robot at another state, or at its own; raise if the state is folded."""
        self.ev.set_source(*self.source)
        q, v = self.q if q is None else q, self.v if v is None else v
        if self.ev.bodies is not None and v is not self.v:  # rates of what bodies carry are theirs
            v = self.carried(v)
        if not self.ev.update(q, v, self.t, self.dt, cv, jac):
            raise ValueError(f"a folded state: 1 + cos(turning angle) = {self.ev.fold:.2g}")
        return self.ev

    def carried(self, v: np.ndarray) -> np.ndarray:
        """Rates ``v`` with those of what rigid bodies carry at the probe's own state."""
        assert self.ev.bodies is not None
        self.ev.set_source(*self.source)
        self.ev.q[:], v = self.q, v.copy()
        self.ev.bodies.place()
        self.ev.bodies.spread(v)
        return v

    def forces(self, q: np.ndarray | None = None, v: np.ndarray | None = None) -> np.ndarray:
        """Generalised forces, shape (dof_count,)."""
        return self.evaluate(q, v).F.copy()

    def energy(self, q: np.ndarray | None = None) -> float:
        """Stored energy [J]."""
        ev = self.evaluate(q)
        return float(sum(b.energy(ev) for b in self.model.bound))

    def jacobian(self, cv: float = 0.0) -> np.ndarray:
        """The assembled matrix -dF/dq - cv dF/dv over the free degrees of freedom, dense."""
        self.evaluate(cv=cv, jac=True)
        return self.model.jacobian().toarray()

    def jacobian_errors(self) -> dict[str, tuple[float, str]]:
        """Errors of the assembled derivatives by q and v against differences of the forces.

        Returns the largest error relative to the largest entry (in units of an edge's length, one
        radian and a typical speed), and the entry where it is, by ``"position"`` and ``"velocity"``.
        """
        m, found = self.model, {}
        free, units = m.free, self.units
        stiffness = self.jacobian()
        rate = self.speed / self.length
        damping = (self.jacobian(cv=rate) - stiffness) / rate
        for name, assembled, speed in (("position", stiffness, 1.0), ("velocity", damping, rate)):

            def function(y: np.ndarray, name: str = name) -> np.ndarray:
                full = (self.q if name == "position" else self.v).copy()
                full[free] = y
                return (self.forces(q=full) if name == "position" else self.forces(v=full))[free]

            start = (self.q if name == "position" else self.v)[free]
            wanted = -differences(function, start, STEP * speed * units[free])
            scale = units[free][:, None] * units[free][None, :] * speed
            # what is zero but for round-off of the forces is zero
            floor = 1e-9 * float(np.abs(units[free] * self.forces()[free]).max(initial=0.0))
            size = max(float(np.abs(scale * wanted).max(initial=0.0)), floor, 1e-300)
            error = np.abs(scale * (assembled - wanted)) / size
            row, column = np.unravel_index(int(np.argmax(error)), error.shape)
            where = f"force along {m.dof_name(int(free[row]))} by {m.dof_name(int(free[column]))}"
            found[name] = float(error.max(initial=0.0)), where
        return found

    def slope_errors(
        self, rng: np.random.Generator, step: float, count: int = 3
    ) -> dict[str, tuple[float, str]]:
        """Errors of the assembled derivatives along random directions, otherwise as `jacobian_errors`.

        A few evaluations in place of some hundreds, with steps [edge lengths] that may be small against the
        corners of laws with memory.
        """
        m, found, free = self.model, {}, self.model.free
        units = self.units[free]
        stiffness = self.jacobian()
        rate = self.speed / self.length
        damping = (self.jacobian(cv=rate) - stiffness) / rate
        for name, assembled, speed in (("position", stiffness, 1.0), ("velocity", damping, rate)):
            worst = 0.0, ""
            for _ in range(count):
                direction = np.zeros(m.dof_count)
                direction[free] = speed * units * rng.uniform(-1.0, 1.0, len(free))

                def along(h: np.ndarray, name: str = name, direction: np.ndarray = direction) -> np.ndarray:
                    moved = (self.q if name == "position" else self.v) + h * direction
                    return (self.forces(q=moved) if name == "position" else self.forces(v=moved))[free]

                wanted = -differences(along, np.zeros(1), np.array([step]))[:, 0]
                floor = 1e-9 * float(np.abs(units * self.forces()[free]).max(initial=0.0))
                size = max(float(np.abs(units * wanted).max(initial=0.0)), floor, 1e-300)
                error = np.abs(units * (assembled @ direction[free] - wanted)) / size
                row = int(np.argmax(error)) if len(free) else 0
                if len(free) and not error[row] <= worst[0]:
                    worst = float(error[row]), f"force along {m.dof_name(int(free[row]))}"
            found[name] = worst
        return found

    def rotated(self, R: np.ndarray, shift: np.ndarray) -> Probe:
        """The same robot in the same state, rotated and shifted as a whole."""
        import copy

        other, shifts = copy.copy(self), np.zeros(self.model.dof_count)
        shifts[: self.model.twist0] = np.tile(shift, self.model.node_count)
        other.q, other.v = self.turn_vector(self.q, R) + shifts, self.turn_vector(self.v, R)
        tangents, directors, turns, q = self.source
        other.source = tangents @ R.T, directors @ R.T, turns, self.turn_vector(q, R) + shifts
        return other

    def turn_vector(self, y: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Rotate the spatial part of a vector over the degrees of freedom."""
        k, n = self.model.twist0, self.model.turn0
        turned = ((part.reshape(-1, 3) @ R.T).ravel() for part in (y[:k], y[n:]))
        return np.concatenate([next(turned), y[k:n], next(turned)])

    def resultant(self, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Total force [N] and total moment about the origin [N m] of generalised forces.

        A rotation of the whole robot turns its frames too: with the source held, the twist angles then
        change by the tangent's component and by the transport's holonomy.
        """
        ev, k, n = self.evaluate(), self.model.twist0, self.model.turn0
        f = F[:k].reshape(-1, 3)
        moment = np.cross(ev.x, f).sum(axis=0) + F[k:n] @ (ev.T + np.cross(ev.T, ev.S))
        for T, share in zip([] if ev.bodies is None else ev.bodies.T, F[n:].reshape(-1, 3), strict=False):
            moment += np.linalg.solve(T.T, share)
        return f.sum(axis=0), moment


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation matrix, shape (3, 3), about a random axis by up to 180 degrees."""
    return rotation(rng.uniform(0.5, np.pi) * unit(rng.normal(size=3)))
