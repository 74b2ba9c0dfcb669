"""One recording with the robot and the instruments that a case makes of it, ready to be predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import CaseError, ConvergenceError, ParameterError
from rodnet.inference.case import Case
from rodnet.inference.quantities import (
    instrument_path,
    is_there,
    robot_values,
    set_instrument,
    tie,
    value_of,
)
from rodnet.names import listed, meant
from rodnet.recordings.observation import Observation
from rodnet.recordings.prediction import observe
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.trajectory import Trajectory


@dataclass(frozen=True)
class Trial:
    """A recording and the model of it.

    Parameters
    ----------
    rec : Recording
        What of it is predicted; the simulation's time zero is its first frame.
    robot : Robot
        With the values in question.
    observations : sequence of Observation
        What was recorded.
    options : mapping
        Of `Simulation`.
    """

    rec: Recording
    robot: Robot
    observations: Sequence[Observation]
    options: Mapping[str, Any]

    @classmethod
    def of(cls, case: Case, rec: Recording, values: Mapping[str, Any] | None = None) -> Trial:
        """Build what a case says, with these values of parameters of the robot and of observations.

        Raises
        ------
        CaseError
            For a path that is of neither.
        """
        rec = case.part(rec)
        robot = case.robot(rec)
        observations = case.observations(rec, robot)
        known = {path: p.value for path, p in robot.parameters.items()}
        known |= {f"{o.name}.{n}": p.value for o in observations for n, p in o.parameter_items()}
        wanted: dict[str, Any] = dict(values or {})
        mine: dict[str, Any] = {}
        whole: dict[str, Any] = {}
        seen, unknown = [], []
        free = [p for p in case.free if case.tied and is_there(robot, observations, p)]
        drawn = {p: value_of(robot, observations, p) for p in free}
        for path, function in case.tied.items():
            wanted[path] = tie(path, function, {**known, **drawn, **wanted})
        for path, value in wanted.items():
            try:
                place = _instrument(observations, path, value)
                if place is not None:
                    seen.append((place, value))
                elif np.ndim(value) and path in robot.parameters:
                    whole[path] = value
                else:
                    robot_values(robot, {path: value})  # if there is such a one
                    mine[path] = value
            except ParameterError:
                unknown.append(path)
        if unknown:
            raise CaseError(
                f"case '{case.name}' has no parameter {', '.join(map(repr, sorted(unknown)))} in '{rec.name}'; "
                f"{meant(unknown[0], known)}{listed(known)}"
            )
        if mine or whole:
            robot = robot.with_parameters({**whole, **robot_values(robot, mine)})
            observations = case.observations(rec, robot)
        for (number, name, index), value in seen:
            set_instrument(observations[number], name, index, value)
        return cls(rec, robot, observations, case.simulation(rec, robot))

    def predict(self) -> tuple[list[np.ndarray], str]:
        """Simulate open loop; return what each instrument would have read at every frame, and what went wrong.

        Where the simulation fails, its last state is held for the rest.
        """
        traj, failure = self.run()
        return self.read(traj), failure

    def run(self) -> tuple[Trajectory, str]:
        """Simulate open loop; return the motion, as far as it goes, and what went wrong.

        It is as long as the recording, or longer where an instrument reads ahead (its lag is negative).
        """
        sim = Simulation(self.robot, **self.options)
        failure = ""
        ahead = max(0.0, *(-float(one.lag.value) for one in self.observations))
        try:
            traj = sim.run(self.rec.duration + ahead)
        except ConvergenceError as error:
            if error.debug_path is not None:
                Path(error.debug_path).unlink(missing_ok=True)
            if error.trajectory is None:
                raise
            traj, failure = error.trajectory, f"fails at {error.time:.3g} s ({error.worst})"
        return traj, failure

    def read(self, traj: Trajectory) -> list[np.ndarray]:
        """Return what each instrument would have read of a motion at every frame; its last state is held."""
        times = np.minimum(self.rec.t - self.rec.t[0], traj.t[-1])
        return observe(self.observations, traj, times)


def _instrument(
    observations: Sequence[Observation], path: str, value: Any
) -> tuple[int, str, int | None] | None:
    """Which instrument's parameter a path is, whole or one number of it; None if it is the robot's."""
    for number, one in enumerate(observations):
        name = path.removeprefix(f"{one.name}.")
        if np.ndim(value) and name != path and name in one.declared():
            return number, name, None
    return instrument_path(observations, path)
