"""Estimating an instrument's noise from recordings alone (docs, theory: noise)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from rodnet.errors import RecordingError
from rodnet.recordings.lagged import Piece, known_mean, lagged_of, lagged_products, long_ones, of_one_rate
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording
from rodnet.recordings.rest import SHORTEST_REST, common_part, recorded

ORDER = 6  # of differences: a swing of 3 Hz at 100 Hz shrinks by 4e-5, white noise grows by 30
LONGEST_PIECE = 2000  # frames
CLEARLY = 5.0  # standard errors of a slow part that can be told from white noise
ALIKE = 0.5  # of the slow variance, by which markers of one robot differ
ROUNDED = 1e-12  # [m]: what is not zero for the arithmetic's sake
NORMAL = 30.0  # degrees of freedom of differences that are as good as normal
NEAR, BESIDE = 0.1, 0.75  # of a step: a frame that is at a time, and one that is not missing there


@dataclass(frozen=True)
class NoiseEstimate:
    """A noise model and what it rests on.

    Attributes
    ----------
    model : NoiseModel
        The model.
    breathing : ndarray, shape (E,)
        Standard deviation of the arc length between neighbouring markers [m].
    rest : float
        Time during which everything was at rest, over all trials [s].
    effective : float
        Effective number of frames of a trial, for a constant.
    notes : tuple of str
        What could not be told from these recordings.
    """

    model: NoiseModel
    breathing: np.ndarray
    rest: float
    effective: float
    notes: tuple[str, ...]


def estimate_noise(recordings: Recording | Sequence[Recording]) -> NoiseEstimate:
    """Estimate an instrument's noise from trials of one kind.

    The white part comes from differences of sixth order of single markers. The slow part comes from how the arc
    length between neighbouring markers varies, which on an inextensible rod is error (the marker sits on the
    surface and rolls, slips, or is seen askew): its variance and correlation in time, what the mean of
    a trial takes away put back. What is common to all
    markers doesn't change distances; it is told where everything rests, and else is unknown. Where frame rates
    differ, what depends on time is told from the rate that most was recorded at.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        With the same markers and edges.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    RecordingError
        If trials differ in their markers, or hold fewer than 20 frames in a row anywhere.
    """
    trials = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not trials:
        raise RecordingError("estimate_noise needs at least one recording")
    first, notes = trials[0], []
    for rec in trials[1:]:
        if rec.names != first.names or not np.array_equal(rec.edges, first.edges):
            raise rec.error(f"has other markers or edges than '{first.name}'; estimate their noise apart")
    white, dof = _white(trials)
    pieces = [piece for rec in trials for piece in _pieces(rec)] if len(first.edges) else []
    alike = of_one_rate(pieces)
    breathing, slow, time, unsure = _slow(long_ones(alike), first.edges, white)
    if not len(first.edges):
        notes.append("no edges between markers: a slow part cannot be told from motion and is taken as zero")
    if len(alike) < len(pieces):
        told, of = (sum(len(x) * step for x, step in some) for some in (alike, pieces))
        notes.append(
            f"frame rates differ: the slow part is told from the {told:.3g} of {of:.3g} s that were recorded at "
            f"{1.0 / alike[0][1]:.4g} Hz"
        )
    rough = np.average([_roughness(rec.rate, time) for rec in trials], weights=[len(rec.t) for rec in trials])
    white = np.sqrt(np.maximum(white**2 - slow**2 * rough, (0.5 * white) ** 2))  # real ones are smoother
    common, common_time, rest = common_part(trials, white, slow, time)
    if rest < 4.0 * SHORTEST_REST:
        notes.append("hardly ever at rest: a part common to all markers cannot be seen and is taken as zero")
    model = NoiseModel(white, slow, time, common, common_time, dof, unsure)
    m = int(np.argmax(model.total(len(first.names))))
    effective = float(np.mean([model.effective_samples(rec.t[:2000], m) for rec in trials]))
    return NoiseEstimate(model, breathing, rest, effective, tuple(notes))


# -- the white part ---------------------------------------------------------------------------
def _white(trials: Sequence[Recording]) -> tuple[np.ndarray, float]:
    from scipy.stats import t as student

    count = len(trials[0].names)
    gain = np.sqrt(comb(2 * ORDER, ORDER))
    found: list[list[np.ndarray]] = [[] for _ in range(count)]
    for rec in trials:
        d = np.diff(recorded(rec), n=ORDER, axis=0) / gain
        for m in range(count):
            found[m].append(d[np.isfinite(d[:, m]).all(axis=1), m])
    if min(sum(map(len, f)) for f in found) < 20 - ORDER:
        raise trials[0].error("needs at least 20 good frames in a row of every marker to tell its noise")
    pooled = [np.concatenate([d.ravel() for d in f]) for f in found]
    white = np.array([_spread(p) for p in pooled])
    resolution = max(np.median(white), 1e-9)
    white = np.maximum(white, 1e-2 * resolution)
    scaled = np.concatenate([p[:: ORDER + 1] / s for p, s in zip(pooled, white, strict=True)])
    scaled = scaled[:: max(len(scaled) // 5000, 1)]
    dof = float(student.fit(scaled, floc=0.0)[0]) if len(scaled) > 200 else np.inf
    if (
        4.0 < dof < NORMAL
    ):  # sums have thinner tails than samples: their excess kurtosis, 6 / (dof - 4), is smaller
        a = np.array([comb(ORDER, k) for k in range(ORDER + 1)], dtype=float)
        dof = 4.0 + (dof - 4.0) * float((a**4).sum() / (a**2).sum() ** 2)
    return white, dof if 2.0 < dof < NORMAL else (2.5 if dof <= 2.0 else np.inf)


def _spread(d: np.ndarray) -> float:
    """Standard deviation without what is ten times farther out than usual: swaps and slips, not noise."""
    size = np.abs(d)
    usual = np.median(size) / 0.6745
    if usual < ROUNDED and (size > ROUNDED).any():  # numbers of a resolution that is coarser than the noise
        usual = size[size > ROUNDED].min()
    near = d[size <= 10.0 * max(usual, ROUNDED)]
    return float(np.sqrt(np.mean(near**2)))


def _roughness(rate: float, time: float) -> float:
    """Variance that an Ornstein-Uhlenbeck process of unit variance lends to scaled differences."""
    a = np.array([(-1.0) ** k * comb(ORDER, k) for k in range(ORDER + 1)])
    k = np.arange(ORDER + 1)
    return float(a @ np.exp(-np.abs(np.subtract.outer(k, k)) / (rate * time)) @ a / comb(2 * ORDER, ORDER))


# -- the slow part ----------------------------------------------------------------------------
def arc_lengths(rec: Recording) -> np.ndarray:
    """Arc lengths between the markers of each edge [m], shape (T, E): chords, corrected for curvature."""
    x, edges = rec.trusted, rec.edges
    d = x[:, edges[:, 1]] - x[:, edges[:, 0]]
    chord = np.linalg.norm(d, axis=2)
    curvature = np.full((len(edges), 2, len(x)), np.nan)
    for e, (i, j) in enumerate(edges):
        for end, node in enumerate((i, j)):
            for f in np.flatnonzero((edges == node).any(axis=1)):
                if f == e:
                    continue
                ahead = d[:, e] if end else -d[:, e]
                onward = d[:, f] if edges[f, 0] == node else -d[:, f]
                cosine = (ahead * onward).sum(axis=1) / (chord[:, e] * chord[:, f])
                bend = 2.0 * np.arccos(np.clip(cosine, -1.0, 1.0)) / (chord[:, e] + chord[:, f])
                curvature[e, end] = np.fmin(curvature[e, end], bend)  # at a junction the straighter way
    known = np.isfinite(curvature)
    square = np.where(known, curvature, 0.0) ** 2
    mean = square.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return chord + mean.T * chord**3 / 24.0


def _slow(
    pieces: list[Piece], edges: np.ndarray, white: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Breathing of the edges, slow standard deviation of the markers, correlation time, and error of the power."""
    from scipy.optimize import minimize_scalar

    count = len(white)
    if not pieces:
        return np.zeros(len(edges)), np.zeros(count), 0.5, 0.0
    # the mean of a trial takes its share of the white part
    floor = (white[edges] ** 2).sum(axis=1) * (1.0 - len(pieces) / sum(len(x) for x, _ in pieces))
    lags = max(min(len(x) for x, _ in pieces) // 4, 2)
    lagged = np.array([lagged_products(x, lags) for x, _ in pieces])  # (pieces, lags, E)
    # so weighed, what their means take away is, to first order, what it is of a piece of their mean length; an edge
    # that is not seen in a piece, or not for so long, is told by the others
    known = np.isfinite(lagged)
    weights = known * np.array([float(len(x)) for x, _ in pieces])[:, None, None]
    told = (weights.sum(axis=0) > 0.0).all(axis=1)
    lags = lags if told.all() else int(np.argmin(told)) - 1
    if lags < 2:
        return np.zeros(len(edges)), np.zeros(count), 0.5, 0.0
    lagged, weights = np.where(known, lagged, 0.0)[:, : lags + 1], weights[:, : lags + 1]
    mean = (weights * lagged).sum(axis=0) / weights.sum(axis=0)
    frames = sum(len(x) for x, _ in pieces)
    step = float(np.mean([s for _, s in pieces]))
    longest = float(np.mean([len(x) * s for x, s in pieces]))
    without = mean - np.eye(1, lags + 1).T * floor
    # edges breathe to different degrees, but alike in time: together they tell how
    weight = 1.0 / np.maximum(mean[0], floor)
    together = without @ weight
    usual_count = round(longest / step)

    def expected(time: float) -> np.ndarray:
        return lagged_of(np.exp(-step / time), usual_count, lags)

    def misfit(log_time: float) -> float:
        shape = expected(float(np.exp(log_time)))[1:]
        return float(((together[1:] - shape * (shape @ together[1:]) / (shape @ shape)) ** 2).sum())

    time = 10.0 * step
    if together[0] > CLEARLY * np.sqrt(2.0 * len(edges) / frames):
        bounds = (np.log(0.5 * step), np.log(longest))
        time = float(np.exp(minimize_scalar(misfit, bounds=bounds, method="bounded").x))
    shape = expected(time)
    variance = shape @ without / (shape @ shape)
    ratio = time / (frames * step)
    usual = _usual(variance, floor, ratio)
    slow = _of_markers(variance, floor, edges, count, frames, ratio, usual)
    # power is variance times time: an error of the one makes as large a one of the other; neighbours share a marker
    own, slow_power = float(floor.mean()) * step, 4.0 * usual * time
    error = 2.0 * float(np.sqrt(1.5 * 2.0 * time / (frames * step * len(edges))))
    unsure = error * slow_power / (slow_power + own)
    return np.sqrt(np.maximum(variance, 0.0)), np.sqrt(slow), time, unsure


def _usual(variance: np.ndarray, floor: np.ndarray, ratio: float) -> float:
    """Variance of the marker in the middle, of edges with two markers each."""
    # that in the middle of squares is below their mean: of as many independent ones as an edge has correlation times
    middle = float(np.median(variance)) / (1.0 - 2.0 * min(ratio, 1.0) / 9.0) ** 3
    return max(0.5 * middle, 1e-3 * float(floor.mean()))


def _of_markers(
    variance: np.ndarray, floor: np.ndarray, edges: np.ndarray, count: int, frames: int, ratio: float,
    usual: float,
) -> np.ndarray:  # fmt: skip
    """Variances of the markers from those of the edges, var_e = s_i^2 + s_j^2.

    A chain has one edge less than markers, and adds and takes away the edges' errors by turns along it. So each
    marker is taken to be as the ``usual`` one is, within a factor, and the rest is weighed by what so many frames,
    so many correlation times (one over ``ratio``), tell of an edge. A marker that wanders many times as far as the
    others is not followed: that is no noise, but something to be found.
    """
    from scipy.optimize import nnls

    A = np.zeros((len(edges), count))
    A[np.arange(len(edges)), edges[:, 0]] = A[np.arange(len(edges)), edges[:, 1]] = 1.0
    error = np.sqrt(2.0 / frames * floor**2 + 2.0 * ratio * np.maximum(variance, 2.0 * usual) ** 2)
    level = np.full(count, usual)
    pull = 1.0 / (ALIKE * level)
    found, _ = nnls(
        np.vstack([A / error[:, None], np.diag(pull)]), np.concatenate([variance / error, pull * level])
    )
    return np.asarray(found)


def _pieces(rec: Recording) -> list[Piece]:
    """Evenly sampled arc lengths without their mean (frames by edges) [m], and the step [s]."""
    s = arc_lengths(rec)
    good = np.isfinite(s)
    step = 1.0 / rec.rate
    even = rec.t[0] + step * np.arange(round((rec.t[-1] - rec.t[0]) / step) + 1)
    if len(even) < 32 or good.mean(axis=0).min() < 0.5:
        return []
    after = np.clip(np.searchsorted(rec.t, even), 1, len(rec.t) - 1)
    nearest = np.where(even - rec.t[after - 1] < rec.t[after] - even, after - 1, after)
    off = np.abs(rec.t[nearest] - even)
    seen = off <= BESIDE * step
    filled = s[nearest]
    if np.any(off[seen] > NEAR * step):
        filled = np.stack([np.interp(even, rec.t[g], s[g, e]) for e, g in enumerate(good.T)], axis=1)
    # what is filled in is too smooth: it does not count
    filled[~good[nearest] | ~seen[:, None]] = np.nan
    parts = np.array_split(filled, max(int(np.ceil(len(even) / LONGEST_PIECE)), 1))
    return [(p - known_mean(p), step) for p in parts]
