"""The tangent of motors: their angle is a memory that turns the natural frame of one spring."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.terms.actuators import Motor, _BoundTwist
from rodnet.terms.dissipation import _BoundKelvinVoigt
from rodnet.terms.local.joints import _BoundGive
from rodnet.terms.spring_moments import SpringMoments

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
        self.bound, self.dofs = bound, model.spring_dofs[bound.spring]
        # the natural frame turns as if the rotor's twist, of that number in the stencil, turned back
        second = bound.sign > 0.0
        self.twist = 7 if second else 3
        self.side = bound.sign * float((model.sign2 if second else model.sign1)[bound.spring])
        self.follows = bound.actuator.drives == "twist"
        # joints that give there, whose energy is more than quadratic
        self.gives = [
            (b, int(np.flatnonzero(b.springs == bound.spring)[0]))
            for b in model.bound
            if isinstance(b, _BoundGive) and bound.spring in b.springs and not b.idle
        ]
        self.moments = SpringMoments(model, np.array([bound.spring]))
        self._constant: dict[int, float] = {}  # commands that never change
        self._new = np.zeros((2, 0))
        self.change = np.zeros(0)  # of the angle in a stage, by every column
        self._commands: list[tuple[int, list]] = []

    @staticmethod
    def knows(model: Model, bound: _BoundTwist) -> bool:
        """Whether the motor acts through its spring's elasticity alone, and answers to no sensor."""
        if not bound.isotropic:  # its turn changes stiffnesses, too
            return False
        own = type(bound.actuator).command is not Motor.command
        if own and model.robot.sensors:
            return False
        damped = any(isinstance(b, _BoundKelvinVoigt) and bound.spring in b.springs for b in model.bound)
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
        b, new = self.bound, np.empty_like(before)
        angle = new[0]
        # where the angle itself is commanded, it does not matter what it was before
        angle[:] = 0.0 if self.follows else before[0]
        for c, near in self._commands:
            angle[c] += self._command(c, near, stage) * (1.0 if self.follows else stage.elapsed)
        np.subtract(angle, before[0], out=new[1])
        new[1] /= stage.elapsed
        self._new, self.change = new, angle
        motor_change(
            ev._quadratic.table, b.parts, b.angle, STEP, b.spring, b.sign > 0.0,
            self.model.quadratic_stiffness(), self.dofs, angle, out,
        )  # fmt: skip
        self.beyond(ev, angle, out)

    def beyond(self, ev: Evaluation, angle: np.ndarray, out: np.ndarray) -> None:
        """Add what a joint that gives feels of the angle: its energy turns with the rotor's twist, against it."""
        if not self.gives:
            return
        B, second = self.moments.gradient(ev, hessian=True)
        assert second is not None
        for joint, row in self.gives:
            sigma, H = joint.law(ev)
            whole = B[0].T @ H[row] @ B[0] + np.einsum("k,kij->ij", sigma[row], second[0])
            out[self.dofs] -= self.side * np.outer(whole[:, self.twist], angle)

    def _command(self, c: int, near: list[tuple[float, _BoundTwist]], stage: Stage) -> float:
        """Derivative of the command by a column."""
        if c in self._constant and not stage.inputs:
            return self._constant[c]
        total = 0.0
        for weight, other in near:
            other._take(stage.inputs)
            total += weight * float(other.actuator.command(stage.now, stage.sensors, other.p))
        if type(b := self.bound.actuator) is Motor and b.angle is None and not stage.inputs:
            self._constant[c] = total
        return total

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (2, k), whatever moved."""
        return self._new
