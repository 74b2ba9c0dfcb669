"""How noisy records of drives are: recordings hold them as they are, and robots are driven with them smoothed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.terms.constraints import PrescribedMotion

NEAR = 0.1  # of a motion: a channel that is nearer to it is its record


@dataclass(frozen=True)
class RecordNoise:
    """What smoothing has taken off the records of drives; None where no channel is the record of what moves.

    Attributes
    ----------
    shift : float or None
        Standard deviation of a coordinate [m].
    turn : float or None
        Of a component of the rotation vector [rad].
    """

    shift: float | None = None
    turn: float | None = None

    @property
    def known(self) -> bool:
        """Whether it is, of all that moves."""
        return self.shift is not None and self.turn is not None


def record_noise(build: Callable[[Recording], Robot], recordings: Iterable[Recording]) -> RecordNoise:
    """Compare what prescribed motions are with the channels of recordings, constants aside.

    A motion of the robot that follows a channel within `NEAR` has been made of it, and what they differ by is about
    the noise of the record: a smoothing spline follows little of that.

    Parameters
    ----------
    build : callable
        Makes the robot of a recording.
    recordings : iterable of Recording
        Trials.
    """
    found = noise_of_records(build, recordings).values()
    return RecordNoise(_pooled([one.shift for one in found]), _pooled([one.turn for one in found]))


def noise_of_records(
    build: Callable[[Recording], Robot], recordings: Iterable[Recording]
) -> dict[str, RecordNoise]:
    """The same of each prescribed motion, by its name."""
    shifts: dict[str, list[float | None]] = {}
    turns: dict[str, list[float | None]] = {}
    for rec in recordings:
        for term in build(rec).terms:
            if isinstance(term, PrescribedMotion):
                shifts.setdefault(term.name, []).append(_noise(rec, term.displacement, _shifts))
                turns.setdefault(term.name, []).append(_noise(rec, term.rotation, _turns))
    return {name: RecordNoise(_pooled(shifts[name]), _pooled(turns[name])) for name in shifts}


def _pooled(found: Sequence[float | None]) -> float | None:
    known = [one for one in found if one]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None if None in found or not found else 0.0


def _noise(
    rec: Recording, motion: Callable[[float], Any] | None, compare: Callable[..., Any]
) -> float | None:
    """Rms difference from the channel nearest to a motion, None if that is no record of it; 0 where nothing moves."""
    if motion is None:
        return 0.0
    moved = np.array([motion(float(t)) for t in rec.t])
    if np.array_equal(moved, np.broadcast_to(moved[0], moved.shape)):  # what has noise does not stay
        return 0.0
    found = [compare(np.asarray(channel), moved) for channel in rec.channels.values()]
    return min(
        (off for off, size in (one for one in found if one is not None) if off < NEAR * size), default=None
    )


def _shifts(channel: np.ndarray, moved: np.ndarray) -> tuple[float, float] | None:
    if channel.shape != moved.shape or not np.isfinite(channel).any(axis=0).all():
        return None
    off, way = channel - moved, moved - moved.mean(axis=0)
    return float(np.sqrt(np.nanmean((off - np.nanmean(off, axis=0)) ** 2))), float(np.sqrt(np.mean(way**2)))


def _turns(channel: np.ndarray, moved: np.ndarray) -> tuple[float, float] | None:
    if channel.shape == (len(moved), 4):
        seen = np.isfinite(channel).all(axis=1) & (np.linalg.norm(np.nan_to_num(channel), axis=1) > 0.5)
        recorded = Rotation.from_quat(channel[seen]) if seen.any() else None
    elif channel.shape == moved.shape:
        seen = np.isfinite(channel).all(axis=(1, 2))
        recorded = Rotation.from_matrix(channel[seen]) if seen.any() else None
    else:
        return None
    if recorded is None:
        return None
    commanded = Rotation.from_matrix(moved[seen])
    off = (commanded.inv() * recorded).as_rotvec()  # a gripper that is drawn turned is off by a constant
    way = (commanded * commanded[0].inv()).as_rotvec()
    return float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2))), float(np.sqrt(np.mean(way**2)))
