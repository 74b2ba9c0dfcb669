"""What all markers share of an instrument's noise: a camera that drifts. It shows where everything rests."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from rodnet.recordings.lagged import Piece, lagged_products, lagged_without_drift, long_ones, of_one_rate
from rodnet.recordings.recording import PLANE, Recording

AT_REST = 5e-3  # [m/s]
SHORTEST_REST = 0.5  # [s]
LONGEST = 2000  # frames


def recorded(rec: Recording) -> np.ndarray:
    """Positions along the axes that were recorded [m]: in the plane, y stands as zero without any noise."""
    return rec.trusted[..., PLANE] if rec.planar else rec.trusted


def common_part(
    trials: Sequence[Recording], white: np.ndarray, slow: np.ndarray, time: float
) -> tuple[float, float, float]:
    """Standard deviation and time of the common part, and how long everything was at rest."""
    total, stretches, single, slows = 0.0, [], [], []
    for rec in trials:
        for start, end in parts(rest_stretches(rec)):
            x = recorded(rec)[start:end]
            seen = np.isfinite(x).all(axis=(0, 2))
            x = x[:, seen]
            if x.shape[1] < 2:
                continue
            total += float(rec.t[end - 1] - rec.t[start])
            mean = x.mean(axis=1)
            clock = rec.t[start:end] - rec.t[start:end].mean()
            mean = mean - mean.mean(axis=0)  # and without a drift, which may be the robot's
            mean = mean - np.outer(clock, clock @ mean / (clock @ clock))
            stretches.append((mean, 1.0 / rec.rate))
            slows.append(float((slow[seen] ** 2).sum()) / int(seen.sum()) ** 2)
            single.append(slows[-1] + float((white[seen] ** 2).sum()) / int(seen.sum()) ** 2)
    if total < 4.0 * SHORTEST_REST:
        return 0.0, 1.0, total
    sizes = [x.size for x, _ in stretches]
    own = float(np.average(single, weights=sizes))  # of the mean of those markers that were seen
    common = sum(float((x**2).sum()) for x, _ in stretches) / sum(sizes) - own
    if common <= 0.25 * own:
        return 0.0, 1.0, total
    alike = long_ones(of_one_rate(stretches))  # a frame on is not as much later elsewhere
    slow_own = float(np.average(slows, weights=sizes))
    return *_in_time(alike, common, slow_own, time), total


def _in_time(pieces: list[Piece], common: float, slow: float, time: float) -> tuple[float, float]:
    """Standard deviation and time of what is common, from products of means some frames apart.

    ``common`` is its variance at first sight, ``slow`` that of the markers' own slow part in their mean, of the
    correlation ``time``. What was taken away as a drift is put back; white noise is not in products of two frames.
    """
    from scipy.optimize import minimize_scalar

    step = float(np.mean([step for _, step in pieces]))
    weights = [len(x) for x, _ in pieces]
    count = round(float(np.mean(weights)))
    lags = min(weights) // 4
    if lags < 3:
        return float(np.sqrt(common)), 10.0 * step
    seen = np.average([lagged_products(x, lags).mean(axis=1) for x, _ in pieces], axis=0, weights=weights)

    def expected(time: float) -> np.ndarray:
        return lagged_without_drift(np.exp(-step / time), count, lags)[1:]

    wanted = seen[1:] - slow * expected(time)

    def misfit(log_time: float) -> float:
        shape = expected(float(np.exp(log_time)))
        return float(((wanted - shape * (shape @ wanted) / (shape @ shape)) ** 2).sum())

    bounds = np.log(0.5 * step), np.log(0.25 * count * step)  # what is longer is taken for a drift
    found = float(np.exp(minimize_scalar(misfit, bounds=bounds, method="bounded").x))
    shape = expected(found)
    return float(np.sqrt(max(shape @ wanted / (shape @ shape), common))), found


def parts(stretches: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stretches (first, behind the last), the long ones in parts of one length."""
    found = []
    for a, b in stretches:
        ends = np.linspace(a, b, -(-(b - a) // LONGEST) + 1).round().astype(int)
        found += [(int(i), int(j)) for i, j in pairwise(ends)]
    return found


def rest_stretches(rec: Recording) -> list[tuple[int, int]]:
    """Stretches of frames in which no marker moves, as (first, behind the last)."""
    from numpy.lib.stride_tricks import sliding_window_view

    window = max(round(SHORTEST_REST * rec.rate), 2)
    if len(rec.t) <= window:
        return []
    x = sliding_window_view(rec.trusted, window + 1, axis=0)
    reach = np.nanmax(x, axis=-1, initial=-np.inf) - np.nanmin(x, axis=-1, initial=np.inf)
    seen = sliding_window_view(np.isfinite(rec.trusted[..., 0]).any(axis=1), window + 1).mean(axis=1)
    most = np.where(seen > 0.5, reach.max(axis=(1, 2)), np.inf)  # what nobody sees may move
    speed = most / (rec.t[window:] - rec.t[:-window])
    still = np.concatenate([[False], speed < AT_REST, [False]])
    starts, ends = (np.flatnonzero(np.diff(still.astype(int)) == s) for s in (1, -1))
    stretches = [(int(a), int(b) + window) for a, b in zip(starts, ends, strict=True)]
    return [
        (a, min(b, len(rec.t)))
        for a, b in stretches
        if rec.t[min(b, len(rec.t)) - 1] - rec.t[a] >= SHORTEST_REST
    ]
