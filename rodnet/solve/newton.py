"""Newton's method for one time step, with line search and convergence per degree of freedom."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from rodnet.errors import ParameterError, SingularMatrixError
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.solve.steppers import Rates, State, Stepper
from rodnet.solve.watch import Stage, Watch

LEAP = 1.0  # [rad] farthest turn of a joint's frame that is guessed


class Status(enum.Enum):
    """How a step ended."""

    CONVERGED = "converged"
    STALLED = "Newton's method did not converge"
    FOLDED = "two edges fold back on each other (turning angle near 180 degrees)"
    SINGULAR = "the Jacobian is singular"
    NOT_FINITE = "a force is not a finite number"
    BLOCKED = "motion leads through a contact"
    TURNED = "a hinge turns by nearly half a turn in one time step"


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
    """Solves steps of one model; holds buffers and counters only.

    Parameters
    ----------
    model : Model
        The model.
    tolerance : Tolerance, optional
        Convergence criteria.
    predict : bool
        Begin with the stepper's extrapolation, else with the last state.

    Attributes
    ----------
    iterations, evaluations : int
        Totals over all steps.
    watch : Watch or None
        What is told of every solved stage, while the evaluation holds it, and of every accepted state.
    """

    def __init__(self, model: Model, tolerance: Tolerance | None = None, *, predict: bool = True) -> None:
        from rodnet.packed import Packed
        from rodnet.solve import newton_kernels
        from rodnet.solve.hinge_turns import HingeTurns

        self.model, self.tolerance, self.predict = model, tolerance or Tolerance(), predict
        self.ev, self._kernels = Evaluation(model), newton_kernels
        self.turns = HingeTurns(model, self.ev)
        edges = [frames.edges for frames in model.joints]
        self._frames = model.twist0 + np.concatenate(edges) if edges else None
        self.length = model.graph.size
        # a state without any force must still count as balanced
        stiff = float((model.graph.EI1.min() + model.graph.EI2.min()) / 2.0)
        if stiff == np.inf:  # rigid bodies alone
            stiff = float(model.node_mass.sum()) * self.length**3
        self._least = np.array([1e-12 * stiff / self.length**2, 1e-12 * stiff / self.length])
        self._shortest = float(model.rest_length.min())
        self.iterations = self.evaluations = 0
        self.watch: Watch | None = None
        # iterations, and the last one with new factors; they decide on what is computed beforehand, not on results
        self._expected = self._renewed = 1
        self._r, self._none = np.zeros(len(model.free)), np.zeros(0)
        self._a, self._base, numbers = self.ev.a, np.zeros(model.dof_count), model.reduced
        if model.bodies is not None and self.ev.bodies is not None:
            self._a, numbers = self.ev.bodies.a, model.bodies.numbers
        self._merit = 0.0
        self._packed = Packed(
            newton_kernels.NEWTON, model.free, self.ev.q, self.ev.rates, self._a, self._base, model.mass,
            self.ev.F, model.diagonal, self._least, self._r, model.edges, self.ev.L, numbers,
        )  # fmt: skip
        table, twist0 = self._packed.table, model.twist0
        if self.ev.bodies is None:
            kernels: tuple[Callable[..., Any], ...] = (
                partial(newton_kernels.move, table),
                partial(newton_kernels.measure, table, twist0, self.length),
                partial(newton_kernels.advance, table, twist0, self.length),
                partial(newton_kernels.residual, table, twist0, self._shortest),
            )
        else:
            kernels = self.ev.bodies.kernels(table, self.length, self._shortest)
        self._move_free, self._measure_free, self._advance_free, self._residual_free = kernels
        self.scales = 1.0, 1.0
        self._at: tuple[Any, ...] | None = None  # memories that the bound terms are at

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
        m, ev, report = self.model, self.ev, StepReport()
        m.order = stepper.order
        if state.memories is not self._at:
            for b, memory in zip(m.bound, state.memories, strict=True):
                if memory is not None:
                    b.restore(m, memory)
        self._at = None
        ev.set_source(state.tangents, state.directors, state.tau, state.q, bodies=False)
        cv, ca = stepper.coefficients(dt)
        done: Rates = []
        v, a, rates = state.v, state.a, None
        for node in stepper.nodes:
            now, elapsed = t - (1.0 - node) * dt, node * dt
            for b in m.beginning:
                b.begin_step(m, now, elapsed, sensors, inputs)
            v0, a0 = stepper.offsets(state, dt, done)
            guess = self._base
            guess[:] = stepper.predict(state, dt, done) if self.predict else state.q
            if self._frames is not None:  # after a jump, rates of what has no inertia lead astray
                old = state.q[self._frames]
                guess[self._frames] = np.minimum(np.maximum(guess[self._frames], old - LEAP), old + LEAP)
            if len(m.held):
                guess[m.held] = state.q[m.held]
            if m.moving:
                m.prescribe(guess, now, state.q[m.twist0 :], (state.tangents, state.directors))
                rates = m.prescribed_rates(guess, now, dt) if stepper.exact_rates else None
            if ev.bodies is not None:
                ev.bodies.begin(state.q, state.v, guess)
            if m.bounding and not self._approach(state.q, guess):
                report.status = Status.BLOCKED
                return None, report
            motion = _Motion(state.q, cv, ca, self._none if v0 is None else v0, a0, m.held, rates)
            self._solve(motion, now, elapsed, report, keep_history)
            if not report.ok:
                self.iterations += report.iterations
                return None, report
            if not self.turns.count(state, self._a, cv, ca):
                report.status = Status.TURNED
                self.iterations += report.iterations
                return None, report
            # iterates may go round the end of a body that the motion itself would have to pass through
            if ev.bodies is not None and m.bounding and not ev.bodies.reached(state.q, m.bounding):
                report.status = Status.BLOCKED
                self.iterations += report.iterations
                return None, report
            v, a = ev.rates.copy(), self._a.copy()
            done.append((v, a))
            if self.watch is not None:
                self.watch.stage(Stage(state, stepper, t, dt, now, elapsed, sensors, inputs, done, motion))
        self.iterations += report.iterations
        new = self._accepted(state, stepper, t, dt, v, a, rates)
        if self.watch is not None:
            self.watch.accepted(new)
        return new, report

    def _accepted(self, state, stepper, t, dt, v, a, rates) -> State:
        """Collect the new state, and let the terms keep their memories."""
        m, ev = self.model, self.ev
        acc = stepper.acceleration(state, v, ev.q, a, dt)
        if rates is not None:
            acc[m.held] = a[m.held]
        memories = tuple([b.next_memory(ev) for b in m.bound])
        for b, memory in zip(m.bound, memories, strict=True):
            if memory is not None:
                b.accept(m, memory)
        self._at = memories
        q, turns = ev.q.copy(), state.turns.copy()
        if ev.bodies is not None:
            ev.bodies.accept(q, v, a, acc)
        return State(t, state.index + 1, q, v, a, acc, *self.frames(q, turns), memories, turns)

    def frames(self, q: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tangents, directors and twists of the evaluated state; ``q`` and ``turns`` change by full turns."""
        ev = self.ev
        frames = np.empty_like(ev.T), np.empty_like(ev.T), np.empty_like(ev.tau_ref)
        self._kernels.accept(q[: self.model.turn0], ev.theta, ev.T, ev.M1, ev.M2, ev.eps, *frames, turns)
        return frames

    def _solve(self, motion, t, dt, report, keep_history) -> None:
        """Newton iterations of one stage from the base; on return the evaluation holds the final state."""
        m, ev, tol = self.model, self.ev, self.tolerance
        first, limit = report.iterations, report.iterations + tol.iterations
        self._move(self._none, 0.0, motion)
        error, before, renewed = self._residual(t, dt, motion, True, report), 0.0, 0
        while error is not None:
            if keep_history:
                report.history.append((ev.q.copy(), self._whole()))
            if error <= tol.residual:
                report.status = Status.CONVERGED
                self._expected, self._renewed = report.iterations - first, renewed
                return
            if report.iterations >= limit:
                report.status = Status.STALLED
                return
            try:
                # the same factors once more, if the last gain repeated is enough
                fresh = not 2.0 * error * error <= tol.residual * before
                if fresh:
                    if not self._has_jacobian:
                        self._residual(t, dt, motion, True, report)
                    update = m.solver.factor_and_solve(m.data, self._r)
                else:
                    update = m.solver.solve(self._r, check=False)
            except SingularMatrixError:
                report.status = Status.SINGULAR
                return
            report.iterations += 1
            done = report.iterations - first
            renewed = done if fresh else renewed
            size, scale = self._advance(update, motion)
            small = fresh and size <= tol.update
            merit, slope = self._merit, float(self._r @ update) if m.bounding else 0.0
            # a Jacobian comes with the residual where new factors are expected, and at the end for who watches
            jac = done < self._renewed or (self.watch is not None and done >= self._expected)
            before = error
            for attempt in range(12):
                if attempt:
                    scale *= 0.5
                    self._move(update, -scale, motion)
                error = self._residual(t, dt, motion, jac, report)
                if error is not None and (
                    small
                    or error <= tol.residual
                    or self._merit <= (1.0 - 1e-4 * scale) * merit
                    or (slope > 0.0 and self._r @ update >= -0.9 * slope)
                    or self._closer(size, scale)
                ):
                    break
            else:
                if not fresh:  # the old factors were no good
                    self._move(self._none, 0.0, motion)
                    error, before = self._residual(t, dt, motion, True, report), 0.0
                    continue
                if error is not None:
                    report.status = Status.STALLED
                else:  # leave the evaluation at the last good state
                    status = report.status
                    self._move(self._none, 0.0, motion)
                    self._residual(t, dt, motion, False, report)
                    report.status = status
                return
            if small and error > tol.residual:
                report.status = Status.CONVERGED
                return

    def _approach(self, q: np.ndarray, guess: np.ndarray) -> bool:
        """Shorten the way from ``q`` to the guess until all terms are defined on it; prescribed motion stays."""
        m, way = self.model, guess - q
        for _ in range(8):
            share = m.largest_step(q, way, self.ev.bodies)
            if share == 1.0:
                break
            way[m.free] *= share
        else:
            if np.any(way[m.held]):
                return False
        guess[m.free] = q[m.free] + way[m.free]
        return True

    def _advance(self, update: np.ndarray, motion: _Motion) -> tuple[float, float]:
        """Go along an update from here, which becomes its base; return its size and the factor taken on it."""
        m, ev = self.model, self.ev
        if m.bounding:
            size, scale = self._measure_free(update, True)
            moved = np.zeros(m.dof_count)
            moved[m.free] = -scale * update
            scale *= m.largest_step(self._base, moved, ev.bodies)
            self._move(update, -scale, motion)
            return size, scale
        q_old, cv, ca, v0, a0, held, prescribed = motion
        size, scale, turned = self._advance_free(update, q_old, cv, ca, v0, a0)
        self._moved(turned, held, prescribed)
        return size, scale

    def _move(self, update: np.ndarray, scale: float, motion: _Motion) -> None:
        """Put the evaluation at the base plus ``scale * update``."""
        q_old, cv, ca, v0, a0, held, prescribed = motion
        self._moved(self._move_free(update, scale, q_old, cv, ca, v0, a0), held, prescribed)

    def _moved(
        self, turned: bool, held: np.ndarray, prescribed: tuple[np.ndarray, np.ndarray] | None
    ) -> None:
        if self.ev.bodies is not None:
            self.ev.bodies.too_far = turned
        if prescribed is not None:
            self.ev.rates[held], self._a[held] = prescribed[0][held], prescribed[1][held]

    def _residual(self, t, dt, motion, jac, report) -> float | None:
        """Residual M a - F and its scaled maximum over the free degrees of freedom; None if folded."""
        ev = self.ev
        self.evaluations += 1
        self._has_jacobian, ev.ca = jac, motion.ca
        if not ev.assemble(t, dt, motion.cv, jac, reduced=False):
            report.status = Status.FOLDED
            return None
        error, worst, self._merit, force, moment = self._residual_free(
            self.model.data, motion.cv, motion.ca, ev.force_scale, ev.moment_scale, jac
        )
        self.scales = force, moment
        report.residual, report.worst = error, worst
        if not error < np.inf:
            report.status = Status.NOT_FINITE
            return None
        return error

    def _whole(self) -> np.ndarray:
        """Residual over all degrees of freedom, that of held ones included."""
        return self.model.mass * self._a - self.ev.F

    def _closer(self, size: float, scale: float) -> bool:
        """Natural monotonicity test: whether the next update with the same Jacobian would be smaller.

        Turning a stiff edge along its tangent raises the residual steeply while it brings the shape
        closer; this test does not depend on stiffness ratios (Deuflhard 2011, section 3.2).
        """
        m = self.model
        following = m.solver.solve(self._r, check=False)
        next_size, _ = self._measure_free(following, False)
        return next_size <= (1.0 - 0.25 * scale) * size


class _Motion(NamedTuple):
    """What gives rates and accelerations as functions of the new position."""

    q_old: np.ndarray
    cv: float
    ca: float
    v0: np.ndarray
    a0: np.ndarray
    held: np.ndarray
    prescribed: tuple[np.ndarray, np.ndarray] | None
