"""Models without physics that are fitted to recordings, for a model with physics to beat.

Two for markers whose motion comes to rest. The file of a fitted model keeps them (`Fitted.baselines`), so that they
stand beside it also where the recordings that it was fitted to are not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from rodnet.errors import CaseError, RecordingError
from rodnet.inference.naive import START
from rodnet.recordings.recording import Recording

STEPS = (0.02, 0.03, 0.05)  # of a linear law that are tried [s]
ERRORS = (1e-6, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)  # of its states, likewise [m]


@dataclass(frozen=True)
class RestPose:
    """Markers stay where they usually come to rest.

    Parameters
    ----------
    pose : array_like, shape (M, 3)
        Positions [m].
    """

    pose: Any
    model: ClassVar[str] = "rest pose"

    @classmethod
    def fit(cls, train: Sequence[Recording]) -> RestPose:
        """Take the median of the last known positions in recordings.

        Raises
        ------
        RecordingError
            If there is no recording, or a marker is never seen.
        """
        return cls(_rest(train))

    def __call__(self, rec: Recording) -> list[np.ndarray]:
        """Predict the markers of a recording."""
        return [np.broadcast_to(np.asarray(self.pose, dtype=float), rec.markers.shape)]


@dataclass(frozen=True)
class LinearMotion:
    """Markers follow a linear law of second order, y(t + h) = A y(t) + B y(t - h) + c.

    y are the displacements from a rest pose of all markers. A prediction starts at rest from the first frame.

    Parameters
    ----------
    pose : array_like, shape (M, 3)
        Rest pose [m].
    now, past : array_like, shape (3 M, 3 M)
        A and B.
    drift : array_like, shape (3 M,)
        c [m].
    step : float
        h [s]; between, positions are interpolated by cubic splines.
    """

    pose: Any
    now: Any
    past: Any
    drift: Any
    step: float
    model: ClassVar[str] = "linear motion"

    @classmethod
    def fit(cls, train: Sequence[Recording]) -> LinearMotion:
        """Fit by least squares, with a ridge that stands for errors of the states.

        Of several steps and ridges those are taken with which the same recordings are predicted best.

        Raises
        ------
        RecordingError
            If there is no recording, all are too short, a marker is never seen, or no law is stable.
        """
        rest, found = _rest(train), []
        for step in STEPS:
            states = [(_resampled(rec, step) - rest).reshape(-1, rest.size) for rec in train]
            past, now, after = (np.vstack([y[k : max(len(y) - 2 + k, 0)] for y in states]) for k in range(3))
            seen = np.isfinite(np.hstack([past, now, after])).all(axis=1)
            past, now, after = past[seen], now[seen], after[seen]
            if not len(now):
                continue
            size = float(np.sqrt((now**2).mean())) or 1.0
            known = np.hstack([now, past, np.full((len(now), 1), size)])
            for error in ERRORS:
                ridge = error**2 * len(known) * np.eye(known.shape[1])
                law = np.linalg.solve(known.T @ known + ridge, known.T @ after)
                A, B, c = law[: rest.size].T, law[rest.size : -1].T, size * law[-1]
                found.append(cls(rest, A, B, c, step))
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable law
            off = [float(np.mean([_off(one, rec) for rec in train])) for one in found]
        if not np.isfinite(off).any():
            raise RecordingError("no linear law predicts these recordings: they are too short, or grow")
        return found[int(np.nanargmin(off))]

    def __call__(self, rec: Recording) -> list[np.ndarray]:
        """Predict the markers of a recording."""
        pose, A, B, c = (np.asarray(v, dtype=float) for v in (self.pose, self.now, self.past, self.drift))
        known = np.isfinite(rec.trusted[0])
        start = np.where(known, rec.trusted[0] - pose, 0.0).ravel()
        # at rest in the beginning: the state after the first is also that before it
        after = np.linalg.lstsq(np.eye(len(c)) - B, A @ start + c, rcond=None)[0]
        states = [after, start, after]
        while len(states) < rec.duration / self.step + 4:
            states.append(A @ states[-1] + B @ states[-2] + c)
        times = self.step * (np.arange(len(states)) - 1)
        if not np.isfinite(states[-1]).all():
            return [np.full(rec.markers.shape, np.inf)]
        return [pose + CubicSpline(times, states)(rec.t - rec.t[0]).reshape(-1, *pose.shape)]


MODELS: dict[str, Any] = {one.model: one for one in (RestPose, LinearMotion)}


def stored(models: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return those of a case's simpler models that a file can keep, by name."""
    return {
        name: {"model": one.model, **{f.name: getattr(one, f.name) for f in fields(one)}}
        for name, one in models.items()
        if isinstance(one, RestPose | LinearMotion)
    }


def restored(kept: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Make simpler models of what `stored` returned.

    Raises
    ------
    CaseError
        If it is of no kind that there is, or not of numbers.
    """
    found = {}
    for name, entry in kept.items():
        try:
            given = dict(entry)
            one = MODELS[given.pop("model")](**given)
            for field in fields(one):
                if not np.isfinite(np.asarray(getattr(one, field.name), dtype=float)).all():
                    raise ValueError(field.name)
        except (KeyError, TypeError, ValueError):
            raise CaseError(f"the fitted model's baseline '{name}' cannot be read; calibrate again") from None
        found[name] = one
    return found


def _rest(train: Sequence[Recording]) -> np.ndarray:
    """Median of the last known positions, shape (M, 3)."""
    if not len(train):
        raise RecordingError("there are no recordings to fit simpler models to")
    last = []
    for rec in train:
        known = np.isfinite(rec.trusted).all(axis=2)
        if not known.any(axis=0).all():
            raise rec.error(f"marker {int(np.argmin(known.any(axis=0)))} is never trusted")
        rows = len(known) - 1 - np.argmax(known[::-1], axis=0)
        last.append(rec.trusted[rows, np.arange(len(rows))])
    return np.asarray(np.median(last, axis=0))


def _resampled(rec: Recording, step: float) -> np.ndarray:
    """Positions at multiples of a step, interpolated between frames, NaN beside lost ones, shape (n, M, 3)."""
    t = rec.t - rec.t[0]
    times = np.arange(0.0, t[-1] + 1e-9, step)
    columns = [np.interp(times, t, column) for column in rec.trusted.reshape(len(t), -1).T]
    return np.stack(columns, axis=1).reshape(-1, *rec.markers.shape[1:])


def _off(model: LinearMotion, rec: Recording) -> float:
    """Mean distance from what was measured [m]."""
    return float(np.nanmean(np.linalg.norm(model(rec)[0] - rec.trusted, axis=2)[START:]))
