"""Instruments that write a channel of a recording: counters on a head, and whatever else reads numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import RecordingError
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.observation import Observation

if TYPE_CHECKING:
    from rodnet.observer import Observer
    from rodnet.recordings.recording import Recording
    from rodnet.robot import Robot

FOREVER = 1e9  # [s]: longer than anything is recorded
UNITS = {"rad/s": 1.0, "rpm": 60.0 / (2.0 * np.pi), "rad": 1.0, "deg": 180.0 / np.pi, "rev": 0.5 / np.pi}


class ChannelReader(Observation):
    """An instrument whose readings are the channel ``channel`` of a recording."""

    channel: str

    def written(self, rec: Recording, readings: np.ndarray) -> Recording:
        """Return the recording with other values in the channel, of as many numbers for each frame."""
        shape = np.shape(rec.channels[self.channel])
        return rec.replace(channels={**rec.channels, self.channel: np.reshape(readings, shape)})


class HeadSpeed(ChannelReader):
    """Rate of rotation of an edge about its axis, as a counter on it reads.

    Parameters
    ----------
    robot : Robot
        What is observed.
    channel : str, optional
        Channel of the recording, ``"head_speed"``.
    on : str
        The edge; by default the head's first.
    unit : {"rpm", "rad/s"}, optional
        Of the channel; the first by default.
    """

    default_name = "head_speed"
    units: ClassVar[tuple[str, ...]] = ("rpm", "rad/s")

    def __init__(
        self, robot: Robot, channel: str | None = None, *, on: str = "head:0-1", unit: str | None = None,
        name: str | None = None, **parameters: Any,
    ) -> None:  # fmt: skip
        super().__init__(robot, name=name, **parameters)
        self.channel, self.unit = channel or self.default_name, unit or self.units[0]  # type: ignore[misc]
        if self.unit not in self.units:
            raise RecordingError(
                f"{type(self).__name__}: unit = {unit!r} must be one of {', '.join(self.units)}"
            )
        self.edge, self.factor = int(robot.graph.edge_indices(on)[0]), UNITS[self.unit]

    def read(self, view: Observer) -> np.ndarray:
        """Return the rate in the channel's unit."""
        return np.asarray(self.factor * view.w[self.edge])

    def measured(self, rec: Recording) -> np.ndarray:
        """Return the channel, shape (T,)."""
        return channel_of(rec, self.channel, ())


class HeadAngle(HeadSpeed):
    """Angle by which an edge has turned about its axis since the first frame.

    Parameters
    ----------
    robot, channel, on
        As for `HeadSpeed`; the channel is ``"head_angle"``.
    unit : {"rad", "deg", "rev"}, optional
        Of the channel; the first by default.
    """

    default_name = "head_angle"
    units = ("rad", "deg", "rev")

    def read(self, view: Observer) -> np.ndarray:
        """Return the angle in the channel's unit; a run begins at zero."""
        return np.asarray(self.factor * view.theta[self.edge])

    def measured(self, rec: Recording) -> np.ndarray:
        """Return the channel less its first value, shape (T,); raise where that is missing, but later ones are not.

        The first itself tells nothing, and is NaN.
        """
        values = super().measured(rec)
        k = int(np.argmax(np.isfinite(values)))
        if k:  # by how much it had turned until then nobody knows
            raise rec.error(
                f"channel '{self.channel}' has no reading in the first frame, from which the angle counts, but from "
                f"frame {k} on, {rec.t[k] - rec.t[0]:g} s later: cut the recording to begin where the counter reads, "
                f"rec.cut(rec.t[{k}], rec.t[-1])"
            )
        return np.concatenate([[np.nan], values[1:] - values[0]])

    def written(self, rec: Recording, readings: np.ndarray) -> Recording:
        """Return the recording with other angles in the channel, which begins at zero."""
        return super().written(rec, np.concatenate([[0.0], readings[1:]]))

    def noise(self, sigma: float) -> NoiseModel:
        """Return the noise of angles whose dial is read with a standard deviation: the first reading errs in all."""
        return NoiseModel(white=sigma, slow=sigma, time=FOREVER)


class Reading(ChannelReader):
    """A channel that a function of the state predicts: whatever has no observation of its own.

    Parameters
    ----------
    robot : Robot
        What is observed.
    channel : str
        Channel of the recording.
    function : callable
        Of an `rodnet.Observer`; returns what one row of the channel holds.
    unit : str
        Of the channel.
    """

    default_name = "reading"

    def __init__(
        self, robot: Robot, channel: str, function: Callable[[Observer], Any], *, unit: str = "1",
        name: str | None = None, **parameters: Any,
    ) -> None:  # fmt: skip
        super().__init__(robot, name=name or channel, **parameters)
        if not callable(function):
            raise RecordingError(f"Reading '{channel}' needs a function of a state, got {function!r}")
        self.channel, self.function, self.unit = channel, function, unit  # type: ignore[misc]

    def read(self, view: Observer) -> np.ndarray:
        """Return what the function returns."""
        return np.asarray(self.function(view), dtype=float)

    def measured(self, rec: Recording) -> np.ndarray:
        """Return the channel."""
        return channel_of(rec, self.channel, None)


def channel_of(rec: Recording, name: str, shape: tuple[int, ...] | None) -> np.ndarray:
    """Return the values of a channel, one row for each frame; raise if it is missing, or holds something else."""
    if name not in rec.channels:
        raise rec.error(f"has no channel '{name}'; it has {', '.join(rec.channels) or 'none'}")
    values = np.asarray(rec.channels[name])
    if values.dtype.kind != "f" or (shape is not None and values.shape[1:] != shape):
        raise rec.error(
            f"channel '{name}' {values.shape} of {values.dtype} does not hold one number for each frame"
        )
    return np.array(values, dtype=float)
