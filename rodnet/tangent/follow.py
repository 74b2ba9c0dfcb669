"""Follows a simulation and keeps the derivative of its state."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.observer import Observer
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.newton import StepReport
from rodnet.solve.steppers import Rates, State
from rodnet.solve.watch import Stage
from rodnet.tangent.differences import Differences
from rodnet.tangent.fast import Fast, fits
from rodnet.tangent.state import StateTangent, first, joined, moved, zero
from rodnet.tangent.twin import Twin
from rodnet.tangent.variation import Variation
from rodnet.terms.actuators import _BoundTwist
from rodnet.terms.driven_curvature import _BoundCurvature


class Tangent:
    """The derivative of a simulation's state by some parameters, step by step as it runs.

    While it is attached every step of the simulation, however it is taken, also advances the tangent.

    Parameters
    ----------
    sim : Simulation
        With a fixed time step.
    columns : list of Variation
        What to differentiate by.
    initial : StateTangent, optional
        Derivative of the state that ``sim`` is at; by default that of a start from rest.

    Attributes
    ----------
    current : StateTangent
        Of the simulation's state.

    Raises
    ------
    ParameterError
        If the simulation chooses its time step: its choice has no derivative.
    """

    def __init__(
        self, sim: Simulation, columns: list[Variation], initial: StateTangent | None = None
    ) -> None:
        if sim.adaptive is not None:
            raise ParameterError(
                "sensitivities need a fixed time step: leave out adaptive=, its choice of steps has no derivative"
            )
        self.sim, self.columns = sim, columns
        self.model, self.newton = sim.model, sim.newton
        self.fast = Fast(self.model, self.newton, columns) if fits(self.model) else None
        if initial is None:
            initial = joined([column.initial(sim) for column in columns])
        if self.fast is not None and self.fast.wide > len(columns):
            initial = joined([initial, zero(self.model, sim.state, self.fast.wide - len(columns))])
        self._known: list[tuple[State, StateTangent]] = [(sim.state, initial)]
        self._done: Rates = []
        self._end: Any = None
        unfit = [False] * len(columns) if self.fast is None else [part is None for part in self.fast.parts]
        self._always = np.array(unfit)  # found by differences at every step
        self._quiet: StateTangent | None = None  # a tangent that is known to need none
        self._sort_memories()

    @cached_property
    def differences(self) -> Differences:
        """What finds the rest by whole evaluations, of models of their own; as a rule nobody asks for it."""
        return Differences(Twin(Model(self.sim.robot)), self.columns)

    def _sort_memories(self) -> None:
        """Tell apart the memories that only whole evaluations know, and among them those that hear of no motion."""
        fast, bound = self.fast, self.model.bound
        known: set[int] = set() if fast is None else {*fast.memories, *fast.deaf}
        self._other = [k for k, b in enumerate(bound) if b.memory is not None and k not in known]
        self._blind = all(
            type(bound[k]) is _BoundTwist or isinstance(bound[k], _BoundCurvature) for k in self._other
        )

    def __enter__(self) -> Tangent:
        self.newton.watch = self
        return self

    def __exit__(self, *_: Any) -> None:
        self.newton.watch = None

    @property
    def current(self) -> StateTangent:
        """Derivative of the simulation's state, one column for each of ``columns``."""
        return first(self._of(self.sim.state), len(self.columns))

    def _of(self, state: State) -> StateTangent:
        for known, tangent in reversed(self._known):
            if known is state or known.q is state.q:
                return tangent
        raise ParameterError("the simulation has taken steps that its tangent has not followed")

    # -- what Newton's method tells -----------------------------------------------------------
    def stage(self, stage: Stage) -> None:
        """Take the derivative of a stage that has just been solved."""
        tangent = self._of(stage.state)
        if len(stage.done) == 1:
            self._done = []
        last = len(stage.done) == len(stage.stepper.nodes)
        if self.fast is None:
            self._by_differences(stage, tangent, last)
        else:
            self._quickly(stage, tangent, last)

    def _by_differences(self, stage: Stage, tangent: StateTangent, last: bool) -> None:
        m, done, differences = self.model, self._done, self.differences
        q, readings, every = self.newton.ev.q.copy(), self._readings(stage), list(range(len(self.columns)))
        self.newton._residual(stage.now, stage.elapsed, stage.motion, True, StepReport())
        here = self.newton._r.copy(), self.newton.scales
        m.solver.factor(m.data)
        steps = [differences.step(stage, tangent, done, c) for c in every]
        b, _ = differences.residual(
            stage, tangent, done, q, readings, every, steps, [True] * len(every), here
        )
        dq = np.zeros((m.dof_count, len(every)))
        dq[m.free] = -m.solver.solve(b)
        if last:
            self._end = lambda new: differences.rates(stage, tangent, done, q, dq, readings, new, every)
        else:
            done.append(differences.rates(stage, tangent, done, q, dq, readings, None, every))

    def _quickly(self, stage: Stage, tangent: StateTangent, last: bool) -> None:
        m, done, fast = self.model, self._done, self.fast
        assert fast is not None
        which = self._which(stage, tangent)
        rest = held = q = None
        readings: Any = None
        if which:
            q, readings = self.newton.ev.q.copy(), self._readings(stage)
            part = self._rest(tangent)
            before = [(self._held_only(v), self._held_only(a)) for v, a in done]
            steps = [self.differences.step(stage, tangent, done, c) for c in which]
            near = [fast.parts[c] is None for c in which]
            here = self.newton._r.copy(), self.newton.scales
            b, h = self.differences.residual(stage, part, before, q, readings, which, steps, near, here)
            rest, held = np.zeros((m.dof_count, fast.wide)), np.zeros((3, len(m.held), fast.wide))
            rest[np.ix_(m.free, np.array(which))], held[:, :, which] = b, h
        dq, dv, da, spin = fast.solve(stage, tangent, done, rest, held)
        if not last:
            done.append((dv, da))
            return
        acc = stage.stepper.acceleration(tangent, dv, dq, da, stage.dt)  # type: ignore[arg-type]
        if len(m.held):
            acc = acc.copy()
            acc[m.held] = da[m.held] if m.moving and stage.stepper.exact_rates else acc[m.held]

        def end(new: State) -> StateTangent:
            memories: list[np.ndarray | None] = [
                None if memory is None else np.zeros((*np.shape(memory), fast.wide))
                for memory in new.memories
            ]
            for number, memory in fast.memories.items():
                memories[number] = memory.accepted(dq, dv, fast.turned)
            # of columns that only whole evaluations know, the memories that are followed know the motion's part alone
            lone = np.flatnonzero(self._always).tolist() if fast.memories else []
            every = which if self._blind else list(range(len(self.columns)))
            asked = sorted({*lone, *(every if self._other else ())})
            if asked:
                at, read = (self.newton.ev.q.copy(), self._readings(stage)) if q is None else (q, readings)
                part = self.differences.rates(stage, tangent, done, at, dq, read, new, asked)
                for numbers, of in ((self._other, asked), (fast.memories, lone)):
                    for number in numbers:
                        target, found_here = memories[number], part.memories[number]
                        if target is not None and found_here is not None:
                            target[..., of] = found_here[..., [asked.index(c) for c in of]]
            found = StateTangent(dq, dv, da, acc, spin, tuple(memories))
            if not which and not self._other and not self._always.any():
                self._quiet = found
            return found

        self._end = end

    def _which(self, stage: Stage, tangent: StateTangent) -> list[int]:
        """Columns of which something is to be found by differences."""
        count, held = len(self.columns), self.model.held
        if self.sim.robot.sensors and stage.sensors._taken:  # type: ignore[attr-defined]
            return list(range(count))  # an actuator reads sensors
        if self._quiet is tangent:
            return []
        ask = self._always.copy()
        for number in self._other:
            d = tangent.memories[number]
            if d is not None:
                ask |= np.any(d.reshape(-1, d.shape[-1])[:, :count], axis=0)
        if len(held) and (self.fast is None or self.fast.held is None):
            for array in (tangent.q, tangent.v, tangent.a, tangent.acc):
                ask |= np.any(array[held, :count], axis=0)
        return np.flatnonzero(ask).tolist()

    def _held_only(self, array: np.ndarray) -> np.ndarray:
        out = np.zeros_like(array)
        out[self.model.held] = array[self.model.held]
        return out

    def _rest(self, tangent: StateTangent) -> StateTangent:
        """The part of a tangent that the compiled way leaves out: what is held, and other memories."""
        m = self.model
        edges = m.held[(m.held >= m.twist0) & (m.held < m.turn0)] - m.twist0
        spin = np.zeros_like(tangent.spin)
        spin[edges] = tangent.spin[edges]
        memories = tuple(
            d if d is None or k in self._other else np.zeros_like(d) for k, d in enumerate(tangent.memories)
        )
        q, v, a, acc = (self._held_only(array) for array in (tangent.q, tangent.v, tangent.a, tangent.acc))
        return StateTangent(q, v, a, acc, spin, memories)

    def accepted(self, state: State) -> None:
        """Take the derivative of an accepted state."""
        new = self._end(state)
        # the state that the step began with may be needed once more, where steps are halved
        begin = self.sim.state
        if self.fast is not None:
            self.fast.accepted(begin, state)
        self._known = [(s, t) for s, t in self._known if s.q is begin.q] + [(state, new)]

    def _readings(self, stage: Stage) -> Any:
        """Sensor readings after a change of a column, as a function of it."""
        robot = self.sim.robot
        begin = getattr(getattr(stage.sensors, "_view", None), "state", None)

        def after(column: int, step: float) -> Mapping[str, Any]:
            if not robot.sensors or begin is None:
                return stage.sensors
            state = moved(self.model, begin, self._of(begin), column, step)
            return Observer(self.model, state, robot.sensors).sensors

        return after
