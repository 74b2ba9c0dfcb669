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

    @staticmethod
    def knows(model: Model, bound: _BoundTwist) -> bool:
        """Whether the motor acts through its spring's elasticity alone."""
        damped = any(
            isinstance(b, _BoundKelvinVoigt) and bound.spring in b.moments.springs for b in model.bound
        )
        return not damped and not model.stressing

    def add(
        self,
        stage: Stage,
        ev: Evaluation,
        before: np.ndarray | None,
        parts: list[Part | None],
        out: np.ndarray,
    ) -> None:
        """Add the change of the residual (dof_count, k) that comes from the motor's angle.

        ``before``, shape (2, k), is the derivative of its memory.
        """
        from rodnet.tangent.step_kernels import motor_change

        assert before is not None
        b = self.bound
        angle = before[0].copy()
        follows = b.actuator.drives == "twist"
        for c, part in enumerate(parts):
            for number, near in part.motors if part is not None else ():
                if number != self.number:
                    continue
                command = 0.0
                for weight, other in near:
                    other._take(stage.inputs)
                    command += weight * float(other.actuator.command(stage.now, stage.sensors, other.p))
                angle[c] = command if follows else angle[c] + command * stage.elapsed
        if follows:  # the angle itself is commanded: what it was before does not matter
            mine = {
                c for c, p in enumerate(parts) if p is not None and any(n == self.number for n, _ in p.motors)
            }
            angle[[c for c in range(len(angle)) if c not in mine]] = 0.0
        self._new = np.stack([angle, (angle - before[0]) / stage.elapsed])
        if angle.any():
            motor_change(
                ev._quadratic.table, b.parts, b.angle, STEP, b.spring, b.sign > 0.0,
                self.model.quadratic_stiffness(), self._column,
            )  # fmt: skip
            np.add.at(out, self.dofs, self._column[:, None] * angle)

    def accepted(self) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (2, k)."""
        return self._new
