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
from rodnet.terms.grasp import Grasp
from rodnet.terms.motion import white_noise

FEWEST = 8  # samples that were recorded, to tell noise by
LIKE = 1.5  # times its rough part, that the noise of a record may be: what differs more, and smoothly, is no noise
NEAR = 1e-3  # of a motion: what differs from it by less, however, is its record without noise to speak of


@dataclass(frozen=True)
class RecordNoise:
    """What smoothing has taken off the record of a drive; None where no channel is the record of what moves.

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


def record_noise(
    build: Callable[[Recording], Robot], recordings: Iterable[Recording]
) -> dict[str, RecordNoise]:
    """Compare what drives prescribe with the channels of recordings, constants aside.

    A motion of the robot that differs from a channel by what looks like noise has been made of it, and that is about
    the noise of the record: a smoothing spline follows little of it. A grasp is made of what markers have recorded,
    which is no channel.

    Parameters
    ----------
    build : callable
        Makes the robot of a recording.
    recordings : iterable of Recording
        Trials.

    Returns
    -------
    dict
        By name of the prescribed motion, or of the grasp.
    """
    shifts: dict[str, list[float | None]] = {}
    turns: dict[str, list[float | None]] = {}
    for rec in recordings:
        for term in build(rec).terms:
            if isinstance(term, PrescribedMotion):
                shifts.setdefault(term.name, []).append(_noise(rec, term.displacement, _shifts))
                turns.setdefault(term.name, []).append(_noise(rec, term.rotation, _turns))
            elif isinstance(term, Grasp):
                shifts[term.name], turns[term.name] = [None], [None]
    return {name: RecordNoise(_pooled(shifts[name]), _pooled(turns[name])) for name in shifts}


def _pooled(found: Sequence[float | None]) -> float | None:
    known = [one for one in found if one]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None if None in found else 0.0


def _noise(
    rec: Recording, motion: Callable[[float], Any] | None, compare: Callable[..., Any]
) -> float | None:
    """Rms difference from the channel nearest to a motion, None if that is no record of it; 0 where nothing moves."""
    if motion is None:
        return 0.0
    moved = np.array([motion(float(t)) for t in rec.t])
    if np.array_equal(moved, np.broadcast_to(moved[0], moved.shape)):  # what has noise does not stay
        return 0.0
    found = (compare(np.asarray(channel), moved) for channel in rec.channels.values())
    return min(
        (one for one in (_rms(*pair) for pair in found if pair is not None) if one is not None), default=None
    )


def _rms(off: np.ndarray, way: np.ndarray) -> float | None:
    """Standard deviation of the coordinates of a difference that are noisy, None if it is no noise of a record."""
    noisy = np.ptp(off, axis=0) > 0.0
    if not noisy.any():
        return 0.0
    off = (off - off.mean(axis=0))[:, noisy]
    size = float(np.sqrt(np.mean(off**2)))
    like = size < LIKE * white_noise(off) or size < NEAR * float(
        np.sqrt(np.mean((way - way.mean(axis=0)) ** 2))
    )
    return size if like else None


def _shifts(channel: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    if channel.shape != moved.shape:
        return None
    seen = np.isfinite(channel).all(axis=1)
    return (channel[seen] - moved[seen], moved[seen]) if np.sum(seen) >= FEWEST else None


def _turns(channel: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    if channel.shape == (len(moved), 4):
        seen = np.isfinite(channel).all(axis=1) & (np.linalg.norm(np.nan_to_num(channel), axis=1) > 0.5)
        convert = Rotation.from_quat
    elif channel.shape == moved.shape:
        seen, convert = np.isfinite(channel).all(axis=(1, 2)), Rotation.from_matrix
    else:
        return None
    if np.sum(seen) < FEWEST:
        return None
    commanded = Rotation.from_matrix(moved[seen])
    off = commanded.inv() * convert(channel[seen])
    # a gripper that is drawn turned is off by a constant, half a turn perhaps
    return (off.mean().inv() * off).as_rotvec(), (commanded * commanded[0].inv()).as_rotvec()
