"""The tangent of motors that slow down under load: they turn a natural frame, and soften its spring."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rodnet.tangent.motors import STEP, MotorTangent
from rodnet.terms.actuators import RPM, _BoundTwist
from rodnet.terms.drives import RATIO, DCMotor, _BoundDCMotor

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part


class _Command(NamedTuple):
    """What a motor does in a stage: by every column, or of one motor.

    ``angle`` and ``speed`` are those without load, ``lost`` the angle that is lost to droop before the stage, ``give``
    that per moment in it, ``droop`` the speed lost per moment; ``loss`` is what the spring's stiffness loses.
    """

    angle: Any
    speed: Any
    lost: Any
    give: Any
    droop: Any
    loss: Any


class DroopTangent(MotorTangent):
    """How the angle of a `DCMotor` changes, and what that does.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the motor is.
    """

    def __init__(self, model: Model, number: int) -> None:
        super().__init__(model, number)
        self._shapes: list[tuple[int, np.ndarray | None, np.ndarray | None]] = []
        self._change: _Command | None = None

    @staticmethod
    def knows(model: Model, bound: Any) -> bool:
        """Whether it acts through its spring's elasticity alone, and answers to no sensor."""
        if type(bound.actuator).command is not DCMotor.command and model.robot.sensors:
            return False
        return MotorTangent.knows(model, bound)

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the motor, its spring's stiffness or its natural strains."""
        super().take(number, parts)
        s = self.bound.spring
        self._shapes = [
            (
                c,
                None if part.stiffness is None else part.stiffness[s],
                None if part.offset is None else part.offset[s],
            )
            for c, part in enumerate(parts)
            if part is not None and (part.stiffness is not None or part.offset is not None)
        ]

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from the motor's angle and its give.

        ``before``, shape (8, k), is the derivative of its memory.
        """
        from rodnet.tangent.step_kernels import motor_change

        assert before is not None
        b, s = self.bound, self.bound.spring
        memory = stage.state.memories[self.number]
        assert memory is not None
        change = self._of_memory(stage, memory, before)
        for c, near in self._commands:
            for weight, other in near:
                for total, value in zip(change, _asked(other, stage, memory), strict=True):
                    total[..., c] += weight * value
        self._change, self._before, self.change = change, before, change.angle
        self._K = self.model.quadratic_stiffness()[s].copy()
        self._B = self.moments.gradient(ev)[0][0]
        self._strain = ev.eps[s] - self.model.eps0[s]
        self._torque = -b.way * float(self._K[2] @ self._strain)
        sigma = -np.einsum("ijk,j->ik", change.loss, self._strain)
        out[self.dofs] += self._B.T @ sigma
        motor_change(
            ev._quadratic.table, b.parts, b.angle, STEP, s, b.sign > 0.0, self.model.quadratic_stiffness(), self.dofs,
            change.angle, out,
        )  # fmt: skip
        self.beyond(ev, change.angle, out)

    def _of_memory(self, stage: Stage, memory: np.ndarray, before: np.ndarray) -> _Command:
        """Derivative of what the motor does by what it remembers."""
        dt, lag = stage.elapsed, self.bound.p.lag
        left = np.exp(-dt / lag) if lag > 0.0 else 0.0
        ratio = dt / float(memory[6]) if memory[6] > 0.0 else np.inf
        back = ratio**2 / (1.0 + 2.0 * ratio) * (before[7] - before[5]) if ratio < RATIO else 0.0
        none = np.zeros(before.shape[1])
        return _Command(
            before[0] + lag * (1.0 - left) * before[2] - back, left * before[2], before[7] + back, none, none.copy(),
            np.zeros((3, 3, len(none))),
        )  # fmt: skip

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (8, k).

        ``dq``, shape (dof_count, k), is that of its degrees of freedom, and ``turned`` (edge_count, k) are angles by
        which changed source frames turn the directors.
        """
        b, change = self.bound, self._change
        assert isinstance(b, _BoundDCMotor) and change is not None
        motion = dq[self.dofs].copy()
        motion[3] += turned[self.moments.edge1[0]]
        motion[7] += turned[self.moments.edge2[0]]
        motion[self.twist] -= self.side * change.angle
        stress = self._K[2] @ (self._B @ motion) - np.einsum("jk,j->k", change.loss[2], self._strain)
        for c, stiffness, offset in self._shapes:
            if stiffness is not None:
                stress[c] += stiffness[2] @ self._strain
            if offset is not None:
                stress[c] -= self._K[2] @ offset
        torque = -b.way * stress
        droop = b.p.no_load_rpm * RPM / b.p.stall_torque
        yielded = change.give * self._torque + b.give * torque
        rate = change.speed - change.droop * self._torque - droop * torque
        new = np.zeros_like(self._before)
        new[0], new[1], new[2], new[3] = change.angle - yielded, rate, change.speed, change.angle
        new[4], new[5], new[7] = change.give, self._before[7], change.lost + yielded
        return new


def _asked(motor: _BoundDCMotor, stage: Stage, memory: np.ndarray) -> _Command:
    """What a motor nearby would do in a stage that begins with the same memory; it is left as it was."""
    motor.restore(motor.model, memory)
    motor.begin_step(motor.model, stage.now, stage.elapsed, stage.sensors, stage.inputs)
    p = motor.p
    found = _Command(
        motor.angle,
        motor.speed,
        motor.lost,
        motor.give,
        p.no_load_rpm * RPM / p.stall_torque,
        motor.loss.copy(),
    )
    motor.restore(motor.model, np.zeros_like(memory))
    return found


def motor_tangent(model: Model, bound: Any) -> type[MotorTangent] | None:
    """What follows a motor, if it is known how its angle changes; None for whatever else."""
    kind = {_BoundTwist: MotorTangent, _BoundDCMotor: DroopTangent}.get(type(bound))
    return kind if kind is not None and kind.knows(model, bound) else None
