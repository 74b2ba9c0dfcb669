"""Simulating a trial at some values, in one shot or in several, with the derivatives of what instruments read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rodnet.errors import ConvergenceError
from rodnet.inference.corrections import is_share
from rodnet.inference.readings import Clock, Shaping, reading_slope
from rodnet.observer import Observer
from rodnet.recordings.observation import Observation
from rodnet.simulation import Simulation
from rodnet.solve.steppers import State
from rodnet.tangent.columns import make_columns
from rodnet.tangent.follow import Tangent
from rodnet.tangent.state import StateTangent, joined, zero
from rodnet.tangent.variation import Variation

if TYPE_CHECKING:
    from rodnet.inference.comparison import Comparison


class Moment(NamedTuple):
    """A state with the derivatives of position and velocity by all paths, shapes (dof_count, k)."""

    state: State
    q: np.ndarray
    v: np.ndarray


class Shot(NamedTuple):
    """What was predicted of some frames, derivatives, and the states at both ends."""

    predicted: list[np.ndarray]
    slopes: list[np.ndarray]
    begin: Moment
    end: Moment


class Shots:
    """A trial's robot and instruments at some values.

    Parameters
    ----------
    trial : Comparison
        The trial.
    values : mapping
        By path, all that differ from the robot as it was built.
    scales : mapping
        Paths to differentiate by, with changes worth considering.
    """

    def __init__(self, trial: Comparison, values: Mapping[str, float], scales: Mapping[str, float]) -> None:
        self.trial, self.values, self.paths = trial, values, list(scales)
        self.robot, options = trial.robot_at(values)
        self.eyes = trial.instruments_at(values)
        self.sim = Simulation(self.robot, **options)
        kinds = {path: trial.kind(path) for path in scales}
        parameters = {p: s for p, s in scales.items() if kinds[p] == "robot"}
        starts = {p: trial.start_slope(p, values, s) for p, s in scales.items() if kinds[p] == "initial"}
        self._moving = [*parameters, *starts]
        self._columns = (
            make_columns(self.robot, parameters, starts, options, self.sim.model) if self._moving else []
        )
        self._first = joined([c.initial(self.sim) for c in self._columns]) if self._columns else None
        own = [p for p in scales if kinds[p] == "instrument" and not is_share(p)]
        self._shaping = self._shaped(own, scales)
        self._timed = [
            [p for p in scales if kinds[p] == "time" or p == f"{one.name}.lag"] for one in self.eyes
        ]
        self._follow: Callable[..., Tangent] = Tangent

    def add(self, columns: list[Variation]) -> None:
        """Differentiate by these columns, too, whose names are none of the paths."""
        names = [column.name for column in columns]
        self.paths, self._moving = [*self.paths, *names], [*self._moving, *names]
        self._columns = [*self._columns, *columns]
        self._first = joined([c.initial(self.sim) for c in self._columns]) if self._columns else None

    def move(
        self, paths: list[str], columns: list[Variation], first: StateTangent, follow: Callable[..., Tangent]
    ) -> None:
        """Differentiate by these columns instead, which ``follow(sim, columns, first)`` makes a tangent of."""
        self.paths, self._moving, self._columns, self._first = list(paths), list(paths), columns, first
        self._shaping, self._timed, self._follow = self._shaped([], {}), [[] for _ in self.eyes], follow

    def _shaped(self, paths: list[str], scales: Mapping[str, float]) -> list[Shaping]:
        """How the readings of each instrument change with parameters of its own."""
        changes = {p: self.trial.changed(self.eyes, p, self.values[p], scales[p]) for p in paths}
        found = []
        for n, one in enumerate(self.eyes):
            mine = {p: near for p, (which, *near) in changes.items() if which == n}
            found.append(Shaping(one, [self.paths.index(p) for p in mine], [tuple(v) for v in mine.values()]))  # type: ignore[misc]
        return found

    def shoot(self, number: int, until: int = 0, most: float = np.inf) -> Shot:
        """Simulate one segment, and on until the state of an index where it is nearer than that.

        ``most`` is the number of iterations of Newton's method per step that it may take on the whole.

        Raises
        ------
        ConvergenceError
            If it cannot be, or takes more iterations than it may.
        """
        trial, sim = self.trial, self.sim
        frames = trial.frames(number)
        moving, columns, initial = self._begin(number)
        first = sim.state.index
        late = self.values.get("initial.time", 0.0)
        clock = [
            Clock(trial.rec.t[frames], float(one.lag.value) + late, sim.dt, bool(paths), first)
            for one, paths in zip(self.eyes, self._timed, strict=True)
        ]
        needed = [set(c.nodes.tolist()) for c in clock]
        last = max(until, *(max(n) for n in needed))
        read: list[dict[int, np.ndarray]] = [{} for _ in self.eyes]
        slope: list[dict[int, np.ndarray]] = [{} for _ in self.eyes]
        tangent: Tangent | None = None
        where = [self.paths.index(p) for p in moving]
        ends: dict[int, Moment] = {}

        def keep(view: Observer) -> None:
            k = view.state.index
            current = None if tangent is None else tangent.current
            if k in (first, until):
                ends[k] = self._moment(view.state, current, where)
            for n, one in enumerate(self.eyes):
                if k not in needed[n]:
                    continue
                read[n][k] = np.asarray(one.read(view), dtype=float)
                if not self.paths:
                    continue
                rows = np.zeros((*read[n][k].shape, len(self.paths)))
                if current is not None:
                    rows[..., where] = reading_slope(one, sim.model, view, current, self.robot)
                    if one.explicit:
                        rows[..., where] += self._explicit(one, view, columns)
                self._shaping[n].add(view, rows)
                slope[n][k] = rows

        def run() -> None:
            keep(sim.observe())
            if last > first:
                limit = sim.newton.iterations + most * (last - first)
                for view in sim.iterate((last - first) * sim.dt):
                    if sim.newton.iterations > limit:
                        raise ConvergenceError(_laboured(sim, most), time=sim.t)
                    keep(view)

        if columns:
            with self._follow(sim, columns, initial) as tangent:
                run()
        else:
            run()
        predicted, slopes = [], []
        for n, c in enumerate(clock):
            predicted.append(c.at(read[n]))
            rows = c.at(slope[n]) if self.paths else np.zeros((*predicted[-1].shape, 0))
            for path in self._timed[n]:
                rows[..., self.paths.index(path)] = -c.rate(read[n])
            slopes.append(rows)
        return Shot(predicted, slopes, ends[first], ends.get(until, ends[first]))

    def _begin(self, number: int) -> tuple[list[str], list[Variation], StateTangent | None]:
        """Put the simulation at the beginning of a segment; return what moves it, as paths, columns and tangent."""
        if number == 0:
            return self._moving, self._columns, self._first
        segment, model = self.trial.segments[number - 1], self.sim.model
        self.sim.restore(segment.begin(model, self.values))
        own = [path for path in segment.paths() if path in self.paths]
        if not self._moving and not own:
            return [], [], None
        slopes = segment.tangents(model, self.values) if own else {}
        parts = [zero(model, self.sim.state, len(self._moving))] if self._moving else []
        columns = [*self._columns, *(Variation(path, "1", 0.0, (), acts=False) for path in own)]
        return [*self._moving, *own], columns, joined([*parts, *(slopes[path] for path in own)])

    def _explicit(self, one: Observation, view: Observer, columns: list[Variation]) -> np.ndarray:
        """Derivative of a reading by the parameters, the state being what it is; shape (..., columns)."""
        return np.stack([
            np.sum([
                weight * np.asarray(one.read(Observer(other.model, view.state, self.robot.sensors)))
                for weight, other in column.near
            ], axis=0) if column.acts else np.zeros(np.shape(one.read(view)))
            for column in columns
        ], axis=-1)  # fmt: skip

    def _moment(self, state: State, tangent: StateTangent | None, where: list[int]) -> Moment:
        q, v = np.zeros((2, len(state.q), len(self.paths)))
        if tangent is not None:
            q[:, where], v[:, where] = tangent.q, tangent.v
        return Moment(state, q, v)


def _laboured(sim: Simulation, most: float) -> str:
    return (
        f"takes more than {most:g} iterations of Newton's method per step, up to {sim.t:.3g} s, where five are "
        f"usual: take a shorter step than {sim.dt:.3g} s, or begin elsewhere"
    )


def why(error: Exception) -> str:
    """Say why a trial cannot be simulated; a search fails often, and keeps no recording of the step that did."""
    if not isinstance(error, ConvergenceError):
        return str(error)
    if error.debug_path is None:
        return str(error)
    Path(error.debug_path).unlink(missing_ok=True)
    return f"fails at {error.time:.3g} s ({error.worst})"
