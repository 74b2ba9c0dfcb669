"""When and how instruments read a run: interpolation between its states, and derivatives of readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rodnet.observer import Observer
from rodnet.recordings.channels import HeadAngle, HeadSpeed
from rodnet.recordings.observation import Markers, Observation
from rodnet.recordings.prediction import SLACK, _cubic
from rodnet.recordings.recording import PLANE, Recording
from rodnet.robot import Robot
from rodnet.solve.model import Model
from rodnet.tangent.sensitivities import observed
from rodnet.tangent.state import StateTangent

SHIFT = 1e-3  # of a time step: differences in time


class Clock:
    """At which states of a run the frames lie, and how to interpolate between them.

    Parameters
    ----------
    t : ndarray
        Times of the frames, from the first of the trial [s].
    late : float
        By how much the record runs behind the run [s].
    dt : float
        Time step [s].
    rates : bool
        Whether rates of change will be asked for.
    first : int
        Index of the state that the run begins with; before the first of all nothing moves.
    """

    def __init__(self, t: np.ndarray, late: float, dt: float, rates: bool, first: int = 0) -> None:
        # a run is as long as the last frame needs, and at least as a cubic does
        since = t - late
        earliest = 0.0 if first == 0 else -np.inf
        moments = np.maximum(since, earliest)
        steps = max(int(np.ceil(moments.max() / dt - SLACK)) - first, 3) + 1
        grid = dt * np.arange(first, first + steps + 1)
        self._slack, self._h = SLACK * dt, SHIFT * dt

        def place(moment: float, slack: float) -> tuple[np.ndarray, np.ndarray]:
            nodes, weights = _cubic(grid, float(moment), slack)
            return nodes + first, weights

        self._plain = [place(m, self._slack) for m in moments]
        self._near = [
            [place(max(m + s * self._h, earliest), 0.0) for m in since]
            for s in ((1.0, -1.0) if rates else ())
        ]
        groups = [self._plain, *self._near]
        self.nodes = np.unique(np.concatenate([n for group in groups for n, _ in group]))

    def at(self, read: Mapping[int, np.ndarray]) -> np.ndarray:
        """Values at the frames of what was read at states."""
        return _interpolated(self._plain, read)

    def rate(self, read: Mapping[int, np.ndarray]) -> np.ndarray:
        """Its rate of change; before the start it is zero."""
        up, down = (_interpolated(near, read) for near in self._near)
        return (up - down) / (2.0 * self._h)


def _interpolated(places: list[tuple[np.ndarray, np.ndarray]], read: Mapping[int, np.ndarray]) -> np.ndarray:
    return np.array([sum(w * read[int(k)] for k, w in zip(*place, strict=True)) for place in places])


class Shaping:
    """How what an instrument reads changes with parameters of its own.

    Parameters
    ----------
    one : Observation
        The instrument.
    columns : list of int
        Where the derivatives go.
    near : list of (Observation, Observation, float)
        For each the instrument with the parameter a little smaller and larger, and by how much.
    """

    def __init__(
        self, one: Observation, columns: list[int], near: Sequence[tuple[Observation, Observation, float]]
    ) -> None:
        self.one, self.columns, self.near = one, columns, near
        self.seen: Markers | None = None
        if isinstance(one, Markers) and type(one).read is Markers.read and columns:
            self.seen = one
            cameras = [[getattr(i, "camera") for i in pair[:2]] for pair in near]  # noqa: B009
            offsets = [[getattr(i, "offsets") for i in pair[:2]] for pair in near]  # noqa: B009
            widths = [width for *_, width in near]

            def slopes(pairs: list[Any], k: int) -> np.ndarray:
                return np.stack([(b[k] - a[k]) / w for (a, b), w in zip(pairs, widths, strict=True)], axis=-1)

            self.turns, self.shifts = slopes(cameras, 0), slopes(cameras, 1)
            self.first, self.second = slopes(offsets, 0), slopes(offsets, 1)
            moves = [[(i.misplaced.value, i.drift.value) for i in pair[:2]] for pair in near]  # type: ignore[attr-defined]
            self.moves, self.drifts = slopes(moves, 0), slopes(moves, 1)
            lenses = [[np.hstack([np.ravel(p.value) for p in _lens(i)]) for i in pair[:2]] for pair in near]
            self.lenses = [k for k, (low, high) in enumerate(lenses) if np.any(low != high)]

    def add(self, view: Observer, rows: np.ndarray) -> None:
        """Fill in the derivatives in a state, shape (..., all columns)."""
        one = self.seen
        if one is None:
            for column, (low, high, width) in zip(self.columns, self.near, strict=True):
                up, down = (np.asarray(i.read(view), dtype=float) for i in (high, low))
                rows[..., column] = (up - down) / width
            return
        found = np.einsum("mi,iak->mak", one.places(view), self.turns) + self.shifts
        if self.first.any() or self.second.any():
            first, second = one.beside(view)
            moved = self.first * first[..., None] + self.second * second[..., None]
            found += np.einsum("mik,ia->mak", moved, one.camera[0])
        if self.moves.any() or self.drifts.any():
            along = self.moves + view.t * self.drifts
            found += (one.onward(view) @ one.camera[0])[:, :, None] * along[:, None]
        if one.bends or self.lenses:
            A, b = one.camera
            even = one.places(view) @ A + b
            found = one.bending(even) @ found
            for k in self.lenses:
                low, high, width = self.near[k]
                found[..., k] += (high.bent(even) - low.bent(even)) / width  # type: ignore[attr-defined]
        rows[..., self.columns] = found


def _lens(one: Any) -> tuple[Any, ...]:
    return one.lens, one.keystone, one.bow, one.middle


def by_samples(values: np.ndarray) -> np.ndarray:
    """Readings as (frames, samples, coordinates): markers are samples of several coordinates, numbers of one."""
    if values.ndim == 3:
        return values
    return values.reshape(len(values), -1, 1)


def recorded(one: Observation, rec: Recording, coordinates: int) -> list[int]:
    """Which coordinates of a sample an instrument has measured: of markers in the plane, y stands as zero."""
    every = range(coordinates)
    return [k for k in every if one.axes[k] in PLANE] if rec.planar and isinstance(one, Markers) else [*every]


def read_out(one: Observation, rec: Recording) -> np.ndarray:
    """What an instrument read, without what is to be left out; of the first frames, if there are no others."""
    values = np.array(one.measured(rec), dtype=float)
    if one.left_out is not None:
        by_samples(values)[one.left_out[: len(values)]] = np.nan
    return values


def reading_slope(
    one: Observation, model: Model, view: Observer, tangent: StateTangent, robot: Robot
) -> np.ndarray:
    """Derivative of what an instrument reads, shape (..., k): by the chain rule for markers and heads."""
    if isinstance(one, Markers) and type(one).read is Markers.read:
        dx = tangent.q[: model.twist0].reshape(-1, 3, tangent.count)
        edge, along = one.stations(view.t)
        i, j = robot.graph.edges[edge].T
        s = along[:, None, None]
        moved = (1.0 - s) * dx[i] + s * dx[j]
        if one.offset:
            # the directors turn with the tangent, without twist of their own, and by spin and twist about it
            t, apart = view.state.tangents[edge], dx[j] - dx[i]
            length = np.linalg.norm(view.x[j] - view.x[i], axis=1)[:, None, None]
            spun = tangent.spin[edge] + tangent.q[model.twist0 + edge]
            turn = np.cross(t[:, :, None], apart, axis=1) / length + t[:, :, None] * spun[:, None]
            (first, second), (a, b) = one.beside(view), one.offsets
            moved = moved + np.cross(turn, (a * first + b * second)[:, :, None], axis=1)
        A, b = one.camera
        seen = np.asarray(A.T @ moved)
        return np.asarray(one.bending(one.places(view) @ A + b) @ seen) if one.bends else seen
    if type(one).read in (HeadSpeed.read, HeadAngle.read):
        assert isinstance(one, HeadSpeed)
        array = tangent.v if type(one).read is HeadSpeed.read else tangent.q
        return one.factor * array[model.twist0 + one.edge]
    return observed(model, view, tangent, one.read, robot)
