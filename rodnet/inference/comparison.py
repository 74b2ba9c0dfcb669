"""One trial of a calibration: its prediction, its prewhitened residual, and the derivative of both."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rodnet.errors import ConvergenceError, ParameterError
from rodnet.graph.rod_graph import RodGraph
from rodnet.inference.case import Case
from rodnet.inference.modes import soft_modes, twist_mode
from rodnet.inference.quantities import AXES, instrument_path, robot_values, set_instrument
from rodnet.inference.readings import by_samples, read_out, recorded
from rodnet.inference.segments import Segment
from rodnet.inference.shots import Shots, why
from rodnet.parameters import Parameter
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.observation import Markers, Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.steppers import State

LABOURED = 30.0  # iterations of Newton's method per step, over a whole run: two to eight are usual
STEP = 1e-5  # of differences of observations by their own parameters, of their scale


@dataclass(frozen=True)
class Fit:
    """A trial evaluated at some values.

    Attributes
    ----------
    measured, predicted : list of ndarray, shapes (F, ...)
        Of each instrument.
    residual : ndarray, shape (n,)
        Measured less predicted, prewhitened: independent and of unit variance if the model holds.
    jacobian : ndarray, shape (n, k), or None
        Its derivative by the quantities.
    whitened : list of ndarray, shapes (F, M, d)
        The residual of each instrument, frame by frame; zero where nothing was measured.
    seen : list of ndarray of bool, shapes (F, M)
        Where something was: the rows of ``residual``, in this order.
    jumps : ndarray, shape (m,)
        Between segments, over what is tolerated.
    jump_slopes : ndarray, shape (m, k)
        Their derivative.
    plain : list of ndarray, shapes (F, ...)
        What was predicted without the instruments' corrections.
    as_recorded : list of ndarray, shapes (F, ...)
        What was predicted but for errors of drives' records.
    recorded : list of list of int
        Which coordinates of its samples each instrument has measured.
    labels : list of (str, list of str)
        Each instrument's name, and those of its samples: of markers; of readings, numbers.
    t : ndarray, shape (F,)
        Times of the frames [s].
    """

    measured: list[np.ndarray]
    predicted: list[np.ndarray]
    residual: np.ndarray
    jacobian: np.ndarray | None
    whitened: list[np.ndarray]
    seen: list[np.ndarray] = field(default_factory=list)
    jumps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    jump_slopes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    plain: list[np.ndarray] = field(default_factory=list)
    as_recorded: list[np.ndarray] = field(default_factory=list)
    recorded: list[list[int]] = field(default_factory=list)
    labels: list[tuple[str, list[str]]] = field(default_factory=list)
    t: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def samples(self, number: int, values: np.ndarray) -> np.ndarray:
        """Values of an instrument as (frames, samples, coordinates), those that were recorded."""
        found = by_samples(values)
        return found[:, :, self.recorded[number]] if self.recorded else found


class Comparison:
    """A recording with its robot and instruments.

    Parameters
    ----------
    case : Case
        How it is simulated.
    rec : Recording
        The recording; times count from its first frame.
    noise : mapping
        Noise model of each instrument by name.
    modes : int
        Number of modes of the initial state.
    segments : sequence of Segment
        Those after the first, if it is simulated in several.

    Attributes
    ----------
    digest : str
        Of the recording as it was given.
    """

    def __init__(
        self, case: Case, rec: Recording, noise: Mapping[str, NoiseModel], modes: int = 6,
        segments: Sequence[Segment] = (),
    ) -> None:  # fmt: skip
        self.case, self.noise, self.mode_count = case, dict(noise), modes
        self.digest = rec.digest
        self.rec = case.part(rec)
        self.robot = case.robot(self.rec)
        self.instruments = case.observations(self.rec, self.robot)
        self.options = case.simulation(self.rec, self.robot)
        self.measured = [read_out(one, self.rec) for one in self.instruments]
        self._modes: np.ndarray | None = None
        self.segments: tuple[Segment, ...] = tuple(segments)
        if self.options.get("adaptive") is not None:
            raise ParameterError("a calibration needs a fixed time step: leave out adaptive")

    @property
    def recorded(self) -> list[list[int]]:
        """Which coordinates of its samples each instrument has measured."""
        pairs = zip(self.instruments, self.measured, strict=True)
        return [recorded(one, self.rec, by_samples(m).shape[2]) for one, m in pairs]

    @cached_property
    def twist(self) -> np.ndarray | None:
        """How the rods may be twisted at the beginning, which nodes don't tell; None where it doesn't show."""
        return twist_mode(self.robot) if self.mode_count else None

    # -- the robot at some values -----------------------------------------------------------------
    def motion(self, path: str) -> tuple[str, np.ndarray]:
        """Whether a path of the initial state is of positions, velocities or twist, and its displacement."""
        name, _, index = path.removeprefix("initial.").partition("[")
        shape, which = self.robot.graph.x0.shape, index.rstrip("]")
        if name == "offset":
            if which not in tuple(AXES):
                raise ParameterError(f"'{path}': axes are x, y and z")
            return "x", np.broadcast_to(np.eye(3)[AXES.index(which)], shape)
        if name == "twist":
            if self.twist is None:
                raise ParameterError(f"'{path}': of this robot no twist shows")
            return "turn", self.twist
        if self._modes is None:
            shapes = soft_modes(self.robot, self.mode_count)[:, : shape[0] * 3]
            self._modes = shapes.reshape(-1, *shape)
        if not which.isdigit() or int(which) >= len(self._modes):
            raise ParameterError(f"'{path}': there are {len(self._modes)} modes, numbered from 0")
        return ("x" if name == "position" else "v"), self._modes[int(which)]

    def robot_at(self, values: Mapping[str, float]) -> tuple[Robot, dict[str, Any]]:
        """Return the robot with these values, in its initial position, and the options of its simulation."""
        own = {p: v for p, v in values.items() if self.kind(p) == "robot"}
        # whether its terms can act shows when it is simulated
        robot = self.robot._changed(robot_values(self.robot, own)) if own else self.robot
        moved = {
            "x": np.zeros(robot.graph.x0.shape),
            "v": np.zeros(robot.graph.x0.shape),
            "turn": np.zeros(1),
        }
        for path, value in values.items():
            if self.kind(path) == "initial" and value:
                key, shape = self.motion(path)
                moved[key] = moved[key] + value * shape
        if moved["x"].any():
            place = rigidly(robot.graph, moved["x"])
            robot = Robot(robot.graph.with_positions(place), robot.terms, robot.sensors)
        if moved["turn"].any():
            robot = Robot(robot.graph.twisted(moved["turn"]), robot.terms, robot.sensors)
        options = dict(self.options)
        if moved["v"].any():
            start = options.get("velocity")
            options["velocity"] = moved["v"] + (0.0 if start is None else np.asarray(start, dtype=float))
        return robot, options

    def start_slope(self, path: str, values: Mapping[str, float], scale: float) -> dict[str, np.ndarray]:
        """Derivative of the initial positions ``x``, velocities ``v`` or twist ``turn`` by a path."""
        key, shape = self.motion(path)
        if key != "x" or not self.robot.graph.bodies:
            return {key: shape}
        ends = []
        for sign in (1.0, -1.0):
            near = {**values, path: values.get(path, 0.0) + sign * STEP * scale}
            ends.append(self.robot_at({p: v for p, v in near.items() if self.kind(p) == "initial"})[0])
        return {key: (ends[0].graph.x0 - ends[1].graph.x0) / (2.0 * STEP * scale)}

    def kind(self, path: str) -> str:
        if path == "initial.time":
            return "time"
        if path.startswith("initial."):
            return "initial"
        if path.startswith("segment") and any(path in segment.paths() for segment in self.segments):
            return "segment"
        return "robot" if instrument_path(self.instruments, path) is None else "instrument"

    def model_at(self, values: Mapping[str, float]) -> Model:
        """Return the model of the robot with these values."""
        robot, options = self.robot_at(values)
        return Simulation(robot, **options).model

    def instruments_at(self, values: Mapping[str, float]) -> list[Observation]:
        """Return the instruments with these values."""
        found = [copy.copy(one) for one in self.instruments]
        for path, value in values.items():
            place = None if path.startswith("initial.") else instrument_path(self.instruments, path)
            if place is not None:
                set_instrument(found[place[0]], place[1], place[2], value)
        return found

    # -- prediction ---------------------------------------------------------------------------------
    def frames(self, number: int) -> slice:
        """Frames of a segment; the whole trial is the only one, 0, if there are no others."""
        firsts = [0, *(segment.first for segment in self.segments), len(self.rec.t)]
        return slice(firsts[number], firsts[number + 1])

    def predict(
        self, values: Mapping[str, float], scales: Mapping[str, float] | None = None
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Readings of every instrument at the frames, and their derivatives by the paths in ``scales``.

        Returns
        -------
        predicted : list of ndarray, shapes (F, ...)
            Of each instrument.
        slopes : list of ndarray, shapes (F, ..., k)
            Likewise; of no columns without ``scales``.
        """
        predicted, slopes, _ = self._predict(values, scales or {})
        return self._corrected(predicted, slopes, values, list(scales or {}))[0], slopes

    def _predict(
        self, values: Mapping[str, float], scales: Mapping[str, float], most: float = np.inf
    ) -> tuple[list[np.ndarray], list[np.ndarray], list[tuple[np.ndarray, np.ndarray]]]:
        """Like `predict`, without corrections, and the jumps between segments with their derivatives."""
        shots, parts, jumps = Shots(self, values, scales), [], []
        for number, until in enumerate([*(segment.state.index for segment in self.segments), 0]):
            parts.append(shots.shoot(number, until, most))
        for segment, one, two in zip(self.segments, parts[:-1], parts[1:], strict=True):
            slopes = two.begin.q - one.end.q, two.begin.v - one.end.v
            jumps.append(segment.jump(two.begin.state, one.end.state, slopes))
        join = lambda lists: [np.concatenate(pieces) for pieces in zip(*lists, strict=True)]  # noqa: E731
        predicted, rates = join([p.predicted for p in parts]), join([p.slopes for p in parts])
        return predicted, rates, jumps

    def _corrected(
        self, plain: Sequence[np.ndarray], slopes: Sequence[np.ndarray], values: Mapping[str, float],
        paths: list[str],
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:  # fmt: skip
        """Readings with the instruments' corrections, whose derivatives are put into ``slopes``; and as recorded."""
        found, held, eyes = list(plain), list(plain), self.instruments_at(values)
        for k, eye in enumerate(eyes):
            for one, name, changes in (
                (eye, "numerics", eye.corrections),
                (eyes[0], "records", eye.misread),  # a drive is one for all that look at what it drives
            ):
                shares: Parameter = getattr(one, name)
                for j, (share, change) in enumerate(zip(shares.value, changes, strict=False)):
                    found[k] = found[k] + share * change
                    if name == "numerics":
                        held[k] = found[k]
                    if (path := f"{one.name}.{name}[{j}]") in paths:
                        slopes[k][..., paths.index(path)] = change
        return found, held

    def end_of(self, values: Mapping[str, float], number: int, frame: int) -> State | None:
        """State in which a segment is at a frame; None if it cannot be simulated so far."""
        shots = Shots(self, values, {})
        late = max(float(one.lag.value) for one in shots.eyes) + values.get("initial.time", 0.0)
        index = max(int((self.rec.t[frame] - max(late, 0.0)) / shots.sim.dt + 1e-6), 1)
        try:
            return shots.shoot(number, index).end.state
        except ConvergenceError as error:
            why(error)
            return None

    def shot_residual(
        self, values: Mapping[str, float], number: int, scales: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Prewhitened residual of one segment by itself, and its derivative."""
        shot = Shots(self, values, scales).shoot(number)
        frames = self.frames(number)
        found = self._whiten(shot.predicted, shot.slopes, frames, None)
        return found[0][:, 0], found[0][:, 1:]

    def changed(
        self, eyes: Sequence[Observation], path: str, value: float, scale: float
    ) -> tuple[int, Observation, Observation, float]:
        """Instruments with a parameter a little smaller and larger, and by how much."""
        place = instrument_path(self.instruments, path)
        assert place is not None
        number, name, index = place
        bounds = getattr(eyes[number], name).bounds
        low, high = max(value - STEP * scale, bounds[0]), min(value + STEP * scale, bounds[1])
        changed = []
        for v in (low, high):
            one = copy.copy(eyes[number])
            set_instrument(one, name, index, v)
            changed.append(one)
        return number, changed[0], changed[1], high - low

    # -- residual -----------------------------------------------------------------------------------
    def evaluate(
        self, values: Mapping[str, float], scales: Mapping[str, float] | None = None,
        rejected: Sequence[np.ndarray] | None = None,
    ) -> Fit:  # fmt: skip
        """Compare with what was measured, as searches do: where steps take far more than usual is no place for them.

        Parameters
        ----------
        values : mapping
            By path, all that differ from the robot as it was built.
        scales : mapping, optional
            Paths to differentiate by, with changes worth considering.
        rejected : sequence of ndarray, shapes (F, M)
            Samples to leave out.
        """
        plain, slopes, jumps = self._predict(values, scales or {}, LABOURED)
        predicted, held = self._corrected(plain, slopes, values, list(scales or {}))
        table, whitened, seen = self._whiten(predicted, slopes, slice(None), rejected)
        bonds = np.concatenate([row for row, _ in jumps]) if jumps else np.zeros(0)
        bond_slopes = np.concatenate([J for _, J in jumps]) if jumps else np.zeros((0, len(scales or {})))
        jacobian = table[:, 1:] if scales is not None else None
        labels = [(one.name, self._labels(one, w.shape[1]))
                  for one, w in zip(self.instruments, whitened, strict=True)]  # fmt: skip
        return Fit(
            self.measured, predicted, table[:, 0], jacobian, whitened, seen, bonds, bond_slopes, plain, held,
            self.recorded, labels, self.rec.t,
        )  # fmt: skip

    def _labels(self, one: Observation, samples: int) -> list[str]:
        """What the samples of an instrument are called."""
        if isinstance(one, Markers):
            return [self.rec.names[self.rec.marker(m)] for m in one.markers]
        return [str(k) for k in range(samples)]

    def corrected(self, fit: Fit, values: Mapping[str, float], paths: Sequence[str]) -> Fit:
        """Compare a run at the same values once more, the instruments having other corrections.

        The derivatives are those by ``paths``, shares of the corrections. Nothing is to be left out.
        """
        slopes = [np.zeros((*p.shape, len(paths))) for p in fit.plain]
        predicted, held = self._corrected(fit.plain, slopes, values, list(paths))
        table, whitened, seen = self._whiten(predicted, slopes, slice(None), None)
        r, J = table[:, 0], table[:, 1:]
        return replace(
            fit, predicted=predicted, as_recorded=held, residual=r, jacobian=J, whitened=whitened, seen=seen
        )

    def whitened(self, one: Observation, table: np.ndarray, frames: slice = slice(None)) -> np.ndarray:
        """Prewhitened errors of an instrument, with whatever stands behind them, (F, M, d, ...).

        Only the coordinates that were recorded.
        """
        white, _ = self.noise[one.name].whiten(self.rec.t[frames], table)
        return white[:, :, recorded(one, self.rec, table.shape[2])]

    def _whiten(
        self, predicted: Sequence[np.ndarray], slopes: Sequence[np.ndarray], frames: slice,
        rejected: Sequence[np.ndarray] | None,
    ) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:  # fmt: skip
        """Prewhitened residual with its derivative, (n, 1 + k); frame by frame for each instrument; and where seen."""
        parts, whitened, places = [], [], []
        for number, one in enumerate(self.instruments):
            error = by_samples(self.measured[number][frames] - predicted[number])
            if rejected is not None:
                error = np.where(rejected[number][frames][..., None], np.nan, error)
            columns = slopes[number].reshape(*error.shape, -1)
            stack = np.concatenate([error[..., None], -columns], axis=-1)
            white = self.whitened(one, stack, frames)
            seen = np.isfinite(error).all(axis=2)
            whitened.append(white[..., 0])
            places.append(seen)
            parts.append(white[seen].reshape(-1, stack.shape[-1]))
        return np.concatenate(parts), whitened, places


def rigidly(graph: RodGraph, displacement: np.ndarray) -> np.ndarray:
    """Positions after a displacement, of the nodes of a rigid body those of the nearest rigid motion."""
    x = graph.x0 + displacement
    for body in graph.bodies:
        old, new = graph.x0[body.nodes], x[body.nodes]
        if len(old) < 2:
            continue
        arms = old - old.mean(axis=0)
        turn, _ = Rotation.align_vectors(new - new.mean(axis=0), arms)
        x[body.nodes] = new.mean(axis=0) + turn.apply(arms)
    return x
