"""Follows a simulation and keeps the derivative of its state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.observer import Observer
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.newton import StepReport
from rodnet.solve.steppers import Rates, State
from rodnet.solve.watch import Stage
from rodnet.tangent.columns import Variation
from rodnet.tangent.differences import Differences
from rodnet.tangent.state import StateTangent, joined, moved
from rodnet.tangent.twin import Twin


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
        if initial is None:
            initial = joined([column.initial(sim) for column in columns])
        self._known: list[tuple[State, StateTangent]] = [(sim.state, initial)]
        self._pending: StateTangent | None = None
        self._done: Rates = []
        self._last: tuple[Stage, np.ndarray, np.ndarray, Rates] | None = None
        self.twin = Twin(Model(sim.robot))
        self.differences = Differences(self.twin, columns)

    def __enter__(self) -> Tangent:
        self.newton.watch = self
        return self

    def __exit__(self, *_: Any) -> None:
        self.newton.watch = None

    @property
    def current(self) -> StateTangent:
        """Derivative of the simulation's state."""
        return self._of(self.sim.state)

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
        m, ev = self.model, self.newton.ev
        q = ev.q.copy()
        readings = self._readings(stage)
        every = list(range(len(self.columns)))
        self._factor(stage)
        b = self.differences.residual(stage, tangent, self._done, q, readings, every)
        dq = np.zeros((m.dof_count, len(every)))
        dq[m.free] = -m.solver.solve(b)
        if len(stage.done) < len(stage.stepper.nodes):
            self._done.append(
                self.differences.rates(stage, tangent, self._done, q, dq, readings, None)
            )
        else:
            self._last = stage, q, dq, self._done

    def _factor(self, stage: Stage) -> None:
        """Factorise the Jacobian at the solution."""
        self.newton._residual(stage.now, stage.elapsed, stage.motion, True, StepReport())
        self.model.solver.factor(self.model.data)

    def accepted(self, state: State) -> None:
        """Take the derivative of an accepted state."""
        assert self._last is not None
        stage, q, dq, done = self._last
        tangent = self._of(stage.state)
        new = self.differences.rates(stage, tangent, done, q, dq, self._readings(stage), state)
        # the state that the step began with may be needed once more, where steps are halved
        begin = self.sim.state
        self._known = [(s, t) for s, t in self._known if s is begin or s is stage.state] + [(state, new)]

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
