"""How sure the values are: profile likelihoods, and what other trials of the same kind might have given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.crossval import best_change, reduced
from rodnet.diagnosis.findings import LEVEL, Interval, interval
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.inference.problem import Problem

RISE = float(chi2_of.ppf(LEVEL, 1))  # of the deviance at the ends of an interval
STRIDES = (1.0, 2.0)  # of the linear half width: where a profile is evaluated, to either side
DRAWS = 1000


def profiles(bench: Workbench, model: Fitted, paths: Sequence[str]) -> dict[str, Interval]:
    """Intervals of common values by profile likelihood, over the variance factor of the model.

    Along a parameter all others follow to first order and are then corrected once, with the derivatives at the
    optimum; the deviance is that of full runs. An end is interpolated where its root has risen enough.
    """
    problem = bench.problem(model.candidates, model.values, model.own)
    J = model.jacobian
    C, factor = model.covariance(), variance_factor(model)
    found = {}
    for path in paths:
        k = model.place(path)
        found[path] = _profile(problem, model, J, C, factor, k)
    return found


def _profile(
    problem: Problem, model: Fitted, J: np.ndarray, C: np.ndarray, factor: float, k: int
) -> Interval:
    linear = interval(model, model.quantities[k].path)
    q, sd = problem.quantities[k], float(np.sqrt(C[k, k]))
    if not sd > 0.0 or not np.isfinite(sd):
        return linear
    others = np.delete(np.arange(len(C)), k)
    inverse = np.linalg.pinv(J[:, others], rcond=1e-9)
    half = np.sqrt(RISE * factor) * sd
    low, high = q.bounds
    ends = []
    for side in (-1.0, 1.0):
        places, roots = [0.0], [0.0]
        for stride in STRIDES:
            step = float(np.clip(side * stride * half, low, high))
            if step == places[-1]:
                break
            z = _clipped(problem, C[:, k] / C[k, k] * step)
            z[k] = step
            here = _residual(problem, z)
            if here is None:
                break
            z[others] -= inverse @ here
            z = _clipped(problem, z)
            corrected = _residual(problem, z)
            rise = min(float(r @ r) for r in (here, corrected) if r is not None) - model.deviance
            places.append(step)
            roots.append(np.sqrt(max(rise, 0.0) / factor))
            if roots[-1] >= np.sqrt(RISE):
                break
        ends.append(_end(places, roots, side * half, low if side < 0.0 else high))
    values = sorted(q.value(z) for z in ends)
    return Interval(model.values[q.path], values[0], values[1], q.unit)


def _clipped(problem: Problem, z: np.ndarray) -> np.ndarray:
    low, high = (np.array(b) for b in zip(*(q.bounds for q in problem.quantities), strict=True))
    return np.clip(z, low, high)


def _residual(problem: Problem, z: np.ndarray) -> np.ndarray | None:
    fits = problem.fits(z, slopes=False)
    return None if fits is None else np.concatenate([*(f.residual for f in fits), problem.priors(z)[0]])


def _end(places: Sequence[float], roots: Sequence[float], linear: float, bound: float) -> float:
    """Where the root of the deviance has risen enough: between two places, or beyond the last on the same slope."""
    wanted = float(np.sqrt(RISE))
    if len(places) == 1:  # it could not be simulated there
        return float(np.clip(linear, min(0.0, bound), max(0.0, bound)))
    for a in range(len(places) - 1):
        if roots[a + 1] >= wanted:
            share = (wanted - roots[a]) / (roots[a + 1] - roots[a])
            return places[a] + share * (places[a + 1] - places[a])
    if roots[-1] <= 0.25 * wanted:  # flat: the bound is all that is known
        return bound
    return float(np.clip(places[-1] * wanted / roots[-1], min(0.0, bound), max(0.0, bound)))


@dataclass(frozen=True)
class Resampled:
    """What other trials of the same kind might have given.

    Attributes
    ----------
    kind : str
        How: ``"linearised"`` (trials drawn again, on stored derivatives, nothing simulated), or ``"pipeline"``.
    draws : int
        How often.
    intervals : dict
        Of the values of the effects, by path.
    named : dict
        Share of the draws in which an effect is found (again), by id.
    removed : tuple of float or None
        Interval of the share of the held-out error beyond the floor that the repaired model removes.
    verdicts : dict
        How often each verdict, with ``"pipeline"``.
    """

    kind: str
    draws: int
    intervals: dict[str, tuple[float, float]]
    named: dict[str, float]
    removed: tuple[float, float] | None = None
    verdicts: dict[str, int] = field(default_factory=dict)


def linearised(
    model: Fitted, paths: Sequence[str], gains: dict[str, np.ndarray], least: float,
    errors: tuple[np.ndarray, np.ndarray, float | None] | None, seed: int,
) -> Resampled:  # fmt: skip
    """Bootstrap over trials to first order: training trials drawn again with the derivatives that are stored.

    Parameters
    ----------
    model : Fitted
        The repaired model.
    paths : sequence of str
        Values of interest.
    gains : dict
        By effect, what each trial gains when it is predicted from the others.
    least : float
        Gain of all trials together from which an effect counts as found.
    errors : tuple, optional
        Of each trial not seen, its error before and after, and the floor.
    seed : int
        Of the draws.
    """
    rng = np.random.default_rng(seed)
    forms, prior = reduced(model)
    common = [q for q in model.quantities if q.trial is None]
    count = len(forms)
    drawn = np.zeros((DRAWS, len(common)))
    hits = dict.fromkeys(gains, 0)
    for draw in range(DRAWS):
        picked = rng.integers(count, size=count)
        drawn[draw] = best_change([forms[k] for k in picked], prior)
        for id, gain in gains.items():
            hits[id] += float(gain[picked].sum()) > least
    tails = 50.0 * (1.0 - LEVEL)
    intervals = {}
    for path in paths:
        k = [q.path for q in common].index(path)
        z = common[k].coordinate(model.values[path]) + drawn[:, k]
        low, high = np.percentile([common[k].value(v) for v in z], [tails, 100.0 - tails])
        intervals[path] = (float(low), float(high))
    removed = None
    if errors is not None:
        before, after, floor = errors
        picks = rng.integers(len(before), size=(DRAWS, len(before)))
        a, b = (before[picks] ** 2).mean(axis=1), (after[picks] ** 2).mean(axis=1)
        excess = a - (floor or 0.0) ** 2
        share = np.where(excess > 0.0, (a - b) / np.where(excess > 0.0, excess, 1.0), 0.0)
        low, high = np.percentile(share, [tails, 100.0 - tails])
        removed = (float(low), float(high))
    return Resampled("linearised", DRAWS, intervals, {i: n / DRAWS for i, n in hits.items()}, removed)
