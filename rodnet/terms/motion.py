"""Smooth motions from measurements: splines through noisy positions and orientations."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from rodnet.errors import TermError

# of the noise's variance, that a spline may leave: less, for its coefficients follow a part of the noise, or more, for
# it may be larger than it is said to be
STILL = 1e-6  # of the largest span of a coordinate
SHARES = (1.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.2, 1.5, 2.0)


def smooth_motion(t: np.ndarray, values: np.ndarray, noise: float | None = None) -> SmoothMotion:
    """Return a twice differentiable function of time through noisy samples.

    A cubic smoothing spline (C2): of those whose residual has half to twice the variance of the noise, the one that
    tells samples left out best. Piecewise linear input at 100 Hz would shake a rod; this does not.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Sample times [s], increasing.
    values : ndarray, shape (n, 3)
        Samples [m]; rows with NaN are left out.
    noise : float, optional
        Standard deviation of the white part of the noise [m]; by default estimated (`white_noise`).

    Returns
    -------
    SmoothMotion
        ``f(t) -> (3,)``; outside the samples it continues linearly. ``f - place`` is the motion from a place.

    Raises
    ------
    TermError
        For wrong shapes, times that do not increase, or fewer than 5 valid samples.
    """
    t, values = _valid("smooth_motion", t, values, 3)
    spline = _smoothing_spline(t, values, noise)
    return SmoothMotion(spline, float(t[0]), float(t[-1]))


class SmoothMotion:
    """A spline of time that continues linearly before its first and after its last sample.

    Parameters
    ----------
    spline : scipy.interpolate.BSpline
        From the time [s] to (3,).
    first, last : float
        Times of the samples' ends [s].
    """

    def __init__(self, spline: Any, first: float, last: float) -> None:
        self.spline, self.first, self.last = spline, float(first), float(last)
        self._slope = spline.derivative()

    def __call__(self, time: float) -> np.ndarray:
        """Value at a time, shape (3,)."""
        inside = min(max(time, self.first), self.last)
        value = self.spline(inside)
        return value if inside == time else value + (time - inside) * self._slope(inside)

    def __sub__(self, place: np.ndarray) -> SmoothMotion:
        """The motion from a place, shape (3,): ``hand - hand(0.0)`` is how far it has come."""
        from scipy.interpolate import BSpline

        spline = BSpline(self.spline.t, self.spline.c - np.asarray(place, dtype=float), self.spline.k)
        return SmoothMotion(spline, self.first, self.last)

    def many(self, times: np.ndarray) -> np.ndarray:
        """Values at times, shape (n, 3)."""
        inside = np.clip(times, self.first, self.last)
        return np.asarray(self.spline(inside) + (times - inside)[:, None] * self._slope(inside))


def smooth_rotation(
    t: np.ndarray, rotations: np.ndarray, noise: float | None = None
) -> Callable[[float], np.ndarray]:
    """Return a twice differentiable rotation from the initial orientation through noisy samples.

    A cubic smoothing spline (C2) through the quaternions, normalised.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Sample times [s], increasing.
    rotations : ndarray, shape (n, 3, 3) or (n, 4)
        Measured orientations as rotation matrices, or as quaternions (x, y, z, w) of any length.
    noise : float, optional
        Standard deviation of the measured angles [rad]; by default estimated.

    Returns
    -------
    callable
        ``R(t) -> (3, 3)`` with R = identity at the first sample, for ``PrescribedMotion(orientation=R)``;
        outside the samples it stays.

    Raises
    ------
    TermError
        For wrong shapes, matrices that are not rotations, times that do not increase, or fewer than
        5 valid samples.
    """
    from scipy.spatial.transform import Rotation

    rotations = np.asarray(rotations, dtype=float)
    if rotations.ndim == 3 and rotations.shape[1:] == (3, 3):
        bad = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2)) > 1e-3
        if bad.any() or np.any(np.linalg.det(rotations[~np.isnan(rotations).any(axis=(1, 2))]) < 0):
            raise TermError(f"smooth_rotation: sample {int(np.argmax(bad))} is not a rotation matrix")
        good = np.isfinite(rotations).all(axis=(1, 2))
        quaternions = np.full((len(rotations), 4), np.nan)
        quaternions[good] = Rotation.from_matrix(rotations[good]).as_quat()
    else:
        quaternions = rotations / np.linalg.norm(rotations, axis=-1, keepdims=True)
    t, quaternions = _valid("smooth_rotation", t, quaternions, 4)
    # q and -q are the same rotation: stay on one sheet
    flips = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=1))
    quaternions[1:] *= np.cumprod(np.where(flips == 0.0, 1.0, flips))[:, None]
    # half the angle goes into the quaternion, into three of its four directions
    spline = _smoothing_spline(t, quaternions, None if noise is None else 0.5 * noise * np.sqrt(0.75))
    return SmoothRotation(spline, float(t[0]), float(t[-1]))


class SmoothRotation:
    """A spline of quaternions (x, y, z, w) of any length; it stays before and after its samples.

    Parameters
    ----------
    spline : scipy.interpolate.BSpline
        From the time [s] to (4,).
    first, last : float
        Times of the samples' ends [s].
    """

    def __init__(self, spline: Any, first: float, last: float) -> None:
        self.spline, self.first, self.last = spline, float(first), float(last)
        self._start = tuple(float(v) for v in spline(self.first))

    def __call__(self, time: float) -> np.ndarray:
        """Rotation from the orientation at the first sample, shape (3, 3)."""
        return self._matrix(*(float(v) for v in self.spline(min(max(time, self.first), self.last))))

    def many(self, times: np.ndarray) -> np.ndarray:
        """Rotations at times, shape (n, 3, 3)."""
        return np.moveaxis(self._matrix(*self.spline(np.clip(times, self.first, self.last)).T), -1, 0)

    def _matrix(self, a: Any, b: Any, c: Any, d: Any) -> np.ndarray:
        """Rotation of a quaternion, or of many, from the start; shape (3, 3, ...)."""
        e, f, g, h = self._start
        # the product with the inverse of the start; a search asks for many, one by one
        x, y = a * h - d * e - b * g + c * f, b * h - d * f - c * e + a * g
        z, w = c * h - d * g - a * f + b * e, d * h + a * e + b * f + c * g
        s = 2.0 / (x * x + y * y + z * z + w * w)
        return np.array(
            [
                [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
                [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
                [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
            ]
        )


def _valid(owner: str, t: np.ndarray, values: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Check samples and leave out those with NaN."""
    t, values = np.asarray(t, dtype=float), np.asarray(values, dtype=float)
    if t.ndim != 1 or values.shape != (len(t), width):
        raise TermError(
            f"{owner} needs t of shape (n,) and values (n, {width}), got {t.shape} and {values.shape}"
        )
    good = np.all(np.isfinite(values), axis=1) & np.isfinite(t)
    t, values = t[good], values[good]
    if len(t) < 5:
        raise TermError(f"{owner} needs at least 5 valid samples, got {len(t)}")
    if np.any(np.diff(t) <= 0):
        raise TermError(f"{owner}: the sample times must increase")
    return t, values


def _smoothing_spline(t: np.ndarray, values: np.ndarray, noise: float | None) -> Any:
    """Cubic vector spline through samples with noise of a standard deviation."""
    if noise is None:
        noise = white_noise(values)
    if not (np.isfinite(noise) and noise >= 0.0):
        raise TermError(f"noise = {noise!r} must be a standard deviation, zero or more")
    return _splined(t.tobytes(), values.tobytes(), values.shape, float(noise))


@lru_cache(maxsize=256)
def _splined(times: bytes, samples: bytes, shape: tuple[int, int], noise: float) -> Any:
    """The spline of given numbers: a search builds the robot of one recording again and again."""
    from scipy.interpolate import BSpline, make_splprep

    t, values = np.frombuffer(times), np.frombuffer(samples).reshape(shape)
    with warnings.catch_warnings():
        # its search for the residual may end a little off: what it has found then is as good
        warnings.simplefilter("ignore", RuntimeWarning)
        size = len(values) * int(_noisy(values).sum())
        fits = [make_splprep(values.T, u=t, s=share * size * noise**2)[0] for share in SHARES]
    fit = min(fits, key=lambda fit: _cross_validated(fit, t, values))
    # releases of scipy differ in how they lay coefficients out, and of four quaternions both ways look alike
    count = len(fit.t) - fit.k - 1
    either = [BSpline(fit.t, c, fit.k) for c in (fit.c, fit.c.T) if len(c) == count]
    return min(either, key=lambda one: float(np.abs(one(t) - fit(t).T).max()))


def _cross_validated(fit: Any, t: np.ndarray, values: np.ndarray) -> float:
    """Mean square by which a spline errs about samples left out, as its coefficients tell (Craven & Wahba 1979)."""
    left = len(t) - (len(fit.t) - fit.k - 1)
    return float(np.mean((fit(t).T - values) ** 2)) * (len(t) / left) ** 2 if left > 0 else np.inf


def white_noise(values: np.ndarray) -> float:
    """Standard deviation of white noise on smooth samples, from their third differences [m].

    Parameters
    ----------
    values : ndarray, shape (n, k)
        Samples at equal steps of time.
    """
    sigmas = _rough(values)[_noisy(values)]
    return float(np.sqrt(np.mean(sigmas**2))) if len(sigmas) else 0.0


def _rough(values: np.ndarray) -> np.ndarray:
    """Standard deviation of white noise in each coordinate, shape (k,)."""
    # the third difference of white noise has 20 times its variance; the median ignores outliers
    return np.asarray(np.median(np.abs(np.diff(values, n=3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0))


def _noisy(values: np.ndarray) -> np.ndarray:
    """Which coordinates are not constant, shape (k,) of bool: what was not measured has no noise."""
    return np.asarray((spans := np.ptp(values, axis=0)) > STILL * spans.max(initial=0.0))
