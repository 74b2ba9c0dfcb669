"""Newton's method for one time step, with line search and convergence per degree of freedom."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rodnet.errors import ParameterError, SingularMatrixError
from rodnet.solve.model import Evaluation, Model
from rodnet.solve.steppers import Rates, State, Stepper


class Status(enum.Enum):
    """How a step ended."""

    CONVERGED = "converged"
    STALLED = "Newton's method did not converge"
    FOLDED = "two edges fold back on each other (turning angle near 180 degrees)"
    SINGULAR = "the Jacobian is singular"
    NOT_FINITE = "a force is not a finite number"


@dataclass(frozen=True)
class Tolerance:
    """Convergence criteria of Newton's method.

    Attributes
    ----------
    residual : float
        Largest residual against the largest force (positions) or moment (twists) of the state [1].
    update : float
        Largest update against the robot's size (positions) or one radian (twists) [1]; an update
        below it counts as converged where round-off keeps the residual up.
    iterations : int
        Largest number of iterations.
    """

    residual: float = 1e-8
    update: float = 1e-10
    iterations: int = 30

    def __post_init__(self) -> None:
        for name in ("residual", "update", "iterations"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(f"Tolerance: {name} = {value!r} must be a positive, finite number")


@dataclass
class StepReport:
    """What Newton's method did in one step.

    Attributes
    ----------
    status : Status
        How it ended.
    iterations : int
        Linear solves.
    residual : float
        Scaled residual at the end.
    worst : int
        Degree of freedom with the largest scaled residual.
    history : list of (ndarray, ndarray)
        Iterates and residuals, if they were asked for.
    """

    status: Status = Status.STALLED
    iterations: int = 0
    residual: float = np.inf
    worst: int = -1
    history: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether the step converged."""
        return self.status is Status.CONVERGED


class Newton:
    """Solves steps of one model; holds scratch and counters only.

    Attributes
    ----------
    iterations, evaluations : int
        Totals over all steps.
    """

    def __init__(self, model: Model, tolerance: Tolerance | None = None) -> None:
        self.model, self.tolerance = model, tolerance or Tolerance()
        self.ev = Evaluation(model)
        self.length = model.graph.size
        # a state without any force must still count as balanced
        stiff = float((model.graph.EI1.min() + model.graph.EI2.min()) / 2.0)
        self.floor = 1e-12 * stiff / self.length**2, 1e-12 * stiff / self.length
        self.iterations = self.evaluations = 0
        self._split = int(np.searchsorted(model.free, model.twist0))
        self._diagonal = model.diagonal[model.free]

    def step(
        self,
        state: State,
        stepper: Stepper,
        t: float,
        dt: float,
        sensors: Mapping[str, Any],
        inputs: dict[str, Any],
        keep_history: bool = False,
    ) -> tuple[State | None, StepReport]:
        """Advance ``state`` by ``dt`` to time ``t``; return None and the reason if that fails."""
        m, report = self.model, StepReport()
        for b, memory in zip(m.bound, state.memories, strict=True):
            if memory is not None:
                b.restore(m, memory)
        self.ev.set_source(state.tangents, state.directors, state.tau)
        cv, ca = stepper.coefficients(dt)
        done: Rates = []
        q, v, a, rates = state.q, state.v, state.a, None
        for node in stepper.nodes:
            now, elapsed = t - (1.0 - node) * dt, node * dt
            for b in m.bound:
                b.begin_step(m, now, elapsed, sensors, inputs)
            v0, a0 = stepper.offsets(state, dt, done)
            q = state.q.copy()
            q[m.free] = stepper.predict(state, dt, done)[m.free]
            if len(m.held):
                m.prescribe(q, now, state.q[m.twist0 :], (state.tangents, state.directors))
                rates = m.prescribed_rates(q, now, dt) if stepper.exact_rates else None
            motion = _Motion(state.q, cv, ca, v0, a0, m.held, rates)
            q, v, a = self._solve(q, motion, now, elapsed, report, keep_history)
            if not report.ok:
                self.iterations += report.iterations
                return None, report
            done.append((v, a))
        self.iterations += report.iterations
        acc = stepper.acceleration(state, q, a, dt)
        if rates is not None:
            acc[m.held] = a[m.held]
        memories = tuple(b.next_memory(self.ev) for b in m.bound)
        directors, tau = self._directors(), self.ev.eps[:, 2].copy()
        theta = q[m.twist0 :]
        turned = np.round(theta / (2.0 * np.pi)).astype(np.int64)
        theta -= 2.0 * np.pi * turned
        tangents = self.ev.T.copy()
        return State(
            t, state.index, q, v, a, acc, tangents, directors, tau, memories, state.turns + turned
        ), report

    def _directors(self) -> np.ndarray:
        """Transported reference directors, recovered from the material ones."""
        ev = self.ev
        c, s = np.cos(ev.theta)[:, None], np.sin(ev.theta)[:, None]
        return c * ev.M1 - s * ev.M2

    def _solve(self, q, motion, t, dt, report, keep_history):
        """Newton iterations of one stage; on return the evaluation holds the final state."""
        m, tol = self.model, self.tolerance
        free, limit = m.free, report.iterations + self.tolerance.iterations
        v, a = motion.rates(q)
        r, error = self._residual(q, v, a, t, dt, motion, True, report)
        if r is None:
            return q, v, a
        while True:
            if keep_history:
                report.history.append((q.copy(), r))
            if error <= tol.residual:
                report.status = Status.CONVERGED
                return q, v, a
            if report.iterations >= limit:
                report.status = Status.STALLED
                return q, v, a
            if self._has_jacobian is False:
                r, error = self._residual(q, v, a, t, dt, motion, True, report)
            try:
                m.solver.factor(m.data)
                update = -m.solver.solve(r[free])
            except SingularMatrixError:
                report.status = Status.SINGULAR
                return q, v, a
            report.iterations += 1
            small = self._size(update) <= tol.update
            scale = self._cap(update)
            merit = self._merit(r)
            # close to the solution the next residual decides, and no further Jacobian is needed
            jac = error > 1e-4
            for _ in range(12):
                trial = q.copy()
                trial[free] += scale * update
                vt, at = motion.rates(trial)
                rt, error_t = self._residual(trial, vt, at, t, dt, motion, jac, report)
                if rt is not None and (
                    small
                    or error_t <= tol.residual
                    or self._merit(rt) <= (1.0 - 1e-4 * scale) * merit
                    or self._closer(rt, update, scale)
                ):
                    break
                scale *= 0.5
            else:
                if rt is not None:
                    report.status = Status.STALLED
                if rt is None:
                    self._residual(q, v, a, t, dt, motion, False, report)
                return q, v, a
            q, v, a, r, error = trial, vt, at, rt, error_t
            if small and error > tol.residual:
                report.status = Status.CONVERGED
                return q, v, a

    def _residual(self, q, v, a, t, dt, motion, jac, report):
        """Residual M a - F and its scaled maximum over the free degrees of freedom; None if folded."""
        m, ev = self.model, self.ev
        self.evaluations += 1
        self._has_jacobian = jac
        if not ev.update(q, v, t, dt, motion.cv, jac):
            report.status = Status.FOLDED
            return None, np.inf
        inertia = m.mass * a
        r = inertia - ev.F
        if jac:
            m.data[self._diagonal] += motion.ca * m.mass[m.free]
        k = self._split
        rf = np.abs(r[m.free])
        force = max(ev.force_scale, float(np.abs(inertia[: m.twist0]).max()), self.floor[0])
        moment = max(ev.moment_scale, force * float(m.rest_length.min()), self.floor[1])
        self._scales = force, moment
        top = float(rf[:k].max(initial=0.0)) / force
        spin = float(rf[k:].max(initial=0.0)) / moment
        report.residual = max(top, spin)
        if not np.isfinite(report.residual):
            report.status = Status.NOT_FINITE
            report.worst = int(m.free[np.argmin(np.isfinite(rf))])
            return None, np.inf
        if len(rf):
            report.worst = int(m.free[np.argmax(rf[:k]) if k and top >= spin else k + np.argmax(rf[k:])])
        return r, report.residual

    def _merit(self, r: np.ndarray) -> float:
        rf = r[self.model.free]
        k = self._split
        force, moment = self._scales
        return float(np.hypot(np.linalg.norm(rf[:k]) / force, np.linalg.norm(rf[k:]) / moment))

    def _closer(self, r: np.ndarray, update: np.ndarray, scale: float) -> bool:
        """Natural monotonicity test: whether the next update with the same Jacobian would be smaller.

        Turning a stiff edge along its tangent raises the residual steeply while it brings the shape
        closer; this test does not depend on stiffness ratios (Deuflhard 2011, section 3.2).
        """
        following = self.model.solver.solve(r[self.model.free])
        return self._size(following) <= (1.0 - 0.25 * scale) * self._size(update)

    def _size(self, update: np.ndarray) -> float:
        k = self._split
        return max(
            float(np.abs(update[:k]).max(initial=0.0)) / self.length,
            float(np.abs(update[k:]).max(initial=0.0)),
        )

    def _cap(self, update: np.ndarray) -> float:
        """Largest factor on an update for which no edge turns or stretches by more than half."""
        m = self.model
        full = np.zeros(m.dof_count)
        full[m.free] = update
        x = full[: m.twist0].reshape(-1, 3)
        change = np.linalg.norm(x[m.edges[:, 1]] - x[m.edges[:, 0]], axis=1) / self.ev.L
        twist = np.abs(full[m.twist0 :])
        return 1.0 / max(1.0, 2.0 * float(change.max(initial=0.0)), float(twist.max(initial=0.0)) / 3.0)


@dataclass(frozen=True)
class _Motion:
    """Rates and accelerations as functions of the new position."""

    q_old: np.ndarray
    cv: float
    ca: float
    v0: np.ndarray
    a0: np.ndarray
    held: np.ndarray
    prescribed: tuple[np.ndarray, np.ndarray] | None

    def rates(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dq = q - self.q_old
        v, a = self.cv * dq + self.v0, self.ca * dq + self.a0
        if self.prescribed is not None:
            v[self.held], a[self.held] = self.prescribed[0][self.held], self.prescribed[1][self.held]
        return v, a
