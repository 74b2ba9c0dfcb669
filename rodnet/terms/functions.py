"""Functions of time that constraints follow: remembered, as rotations, directions, frames that do not spin."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from rodnet.errors import TermError
from rodnet.kinematics.frames import transport
from rodnet.terms.motion import SmoothMotion, SmoothRotation


def as_numbers(value: Any) -> np.ndarray:
    """Return an array of floats."""
    return np.asarray(value, dtype=float)


class Remembered:
    """A function of time that keeps its values: one run after another asks for the same times.

    Parameters
    ----------
    function : callable
        A pure function; what it returns must not be changed.
    convert : callable
        Of what it returns, to what is kept.
    """

    MOST = 100_000  # values

    def __init__(self, function: Callable[[float], Any], convert: Callable[[Any], Any] = as_numbers) -> None:
        self.function, self.convert = function, convert
        self._known: dict[float, Any] = {}

    def __call__(self, t: float) -> Any:
        found = self._known.get(t)
        if found is None:
            if len(self._known) >= self.MOST:
                self._known.clear()
            found = self._known[t] = self.convert(self.function(t))
        return found

    @property
    def splined(self) -> bool:
        """Whether it is a spline, which knows many times at once; what inherits one may move otherwise."""
        return type(self.function) in (SmoothMotion, SmoothRotation)

    def many(self, times: np.ndarray) -> np.ndarray:
        """Values at many times; a function but a spline is asked for one after another."""
        return self.function.many(times) if self.splined else np.stack([self(float(t)) for t in times])  # type: ignore[attr-defined]

    def __reduce__(self) -> Any:  # other processes begin anew
        return Remembered, (self.function, self.convert)


def rotation_matrix(value: Any, owner: str = "an orientation") -> np.ndarray:
    """Return an orientation as a rotation matrix, shape (3, 3).

    Parameters
    ----------
    value : array_like or scipy.spatial.transform.Rotation
        A matrix (3, 3), or a quaternion (x, y, z, w) of any length, shape (4,).
    owner : str
        What the orientation is of, for messages.

    Raises
    ------
    TermError
        If it is neither, or a quaternion without direction.
    """
    from scipy.spatial.transform import Rotation

    if isinstance(value, Rotation):
        return value.as_matrix()
    array = np.asarray(value, dtype=float)
    if array.shape == (3, 3):
        return array
    if array.shape != (4,):
        raise TermError(
            f"{owner} must be a rotation matrix (3, 3), a quaternion (x, y, z, w) or a scipy Rotation, "
            f"not of shape {array.shape}"
        )
    if not np.linalg.norm(array) > 0.0:
        raise TermError(f"{owner} is the quaternion {array}, which has no direction")
    return Rotation.from_quat(array).as_matrix()


class UnitDirection:
    """A unit vector as a function of time.

    Parameters
    ----------
    tangent : callable
        Of any length but zero; with a method ``many`` it is asked for all times at once.
    """

    def __init__(self, tangent: Callable[[float], np.ndarray]) -> None:
        self.tangent = tangent

    def __call__(self, t: float) -> np.ndarray:
        """The unit vector at a time, shape (3,)."""
        value = np.asarray(self.tangent(t), dtype=float)
        norm = math.sqrt(float(value @ value))
        if not norm > 0:
            raise TermError(f"the direction of a grasp vanishes at t = {t:g} s")
        return value / norm

    def many(self, times: np.ndarray) -> np.ndarray:
        """The unit vectors at times, shape (n, 3)."""
        together = getattr(self.tangent, "many", None)
        if together is None:
            return np.array([self(float(t)) for t in times]).reshape(-1, 3)
        values = together(times)
        norms = np.linalg.norm(values, axis=1)
        if not np.all(norms > 0.0):
            raise TermError(f"the direction of a grasp vanishes at t = {times[np.argmin(norms)]:g} s")
        return np.asarray(values / norms[:, None])


class NoSpinFrame:
    """Orientation of a body whose axis follows a direction without spinning about it.

    The rotation R(t) carries the initial orientation along the path of the axis by parallel
    transport over steps much shorter than the simulation's, so that the frame does not depend on dt.

    Parameters
    ----------
    direction : callable
        Unit axis as a function of time.
    duration : float
        Time up to which the path is prepared at once [s]; later it grows as it is asked for.
    step : float
        Transport step [s].
    """

    def __init__(self, direction: Callable[[float], np.ndarray], duration: float, step: float = 1e-3) -> None:
        self.direction, self.step = direction, step
        self.times = np.zeros(1)
        self.axes, self.frames = np.array([direction(0.0)]), np.eye(3)[None]
        self._extend(duration)

    def _extend(self, until: float) -> None:
        """Prepare the path up to a time; always the same steps, so that nothing depends on who asked."""
        first = len(self.times) - 1
        count = max(int(np.ceil(until / self.step - 1e-9)) - first, 0)
        times = self.step * np.arange(first + 1, first + 1 + count)
        known = getattr(self.direction, "function", self.direction)  # of what is remembered
        many = getattr(known, "many", None)
        axes = (np.array([self.direction(t) for t in times]) if many is None else many(times)).reshape(-1, 3)
        frames, frame = np.empty((count, 3, 3)), self.frames[-1]
        before = np.vstack([self.axes[-1:], axes])[:count]
        # the smallest rotations from one axis to the next, their columns those of the unit vectors
        turns = transport(np.eye(3), before[:, None], axes[:, None])
        for k in range(count):
            frames[k] = frame = turns[k].T @ frame
        self.times = np.concatenate([self.times, times])
        self.axes, self.frames = np.vstack([self.axes, axes]), np.concatenate([self.frames, frames])

    def __call__(self, t: float) -> np.ndarray:
        """Rotation matrix (3, 3) from the orientation at t = 0."""
        if t > self.times[-1] + self.step:
            self._extend(1.5 * t)
        k = min(max(int(np.searchsorted(self.times, t, side="right")) - 1, 0), len(self.times) - 1)
        (a, b, c), (x, y, z) = self.axes[k].tolist(), self.direction(t).tolist()
        # the smallest rotation between the two axes in plain numbers: it is asked for at every stage
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        along = a * x + b * y + c * z
        q = np.array((u, v, w))
        turn = np.array(((along, -w, v), (w, along, -u), (-v, u, along)))
        return (turn + q[:, None] * q / (1.0 + along)) @ self.frames[k]
