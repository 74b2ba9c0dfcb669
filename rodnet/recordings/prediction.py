"""What instruments would have read of a trajectory, at the times of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import OutputError, ParameterError
from rodnet.recordings.observation import Observation

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

SLACK = 1e-9  # of a time step: rounding of times


def observe(
    observations: Observation | Sequence[Observation], traj: Trajectory, t: np.ndarray
) -> list[np.ndarray]:
    """Return what each instrument reads of a trajectory at times ``t``.

    Between recorded states the readings follow the cubic through the four nearest; where a state was recorded
    they are exact. An instrument's lag shifts the time at which it looks; before the start it sees the start.

    Parameters
    ----------
    observations : Observation or sequence of Observation
        The instruments.
    traj : Trajectory
        With its robot.
    t : array_like, shape (T,)
        Times [s], within the trajectory.

    Returns
    -------
    list of ndarray
        Of each instrument, shape (T, ...).

    Raises
    ------
    ParameterError
        If a time lies outside the trajectory.
    OutputError
        If the trajectory was loaded without its robot.
    """
    instruments = [observations] if isinstance(observations, Observation) else list(observations)
    if traj.robot is None:
        raise OutputError("observe needs the robot: load the file with Trajectory.load(path, robot)")
    times = np.asarray(t, dtype=float)
    slack = SLACK * max(traj.dt, 1e-12)
    if len(times) and (times.min() < traj.t[0] - slack or times.max() > traj.t[-1] + slack):
        raise ParameterError(
            f"observe: t runs from {times.min():g} to {times.max():g} s, the trajectory from {traj.t[0]:g} to "
            f"{traj.t[-1]:g} s"
        )
    readings: dict[tuple[int, int], np.ndarray] = {}

    def reading(number: int, k: int) -> np.ndarray:
        if (number, k) not in readings:
            readings[number, k] = np.asarray(instruments[number].read(traj.view(k)), dtype=float)
        return readings[number, k]

    found = []
    for number, instrument in enumerate(instruments):
        lag = float(instrument.lag.value)
        rows = []
        for moment in np.clip(times - lag, traj.t[0], traj.t[-1]):
            nodes, weights = _cubic(traj.t, float(moment), slack)
            rows.append(sum(w * reading(number, int(k)) for k, w in zip(nodes, weights, strict=True)))
        found.append(np.array(rows))
    return found


def _cubic(t: np.ndarray, moment: float, slack: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices of up to four states about a time, and the weights of Lagrange's polynomial through them."""
    k = int(np.searchsorted(t, moment))
    for near in (k, k - 1):
        if 0 <= near < len(t) and abs(t[near] - moment) <= slack:
            return np.array([near]), np.ones(1)
    first = min(max(k - 2, 0), max(len(t) - 4, 0))
    nodes = np.arange(first, min(first + 4, len(t)))
    x = t[nodes]
    weights = [
        np.prod([(moment - x[j]) / (x[i] - x[j]) for j in range(len(x)) if j != i]) for i in range(len(x))
    ]
    return nodes, np.array(weights)
