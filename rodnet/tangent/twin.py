"""A model of its own that evaluates single stages of steps: of other states, of other parameter values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import FoldedStateError
from rodnet.solve.newton import Newton, StepReport, _Motion
from rodnet.solve.steppers import Rates, State

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage


class Twin:
    """Evaluates the residual of a stage, and what state a step would end in, without solving anything.

    Parameters
    ----------
    model : Model
        A model that nobody else computes with.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.newton = model, Newton(model)
        self._none = np.zeros(0)

    def residual(
        self, stage: Stage, state: State, done: Rates, q: np.ndarray, sensors: Mapping[str, Any]
    ) -> np.ndarray:
        """Residual of a stage that begins with ``state``, at given free degrees of freedom.

        Parameters
        ----------
        stage : Stage
            Which stage.
        state : State
            The state that the step begins with.
        done : list
            Rates of the stages before.
        q : ndarray, shape (dof_count,)
            Degrees of freedom; those that are prescribed are those of this model and state.
        sensors : Mapping
            What actuators read.

        Returns
        -------
        ndarray, shape (free,)
        """
        m, ev, newton, stepper = self.model, self.newton.ev, self.newton, stage.stepper
        for b, memory in zip(m.bound, state.memories, strict=True):
            if memory is not None:
                b.restore(m, memory)
        newton._at = None
        m.order = stepper.order
        ev.set_source(state.tangents, state.directors, state.tau, state.q)
        for b in m.beginning:
            b.begin_step(m, stage.now, stage.elapsed, sensors, stage.inputs)
        cv, ca = stepper.coefficients(stage.dt)
        v0, a0 = stepper.offsets(state, stage.dt, done)
        base = newton._base
        base[:] = q
        base[m.held] = state.q[m.held]
        self.rates = None
        if m.moving:
            m.prescribe(base, stage.now, state.q[m.twist0 :], (state.tangents, state.directors))
            self.rates = m.prescribed_rates(base, stage.now, stage.dt) if stepper.exact_rates else None
        motion = _Motion(state.q, cv, ca, self._none if v0 is None else v0, a0, m.held, self.rates)
        newton._move(self._none, 0.0, motion)
        report = StepReport()
        if newton._residual(stage.now, stage.elapsed, motion, False, report) is None:
            raise FoldedStateError(
                f"a sensitivity cannot be computed at t = {stage.now:g} s: {report.status.value}"
            )
        return newton._r.copy()

    def rates_now(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations of the stage that was evaluated last."""
        return self.newton.ev.rates.copy(), self.newton._a.copy()

    def held(self) -> np.ndarray:
        """Prescribed degrees of freedom of that stage, their rates and accelerations, shape (3, held)."""
        held = self.model.held
        return np.stack([self.newton.ev.q[held], self.newton.ev.rates[held], self.newton._a[held]])

    def accepted(self, stage: Stage, state: State) -> State:
        """State that the step ends in, the stage that was evaluated last being its last one."""
        v, a = self.rates_now()
        return self.newton._accepted(state, stage.stepper, stage.t, stage.dt, v, a, self.rates)
