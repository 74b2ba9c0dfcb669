"""Fits with effects: where they begin, and where they begin again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.numerics import shares_inside
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score, strongest
from rodnet.diagnosis.workbench import FLAT, UNABLE, Fitted, Workbench
from rodnet.errors import RecordingError
from rodnet.inference.quantities import Quantity
from rodnet.recordings.recording import Recording

STARTS = (1.0, 0.2, 0.02)  # shares of the strength that the score test found
HOPELESS = 0.1  # share of the gain that the score promised, below which another start is tried
EARLY = 0.3  # share of a trial that a search may begin with
ENOUGH = 0.2  # of the promised gain, to be content with
FAR = 1.0  # of a coordinate: where following to first order leads nowhere
FINE = 0.1  # of deviance over the variance factor: what else a refit may gain is not worth another run
ROUGHLY, MISFIT = 0.5, 3e-3  # the same, and that of `ROUGHEST`, where sigma is what a model is off by
ODD = 1.2  # times the mean square of the trial in the middle: its own parameters may be caught somewhere
MOST = 0.8  # of what is not noise, that a model must explain: what is odd beside a large remainder is that
WANDERED = 0.35  # logarithm of the factor that a nominal parameter has moved by, to be far from the case's
LEFT = 2.0  # standard deviations of the sum of squares, by which more than noise is left
ROUGHEST = 1e-3  # relative change of the sum of squares at which a refit ends at most
WILD = 10.0  # times the deviance of the model without an effect: no place to begin with it
ONWARDS = 3  # times that a fit goes on, each as long as a fit may be
KEPT = 0.2  # of what derivatives promise, that a fit must gain to go on once more
LEAST = 1e-3  # of a strength's scale: where a refit begins at least


def best_fit(
    bench: Workbench, base: Fitted, score: Score, goal: float | None = None, flat: float | None = None
) -> Fitted | None:
    """The best fit from a few strengths, what else is free following; None if none can be simulated, or gains.

    ``goal`` is the deviance of a rival: a fit that stays far behind it, or behind the model without the effect, need
    not be exact. ``flat`` is the relative change of the sum of squares at which it ends, by default that of `flat_of`.

    Where sigma is what a case says it is off by, effects are far from small, and a search over all of a swinging
    motion stops in a valley beside the one that it should be in. There it begins with the first part of each trial.

    Smaller strengths are for where first order promised too much: full runs have tried them.
    """
    goal = base.deviance if goal is None else min(goal, base.deviance)
    best = _from_early(bench, base, score, goal) if bench.case.noise is not None else None
    if best is not None and best.deviance < base.deviance - ENOUGH * max(score.chi2, 0.0):
        return best
    for share in STARTS:
        added = [(score, {p: share * v for p, v in score.strength.items()})]
        tame = share > STARTS[-1] and bench.case.noise is not None
        fitted = _fit(bench, base, added, goal, tame, flat)
        if fitted is not None and (best is None or fitted.deviance < best.deviance):
            best = fitted
        if best is None:
            continue
        if score.ran or best.deviance < base.deviance - HOPELESS * max(score.chi2, 0.0):
            break
    return None if best is None else begun_again(bench, base, best, goal, flat)


def begun_again(
    bench: Workbench, base: Fitted, fitted: Fitted, goal: float | None = None, flat: float | None = None
) -> Fitted:
    """The fit of a model that explains most, its odd trials begun anew as the case begins them.

    What is a trial's own (its initial state) can be caught, while all others fit, where the model without the effect
    has bent it to hide the effect.
    """
    sizes = np.array([float(np.mean(f.residual**2)) for f in fitted.fits])
    odd = sizes > ODD * np.median(sizes)
    most = base.deviance - fitted.deviance > MOST * (base.deviance - fitted.samples)
    if not (odd.any() and most and any(fitted.own)):
        return fitted
    own = [{} if o else mine for o, mine in zip(odd, fitted.own, strict=True)]
    try:
        again = bench.fit(fitted.candidates, fitted.values, own, flat=flat, goal=goal)
    except UNABLE:
        return fitted
    return again if again.deviance < fitted.deviance else fitted


def from_home(bench: Workbench, base: Fitted, fitted: Fitted, score: Score) -> Fitted:
    """The fit of an effect, or a better one that begins where the case does, first with the effect alone.

    Without the effect the search may have gone far along what the trials hardly tell, as a common factor of stiffness,
    drag and strength, and stops on the long way back. Shares of the numerical error that no method has are a sign.
    """
    left = fitted.deviance - fitted.samples > LEFT * np.sqrt(2.0 * fitted.samples)
    begun = score.begin is not None  # there, at a strength that was found there
    if bench.case.noise is not None or begun or not left or not wandered(bench, fitted):
        return fitted
    values, nominal = _homeward(bench, base)
    values |= begin_at(bench, base, score, 0.0)
    kinds, flat = fitted.candidates, flat_of(bench, base)
    try:
        first = bench.fit(kinds, values, flat=ROUGHEST, held=nominal)
        again = bench.fit(kinds, first.values, first.own, flat=flat, goal=fitted.deviance)
    except UNABLE:
        return fitted
    return again if again.deviance < fitted.deviance else fitted


def fitted_on(bench: Workbench, fitted: Fitted, goal: float | None = None) -> Fitted:
    """The fit of a model, or where it goes on to, if its own derivatives promise more than that it may end at.

    How exact a refit is depends on what the model without the effect leaves, which may be large and last long, and what
    little of that is idle to gain may move a place by many standard deviations; and it may have ended for want of
    evaluations.
    """
    for _ in range(ONWARDS if bench.case.noise is None else 0):
        least, promise = flat_of(bench, fitted) * fitted.deviance, promised(fitted)
        if promise < least:
            break
        try:
            again = from_there(bench, fitted, goal)
        except UNABLE:
            break
        gained = fitted.deviance - again.deviance
        fitted = again if gained > 0.0 else fitted
        if gained < max(least, KEPT * promise):  # where motion is rough, derivatives promise what never comes
            break
    return fitted


def from_there(bench: Workbench, fitted: Fitted, goal: float | None = None) -> Fitted:
    """The fit of a model from where it is on, which may be beside another numerical error than it was fitted beside.

    Raises
    ------
    ConvergenceError
        If a trial cannot be simulated there.
    """
    flat = flat_of(bench, fitted)
    return bench.fit(fitted.candidates, fitted.values, fitted.own, flat=flat, goal=goal, known=fitted)


def promised(fitted: Fitted) -> float:
    """By how much the deviance would fall to first order if nothing were bounded."""
    end = Basis.of(fitted.jacobian).out(fitted.residual)
    return fitted.deviance - float(end @ end)


def at_home(bench: Workbench, model: Fitted) -> Fitted | None:
    """A model with nominal parameters as the case has them, if it has gone far from there; None if it cannot be run."""
    if bench.case.noise is not None or not wandered(bench, model):
        return None
    values, nominal = _homeward(bench, model)
    try:
        return bench.fit(model.candidates, values, model.own, flat=ROUGHEST, held=nominal)
    except UNABLE:
        return None


def wandered(bench: Workbench, fitted: Fitted) -> bool:
    """Whether a nominal parameter is far from what the case says, or a share of the numerical error is no method's."""
    far = any(abs(q.coordinate(fitted.values[path])) > WANDERED for path, q in _nominal(bench).items())
    return far or shares_inside(fitted.values) != fitted.values


def _homeward(bench: Workbench, model: Fitted) -> tuple[dict[str, float], tuple[str, ...]]:
    """Values of a model without its nominal parameters, which begin where the case does, and paths of these."""
    nominal = tuple(_nominal(bench))
    return {p: v for p, v in shares_inside(model.values).items() if p not in nominal}, nominal


def _nominal(bench: Workbench) -> dict[str, Quantity]:
    """What is free in the case, common to the trials, positive and of no prior of its own, by path."""
    free = (q for q in bench.problem().quantities if q.trial is None and q.log)
    return {q.path: q for q in free if q.path not in bench.priors}


def _from_early(bench: Workbench, base: Fitted, score: Score, goal: float | None) -> Fitted | None:
    """A fit that begins with what the first part of each trial gives."""
    if any(".numerics[" in path for path in bench.case.free):  # these differences are of whole trials
        return None
    case, recs = replace(bench.case, cut=None), [_early(bench.case.part(rec)) for rec in bench.recordings]
    early = replace(bench.with_trials(recs, bench.noise), case=case)
    candidates = (*base.candidates, score.candidate)
    try:
        first = early.fit(
            candidates, {**base.values, **begin_at(bench, base, score, EARLY)}, base.own, flat=MISFIT
        )
        if _wild(bench, base, candidates, first.values, first.own):  # it holds for the beginning alone
            return None
        return bench.fit(candidates, first.values, first.own, flat=flat_of(bench, base), goal=goal)
    except (RecordingError, *UNABLE):
        return None


def _early(part: Recording) -> Recording:
    """The first part of what is simulated of a recording."""
    return part.cut(part.t[0], part.t[0] + EARLY * (part.t[-1] - part.t[0]))


def begin_at(bench: Workbench, base: Fitted, score: Score, share: float) -> dict[str, float]:
    """Values of an effect with a share of the strength that the score test found."""
    bounds = bench.bounds((*base.candidates, score.candidate))
    found = dict(score.shape)
    for path, change in score.strength.items():
        start = score.nulls[path] + _away(share * change, score.scales[path])
        found[path] = _inside(start, score.nulls[path], bounds[path])
    return found


def fit_both(bench: Workbench, base: Fitted, one: Score, other: Score) -> Fitted | None:
    """A fit with two effects, from the strengths that together explain most; None if that cannot be simulated."""
    r = Basis.of(base.jacobian).out(base.residual)
    signs = np.concatenate([one.one_sided, other.one_sided])
    z, count = strongest(np.hstack([one.columns, other.columns]), r, signs), len(one.candidate.strength)
    changes = []
    for score, own in ((one, z[:count]), (other, z[count:])):
        paths = score.candidate.strength
        changes.append((score, {p: float(c * score.scales[p]) for p, c in zip(paths, own, strict=True)}))
    return _fit(bench, base, changes)


def _fit(
    bench: Workbench, base: Fitted, added: Sequence[tuple[Score, dict[str, float]]], goal: float | None = None,
    tame: bool = False, flat: float | None = None,
) -> Fitted | None:  # fmt: skip
    """A fit from given changes of the strengths of effects, what else is free following them to first order.

    None if that is no place to begin at, where it must be ``tame``.
    """
    try:
        candidates, values, own = begun_with(bench, base, added)
        if tame and _wild(bench, base, candidates, values, own):
            return None
        flat = flat_of(bench, base) if flat is None else flat
        return bench.fit(candidates, values, own, flat=flat, goal=goal)
    except UNABLE:  # a law with a corner may have no derivative there
        return None


def _wild(
    bench: Workbench, base: Fitted, candidates: Sequence[Candidate], values: Mapping[str, float],
    own: Sequence[Mapping[str, float]],
) -> bool:  # fmt: skip
    """Whether trials are predicted so badly there that the way back is long, or cannot be simulated."""
    try:
        problem = bench.problem(candidates, values, own)
    except UNABLE:
        return True
    fits = problem.fits(np.zeros(len(problem.quantities)), slopes=False)
    return fits is None or sum(float(f.residual @ f.residual) for f in fits) > WILD * base.deviance


def begun_with(
    bench: Workbench, base: Fitted, added: Sequence[tuple[Score, dict[str, float]]]
) -> tuple[tuple[Candidate, ...], dict[str, float], Sequence[Mapping[str, float]]]:  # fmt: skip
    """Candidates, values, and what trials have of their own, from given changes of the strengths of effects."""
    candidates = (*base.candidates, *(score.candidate for score, _ in added))
    bounds = bench.bounds(candidates)
    begin: dict[str, float] = {}
    change = np.zeros(len(base.quantities))
    for score, changes in added:
        begin |= score.shape
        for k, path in enumerate(score.candidate.strength):
            start = score.nulls[path] + _away(changes[path], score.scales[path])
            begin[path] = _inside(start, score.nulls[path], bounds[path])
            if score.follow is not None and len(score.follow) == len(change):  # else it was found beside less
                change += score.follow[:, k] * (begin[path] - score.nulls[path])
    values, own = (base.values, base.own) if np.abs(change).max(initial=0.0) > FAR else base.moved(change)
    for score, _ in added:
        if score.begin is not None and score.begin.candidates == base.candidates:
            values, own = score.begin.values, score.begin.own
    return candidates, {**shares_inside(values), **begin}, own


def flat_of(bench: Workbench, base: Fitted) -> float:
    """Relative change of the sum of squares at which a fit beside a model ends."""
    fine, roughest = (FINE, ROUGHEST) if bench.case.noise is None else (ROUGHLY, MISFIT)
    return min(max(FLAT, fine * variance_factor(base) / max(base.deviance, 1e-300)), roughest)


def _away(value: float, scale: float) -> float:
    """A start that is not at the null value itself."""
    least = LEAST * scale
    return value if abs(value) > least else float(np.copysign(least, value))


def _inside(start: float, null: float, bounds: tuple[float, float]) -> float:
    """The start, or a place half way from the null value to the bound that it lies beyond."""
    low, high = bounds
    if low < start < high:
        return start
    return 0.5 * (null + (low if start <= low else high))
