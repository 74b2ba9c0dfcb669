"""Profile likelihood: a parameter held, all others refitted."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from rodnet.inference.problem import Problem, cores
from rodnet.inference.result import Optimum, Profile

RISE = 3.841  # of the deviance at 95 %
ENOUGH = 6.0  # of it where a side ends
STEPS = 12  # to one side
STRIDE = 0.7  # standard deviations
LONGEST = 1.0  # of a coordinate: a factor of e


def profile(
    problem: Problem, best: Optimum, k: int, sd: float, factor: float, evaluations: int, workers: int | None,
    loss: str,
) -> Profile:  # fmt: skip
    """Walk along coordinate ``k`` to either side of the optimum; see `CalibrationResult.profile`."""
    from rodnet.inference.search import minimise
    from rodnet.sweeps.driver import start

    quantity = problem.quantities[k]
    stride = min(STRIDE * sd, LONGEST)
    places, rises = [float(best.z[k])], [0.0]
    problem.interrupt = None  # Ctrl-C that ended the search was for that
    with ExitStack() as stack:
        before = problem.executor
        count = cores() if workers is None and len(problem.packed) > 1 else workers or 0
        problem.executor = start(count, len(problem.packed))
        stack.callback(problem.executor.shutdown, cancel_futures=True)
        for side in (-1.0, 1.0):
            z, step = best.z.copy(), side * stride
            for _ in range(STEPS):
                low, high = quantity.bounds
                place = float(np.clip(z[k] + step, low, high))
                if place == z[k]:
                    break
                z[k] = place
                found = minimise(problem, z, loss, evaluations, lambda text: None, fixed=[k])
                if found is None:
                    break
                z = found.z.copy()
                places.append(float(z[k]))
                rises.append(2.0 * (found.cost - best.cost) / factor)
                if rises[-1] > ENOUGH:
                    break
        problem.executor = before
    order = np.argsort(places)
    at, rise = np.array(places)[order], np.maximum(np.array(rises)[order], 0.0)
    middle = int(np.argmin(np.abs(at - best.z[k])))
    below = _crossing(at[: middle + 1][::-1], rise[: middle + 1][::-1])
    above = _crossing(at[middle:], rise[middle:])
    ends = (
        quantity.low if below is None else quantity.value(below),
        quantity.high if above is None else quantity.value(above),
    )
    return Profile(quantity.path, np.array([quantity.value(z) for z in at]), rise, *ends)


def _crossing(at: np.ndarray, rise: np.ndarray) -> float | None:
    """Where the deviance has risen enough, between places outward from the optimum: its root is nearly straight."""
    for a, b in zip(range(len(at) - 1), range(1, len(at)), strict=True):
        if rise[b] >= RISE:
            low, high = np.sqrt(rise[a]), np.sqrt(rise[b])
            return float(at[a] + (np.sqrt(RISE) - low) / (high - low) * (at[b] - at[a]))
    return None
