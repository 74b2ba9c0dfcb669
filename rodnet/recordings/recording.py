"""One trial: what was measured, when, and what is known of how it was measured."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import RecordingError
from rodnet.names import Named

if TYPE_CHECKING:
    from rodnet.recordings.noise import NoiseModel

LARGEST = 50.0  # [m] farther apart markers are taken for millimetres: no rod robot is filmed from so far
FEWEST = 3  # frames
PLANE = [0, 2]  # coordinates in the plane, x and z


class Channel(np.ndarray):
    """A recorded channel: an array with one row for each frame, and a function of time.

    ``channel(t)`` interpolates linearly and holds the first and last values outside the trial, so that a
    channel can be handed to whatever takes a function of time, a motor's speed for instance.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Times [s].
    """

    t: np.ndarray

    def __new__(cls, values: Any, t: np.ndarray) -> Channel:
        channel = np.array(values).view(cls)
        channel.t = t
        return channel

    def __array_finalize__(self, other: Any) -> None:
        t = getattr(other, "t", np.zeros(0))
        self.t = t if self.ndim and len(t) == len(self) else np.zeros(0)  # a part has no times

    def __reduce__(self) -> Any:  # the times go with it to other processes
        return Channel, (np.asarray(self), self.t)

    def __call__(self, t: float) -> Any:
        values = np.asarray(self, dtype=float)
        if len(self.t) != len(values):
            raise RecordingError(
                "a part of a channel has no times: ask the channel itself, or cut the recording"
            )
        good = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        times = self.t[good]
        flat = values[good].reshape(len(times), -1)
        out = np.array([np.interp(t, times, flat[:, k]) for k in range(flat.shape[1])])
        return float(out[0]) if values.ndim == 1 else out.reshape(values.shape[1:])


@dataclass(frozen=True)
class Recording:
    """One trial.

    Parameters
    ----------
    t : array_like, shape (T,)
        Times of the frames [s], increasing.
    markers : array_like, shape (T, M, 3) or (T, M, 2)
        Positions [m], z up; NaN where a marker was lost. In the plane: x and z (y is zero).
    names : sequence of str, optional
        Names of the markers; by default ``"0"``, ``"1"``, ...
    edges : array_like, shape (E, 2), optional
        Pairs of markers between which a rod runs.
    prescribed : sequence of int, optional
        Markers whose measured motion is an input: what was grasped and moved.
    suspect : array_like, shape (T, M), optional
        Samples not to be trusted.
    channels : mapping, optional
        Whatever else was recorded frame by frame, commands included: arrays with T rows.
    attrs : mapping, optional
        What is known of the whole trial, e.g. a payload: numbers, arrays, words.
    meta : mapping, optional
        What is known of the set that it belongs to (``meta.json`` or ``case.json`` beside the file).
    group : str, optional
        What it shares with others, a specimen or a day: the unit in which sets are split.
    name : str
        For messages and reports; of a file, its stem.
    path : Path, optional
        The file it was read from.
    noise : NoiseModel, optional
        Of the instrument, where it is known; see `rodnet.estimate_noise`.
    planar : bool, optional
        Whether y was not recorded, but stands as zero; so it is where ``markers`` are x and z alone.

    Raises
    ------
    RecordingError
        If shapes, times or units cannot be right.

    Examples
    --------
    >>> import numpy as np, rodnet as rn
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> tip = np.stack([np.zeros(101), np.zeros(101), -0.1 + 0.01 * np.cos(20 * t)], axis=1)
    >>> rec = rn.Recording(t, tip[:, None], names=["tip"], channels={"rpm": np.full(101, 60.0)})
    >>> rec
    Recording 'recording': 101 frames over 1 s (100 Hz), 1 marker, channels rpm
    >>> rec.channels["rpm"](0.5)
    60.0
    """

    t: Any
    markers: Any
    names: Sequence[str] = ()
    edges: Any = ()
    prescribed: Any = ()
    suspect: Any = None
    channels: Mapping[str, Any] = field(default_factory=dict)
    attrs: Mapping[str, Any] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)
    group: str = ""
    name: str = "recording"
    path: Path | None = None
    noise: NoiseModel | None = None
    planar: bool = False

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        t = self._times()
        put("t", t)
        markers = self._positions(len(t))
        flat = self.planar or np.shape(self.markers)[-1] == 2
        # a replica may have been given a y
        put("planar", bool(flat and not np.nan_to_num(markers[..., 1]).any()))
        put("markers", markers)
        count = markers.shape[1]
        names = tuple(map(str, self.names)) or tuple(map(str, range(count)))
        if len(names) != count or len(set(names)) != count:
            raise self.error(
                f"needs one name for each of its {count} markers, all different; got {list(names)}"
            )
        put("names", names)
        put("edges", self._indices("edges", self.edges, (-1, 2), count))
        put("prescribed", self._indices("prescribed", self.prescribed, (-1,), count))
        suspect = (
            np.zeros(markers.shape[:2], dtype=bool) if self.suspect is None else np.asarray(self.suspect)
        )
        if suspect.shape != markers.shape[:2] or not np.isin(suspect, (0, 1)).all():
            raise self.error(
                f"'suspect' {suspect.shape} must be true or false for each of {markers.shape[:2]}"
            )
        put("suspect", suspect.astype(bool))
        channels = {}
        for key, values in self.channels.items():
            array = np.asarray(values)
            if array.ndim == 0 or len(array) != len(t):
                raise self.error(
                    f"channel '{key}' {array.shape} must have one row for each of {len(t)} frames"
                )
            if array.dtype.kind in "biuf":
                array = array.astype(float)
            channels[key] = Channel(array, t)
        of = f"of recording '{self.path or self.name}' called"
        put("channels", Named(channels, what=f"channel {of}"))
        put("attrs", Named(self.attrs, what=f"attribute {of}"))
        put("meta", Named(self.meta, what=f"entry in the meta data {of}"))
        put("group", str(self.group) or self.name)

    def error(self, problem: str) -> RecordingError:
        """Return an error that names this recording."""
        return RecordingError(f"recording '{self.path or self.name}': {problem}")

    def _times(self) -> np.ndarray:
        try:
            t = np.array(self.t, dtype=float)
        except (TypeError, ValueError):
            raise self.error("'t' must be times in seconds") from None
        if t.ndim != 1 or len(t) < FEWEST:
            raise self.error(f"'t' {t.shape} must be at least {FEWEST} times in seconds")
        if not np.isfinite(t).all():
            raise self.error(f"'t' is not finite in frame {int(np.argmin(np.isfinite(t)))}")
        steps = np.diff(t)
        if not (steps > 0.0).all():
            k = int(np.argmin(steps > 0.0))
            raise self.error(
                f"times must increase, but frame {k + 1} is at {t[k + 1]:g} s after {t[k]:g} s; sort the frames, "
                "or cut the recording there"
            )
        return _even(t)

    def _positions(self, frames: int) -> np.ndarray:
        try:
            x = np.array(self.markers, dtype=float)
        except (TypeError, ValueError):
            raise self.error("'markers' must be numbers") from None
        if x.ndim != 3 or x.shape[2] not in (2, 3) or x.shape[1] < 1:
            raise self.error(
                f"'markers' {x.shape} must have the shape (frames, markers, 3), or 2 in the plane"
            )
        if x.shape[0] != frames:
            raise self.error(f"'markers' has {x.shape[0]} frames and 't' {frames}")
        if x.shape[2] == 2:
            x = np.stack([x[..., 0], np.zeros(x.shape[:2]), x[..., 1]], axis=-1)
        if np.isinf(x).any():
            raise self.error("'markers' has infinite values; NaN stands for what was lost")
        seen = np.isfinite(x).all(axis=2)
        x[~seen] = np.nan
        lost = np.flatnonzero(~seen.any(axis=0))
        if len(lost):
            which = ", ".join(
                str(self.names[int(m)]) if len(self.names) == x.shape[1] else str(m) for m in lost
            )
            raise self.error(f"never sees marker {which}; leave it out of the file")
        extent = float(np.max(np.nanmax(x, axis=(0, 1)) - np.nanmin(x, axis=(0, 1))))
        if extent > LARGEST:
            raise self.error(
                f"its markers are {extent:.3g} m apart. Positions must be in metres: of a file in millimetres "
                "say so, read_recording(path, units='mm')"
            )
        return x

    def _indices(self, what: str, values: Any, shape: tuple[int, ...], count: int) -> np.ndarray:
        array = np.asarray(values)
        try:
            whole = np.zeros((0, *shape[1:]), dtype=np.int64) if array.size == 0 else array.reshape(shape)
        except ValueError:
            raise self.error(f"'{what}' {array.shape} has the wrong shape") from None
        if whole.size and (whole.dtype.kind not in "iuf" or (whole != np.round(whole)).any()):
            raise self.error(f"'{what}' must be numbers of markers")
        whole = whole.astype(np.int64)
        if whole.size and (whole.min() < 0 or whole.max() >= count):
            raise self.error(f"'{what}' names marker {int(whole.max())}, but there are 0 to {count - 1}")
        return whole

    # -- views ----------------------------------------------------------------------------------
    @property
    def duration(self) -> float:
        """Time from the first to the last frame [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def rate(self) -> float:
        """Frames per second [Hz], by the mean of the steps in which no frame is missing."""
        steps = np.diff(self.t)
        usual = np.median(steps)  # of times in milliseconds one of two that are rounded
        near = steps[np.abs(steps - usual) <= 0.5 * usual]
        return float(1.0 / (near.mean() if len(near) else usual))

    @cached_property
    def free(self) -> np.ndarray:
        """Indices of the markers that are not prescribed."""
        return np.setdiff1d(np.arange(self.markers.shape[1]), self.prescribed)

    @cached_property
    def trusted(self) -> np.ndarray:
        """Positions with NaN also where a sample is suspect [m], shape (T, M, 3)."""
        return np.where(self.suspect[..., None], np.nan, self.markers)

    def marker(self, name: str | int) -> int:
        """Index of a marker by name.

        Raises
        ------
        RecordingError
            If there is none of that name.
        """
        if isinstance(name, str) and name in self.names:
            return self.names.index(name)
        if not isinstance(name, str) and 0 <= int(name) < len(self.names):
            return int(name)
        raise self.error(f"has no marker '{name}'; it has {', '.join(self.names)}")

    def first_frames(self, window: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities of the markers at the first frame, shapes (M, 3) [m], [m/s].

        From frames 0 and 1; where one of them is lost or suspect, a line through the first five good ones.

        Raises
        ------
        RecordingError
            If a marker has fewer than two good samples in the first ``window`` seconds.
        """
        t, x = self.t, self.trusted
        position, velocity = x[0].copy(), (x[1] - x[0]) / (t[1] - t[0])
        for m in np.flatnonzero(np.isnan(velocity).any(axis=1)):
            good = np.flatnonzero(np.isfinite(x[:, m]).all(axis=1) & (t <= t[0] + window))[:5]
            if len(good) < 2:
                raise self.error(
                    f"marker '{self.names[int(m)]}' is lost for the first {window:g} s; it cannot start there"
                )
            velocity[m], position[m] = np.polyfit(t[good] - t[0], x[good, m], 1)
        return position, velocity

    def cut(self, start: float, end: float) -> Recording:
        """Return the frames from ``start`` to ``end`` [s], at their own times."""
        keep = (self.t >= start - 1e-9) & (self.t <= end + 1e-9)
        if keep.sum() < FEWEST:
            raise self.error(f"has {int(keep.sum())} frames from {start:g} to {end:g} s; it needs {FEWEST}")
        return replace(
            self,
            t=self.t[keep],
            markers=self.markers[keep],
            suspect=self.suspect[keep],
            channels={k: np.asarray(v)[keep] for k, v in self.channels.items()},
        )

    def replace(self, **changes: Any) -> Recording:
        """Return a copy with other values, e.g. ``rec.replace(noise=model)``.

        What is a group of its own is one by its new name.
        """
        if "name" in changes and self.group == self.name:
            changes = {"group": "", **changes}
        return replace(self, **changes)

    @property
    def told_group(self) -> str:
        """What a file says of its group: nothing, if it is one of its own, which has the file's name."""
        return "" if self.group == self.name else self.group

    @cached_property
    def digest(self) -> str:
        """SHA-256 of times, positions and flags: what a ledger knows a trial by."""
        sha = hashlib.sha256()
        for array in (self.t, self.markers, self.suspect):
            sha.update(np.ascontiguousarray(array).tobytes())
        for key in sorted(self.channels):
            sha.update(
                key.encode() + np.ascontiguousarray(np.asarray(self.channels[key]).astype(str)).tobytes()
            )
        return sha.hexdigest()

    def save(self, path: str | Path) -> Path:
        """Write to ``.npz``, ``.csv`` or ``.nc``; see `rodnet.read_recording` for what they hold."""
        from rodnet.recordings.files import write_recording

        return write_recording(self, path)

    def __repr__(self) -> str:
        count = len(self.names)
        parts = [
            f"{len(self.t)} frames over {self.duration:g} s ({self.rate:g} Hz)",
            f"{count} marker{'s' * (count != 1)}{' in the plane' * self.planar}",
        ]
        if len(self.prescribed):
            parts.append(f"{len(self.prescribed)} prescribed")
        lost = 1.0 - np.isfinite(self.trusted[..., 0]).mean()
        if lost:
            parts.append(f"{100 * lost:.2g} % lost or suspect")
        if self.channels:
            parts.append(f"channels {', '.join(self.channels)}")
        return f"Recording '{self.name}': {', '.join(parts)}"


def _even(t: np.ndarray) -> np.ndarray:
    """Times without the rounding of single precision, where they are evenly spaced up to that."""
    even = np.linspace(t[0], t[-1], len(t))
    step = (t[-1] - t[0]) / (len(t) - 1)
    nearest = float(np.format_float_positional(step, precision=5, fractional=False))  # 0.01, not 0.0100000002
    # late in the day that is as wide as a frame; yet one that was dropped moves others a fifth of a step, and must show
    single = np.array_equal(t, t.astype(np.float32))
    tolerance = min(4e-7 * np.abs(t).max(), (0.1 if single else 0.01) * step)
    for candidate in (t[0] + nearest * np.arange(len(t)), even):
        if np.abs(candidate - t).max() <= tolerance:
            return candidate
    return t


def natural_key(text: str) -> list[Any]:
    """Sort key that counts: trial2 comes before trial10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", text)]


def by_group(recordings: Iterable[Recording]) -> dict[str, list[Recording]]:
    """Recordings by group, in order of first appearance."""
    groups: dict[str, list[Recording]] = {}
    for rec in recordings:
        groups.setdefault(rec.group, []).append(rec)
    return groups
