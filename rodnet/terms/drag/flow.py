"""Background flows: the medium's own velocity, which any drag law sees as relative velocity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rodnet.errors import TermError
from rodnet.kinematics.frames import cross

_STEP = np.cbrt(np.finfo(float).eps)


@runtime_checkable
class Flow(Protocol):
    """A velocity field; one's own need these two methods, which must be pure."""

    def velocity(self, x: np.ndarray, t: float) -> np.ndarray:
        """Velocity [m/s] at the places ``x`` (n, 3) [m], shape (n, 3)."""

    def gradient(self, x: np.ndarray, t: float) -> np.ndarray:
        """Gradient d u_i / d x_j [1/s], shape (n, 3, 3)."""


def _vector(owner: str, value: Any, unit: str = "m/s") -> np.ndarray:
    vector = np.asarray(value, dtype=float)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise TermError(f"{owner} = {value!r} must be a finite vector (3,) [{unit}]")
    return vector


def direction_of(owner: str, value: Any) -> np.ndarray:
    """Return a vector (3,) over its length; raise `TermError` if it is none, or zero."""
    vector = _vector(owner, value, "1")
    length = np.linalg.norm(vector)
    if not length > 0:
        raise TermError(f"{owner} must not be zero")
    return vector / length


@dataclass(frozen=True, eq=False)
class UniformFlow:
    """A current, u = U everywhere.

    Parameters
    ----------
    current : (3,)
        Velocity U [m/s].
    """

    current: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "current", _vector("UniformFlow: current", self.current))

    def velocity(self, x: np.ndarray, t: float) -> np.ndarray:
        """Velocity [m/s], shape (n, 3)."""
        return np.broadcast_to(self.current, x.shape)

    def gradient(self, x: np.ndarray, t: float) -> np.ndarray:
        """Zeros, shape (n, 3, 3)."""
        return np.zeros((len(x), 3, 3))


@dataclass(frozen=True, eq=False)
class ShearFlow:
    """A steady linear shear, u = rate ((x - origin) . across) along.

    Parameters
    ----------
    rate : float
        Shear rate [1/s].
    along, across : (3,)
        Directions of the flow and in which it changes; their lengths do not matter.
    origin : (3,)
        A place where it vanishes [m].
    """

    rate: float
    along: Any = (1.0, 0.0, 0.0)
    across: Any = (0.0, 0.0, 1.0)
    origin: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not np.isfinite(self.rate):
            raise TermError(f"ShearFlow: rate = {self.rate!r} must be finite [1/s]")
        for name in ("along", "across"):
            object.__setattr__(self, name, direction_of(f"ShearFlow: {name}", getattr(self, name)))
        object.__setattr__(self, "origin", _vector("ShearFlow: origin", self.origin, "m"))
        if abs(self.along @ self.across) > 1e-9:
            raise TermError(
                "ShearFlow: along and across must be at right angles, or the medium would pile up"
            )

    def velocity(self, x: np.ndarray, t: float) -> np.ndarray:
        """Velocity [m/s], shape (n, 3)."""
        return self.rate * ((x - self.origin) @ self.across)[:, None] * self.along

    def gradient(self, x: np.ndarray, t: float) -> np.ndarray:
        """Gradient [1/s], shape (n, 3, 3)."""
        return np.broadcast_to(self.rate * np.outer(self.along, self.across), (len(x), 3, 3))


@dataclass(frozen=True, eq=False)
class VortexFlow:
    """A vortex with a core (Lamb, Oseen): u = circulation (1 - exp(-d^2/core^2)) / (2 pi d) about an axis.

    Inside the core it turns like a solid body, outside like a point vortex; d is the distance to the axis.

    Parameters
    ----------
    circulation : float
        Circulation [m^2/s], by the right hand about the axis.
    core : float
        Radius of the core [m].
    axis : (3,)
        Direction of the axis.
    centre : (3,)
        A point of the axis [m].
    """

    circulation: float
    core: float
    axis: Any = (0.0, 0.0, 1.0)
    centre: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not np.isfinite(self.circulation):
            raise TermError(f"VortexFlow: circulation = {self.circulation!r} must be finite [m^2/s]")
        if not (np.isfinite(self.core) and self.core > 0):
            raise TermError(f"VortexFlow: core = {self.core!r} must be a positive radius [m]")
        object.__setattr__(self, "axis", direction_of("VortexFlow: axis", self.axis))
        object.__setattr__(self, "centre", _vector("VortexFlow: centre", self.centre, "m"))

    def _spin(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arms from the axis, the angular velocity there, and its derivative by half the square of the arm."""
        arm = x - self.centre
        arm = arm - (arm @ self.axis)[:, None] * self.axis
        s = np.sum(arm**2, axis=1) / self.core**2
        small = s < 1e-3  # where the closed form would lose digits
        safe = np.where(small, 1.0, s)
        lost = -np.expm1(-safe)
        shape = np.where(small, 1.0 - s / 2.0 + s**2 / 6.0, lost / safe)
        slope = np.where(small, -0.5 + s / 3.0 - s**2 / 8.0, (np.exp(-safe) - lost / safe) / safe)
        rate = self.circulation / (2.0 * np.pi * self.core**2)
        return arm, rate * shape, 2.0 * rate / self.core**2 * slope

    def velocity(self, x: np.ndarray, t: float) -> np.ndarray:
        """Velocity [m/s], shape (n, 3)."""
        arm, spin, _ = self._spin(x)
        return spin[:, None] * cross(np.broadcast_to(self.axis, arm.shape), arm)

    def gradient(self, x: np.ndarray, t: float) -> np.ndarray:
        """Gradient [1/s], shape (n, 3, 3)."""
        arm, spin, slope = self._spin(x)
        a, b, c = self.axis
        turn = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        around = arm @ turn.T
        return spin[:, None, None] * turn + slope[:, None, None] * around[:, :, None] * arm[:, None, :]


@dataclass(frozen=True, eq=False)
class _Function:
    """A velocity field given as a function; its gradient is differenced."""

    field: Callable[[np.ndarray, float], np.ndarray]
    step: float  # of differences [m]

    def velocity(self, x: np.ndarray, t: float) -> np.ndarray:
        u = np.asarray(self.field(x, t), dtype=float)
        if u.shape != x.shape:
            raise TermError(
                f"flow(x, t) must return velocities of the shape of x, {x.shape}, but returns {u.shape}"
            )
        return u

    def gradient(self, x: np.ndarray, t: float) -> np.ndarray:
        out = np.empty((len(x), 3, 3))
        for k in range(3):
            h = self.step * np.eye(3)[k]
            out[:, :, k] = (self.velocity(x + h, t) - self.velocity(x - h, t)) / (2.0 * self.step)
        return out


def as_flow(flow: Any, owner: str, length: float = 1e-2) -> Flow:
    """Return a flow: as it is, from a current (3,), or from a function ``flow(x, t)``.

    Parameters
    ----------
    flow : Flow, (3,) or callable
        Callables take places (n, 3) [m] and a time [s] and return velocities (n, 3) [m/s].
    owner : str
        Whose it is, for messages.
    length : float
        Over which a function varies [m], for its differences.

    Raises
    ------
    TermError
        For anything else.
    """
    if isinstance(flow, Flow) and not isinstance(flow, type):
        return flow
    if callable(flow) and not isinstance(flow, type):
        return _Function(flow, _STEP * length)
    try:
        return UniformFlow(flow)
    except (TermError, TypeError, ValueError):
        raise TermError(
            f"{owner}: flow = {flow!r} must be a flow such as rn.ShearFlow(rate=1.0), a current (3,) [m/s], or a "
            "function flow(x, t) of places (n, 3) that returns velocities (n, 3)"
        ) from None
