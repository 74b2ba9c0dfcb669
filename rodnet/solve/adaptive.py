"""Step size control: as long a step as keeps the local error in bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rodnet.errors import ParameterError, StepTooLongError
from rodnet.solve.newton import Newton, StepReport
from rodnet.solve.steppers import Pace, State, Stepper

SAFETY = 0.9
GROWTH, SHRINKAGE = 2.0, 0.2  # limits of the change from one step to the next


@dataclass(frozen=True)
class Adaptive:
    """Choose the time step from the stepper's local error.

    Attributes
    ----------
    tolerance : float
        Largest local error of a step against the largest displacement in that step [1]: about the
        relative error of velocities. Positions and twist angles are judged apart.
    longest, shortest : float
        Bounds of the step [s]. A step that does not converge at ``shortest`` has failed.
    """

    tolerance: float = 1e-2
    longest: float = np.inf
    shortest: float = 1e-7

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise ParameterError(f"Adaptive: tolerance = {self.tolerance!r} must lie between 0 and 1")
        if not 0.0 < self.shortest < self.longest:
            raise ParameterError(
                f"Adaptive: shortest = {self.shortest!r} s must be positive and below longest = {self.longest!r} s"
            )

    @classmethod
    def of(cls, given: Adaptive | float | None) -> Adaptive | None:
        """Return the control for a tolerance, or as given.

        Raises
        ------
        ParameterError
            If it is neither.
        """
        if given is None or isinstance(given, cls):
            return given
        if isinstance(given, bool) or not isinstance(given, int | float | np.number):
            raise ParameterError(
                f"adaptive = {given!r} must be a tolerance such as 0.01, an Adaptive, or None"
            )
        return cls(float(given))

    def step(
        self,
        newton: Newton,
        stepper: Stepper,
        state: State,
        first: float,
        end: float,
        sensors: Mapping[str, Any],
        inputs: dict[str, Any],
        done: list[StepReport],
    ) -> State | None:
        """Take one step from ``state``, not beyond time ``end``.

        Parameters
        ----------
        first : float
            Step to try where the state suggests none [s].
        done : list of StepReport
            Receives the report of every attempt.

        Returns
        -------
        State or None
            With its new `Pace`; None if even the shortest step fails.
        """
        pace = state.pace or self.start(state, first)
        wanted = pace.step
        while True:
            wanted = min(max(wanted, self.shortest), self.longest)
            left = end - state.t
            # the last two steps share what is left, so that none becomes tiny
            h = left if wanted >= left else min(wanted, 0.5 * left) if 2.0 * wanted > left else wanted
            t = end if h == left else state.t + h
            try:
                new, report = newton.step(state, stepper, t, h, sensors, inputs)
            except StepTooLongError as refusal:
                if refusal.limit <= self.shortest:
                    raise
                wanted = min(SAFETY * refusal.limit, 0.5 * h)
                continue
            done.append(report)
            if new is None:
                if h <= self.shortest:
                    return None
                wanted = 0.25 * h
                continue
            mean, bend, error = self._judge(newton, stepper, state, new, pace, h)
            # a step's local error, against its displacement, goes with the order-th power of its size
            factor = SAFETY * max(error, 1e-12) ** (-1.0 / stepper.order) if error >= 0.0 else 1.0
            if error <= 1.0 or h <= self.shortest:
                following = max(h * min(factor, GROWTH), wanted if h < wanted else 0.0)
                return replace(new, pace=Pace(following, np.array([h, pace.lengths[0]]), mean, bend))
            wanted = h * max(factor, SHRINKAGE)

    @staticmethod
    def start(state: State, first: float) -> Pace:
        """Return the pace before the first step."""
        return Pace(first, np.zeros(2), np.zeros_like(state.q), np.zeros_like(state.q))

    def _judge(
        self, newton: Newton, stepper: Stepper, old: State, new: State, pace: Pace, h: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Mean velocity and bend of the step, and its error against what is tolerated (-1: unknown)."""
        k, e = newton.model.twist0, len(new.turns)
        moved = new.q - old.q
        moved[k : k + e] += 2.0 * np.pi * (new.turns - old.turns)
        mean, (h0, h1) = moved / h, pace.lengths
        if h0 == 0.0:
            return mean, np.zeros_like(mean), -1.0
        bend = 2.0 * (mean - pace.mean) / (h + h0)
        if stepper.order == 1:
            derivative = bend
        elif h1 == 0.0:
            return mean, bend, -1.0
        else:
            derivative = 3.0 * (bend - pace.bend) / (h + h0 + h1)
        local = np.abs(stepper.error_constant * h ** (stepper.order + 1) * derivative)
        # at a turning point all displacements vanish: there the acceleration gives their scale
        scale, largest = np.maximum(np.abs(moved), 0.5 * h * h * np.abs(bend)), 0.0
        for part, unit in ((slice(None, k), newton.length), (slice(k, None), 1.0)):
            allowed = self.tolerance * float(scale[part].max(initial=0.0)) + 1e-12 * unit
            largest = max(largest, float(local[part].max(initial=0.0)) / allowed)
        return mean, bend, largest if np.all(np.isfinite(local)) else 1e6
