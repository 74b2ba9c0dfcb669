"""Drives with a life of their own: motors that give way under load, curvatures that follow slowly."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import StepTooLongError, TermError
from rodnet.parameters import Parameter
from rodnet.terms.actuators import RPM, Actuator, _BoundTwist
from rodnet.terms.base import BoundTerm
from rodnet.terms.driven_curvature import _BoundCurvature
from rodnet.terms.energies import EnergyModel
from rodnet.terms.joints import _BoundJoints

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


RATIO = 2.0  # of a step to the last one, up to which BDF2 is used; it is stable up to 2.4


class DCMotor(Actuator):
    """A motor with a torque-speed line and a lag: it slows down under load, and follows commands late.

    Its speed is that of the lagged command less the droop, no_load_rpm / stall_torque for each N m that
    it delivers: at the command no_load_rpm it stalls under stall_torque. The torque is the joint's at
    the end of the step, so the step is stable however steep the line. Driven backwards it brakes.

    Parameters
    ----------
    at : str
        The node between stator and rotor; or ``between=(stator edge, rotor edge)``.
    rpm : float or Parameter
        Commanded speed, that without load [rpm].
    stall_torque, no_load_rpm : float or Parameter
        Two points of the torque-speed line [N m], [rpm]; ``no_load_rpm=0`` is a motor that gives way to
        nothing.
    lag : float or Parameter
        Time constant with which the speed without load follows the command, from rest [s].
    gain : float or Parameter
        Relative change of the command [1].
    """

    default_name = "motor"
    source = "torque-speed line of a permanent-magnet DC motor; lag of first order"
    drives = "twist_rate"
    rpm = Parameter(None, unit="rpm", doc="commanded speed of the rotor against the stator")
    stall_torque = Parameter(
        1.0, unit="N m", bounds=(1e-12, None), kind="shape", doc="torque at which no_load_rpm stalls"
    )
    no_load_rpm = Parameter(
        0.0, unit="rpm", bounds=(0, None), null=0.0, doc="speed without load at which stall_torque stalls"
    )
    lag = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="time constant of the speed")
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of what is commanded")
    example: ClassVar[dict[str, Any]] = {
        "rpm": 100.0, "stall_torque": 0.05, "no_load_rpm": 150.0, "lag": 0.05, "gain": 0.1,
    }  # fmt: skip

    def __init__(
        self,
        *,
        at: str | None = None,
        between: tuple[str, str] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__("*", at=at, between=between, name=name, **parameters)
        if self.rpm.value is None:
            raise TermError("DCMotor: give rpm=, the commanded speed")

    def command(self, t: float, sensors: Any, p: Any) -> float:
        """Commanded speed [rad/s]."""
        return (1.0 + p.gain) * p.rpm * RPM

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the joint."""
        self.check_numbers()
        return _BoundDCMotor(self, model)


class _BoundDCMotor(_BoundTwist):
    """The memory is the angle, its rate, the lagged command, the angle without load and the give of its step,
    the angle lost to droop before it, the step's length, and the angle lost to droop by now.

    The joint's spring and the droop over a step are a spring and a damper in series. The damper's end,
    the natural angle at the end of the step, is eliminated: what is left is a softer spring about the
    angle without load (docs, theory: drives).
    """

    def __init__(self, term: DCMotor, model: Model) -> None:
        super().__init__(term, model)
        self.model = model
        self.memory = np.zeros(8)
        self.speed = self.lost = 0.0
        self.loss = np.zeros((3, 3))  # what the droop takes off the spring's stiffness [N m]
        self.give = 0.0  # angle that it gives way by per N m in this step [rad/(N m)]
        self.checked = False

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        self._take(inputs)
        assert self.memory is not None
        before, old = float(self.memory[0]), float(self.memory[2])
        command = self._angle(self.actuator.command(t, sensors, self.p))
        if not math.isfinite(command):
            raise TermError(f"actuator '{self.actuator.name}' commanded {command} at t = {t:g} s")
        lag, self.dt, self.lost = self.p.lag, dt, float(self.memory[7])
        if self.at_rest:
            self.speed, turn, give = old, 0.0, 0.0
        else:
            left = math.exp(-dt / lag) if lag > 0.0 else 0.0
            self.speed = command + (old - command) * left
            turn = command * dt + (old - command) * lag * (1.0 - left)  # of a constant command
            give = self.p.no_load_rpm * RPM / self.p.stall_torque * dt
            ratio = dt / float(self.memory[6]) if self.memory[6] > 0.0 else np.inf
            if (
                ratio < RATIO
            ):  # BDF2 of what droops; the first step, and one much longer than the last, is implicit Euler's
                back = ratio**2 / (1.0 + 2.0 * ratio) * (self.lost - float(self.memory[5]))
                turn, self.lost = turn - back, self.lost + back
                give *= (1.0 + ratio) / (1.0 + 2.0 * ratio)
        if abs(turn) > math.pi:
            raise StepTooLongError(
                f"actuator '{self.actuator.name}' makes {abs(turn) / math.tau:.3g} turns in one time step, "
                f"at t = {t:g} s; less than half a turn is needed: take dt below {dt * math.pi / abs(turn):.2g} s",
                dt * math.pi / abs(turn),
            )
        self.angle = before + turn
        self.rate = turn / dt
        self._turn(model)
        self._soften(model, give)

    def _soften(self, model: Model, give: float) -> None:
        """Take the elimination of the natural angle off the spring's stiffness."""
        if give and not self.checked:
            self._check(model)
        if give == self.give and (self.isotropic or not give):
            return
        self.give = give
        column = self._whole(model)[:, 2] if give else np.zeros(3)
        self.loss = np.outer(column, column) / (column[2] + 1.0 / give) if give else np.zeros((3, 3))
        model.stiffness_version += 1

    def _whole(self, model: Model) -> np.ndarray:
        """Stiffness of the spring without what the droop takes off it: of all terms that make it."""
        s = self.spring
        if s >= model.first_law:  # a hinge, whose law is no quadratic energy
            joints = [b for b in model.bound if isinstance(b, _BoundJoints)]
            scale = sum(float(b.term.values().scale) for b in joints if b.K[s - model.first_law].any())
            return scale * self._stiffness(0.0 if self.isotropic else self.angle)
        parts = [K[s] for b in model.bound if b is not self and (K := b.spring_stiffness(model)) is not None]
        return np.sum(parts, axis=0) if parts else np.zeros((3, 3))

    def _check(self, model: Model) -> None:
        for b in model.bound:
            law = b.term
            if (
                isinstance(law, EnergyModel)
                and law.strain == "twist"
                and self.spring in model.springs_on(law.on)
            ):
                raise TermError(
                    f"motor '{self.actuator.name}' gives way under load, which asks for linear twisting at its joint, "
                    f"not '{law.name}'; leave the joint's edges out of on="
                )
        self.checked = True

    def spring_stiffness(self, model: Model) -> np.ndarray | None:
        if not self.give:
            return None
        out = np.zeros((model.spring_count, 3, 3))
        out[self.spring] = -self.loss
        return out

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        assert self.memory is not None
        if not self.give:
            return np.array(
                [self.angle, self.rate, self.speed, self.angle, 0.0, self.memory[7], self.dt, self.lost]
            )
        # the moment against the twist is minus the torque that the motor delivers
        torque = -self.way * float(ev.stress[self.spring, 2])
        rate = self.speed - self.p.no_load_rpm * RPM / self.p.stall_torque * torque
        yielded = self.give * torque
        return np.array(
            [
                self.angle - yielded,
                rate,
                self.speed,
                self.angle,
                self.give,
                self.memory[7],
                self.dt,
                self.lost + yielded,
            ]
        )

    def restore(self, model: Model, memory: np.ndarray) -> None:
        super().restore(model, memory[:2])
        self.memory, self.speed = memory.copy(), float(memory[2])
        self._soften(model, 0.0)

    def rewind(self) -> None:
        assert self.memory is not None
        self.angle, give = float(self.memory[3]), float(self.memory[4])
        self._turn(self.model)
        self._soften(self.model, give)

    @property
    def yielding(self) -> bool:
        """Whether it gives way, so that its rate is known only when a step has been solved."""
        return self.p.no_load_rpm > 0.0


class SlowCurvature(Actuator):
    """Natural curvature that follows its command with a time constant: pneumatic chambers, SMA wires.

    A command u(t) of the curvature is followed as dk/dt = (u - k) / time_constant, exactly for a command
    that is constant over a step; away from zero with ``time_constant``, and back with ``release``.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    curvature : float or Parameter
        Natural curvature at full drive [1/m].
    time_constant : float or Parameter
        Of filling or heating [s].
    release : float or Parameter, optional
        Of venting or cooling [s]; by default the same.
    axis : {1, 2}
        Which curvature.
    drive : float or Parameter
        Part of the full curvature that is commanded [1].
    gain : float or Parameter
        Relative change of that, of a drive that does not do quite what it is told [1].
    schedule : callable, optional
        A factor on ``drive`` as a function of time.
    """

    default_name = "muscle"
    drives = "curvature"
    source = "natural curvature as actuation, with a lag of first order"
    curvature = Parameter(0.0, unit="1/m", null=0.0, doc="natural curvature at full drive")
    drive = Parameter(1.0, unit="1", null=0.0, doc="commanded part of it")
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of what is commanded")
    time_constant = Parameter(
        0.1, unit="s", bounds=(0, None), kind="shape", doc="time constant of filling or heating"
    )
    release = Parameter(
        None, unit="s", bounds=(0, None), kind="shape", doc="time constant of venting or cooling"
    )
    example: ClassVar[dict[str, Any]] = {"curvature": 8.0, "time_constant": 0.01, "release": 0.03}

    def __init__(
        self,
        on: Any = "*",
        *,
        axis: int = 1,
        schedule: Callable[[float], float] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(on, name=name, **parameters)
        self.schedule = schedule
        if axis not in (1, 2):
            raise TermError(f"SlowCurvature: axis must be 1 or 2, not {axis!r}")
        self.axis = axis

    def command(self, t: float, sensors: Any, p: Any) -> np.ndarray:
        """Commanded curvatures [1/m], shape (2,)."""
        share = p.drive if self.schedule is None else p.drive * self.schedule(t)
        out = np.zeros(2)
        out[self.axis - 1] = (1.0 + p.gain) * p.curvature * share
        return out

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs."""
        self.check_numbers()
        return _BoundSlowCurvature(self, model)


class _BoundSlowCurvature(_BoundCurvature):
    """The natural curvature itself is the memory; at first there is none, and at rest it has arrived."""

    def _set(self, model: Model, t: float, sensors: Any) -> None:
        self._apply(model, 0.0 * self._commanded(t, sensors))

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        self._take(inputs)
        target = self._commanded(t, sensors)
        assert self.memory is not None
        old = self.memory[0]
        if self.at_rest:
            self._apply(model, target)
            self.rate = np.zeros_like(target)
            return
        p = self.p
        fast, slow = p.time_constant, p.time_constant if p.release is None else p.release
        # to the other side: back to zero with one time constant, and on from there with the other
        across = old * target < 0.0
        back = np.where(across, slow * np.log1p(np.abs(old) / np.where(across, np.abs(target), 1.0)), 0.0)
        over = across & (back < dt)
        start, span = np.where(over, 0.0, old), np.where(over, dt - back, dt)
        times = np.where(over | (~across & (np.abs(target) > np.abs(old))), fast, slow)
        held = np.maximum(times, 1e-300)
        self._apply(model, target + (start - target) * np.where(times > 0.0, np.exp(-span / held), 0.0))
        self.dt = dt
        self.rate = self._end_rate(model, dt)
        if model.order > 1:
            self.rate = np.where(times > 0.0, (target - self.offset) / held, self.rate)
