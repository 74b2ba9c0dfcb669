"""One trial of a calibration: its prediction, its prewhitened residual, and the derivative of both."""

from __future__ import annotations

import copy
import hashlib
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rodnet.errors import ConvergenceError, ParameterError, RodnetError, SingularMatrixError
from rodnet.inference.case import Case
from rodnet.inference.modes import soft_modes
from rodnet.inference.quantities import AXES, instrument_path, robot_values, set_instrument
from rodnet.observer import Observer
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.observation import HeadAngle, HeadSpeed, Markers, Observation
from rodnet.recordings.prediction import SLACK, _cubic
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.tangent.columns import make_columns
from rodnet.tangent.follow import Tangent
from rodnet.tangent.sensitivities import observed
from rodnet.tangent.state import StateTangent

STEP = 1e-5  # of differences of observations by their own parameters, of their scale
SHIFT = 1e-3  # of a time step: differences in time


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
    """

    measured: list[np.ndarray]
    predicted: list[np.ndarray]
    residual: np.ndarray
    jacobian: np.ndarray | None
    whitened: list[np.ndarray]


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
    """

    def __init__(self, case: Case, rec: Recording, noise: Mapping[str, NoiseModel], modes: int = 4) -> None:
        self.case, self.noise, self.mode_count = case, dict(noise), modes
        self.rec = from_zero(case.part(rec))
        self.robot = case.robot(self.rec)
        self.instruments = case.observations(self.rec, self.robot)
        self.options = case.simulation(self.rec, self.robot)
        self.measured = [np.asarray(one.measured(self.rec), dtype=float) for one in self.instruments]
        self._modes: np.ndarray | None = None
        if self.options.get("adaptive") is not None:
            raise ParameterError("a calibration needs a fixed time step: leave out adaptive")

    # -- the robot at some values -----------------------------------------------------------------
    def motion(self, path: str) -> tuple[str, np.ndarray]:
        """Whether a path of the initial state is of positions or velocities, and its displacement."""
        name, _, index = path.removeprefix("initial.").partition("[")
        shape, which = self.robot.graph.x0.shape, index.rstrip("]")
        if name == "offset":
            if which not in tuple(AXES):
                raise ParameterError(f"'{path}': axes are x, y and z")
            return "x", np.broadcast_to(np.eye(3)[AXES.index(which)], shape)
        if self._modes is None:
            self._modes = soft_modes(self.robot, self.mode_count)
        if not which.isdigit() or int(which) >= len(self._modes):
            raise ParameterError(f"'{path}': there are {len(self._modes)} modes, numbered from 0")
        return ("x" if name == "position" else "v"), self._modes[int(which)]

    def robot_at(self, values: Mapping[str, float]) -> tuple[Robot, dict[str, Any]]:
        """Return the robot with these values, in its initial position, and the options of its simulation."""
        own = {p: v for p, v in values.items() if self._kind(p) == "robot"}
        robot = self.robot.with_parameters(robot_values(self.robot, own)) if own else self.robot
        moved = {"x": np.zeros(robot.graph.x0.shape), "v": np.zeros(robot.graph.x0.shape)}
        for path, value in values.items():
            if self._kind(path) == "initial" and value:
                key, shape = self.motion(path)
                moved[key] += value * shape
        if moved["x"].any():
            robot = Robot(robot.graph.with_positions(robot.graph.x0 + moved["x"]), robot.terms, robot.sensors)
        options = dict(self.options)
        if moved["v"].any():
            start = options.get("velocity")
            options["velocity"] = moved["v"] + (0.0 if start is None else np.asarray(start, dtype=float))
        return robot, options

    def _kind(self, path: str) -> str:
        if path == "initial.time":
            return "time"
        if path.startswith("initial."):
            return "initial"
        return "robot" if instrument_path(self.instruments, path) is None else "instrument"

    def instruments_at(self, values: Mapping[str, float]) -> list[Observation]:
        """Return the instruments with these values."""
        found = [copy.copy(one) for one in self.instruments]
        for path, value in values.items():
            place = None if path.startswith("initial.") else instrument_path(self.instruments, path)
            if place is not None:
                set_instrument(found[place[0]], place[1], place[2], value)
        return found

    # -- prediction ---------------------------------------------------------------------------------
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
        scales = dict(scales or {})
        kinds = {path: self._kind(path) for path in scales}
        robot, options = self.robot_at(values)
        eyes = self.instruments_at(values)
        sim = Simulation(robot, **options)
        model = sim.model
        parameters = {p: s for p, s in scales.items() if kinds[p] == "robot"}
        starts = {p: dict([self.motion(p)]) for p in scales if kinds[p] == "initial"}
        moving = [*parameters, *starts]
        shaping = {
            p: self._changed(eyes, p, values[p], scales[p]) for p in scales if kinds[p] == "instrument"
        }
        timed = [[p for p in scales if kinds[p] == "time" or p == f"{one.name}.lag"] for one in eyes]
        late = values.get("initial.time", 0.0)
        clock = [
            Clock(self.rec.t, float(one.lag.value) + late, sim.dt, bool(paths))
            for one, paths in zip(eyes, timed, strict=True)
        ]
        needed = [set(c.nodes.ravel().tolist()) for c in clock]
        steps = max(max(n) for n in needed)
        read: list[dict[int, np.ndarray]] = [{} for _ in eyes]
        slope: list[dict[int, np.ndarray]] = [{} for _ in eyes]
        tangent: Tangent | None = None

        def keep(view: Observer) -> bool:
            k = view.state.index
            current: StateTangent | None = None
            for number, one in enumerate(eyes):
                if k not in needed[number]:
                    continue
                read[number][k] = np.asarray(one.read(view), dtype=float)
                if not scales:
                    continue
                columns = np.zeros((*read[number][k].shape, len(scales)))
                if tangent is not None:
                    current = tangent.current if current is None else current
                    where = [list(scales).index(p) for p in moving]
                    columns[..., where] = reading_slope(one, model, view, current, robot)
                for path, (which, low, high, width) in shaping.items():
                    if which == number:
                        up, down = (np.asarray(i.read(view), dtype=float) for i in (high, low))
                        columns[..., list(scales).index(path)] = (up - down) / width
                slope[number][k] = columns
            return False

        if moving:
            columns = make_columns(robot, parameters, starts, options)
            with Tangent(sim, columns) as tangent:
                self._run(sim, steps, keep)
        else:
            self._run(sim, steps, keep)
        predicted, slopes = [], []
        for number, c in enumerate(clock):
            predicted.append(c.at(read[number]))
            rows = c.at(slope[number]) if scales else np.zeros((*predicted[-1].shape, 0))
            for path in timed[number]:
                rows[..., list(scales).index(path)] = -c.rate(read[number])
            for k, (share, change) in enumerate(zip(eyes[number].numerics.value, eyes[number].corrections, strict=False)):
                predicted[-1] = predicted[-1] + share * change
                if (path := f"{eyes[number].name}.numerics[{k}]") in scales:
                    rows[..., list(scales).index(path)] = change
            slopes.append(rows)
        return predicted, slopes

    def _run(self, sim: Simulation, steps: int, keep: Any) -> None:
        keep(sim.observe())
        if steps:
            for view in sim.iterate(steps * sim.dt):
                keep(view)

    def _changed(
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
        """Compare with what was measured.

        Parameters
        ----------
        values : mapping
            By path, all that differ from the robot as it was built.
        scales : mapping, optional
            Paths to differentiate by, with changes worth considering.
        rejected : sequence of ndarray, shapes (F, M)
            Samples to leave out.
        """
        predicted, slopes = self.predict(values, scales)
        count = len(scales or {})
        parts, whitened = [], []
        for number, one in enumerate(self.instruments):
            error = by_samples(self.measured[number] - predicted[number])
            if rejected is not None:
                error = np.where(rejected[number][..., None], np.nan, error)
            stack = np.concatenate([error[..., None], -slopes[number].reshape(*error.shape, count)], axis=-1)
            white, _ = self.noise[one.name].whiten(self.rec.t, stack)
            seen = np.isfinite(error).all(axis=2)
            whitened.append(white[..., 0])
            parts.append(white[seen].reshape(-1, count + 1))
        table = np.concatenate(parts)
        return Fit(
            self.measured, predicted, table[:, 0], table[:, 1:] if scales is not None else None, whitened
        )


class Clock:
    """At which states of a run the frames lie, and how to interpolate between them."""

    def __init__(self, t: np.ndarray, late: float, dt: float, rates: bool) -> None:
        # a run is as long as the last frame needs, and at least as a cubic does; before the start nothing moves
        since = t - t[0] - late
        self.moments = np.maximum(since, 0.0)
        steps = max(int(np.ceil(self.moments.max() / dt - SLACK)), 3) + 1
        self._grid, self._slack, self._h = dt * np.arange(steps + 1), SLACK * dt, SHIFT * dt
        self._plain = [_cubic(self._grid, m, self._slack) for m in self.moments]
        self._near = [
            [_cubic(self._grid, max(m + s * self._h, 0.0), 0.0) for m in since]
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


def from_zero(rec: Recording) -> Recording:
    """The recording with times that count from its first frame, as a simulation's do."""
    t = rec.t - rec.t[0]
    channels = {k: np.asarray(v) for k, v in rec.channels.items()}
    return replace(rec, t=t, channels=channels)


def by_samples(values: np.ndarray) -> np.ndarray:
    """Readings as (frames, samples, coordinates): markers are samples of several coordinates, numbers of one."""
    if values.ndim == 3:
        return values
    return values.reshape(len(values), -1, 1)


def reading_slope(
    one: Observation, model: Model, view: Observer, tangent: StateTangent, robot: Robot
) -> np.ndarray:
    """Derivative of what an instrument reads, shape (..., k): by the chain rule where the reading is linear."""
    if type(one).read is Markers.read and not (np.any(one.offset1.value) or np.any(one.offset2.value)):  # type: ignore[attr-defined]
        assert isinstance(one, Markers)
        dx = tangent.q[: model.twist0].reshape(-1, 3, tangent.count)
        i, j = robot.graph.edges[one.edge].T
        s = one.along[:, None, None]
        moved = (1.0 - s) * dx[i] + s * dx[j]
        turn = Rotation.from_rotvec(np.array(np.broadcast_to(one.rotation.value, 3))).as_matrix()
        return (one.scale.value * np.einsum("ab,mbk->mak", turn, moved))[:, one.axes]
    if type(one).read in (HeadSpeed.read, HeadAngle.read):
        assert isinstance(one, HeadSpeed)
        array = tangent.v if type(one).read is HeadSpeed.read else tangent.q
        return one.factor * array[model.twist0 + one.edge]
    return observed(model, view, tangent, one.read, robot)


# -- in any process ---------------------------------------------------------------------------------
_known: dict[str, Comparison] = {}


def pack_trial(case: bytes, rec: Recording, noise: Mapping[str, NoiseModel], modes: int) -> bytes:
    """Return what another process needs to make the trial; ``case`` is packed already."""
    return pickle.dumps((case, rec, dict(noise), modes))


def unpack_trial(packed: bytes) -> Comparison:
    """Make the trial, once in each process."""
    key = hashlib.sha256(packed).hexdigest()
    if key not in _known:
        case, rec, noise, modes = pickle.loads(packed)
        rec = rec.replace(channels={k: np.asarray(v) for k, v in rec.channels.items()})
        _known[key] = Comparison(pickle.loads(case), rec, noise, modes)
    return _known[key]


def evaluate_trial(
    packed: bytes, values: Mapping[str, float], scales: Mapping[str, float] | None,
    rejected: Sequence[np.ndarray] | None,
) -> Fit | str:  # fmt: skip
    """Evaluate a trial; a text says why its motion could not be computed."""
    trial = unpack_trial(packed)
    try:
        fit = trial.evaluate(values, scales, rejected)
    except (ConvergenceError, SingularMatrixError) as error:
        return f"trial '{trial.rec.name}': {error}"
    except RodnetError:
        raise
    if not np.isfinite(fit.residual).all():
        return f"trial '{trial.rec.name}': its motion is not finite"
    return fit
