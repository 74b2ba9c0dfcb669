"""Running a robot: whole runs, single steps, iteration, events, restart."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from rodnet.errors import NotCopyableError, ParameterError
from rodnet.events import Event, Watch
from rodnet.interrupts import deferred_interrupt
from rodnet.observer import Observer
from rodnet.parameters import is_number
from rodnet.plausible import warn_of_folding_tendons, warn_of_idle_motors, warn_of_units
from rodnet.recorder import Recorder
from rodnet.robot import Robot, check_robot
from rodnet.solve.adaptive import Adaptive
from rodnet.solve.model import Model
from rodnet.solve.newton import Newton, Status, StepReport, Tolerance
from rodnet.solve.steppers import State, Stepper, make_stepper
from rodnet.start import initial_state
from rodnet.steps import MAX_HALVINGS, StepResult, failed_step
from rodnet.terms.actuators import Actuator
from rodnet.trajectory import Trajectory

WHOLE = 1e-6  # how near to a whole number of steps a duration counts as one [1]


class Simulation:
    """A robot in motion.

    Parameters
    ----------
    robot : Robot
        What moves.
    dt : float
        Time step [s].
    stepper : {"euler", "sdirk2", "alpha"} or Stepper
        Implicit Euler (robust, first order); for what swings, a second-order stepper: SDIRK2
        (damps what dt does not resolve) or generalised-alpha.
    velocity : array_like, shape (N, 3), optional
        Initial node velocities [m/s]; at rest by default. Of those of a rigid body the nearest rigid motion.
    spin : mapping, optional
        Initial angular velocities (3,) of rigid bodies [rad/s] by name, instead of what ``velocity`` says.
    tolerance : Tolerance, optional
        Convergence criteria of Newton's method.
    adaptive : Adaptive or float, optional
        Step size control, or its tolerance [1]; ``dt`` is then the first step that is tried.
    predict : bool
        Begin Newton's method with the stepper's extrapolation, else with the last state.

    Raises
    ------
    ParameterError
        If dt is not positive, or the velocity has the wrong shape.
    """

    def __init__(
        self,
        robot: Robot,
        dt: float = 1e-2,
        *,
        stepper: str | Stepper = "euler",
        velocity: Any = None,
        spin: Mapping[str, Any] | None = None,
        tolerance: Tolerance | None = None,
        adaptive: Adaptive | float | None = None,
        predict: bool = True,
    ) -> None:
        check_robot(robot, "Simulation")
        if not (is_number(dt) and dt > 0):
            raise ParameterError(f"dt = {dt!r} must be a positive time step [s]")
        warn_of_units(robot.graph)
        self.robot, self.dt, self.stepper = robot, float(dt), make_stepper(stepper)
        self.model = Model(robot)
        self.newton = Newton(self.model, tolerance, predict=predict)
        self.adaptive = Adaptive.of(adaptive)
        self.inputs: dict[str, Any] = {}
        self._end = np.inf  # for a step that chooses its size
        self._commands = {
            f"{t.name}.{p}": t.declared()[p]
            for t in robot.terms
            if isinstance(t, Actuator)
            for p in t.declared()
        }
        self.report = StepReport()
        self.state = initial_state(self.newton, self.stepper, self.dt, velocity, spin or {})
        warn_of_idle_motors(self.model, self.state.q)
        warn_of_folding_tendons(self.model)
        self._view = Observer(self.model, self.state, robot.sensors)

    def __repr__(self) -> str:
        steps = "" if self.adaptive is None else f", adaptive={self.adaptive.tolerance:g}"
        return (
            f"Simulation of {self.robot!r}: dt = {self.dt:g} s, {self.stepper.name}{steps}, at t = {self.t:g} s "
            f"after {self.state.index} steps"
        )

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise NotCopyableError(
            "a Simulation can be neither copied nor pickled: it holds a solver's working memory. Copy what matters, "
            "its state: twin = rodnet.Simulation(sim.robot, sim.dt, stepper=sim.stepper); twin.restore(sim.state), and "
            "the commands that were given to step(): twin.inputs.update(sim.inputs). "
            "Robots and states can be pickled, trajectories saved"
        )

    # -- states ---------------------------------------------------------------------------
    @property
    def t(self) -> float:
        """Time of the current state [s]."""
        return self.state.t

    @property
    def next_dt(self) -> float:
        """Length of the step that will be tried next [s]; dt, unless step size control has chosen another."""
        pace = self.state.pace
        return self.dt if self.adaptive is None or pace is None else pace.step

    def observe(self) -> Observer:
        """View of the current state, with the sensors' readings."""
        if self._view.state is not self.state:
            self._view = Observer(self.model, self.state, self.robot.sensors)
        return self._view

    def restore(self, state: State) -> None:
        """Continue from a state, e.g. ``Trajectory.load("run.nc", robot).state(-1)``.

        The continued run is bit-equal to one that was never interrupted (see ``until`` in `run`). Commands that were
        given to `step` are no part of a state: give them again.
        """
        if state.q.shape != (self.model.dof_count,):
            raise ParameterError(
                f"the state has {len(state.q)} degrees of freedom, this robot {self.model.dof_count}: another robot"
            )
        form = lambda m, growing: None if m is None else np.shape(m)[growing:]  # noqa: E731
        bound, memories = self.model.bound, state.memories
        if len(memories) != len(bound) or any(
            form(b.memory, b.growing) != form(m, b.growing) for b, m in zip(bound, memories, strict=True)
        ):
            raise ParameterError(
                "the state is of a robot with other terms; a term without effect (scale=0) keeps them alike"
            )
        self.state = state

    # -- stepping -------------------------------------------------------------------------
    def step(self, inputs: Mapping[str, Any] | None = None) -> StepResult:
        """Take one step of length dt.

        Parameters
        ----------
        inputs : mapping, optional
            New values of actuator parameters from now on, e.g. ``{"motor.rpm": 120.0}``.

        Returns
        -------
        StepResult
            ``ok`` is False if the step failed at the smallest dt; nothing is raised.
        """
        self._take(inputs)
        view, index = self.observe(), self.state.index + 1
        done: list[StepReport] = []
        # whole multiples of dt as long as the clock is on them, for the sake of round-off
        on_grid = self.state.t == self.state.index * self.dt
        t, dt = index * self.dt if on_grid else self.state.t + self.dt, self.dt
        if t > self._end:  # the last step of a run takes what is left
            t, dt = self._end, self._end - self.state.t
        if self.adaptive is None:
            new = self._advance(self.state, t, dt, view.sensors, 0, done)
        else:
            new = self.adaptive.step(
                self.newton, self.stepper, self.state, self.dt, self._end, view.sensors, self.inputs, done
            )
            t = self.t if new is None else new.t
        iterations = sum(r.iterations for r in done)
        self.report = done[-1]
        if new is None:
            return StepResult(False, done[-1].status, view, iterations, len(done))
        self.state = new if new.index == index and new.t == t else new.at(t, index)
        return StepResult(True, Status.CONVERGED, self.observe(), iterations, sum(r.ok for r in done))

    def _take(self, inputs: Mapping[str, Any] | None) -> None:
        if not isinstance(inputs, Mapping | None):
            raise ParameterError(f"inputs are values by name, {{'motor.rpm': 120.0}}, not {inputs!r}")
        for key, value in (inputs or {}).items():
            if key not in self._commands:
                raise ParameterError(
                    f"no actuator takes the input {key!r}; there are {', '.join(self._commands) or 'no actuators'}"
                )
            self.inputs[key] = self._commands[key].with_value(value).value

    def _advance(self, state, t, dt, sensors, depth, done) -> State | None:
        """Step to time t; halve where Newton's method fails."""
        new, report = self.newton.step(state, self.stepper, t, dt, sensors, self.inputs)
        done.append(report)
        if new is not None or depth == MAX_HALVINGS:
            return new
        half = self._advance(state, t - 0.5 * dt, 0.5 * dt, sensors, depth + 1, done)
        return None if half is None else self._advance(half, t, 0.5 * dt, sensors, depth + 1, done)

    def iterate(self, duration: float, inputs: Mapping[str, Any] | None = None) -> Iterator[Observer]:
        """Step through ``duration`` seconds, as `run` does, yielding the state after each step.

        Raises
        ------
        ConvergenceError
            If a step fails; the simulation stays at the last accepted state.
        """
        self._take(inputs)
        for _, end in self._turns(duration, None):
            result = self._step_until(end)
            if not result.ok:
                raise failed_step(self, result.status, None)
            yield result.state

    def _step_until(self, end: float) -> StepResult:
        """Take a step that ends at time ``end`` at the latest."""
        self._end = end
        try:
            return self.step()
        finally:
            self._end = np.inf

    def _turns(self, duration: float | None, until: float | None) -> Iterator[tuple[float, float]]:
        """Before each step of a run, yield the fraction done and the time that the step must not pass."""
        if (duration is None) == (until is None):
            raise ParameterError("give the duration of a run [s], or until=, the time at which it ends [s]")
        for name, value, least in (("duration", duration, 0.0), ("until", until, self.t)):
            if value is not None and not (is_number(value) and value > least):
                raise ParameterError(
                    f"{name} = {value!r} must be "
                    + ("a positive time [s]" if name == "duration" else f"a time after t = {self.t:g} s")
                )
        begin = self.t
        end = float(begin + duration if until is None else until)  # type: ignore[operator]
        if self.adaptive is not None:
            while self.t < end:
                yield (self.t - begin) / (end - begin), end
            return
        steps = (end - begin) / self.dt
        if abs(steps - round(steps)) <= WHOLE and round(steps):
            end = np.inf  # whole steps of dt, whatever round-off makes of their sum
        elif steps < 1.0:
            warnings.warn(
                f"the run of {end - begin:g} s is shorter than the time step, dt = {self.dt:g} s, and takes one short "
                "step; give the simulation a smaller dt",
                RuntimeWarning,
                stacklevel=4,
            )
        count = round(steps) if end == np.inf else math.ceil(steps)
        yield from ((k / count, end) for k in range(count))

    # -- runs -----------------------------------------------------------------------------
    def run(
        self,
        duration: float | None = None,
        *,
        until: float | None = None,
        save_every: int = 1,
        out: str | Path | None = None,
        progress: bool = False,
        events: Sequence[Event] = (),
        stop: Callable[[Observer], bool] | None = None,
        append: bool = False,
    ) -> Trajectory:
        """Run for ``duration`` seconds from the current state, or until a time.

        Without step size control, steps are of length dt; if they do not add up to the duration, the last
        one is shorter.

        Parameters
        ----------
        duration : float
            Time to simulate [s].
        until : float, optional
            In place of it: the time at which the run ends [s]. A continued run is bit-equal to one that was
            never interrupted if both go until the same time.
        save_every : int
            Keep every so many-th step (the first and the last state are always kept).
        out : path, optional
            NetCDF file, written in chunks as the run goes on; readable after a crash.
        progress : bool
            Show a progress bar with the time left.
        events : sequence of Event
            Zero crossings to record, or to stop at.
        stop : callable, optional
            ``stop(state) -> bool``; the run ends after the step for which it is true.
        append : bool
            Continue an existing ``out`` file (see `Trajectory.load` and `restore`).

        Returns
        -------
        Trajectory
            Also after Ctrl-C: what was computed, with ``status`` "interrupted".

        Raises
        ------
        ConvergenceError
            If a step fails at the smallest dt; carries the trajectory so far, which is also on disk.
        OutputError
            If ``out`` cannot be written; before any computing.
        """
        from rodnet.progress import meter

        turns = self._turns(duration, until)
        begun = next(turns)  # raises for a bad duration before anything is written
        if save_every < 1 or int(save_every) != save_every:
            raise ParameterError(f"save_every = {save_every!r} must be a positive integer")
        recorder = Recorder(self, out, append)
        view = self.observe()
        watches = [Watch(e, float(e.function(view))) for e in events]
        if not (append and recorder.resumed):
            recorder.add(self.state)
        status, failure = "failed", None  # also if a sensor, event or actuator raises
        try:
            with meter(progress) as show, deferred_interrupt() as interrupt:
                for fraction, end in itertools.chain([begun], turns):
                    if interrupt.check():
                        status = "interrupted"
                        break
                    show(fraction)
                    before = self.t
                    result = self._step_until(end)
                    recorder.count(result.iterations, result.substeps)
                    if not result.ok:
                        failure = result.status
                        break
                    ended = any([w.see(before, result.state) for w in watches])
                    ended = ended or (stop is not None and bool(stop(result.state)))
                    if ended or self.state.index % save_every == 0:
                        recorder.add(self.state)
                    if ended:
                        status = "stopped"
                        break
                else:
                    show(1.0)
                    status = "finished"
        except KeyboardInterrupt:
            status = "interrupted"
        finally:
            if recorder.last_index != self.state.index:
                recorder.add(self.state)
            traj = recorder.finish(status, {w.event.name: w.times for w in watches})
        if failure is not None:
            raise failed_step(self, failure, traj)
        return traj
