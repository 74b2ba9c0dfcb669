"""Actuators: natural twists and curvatures that change with time, and motors of one's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import StepTooLongError, TermError
from rodnet.graph.joints import FLIP, stiffness
from rodnet.parameters import Parameter
from rodnet.solve.joint_frames import find_motor
from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model

RPM = 2.0 * math.pi / 60.0  # rad/s per revolution per minute
_QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # a turn by -90 degrees about z


class Actuator(Term):
    """A command that changes a natural shape, evaluated once per time step (of each stage, where it has several).

    Subclasses set ``drives`` and implement ``command(self, t, sensors, p)``, a pure function of the
    time at the end of the step, of what the sensors measured at its beginning, and of the parameters.

    Attributes
    ----------
    drives : {"twist", "twist_rate", "curvature"}
        ``"twist"``: natural angle [rad] of a motor joint; ``"twist_rate"``: its rate [rad/s],
        integrated by the framework; ``"curvature"``: natural curvature (kappa1, kappa2) [1/m],
        shape (2,) or (n, 2), of the springs that ``on`` names, added to the natural shape.

    Parameters
    ----------
    at : str
        The node of a motor joint (``drives`` a twist); the rotor is the later edge of the rod.
    between : (str, str), optional
        Stator and rotor edge, where a node has more than one pair.
    on : str or sequence of str
        The rods whose curvature is driven.
    """

    kind = "actuator"
    default_name = "actuator"
    drives: ClassVar[str] = "twist"

    def __init__(
        self,
        on: Any = "*",
        *,
        at: str | None = None,
        between: tuple[str, str] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(on, name=name, **parameters)
        self.at, self.between = at, between

    def command(self, t: float, sensors: Any, p: Any) -> Any:
        """Natural twist [rad], its rate [rad/s], or natural curvatures [1/m]; see ``drives``.

        ``sensors`` is a mapping of the simulation's sensor readings at the beginning of the step (all
        zero before the first one); curvature actuators also find there ``"s"``, the arc
        length of their springs along the rod [m].
        """
        raise TermError(f"{type(self).__name__} must implement command(self, t, sensors, p)")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the joint or to the springs.

        Raises
        ------
        TermError
            If the node has no spring, or more than one and ``between`` is not given.
        """
        if self.drives not in ("twist", "twist_rate", "curvature"):
            raise TermError(
                f"{type(self).__name__}.drives = {self.drives!r}; it is 'twist', 'twist_rate' or 'curvature'"
            )
        from rodnet.terms.driven_curvature import _BoundCurvature

        return _BoundCurvature(self, model) if self.drives == "curvature" else _BoundTwist(self, model)


class _BoundActuator(BoundTerm):
    """Parameters that inputs may override between steps."""

    def __init__(self, term: Actuator, sites: int | None = None) -> None:
        super().__init__(term)
        self.actuator = term
        self.p = term.values(sites)
        self.commands = {f"{term.name}.{name}": (name, p) for name, p in term.declared().items()}

    def _take(self, inputs: dict[str, Any]) -> None:
        if not inputs:
            return
        for key in inputs.keys() & self.commands.keys():
            name, parameter = self.commands[key]
            setattr(self.p, name, parameter.with_value(inputs[key]).value)


class _BoundTwist(_BoundActuator):
    """A joint whose natural twist is driven; the memory is the angle at the last accepted state [rad]."""

    def __init__(self, term: Actuator, model: Model) -> None:
        from rodnet.kinematics.turn_kernels import turn_about

        super().__init__(term)
        self.turn_about = turn_about
        self.spring, self.sign = _motor_spring(term, model)
        # a hinge's axis says in which sense its angle counts; of other joints either body may turn the other way
        self.way = self.sign if self.spring >= model.first_law else 1.0
        self.memory = np.zeros(2)  # angle [rad] and its rate [rad/s]
        if term.drives == "twist":
            self.memory[0] = self._angle(term.command(0.0, model.no_sensors, self.p))
            if not math.isfinite(self.memory[0]):
                raise TermError(f"actuator '{term.name}' commands {self.memory[0]} at t = 0")
        self.angle, self.rate = (float(m) for m in self.memory)
        model.own_frames()
        s = slice(self.spring, self.spring + 1)
        self.base = model.Q1[s].copy(), model.Q2[s].copy()
        # rotor frames Q(angle) = flip Rz(-angle) flip^T Q(0), for either direction of the stencil
        flip = np.eye(3) if (model.sign2 if self.sign > 0 else model.sign1)[s] > 0 else FLIP
        rotor = self.base[1] if self.sign > 0 else self.base[0]
        parts = np.diag([1.0, 1.0, 0.0]), self.sign * _QUARTER, np.diag([0.0, 0.0, 1.0])
        self.parts = np.concatenate([flip @ part @ flip.T @ rotor for part in parts])
        self.compliance = model.compliance1[s], model.compliance2[s]
        self.weight = model.spring_weight[s]
        self.isotropic = all(abs(c[0, 0] - c[0, 1]) <= 1e-12 * c[0].max() for c in self.compliance)
        self._turn(model)

    def _angle(self, command: Any) -> float:
        """Return what was commanded, or its rate, as the number it must be."""
        value = np.asarray(command, dtype=float)
        if value.ndim:
            raise TermError(f"actuator '{self.actuator.name}' must command one number, not {command!r}")
        return float(value)

    def _stiffness(self, angle: float) -> np.ndarray:
        """Stiffness of the spring with the natural frame turned about the rotor's own axis."""
        first, second = (base.copy() for base in self.base)
        self.turn_about(self.parts, angle, 0, second if self.sign > 0 else first)
        return stiffness(first, second, *self.compliance, self.weight)[0]

    def _turn(self, model: Model) -> None:
        s = self.spring
        model.driven[s] = self.way * self.angle
        self.turn_about(self.parts, self.angle, s, model.Q2 if self.sign > 0 else model.Q1)
        if not self.isotropic:
            model.spring_stiffness[s] = self._stiffness(self.angle)
            model.stiffness_version += 1

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        self._take(inputs)
        value = self.actuator.command(t, sensors, self.p)
        if type(value) is not float:
            value = self._angle(value)
        if not math.isfinite(value):
            raise TermError(f"actuator '{self.actuator.name}' commanded {value} at t = {t:g} s")
        before = float(self.memory[0])  # type: ignore[index]
        self.angle = value if self.actuator.drives == "twist" else before + value * dt * (not self.at_rest)
        self.rate = 0.0 if self.at_rest else (self.angle - before) / dt
        if abs(self.rate) * dt > math.pi:  # the spring knows its natural angle up to whole turns only
            raise StepTooLongError(
                f"actuator '{self.actuator.name}' makes {abs(self.rate) * dt / math.tau:.3g} turns in one time step, "
                f"at t = {t:g} s; less than half a turn is needed: take dt below {math.pi / abs(self.rate):.2g} s",
                math.pi / abs(self.rate),
            )
        self._turn(model)

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        return np.array([self.angle, self.rate])

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory = memory

    def restore(self, model: Model, memory: np.ndarray) -> None:
        super().restore(model, memory)
        self.angle, self.rate = (float(m) for m in memory)
        self._turn(model)

    def power(self, ev: Evaluation) -> float:
        """Power that the motor puts in: dE/d(natural angle) times its rate [W]."""
        s = self.spring
        moment = ev.spring_moments()[s]
        edge = ev.model.edge2[s] if self.sign > 0 else ev.model.edge1[s]
        side = ev.model.sign2[s] if self.sign > 0 else ev.model.sign1[s]
        torque = -side * float(moment @ ev.T[edge])
        if not self.isotropic:  # the soft direction of an elliptic section is turned, too
            strain = ev.eps[s] - ev.model.eps0[s]
            change = self._stiffness(self.angle + 1e-4) - self._stiffness(self.angle - 1e-4)
            torque += float(strain @ change @ strain) / 4e-4
        return torque * self.rate


def _motor_spring(term: Actuator, model: Model) -> tuple[int, float]:
    """Return the spring of a motor joint and +1 if its second edge is the rotor, else -1."""
    graph = model.graph
    if term.between is not None:
        stator, rotor = (int(graph.edge_indices(text)[0]) for text in term.between)
        hinge = find_motor(model.joint_laws, model.first_law, -1, (stator, rotor))
        if hinge is not None:
            return hinge
        for s in range(model.spring_count):
            pair = (int(model.edge1[s]), int(model.edge2[s]))
            if pair in ((stator, rotor), (rotor, stator)):
                return s, 1.0 if pair == (stator, rotor) else -1.0
        raise TermError(f"motor '{term.name}': no spring joins {term.between[0]} and {term.between[1]}")
    if term.at is None:
        raise TermError(f"motor '{term.name}': say where it is, at='rod:3' or between=('rod:2-3', 'rod:3-4')")
    node = graph.node(term.at)
    hinge = find_motor(model.joint_laws, model.first_law, node, None)
    if hinge is not None:
        return hinge
    if any(frames.joint.node == node for frames in model.joints):
        raise TermError(
            f"motor '{term.name}' at '{term.at}': it can drive a hinge that has a stiffness, that of its own "
            "shaft; give fig.joint(..., kind='hinge', stiffness=), or rodnet.Hinge(axis=, stiffness=)"
        )
    found = np.flatnonzero(model.spring_node == node)
    if len(found) == 0:
        raise TermError(
            f"motor '{term.name}' at '{term.at}': that node has no spring to drive (it ends a rod, or is clamped); "
            "choose a node between two edges"
        )
    if len(found) > 1:
        pairs = [(graph.edge_name(model.edge1[s]), graph.edge_name(model.edge2[s])) for s in found]
        names = [f"('{stator}', '{rotor}')" for stator, rotor in pairs]
        raise TermError(
            f"motor '{term.name}' at '{term.at}': that node has {len(found)} springs; "
            f"say which, between={' or '.join(names)}"
        )
    return int(found[0]), 1.0


class Motor(Actuator):
    """A motor: the natural twist of its joint grows with time (paper, actuation).

    Positive speed turns the rotor (the later edge) against the stator by the right hand about the
    direction from stator to rotor.

    Parameters
    ----------
    at : str
        The node between stator and rotor; or ``between=(stator edge, rotor edge)``.
    rpm : float or Parameter
        Speed [rpm].
    angle : callable, optional
        Natural twist as any function of time [rad], instead of ``rpm``.
    gain : float or Parameter
        Relative change of either, of a motor that does not do quite what it is told [1].
    """

    default_name = "motor"
    source = "Du et al., natural twist of the head node, omega_T t"
    rpm = Parameter(None, unit="rpm", doc="speed of the rotor against the stator")
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of what is commanded")
    example: ClassVar[dict[str, Any]] = {"rpm": 100.0, "gain": 0.1}

    def __init__(
        self,
        *,
        at: str | None = None,
        between: tuple[str, str] | None = None,
        angle: Callable[[float], float] | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__("*", at=at, between=between, name=name, **parameters)
        self.angle = angle
        if (angle is None) == (self.rpm.value is None):
            raise TermError("Motor: give rpm= or angle=")
        if angle is not None and not callable(angle):
            raise TermError(
                f"Motor: angle must be a function of time, got {angle!r}; fixed: lambda t: {angle!r}"
            )

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the joint."""
        if np.ndim(self.rpm.value):
            raise TermError(
                f"motor '{self.name}' turns one joint: rpm must be one number, not {self.rpm.value}"
            )
        return super().bind(model)

    @property
    def drives(self) -> str:  # type: ignore[override]
        """Rate for ``rpm``, angle for ``angle``."""
        return "twist_rate" if self.angle is None else "twist"

    def command(self, t: float, sensors: Any, p: Any) -> float:
        """Rate [rad/s] or angle [rad]."""
        return (1.0 + p.gain) * (p.rpm * RPM if self.angle is None else self.angle(t))


class CurvatureWave(Actuator):
    """A travelling wave of natural curvature, kappa0 = (1 + gain) A sin(2 pi (f (t - lag) - s / lambda) + phase).

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    amplitude, wavelength, frequency, phase : float or Parameter
        [1/m], [m], [Hz], [rad].
    gain : float or Parameter
        Relative change of the amplitude, of a drive that does not do quite what it is told [1].
    lag : float or Parameter
        By how much it runs late [s].
    axis : {1, 2}
        Which curvature.
    """

    default_name = "wave"
    drives = "curvature"
    source = "natural curvature as actuation (Du et al., actuation; undulatory swimmers)"
    amplitude = Parameter(10.0, unit="1/m", null=0.0, doc="amplitude of the natural curvature")
    wavelength = Parameter(0.1, unit="m", bounds=(1e-9, None), kind="shape", doc="wavelength along the rod")
    frequency = Parameter(1.0, unit="Hz", kind="shape", doc="frequency")
    phase = Parameter(0.0, unit="rad", kind="shape", doc="phase at s = 0, t = 0")
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of what is commanded")
    lag = Parameter(0.0, unit="s", null=0.0, doc="by how much it runs late")

    def __init__(self, on: Any = "*", *, axis: int = 1, name: str | None = None, **parameters: Any) -> None:
        super().__init__(on, name=name, **parameters)
        if axis not in (1, 2):
            raise TermError(f"CurvatureWave: axis must be 1 or 2, not {axis!r}")
        self.axis = axis

    def command(self, t: float, sensors: Any, p: Any) -> np.ndarray:
        """Natural curvatures [1/m], shape (n, 2)."""
        s = sensors["s"]
        out = np.zeros((len(s), 2))
        wave = np.sin(2.0 * np.pi * (p.frequency * (t - p.lag) - s / p.wavelength) + p.phase)
        out[:, self.axis - 1] = (1.0 + p.gain) * p.amplitude * wave
        return out
