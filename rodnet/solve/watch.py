"""What is told to those who follow a computation step by step, such as the tangent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

if TYPE_CHECKING:
    from rodnet.solve.steppers import Rates, State, Stepper


class Stage(NamedTuple):
    """One solved stage of a step: from which state, to which time, and how.

    Attributes
    ----------
    state : State
        The state that the step begins with.
    stepper : Stepper
        The stepper.
    t, dt : float
        End and length of the step [s].
    now, elapsed : float
        Time of the stage, and since the beginning of the step [s].
    sensors, inputs : Mapping
        What actuators are given.
    done : list
        Rates of the stages so far, this one included.
    motion : tuple
        Rates and accelerations as functions of the new position.
    """

    state: State
    stepper: Stepper
    t: float
    dt: float
    now: float
    elapsed: float
    sensors: Mapping[str, Any]
    inputs: dict[str, Any]
    done: Rates
    motion: Any


class Watch(Protocol):
    """Follows the steps of a `Newton`."""

    def stage(self, stage: Stage) -> None:
        """Called when a stage has been solved."""

    def accepted(self, state: State) -> None:
        """Called when a step has been accepted."""
