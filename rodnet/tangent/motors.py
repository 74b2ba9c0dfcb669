"""The tangent of motors: their angle is a memory that turns the natural frame of one spring."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.terms.actuators import _BoundTwist
from rodnet.terms.dissipation import _BoundKelvinVoigt

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part

STEP = 1e-5  # of differences by the angle [rad]


class MotorTangent:
    """How the angle of a motor changes, and what that does.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the motor is.
    """

    def __init__(self, model: Model, number: int) -> None:
        self.model, self.number = model, number
        bound = model.bound[number]
        assert isinstance(bound, _BoundTwist)
        self.bound, self.dofs, self._column = bound, model.spring_dofs[bound.spring], np.zeros(11)
        self._new = np.zeros((2, 0))
        self._commands: list[tuple[int, list]] = []

    @staticmethod
    def knows(model: Model, bound: _BoundTwist) -> bool:
        """Whether the motor acts through its spring's elasticity alone."""
        damped = any(
            isinstance(b, _BoundKelvinVoigt) and bound.spring in b.moments.springs for b in model.bound
        )
        return not damped and not model.stressing

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the motor's command, with weights and bound terms nearby."""
        self._commands = [
            (c, near)
            for c, part in enumerate(parts)
            for k, near in (part.motors if part is not None else ())
            if k == number
        ]

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from the motor's angle.

        ``before``, shape (2, k), is the derivative of its memory.
        """
        from rodnet.tangent.step_kernels import motor_change

        assert before is not None
        b = self.bound
        follows = b.actuator.drives == "twist"  # the angle itself is commanded, whatever it was before
        angle = np.zeros(before.shape[1]) if follows else before[0].copy()
        for c, near in self._commands:
            command = 0.0
            for weight, other in near:
                other._take(stage.inputs)
                command += weight * float(other.actuator.command(stage.now, stage.sensors, other.p))
            angle[c] += command * (1.0 if follows else stage.elapsed)
        self._new = np.array([angle, (angle - before[0]) / stage.elapsed])
        if angle.any():
            motor_change(
                ev._quadratic.table, b.parts, b.angle, STEP, b.spring, b.sign > 0.0,
                self.model.quadratic_stiffness(), self._column,
            )  # fmt: skip
            out[self.dofs] += self._column[:, None] * angle

    def accepted(self) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (2, k)."""
        return self._new
