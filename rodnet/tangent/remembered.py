"""The tangent of laws that give springs moments and remember strains: friction inside a rod, set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.tangent.compare import that_change
from rodnet.tangent.droop import motor_tangent
from rodnet.tangent.motors import STEP, MotorTangent
from rodnet.terms.actuators import _BoundActuator
from rodnet.terms.friction import _BoundFriction
from rodnet.terms.local.creep import _BoundSet
from rodnet.terms.tendons import _BoundTendon

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.parts import Part


class SpringMemoryTangent:
    """How what a law remembers of springs changes, and what that does.

    The law gives moments and the memory after a step, ``law(strain, memory, dt)``, and the derivative of both along
    changes of strain and memory, ``linear(strain, memory, dt, d_strain, d_memory)``. Where it has a corner that
    is the derivative on the side that the step took, which is the only one that the run knows of.

    Parameters
    ----------
    model : Model
        The model.
    number : int
        Which of its bound terms the law is.
    motors : list of MotorTangent
        Those of the model: they turn natural frames of some of the springs, and are asked first.
    """

    def __init__(self, model: Model, number: int, motors: Sequence[MotorTangent] = ()) -> None:
        self.model, self.number = model, number
        bound: Any = model.bound[number]
        self.bound, self.springs, self.dofs = bound, bound.moments.springs, bound.moments.dofs
        self.edges = model.edge1[self.springs], model.edge2[self.springs]
        at = {int(s): row for row, s in enumerate(self.springs)}
        self._motors = [(at[m.bound.spring], m) for m in motors if m.bound.spring in at]
        self._near: list[tuple[int, list[tuple[float, Any]]]] = []
        self._offset: np.ndarray | None = None

    @staticmethod
    def knows(model: Model, bound: Any) -> bool:
        """Whether the law is of this kind, and what drives the natural shapes of its springs is known."""
        return isinstance(bound, _BoundFriction | _BoundSet) and all(
            motor_tangent(model, b) is not None
            for b in model.bound
            if isinstance(b, _BoundActuator) and not isinstance(b, _BoundTendon)
        )

    def take(self, number: int, parts: list[Part | None]) -> None:
        """Take the columns that change the law, with weights and bound terms nearby, or natural shapes."""
        self._near = that_change(self.bound, number, parts)
        offsets = {
            c: part.offset[self.springs]
            for c, part in enumerate(parts)
            if part is not None and part.offset is not None
        }
        self._offset = None
        if offsets:
            self._offset = np.zeros((len(self.springs), 3, -(-len(parts) // 8) * 8))
            for c, offset in offsets.items():
                self._offset[:, :, c] = offset

    def add(self, stage: Stage, ev: Evaluation, before: np.ndarray | None, out: np.ndarray) -> None:
        """Add the change of the residual (dof_count, k) that comes from memory and law, at fixed positions.

        ``before``, shape (n, m, k), is the derivative of the memory.
        """
        assert before is not None
        memory = stage.state.memories[self.number]
        assert memory is not None
        self._strain = (ev.eps - self.model.eps0)[self.springs]
        self._memory, self._before, self._dt = memory, before, ev.dt
        B, _ = self.bound.moments.gradient(ev)
        self._B = B
        change = np.zeros((len(self.springs), 3, before.shape[2]))
        if self._offset is not None:
            change -= self._offset
        for row, motor in self._motors:
            change[row] -= motor.side * np.outer(B[row, :, motor.twist], motor.change)
        sigma, _ = self.bound.linear(self._strain, memory, ev.dt, change, before)
        for c, near in self._near:
            for weight, other in near:
                sigma[:, :, c] += weight * other.law(self._strain, memory, ev.dt)[0]
        np.add.at(out, self.dofs, np.einsum("nai,nak->nik", B, sigma))
        if self._motors:
            moments = self.bound.law(self._strain, memory, ev.dt)[0]
        for row, motor in self._motors:
            force = moments[row] @ self._turning(ev, row, motor)
            out[self.dofs[row]] += np.outer(force, motor.change)

    def _turning(self, ev: Evaluation, row: int, motor: MotorTangent) -> np.ndarray:
        """Derivative of the gradient of a spring's strains by the angle of the motor that turns its frame, (3, 11)."""
        b, m, found = motor.bound, self.model, np.zeros((3, self.dofs.shape[1]))
        frames = m.Q2 if b.sign > 0.0 else m.Q1
        for step in (STEP, -STEP):
            b.turn_about(b.parts, b.angle + step, b.spring, frames)
            found += self.bound.moments.gradient(ev)[0][row] / (2.0 * step)
        b.turn_about(b.parts, b.angle, b.spring, frames)
        return found

    def accepted(self, dq: np.ndarray, dv: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Derivative of the memory that the last stage leaves, shape (n, m, k).

        Parameters
        ----------
        dq, dv : ndarray, shape (dof_count, k)
            Derivatives of the solution and of its rates; the latter do not matter.
        turned : ndarray, shape (edge_count, k)
            Angles by which changed source frames turn the directors.
        """
        motion = dq[self.dofs]
        for place, edges in zip((3, 7), self.edges, strict=True):
            motion[:, place] += turned[edges]
        for row, motor in self._motors:
            motion[row, motor.twist] -= motor.side * motor.change
        change = np.einsum("nai,nik->nak", self._B, motion)
        if self._offset is not None:
            change -= self._offset
        _, new = self.bound.linear(self._strain, self._memory, self._dt, change, self._before)
        for c, near in self._near:
            for weight, other in near:
                new[..., c] += weight * other.law(self._strain, self._memory, self._dt)[1]
        return np.asarray(new)
