"""How sure the values are: profile likelihoods, and what other trials of the same kind might have given."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2 as chi2_of
from scipy.stats import t as student

from rodnet.diagnosis.begin import flat_of
from rodnet.diagnosis.beside import by_trials
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.crossval import best_change, reduced
from rodnet.diagnosis.findings import LEVEL, WITHOUT, Interval, idle_below, interval
from rodnet.diagnosis.numerics import lacking
from rodnet.diagnosis.refit import MANY
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench
from rodnet.inference.comparison import Comparison
from rodnet.inference.packing import unpack_trial
from rodnet.inference.problem import Problem
from rodnet.inference.valley import damped

RISE = float(chi2_of.ppf(LEVEL, 1))  # of the deviance at the ends of an interval
ENOUGH = 3  # trials, or groups of them, to tell from how far they are apart
OFF = 0.5  # of that rise, that the others may still take off at a place of a profile
MENDED = 3  # times that they follow until it is on the floor
NEARER = 0.5  # of how far it is above the floor, that a time may leave
RUNS = 2  # places to either side of a profile, at most
SHORTER = 4  # times that a step is halved there, whose end is not brought to the floor
NEAR = (0.75, 1.4)  # of the root of that rise: near enough to find the end from there
FARTHEST = float(np.log(10.0))  # of a logarithm: no run beyond ten times the value, or a tenth of it
DRAWS = 1000


def intervals(
    bench: Workbench, model: Fitted, accepted: Sequence[Accepted], tell: Callable[[str], None]
) -> tuple[dict[str, Interval], dict[str, list[Fitted]]]:
    """Profile likelihoods of what the effects of a model are described by, if they are few numbers.

    Parameters
    ----------
    bench : Workbench
        The trials.
    model : Fitted
        With all effects.
    accepted : sequence of Accepted
        The effects.
    tell : callable
        Told of the progress.

    Returns
    -------
    intervals : dict of str to Interval
        By path.
    places : dict of str to list of Fitted
        The models with an effect at another place, by its id, where it explains as much there.
    """
    described = [one for one in accepted if len(one.candidate.strength) < MANY]
    if not described:
        return {}, {}
    tell("profiles of what was found")
    found = profiles(bench, model, [p for one in described for p in one.candidate.paths])
    places: dict[str, list[Fitted]] = {}
    for one in described:
        shown = one.refit.score.detectable
        found |= {p: idle_below(found[p], shown[p]) for p in one.candidate.strength if p in shown}
        found, fits = at_other_places(bench, model, one, found)
        places |= {one.candidate.id: fits} if fits else {}
    return found, places


def profiles(bench: Workbench, model: Fitted, paths: Sequence[str]) -> dict[str, Interval]:
    """Intervals of common values by profile likelihood, over the variance in which values err (`doubts`).

    Along a parameter all others follow to first order. The deviance is that of full runs there, less what the others
    would still take off it with the derivatives at the optimum. An end is interpolated where its root has risen
    enough, from one place to either side, or two where the first is far from it. No logarithm goes far, or farther up
    than where it would show: there a law may be all but a jump, and one run take longer than all others. Of what has
    hardly risen by then, nothing is known to that side but the bound.
    """
    problem = bench.problem(model.candidates, model.values, model.own)
    problem.quantities = model.quantities  # in whose coordinates the derivatives are
    J = model.jacobian
    C, factors = model.covariance(), doubts(bench, model)
    limit = to_the_limit(unpack_trial(problem.packed[0]), model)
    found = {}
    for path in paths:
        k = model.place(path)
        found[path] = _stretched(_profile(problem, model, J, C, factors[k], k), model, k, limit[k])
    return found


def at_other_places(
    bench: Workbench, model: Fitted, one: Accepted, found: dict[str, Interval]
) -> tuple[dict[str, Interval], list[Fitted]]:
    """Intervals of an effect that hold other places, too, at which it explains as much, and the fits there.

    A profile follows one valley of the deviance, and knows nothing of another that is as deep: a stretch that is soft
    beside one that is stiff.
    """
    path = one.candidate.place or one.candidate.onset
    held: dict[str, Interval] = dict(found)
    fits: list[Fitted] = []
    if path is None:
        return held, fits
    for other in one.refit.others:
        own = other.own if len(other.own) == len(model.own) else model.own
        try:
            values = {**model.values, **other.values}
            again = bench.fit(model.candidates, values, own, flat=flat_of(bench, model), goal=model.deviance)
        except UNABLE:
            continue
        beyond = again.deviance - model.deviance > RISE * doubt(bench, model)
        if beyond or held[path].low <= again.values[path] <= held[path].high:
            continue
        held |= {p: held[p].with_other(interval(again, p)) for p in one.candidate.paths}
        fits.append(again)
    return held, fits


def to_the_limit(trial: Comparison, model: Fitted) -> np.ndarray:
    """How far each coordinate would go if the numerical error were what the schemes' orders say, to first order.

    Its shares are fitted, and whatever else is small and smooth bends them, and what they resemble with them.
    """
    numbers = [k for k, q in enumerate(model.quantities) if ".numerics[" in q.path]
    if not numbers:
        return np.zeros(len(model.quantities))
    orders = lacking(trial)
    away = []
    for k in numbers:
        q = model.quantities[k]
        kind = next(j for j in range(len(orders)) if q.path.endswith(f"[{j}]"))
        away.append(q.coordinate(orders[kind]) - q.coordinate(model.values[q.path]))
    C = model.covariance()
    return np.asarray(C[:, numbers] @ np.linalg.pinv(C[np.ix_(numbers, numbers)], hermitian=True) @ away)


def _stretched(one: Interval, model: Fitted, k: int, change: float) -> Interval:
    """An interval that holds what would be found without a numerical error, too, as sure as it is itself."""
    q, (low, high) = model.quantities[k], model.quantities[k].bounds
    moved = [q.coordinate(end) + change for end in (one.low, one.high)]
    ends = [q.value(float(np.clip(z, low, high))) if np.isfinite(z) else q.value(z) for z in moved]
    beyond = bool(one.open[0] or moved[0] <= low), bool(one.open[1] or moved[1] >= high)
    return replace(one, low=min(one.low, *ends), high=max(one.high, *ends), open=beyond)


def doubts(bench: Workbench, model: Fitted) -> np.ndarray:
    """Variance over the noise's in which each coordinate errs: that of the residuals, or as the trials disagree.

    What a model leaves out moves the values in each trial by as much as its drive makes of it. How far the trials are
    apart about a value is known as badly as they are few: an interval is by Student's t then.
    """
    factor = doubt(bench, model)
    factors = np.full(len(model.quantities), factor)
    apart, count = by_trials(model)
    if count >= ENOUGH:
        wider = float(student.ppf(0.5 * (1.0 + LEVEL), count - 1)) ** 2 / RISE
        common = [k for k, q in enumerate(model.quantities) if q.trial is None]
        factors[common] = np.maximum(factor, wider * apart)
    return factors


def doubt(bench: Workbench, model: Fitted) -> float:
    """Variance over the noise's of the residuals that tell values: of those that are smooth, as all derivatives are.

    A smooth error of a tenth of sigma is no remainder and does not stand out of the variance of all residuals; but
    averaged over a trial and its markers it is as large as the noise, and moves values as far.
    """
    factor = variance_factor(model)
    return factor if bench.case.noise is not None else max(factor, test_remainder(model).ratio)


def _profile(
    problem: Problem, model: Fitted, J: np.ndarray, C: np.ndarray, factor: float, k: int
) -> Interval:
    linear = interval(model, model.quantities[k].path)
    q, sd = problem.quantities[k], float(np.sqrt(C[k, k]))
    idle = float(np.linalg.norm(J[: model.samples, k])) < WITHOUT
    if idle or (all(linear.open) and not q.log) or not sd > 0.0 or not np.isfinite(sd):
        return linear
    half = np.sqrt(RISE * factor) * sd
    # of what has all but vanished a logarithm would go far too far
    up = float(np.log1p(half)) if q.log else half
    best = np.array(
        [
            p.coordinate(model.values[p.path] if p.trial is None else model.own[p.trial][p.path])
            for p in model.quantities
        ]
    )
    low, high = (bound - best[k] for bound in q.bounds)
    within = _within(problem, best)
    within[1][k] = max(within[1][k], min(best[k] + up, q.bounds[1]))
    # where the search ended before the minimum it would go on to
    end = model.residual + J @ damped(J, model.residual, 0.0, best, within)
    least = float(end @ end)
    little = OFF * RISE * factor + model.deviance - least
    ends = []
    for side, first in ((-1.0, -half), (1.0, up)):
        places, roots = [0.0], [0.0]
        step, failed, beyond = first, 0, np.inf
        while len(places) <= RUNS:
            step = float(np.clip(best[k] + step, within[0][k], within[1][k]) - best[k])
            if step == places[-1]:
                break
            place = np.clip(best + C[:, k] / C[k, k] * step, *within)
            left = _on_the_floor(problem, place, J, k, within, little)
            if left is None and (failed == SHORTER or len(places) > 1):
                break
            if left is None:
                beyond, step, failed = abs(step), 0.5 * (places[-1] + step), failed + 1
                continue
            places.append(step)
            roots.append(float(np.sqrt(max(left - least, 0.0) / factor)))
            if NEAR[0] < roots[-1] / np.sqrt(RISE) < NEAR[1]:
                break
            step *= float(np.clip(np.sqrt(RISE) / max(roots[-1], 1e-300), 0.3, 3.0))
            if abs(step) >= beyond > abs(places[-1]):
                step = 0.5 * (places[-1] + side * beyond)
        ends.append(_end(places, roots, first, low if side < 0.0 else high))
    values = sorted(q.value(best[k] + end) for end in ends)
    reach = (bool(min(ends) <= low), bool(max(ends) >= high))
    return Interval(model.values[q.path], values[0], values[1], q.unit, reach)


def _within(problem: Problem, best: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where runs are made: within the bounds, and not too far from the best coordinates."""
    low, high = (np.array(b) for b in zip(*(q.bounds for q in problem.quantities), strict=True))
    far = np.array([FARTHEST if q.log else np.inf for q in problem.quantities])
    return np.maximum(low, best - far), np.minimum(high, best + far)


def _on_the_floor(
    problem: Problem, place: np.ndarray, J: np.ndarray, k: int, within: tuple[np.ndarray, np.ndarray], little: float
) -> float | None:  # fmt: skip
    """The deviance at a place of a profile less the little that the others would take off it; None if it is far off.

    Where they would take off much, the place is beside a valley that is curved: they follow until it is on its floor,
    with the derivatives at the optimum, as long as these lead there.
    """
    held = within[0].copy(), within[1].copy()
    held[0][k] = held[1][k] = place[k]
    before = np.inf
    for _ in range(MENDED + 1):
        here = _residual(problem, place)
        if here is None:
            return None
        left = here + J @ damped(J, here, 0.0, place, held)
        off = float(here @ here - left @ left)
        if off < little:
            return float(left @ left)
        if off > NEARER * before:
            return None
        before, place = off, np.clip(place + damped(J, here, 1.0, place, held), *held)
    return None


def _residual(problem: Problem, z: np.ndarray) -> np.ndarray | None:
    fits = problem.fits(z, slopes=False)
    return None if fits is None else np.concatenate([*(f.residual for f in fits), problem.priors(z)[0]])


def _end(places: Sequence[float], roots: Sequence[float], linear: float, bound: float) -> float:
    """Where the root of the deviance has risen enough: on the line through the places around there, or the last two.

    In a valley it falls nowhere on the way out; where a place that is nearer has more, that is how inexact it is.
    """
    wanted = float(np.sqrt(RISE))
    inside = lambda z: float(np.clip(z, min(0.0, bound), max(0.0, bound)))  # noqa: E731
    if len(places) == 1:  # it could not be simulated there
        return inside(linear)
    order = np.argsort(np.abs(places))
    z, risen = np.array(places)[order], np.maximum.accumulate(np.array(roots)[order])
    far = min(1.0, abs(float(z[-1])) / max(abs(linear), 1e-300))
    if risen[-1] <= 0.25 * wanted * far:  # flat: the bound is all that is known
        return bound
    k = min(int(np.searchsorted(risen, wanted)), len(z) - 1)
    j = k - 1 if risen[k] > risen[k - 1] else 0
    return inside(z[j] + (wanted - risen[j]) / (risen[k] - risen[j]) * (z[k] - z[j]))


@dataclass(frozen=True)
class Resampled:
    """What other trials of the same kind might have given.

    Attributes
    ----------
    kind : str
        How: ``"linearised"`` (trials drawn again, on stored derivatives, nothing simulated), or ``"pipeline"``.
    draws : int
        How often, those that failed included.
    intervals : dict
        Of the values of the effects, by path; to first order of those alone whose intervals have two ends.
    named : dict
        Share of the draws that did not fail in which an effect is found (again), by id; empty if all failed.
    removed : tuple of float or None
        Interval of the share of the held-out error beyond the floor that the repaired model removes.
    verdicts : dict
        How often each verdict, with ``"pipeline"``; ``"failed"`` for what could not be diagnosed.
    """

    kind: str
    draws: int
    intervals: dict[str, tuple[float, float]]
    named: dict[str, float]
    removed: tuple[float, float] | None = None
    verdicts: dict[str, int] = field(default_factory=dict)


def linearised(
    model: Fitted, paths: Sequence[str], gains: dict[str, np.ndarray], least: float,
    errors: tuple[np.ndarray, np.ndarray, float | None] | None, seed: int, unseen: Sequence[str] = (),
) -> Resampled:  # fmt: skip
    """Bootstrap over trials to first order: training trials drawn again with the derivatives that are stored.

    What trials of a group share is the same in all of them: groups are drawn, each with all its trials.

    Parameters
    ----------
    model : Fitted
        The repaired model.
    paths : sequence of str
        Values of interest.
    gains : dict
        By effect, what each group of trials gains when it is predicted from the others (`Refit.by_group`).
    least : float
        Gain of all trials together from which an effect counts as found.
    errors : tuple, optional
        Of each trial not seen, its error before and after, and the floor.
    seed : int
        Of the draws.
    unseen : sequence of str, optional
        Groups of the trials not seen; by default each is one of its own.
    """
    rng = np.random.default_rng(seed)
    forms, prior = reduced(model)
    common = [q for q in model.quantities if q.trial is None]
    together = _together([form.group for form in forms])
    count = len(together)
    if count < 2:  # drawn again it is the same
        paths, gains = (), {}
    drawn = np.zeros((DRAWS, len(common)))
    hits = dict.fromkeys(gains, 0)
    for draw in range(DRAWS):
        picked = rng.integers(count, size=count)
        drawn[draw] = best_change([forms[k] for g in picked for k in together[g]], prior)
        for id, gain in gains.items():
            hits[id] += float(gain[rng.integers(len(gain), size=len(gain))].sum()) > least
    tails = 50.0 * (1.0 - LEVEL)
    intervals = {}
    for path in paths:
        k = [q.path for q in common].index(path)
        z = common[k].coordinate(model.values[path]) + drawn[:, k]
        low, high = np.percentile([common[k].value(v) for v in z], [tails, 100.0 - tails])
        intervals[path] = (float(low), float(high))
    removed = None
    if errors is not None and len(errors[0]) > 1:  # a single trial says nothing of others
        before, after, floor = errors
        parts = _together(unseen or range(len(before)))
        parts = parts if len(parts) > 1 else _together(range(len(before)))  # as `Fitted.group` has it
        picks = rng.integers(len(parts), size=(DRAWS, len(parts)))
        sums = (np.array([np.sum(v[part] ** 2) for part in parts]) for v in (before, after))
        samples = np.array([len(part) for part in parts])[picks].sum(axis=1)
        a, b = (of[picks].sum(axis=1) / samples for of in sums)
        excess = a - (floor or 0.0) ** 2
        share = np.where(excess > 0.0, (a - b) / np.where(excess > 0.0, excess, 1.0), 0.0)
        low, high = np.percentile(share, [tails, 100.0 - tails])
        removed = (float(low), float(high))
    return Resampled("linearised", DRAWS, intervals, {i: n / DRAWS for i, n in hits.items()}, removed)


def _together(groups: Iterable[Hashable]) -> list[list[int]]:
    """Numbers of what is of one group, in the order in which groups come first."""
    found: dict[Hashable, list[int]] = {}
    for k, group in enumerate(groups):
        found.setdefault(group, []).append(k)
    return list(found.values())
