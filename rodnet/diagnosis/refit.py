"""Full refits of a few candidates beside the nominal parameters, and what they gain on trials left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.crossval import left_out, reduced
from rodnet.diagnosis.numerics import shares_inside
from rodnet.diagnosis.scales import change_sigma, variance_factor
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.workbench import FLAT, UNABLE, Fitted, Workbench
from rodnet.errors import RecordingError
from rodnet.recordings.recording import Recording

STARTS = (1.0, 0.2, 0.02)  # shares of the strength that the score test found
HOPELESS = 0.1  # share of the gain that the score promised, below which another start is tried
RIVAL = 0.6  # share of the best gain that a score must promise
EARLY = 0.3  # share of a trial that a search may begin with
ENOUGH = 0.2  # of the promised gain, to be content with
FAR = 1.0  # of a coordinate: where following to first order leads nowhere
FINE = 0.1  # of deviance over the variance factor: what else a refit may gain is not worth another run
ROUGHLY, MISFIT = 0.5, 3e-3  # the same, and that of `ROUGHEST`, where sigma is what a model is off by
ODD = 1.2  # times the mean square of the trial in the middle: its own parameters may be caught somewhere
MOST = 0.8  # of what is not noise, that a model must explain: what is odd beside a large remainder is that
WANDERED = 0.7  # logarithm of the factor that a nominal parameter has moved by, to be far from the case's
COMPLETE = 1.05  # mean square of the residuals, from which on something is left
HOME = 2  # refits that begin where the case does, too
ROUGHEST = 1e-3  # relative change of the sum of squares at which a refit ends at most
TIMES = 100  # that the width of a prior is found again
WILD = 10.0  # times the deviance of the model without an effect: no place to begin with it
MANY = 4  # strengths, from which on they have a prior
LEAST = 1e-3  # of a strength's scale: where a refit begins at least


@dataclass(frozen=True)
class Refit:
    """A candidate fitted with everything else.

    Attributes
    ----------
    score : Score
        Where it began.
    fitted : Fitted
        The model with it.
    gain : float
        By how much the deviance fell, over ``factor``.
    factor : float
        Variance of what this model leaves, correlation in time included, over the noise's.
    p : float
        Probability of such a gain without the effect, for all that was tried.
    before, after : ndarray, shape (trials,)
        Deviance of each trial predicted from the others, without and with it; of a single trial, in the fit. Judges
        come last.
    sizes : ndarray, shape (trials,)
        Sigma of each trial.
    groups : list of str
        What each trial is left out with.
    effect_sigma : float
        Rms change of the prediction against the fit without it, over the noise's standard deviation.
    """

    score: Score
    fitted: Fitted
    gain: float
    factor: float
    p: float
    before: np.ndarray
    after: np.ndarray
    sizes: np.ndarray
    groups: list[str]
    effect_sigma: float

    @property
    def gains(self) -> np.ndarray:
        """By how much the deviance of each trial falls, over ``factor``, shape (trials,)."""
        return (self.before - self.after) / self.factor

    @property
    def relief(self) -> float:
        """Share of the rms errors of trials left out that it takes off, summed over trials as distances are."""
        errors = [float(np.sum(self.sizes * np.sqrt(np.maximum(d, 0.0)))) for d in (self.before, self.after)]
        return 1.0 - errors[1] / max(errors[0], 1e-300)

    @property
    def id(self) -> str:
        """Id of the candidate."""
        return self.score.candidate.id

    @property
    def cross_gain(self) -> float:
        """Sum of the gains on trials left out."""
        return float(self.gains.sum())

    @property
    def by_group(self) -> np.ndarray:
        """Gains of what is left out together, shape (groups,): each group is one piece of evidence."""
        gains: dict[str, float] = {}
        for group, gain in zip(self.groups, self.gains, strict=True):
            gains[group] = gains.get(group, 0.0) + float(gain)
        return np.array(list(gains.values()))

    @property
    def crossed(self) -> float | None:
        """The same, if there is more than one trial."""
        return self.cross_gain if len(self.gains) > 1 else None


def refit(
    bench: Workbench, base: Fitted, scores: Sequence[Score], tried: int,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Refit]:  # fmt: skip
    """Refit candidates one by one, beside what the model holds; the best in cross-validation first.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base : Fitted
        The model without them.
    scores : sequence of Score
        The candidates.
    tried : int
        Number of candidates and places among which they were found.
    """
    found: list[Refit] = []
    for score in scores:
        best = max(found, key=lambda one: one.gain, default=None)
        scored = np.inf if best is None or bench.case.noise is not None else best.score.chi2
        if best is not None and score.chi2 < RIVAL * min(best.gain * best.factor, scored):
            continue  # it cannot explain as much; what it might explain beside the best is asked again
        promises = [float(one.score.promise.sum()) for one in found]
        if promises and bench.case.noise is not None and float(score.promise.sum()) < RIVAL * max(promises):
            continue  # nor hold as well on trials left out
        progress(f"refit with {score.candidate.id}")
        fitted = best_fit(bench, base, score, None if best is None else best.fitted.deviance)
        if fitted is not None:
            fitted, score = shrunk(bench, fitted, score)
            found.append(assess(bench, base, fitted, score, tried))
    for one in sorted(found, key=lambda f: f.fitted.deviance)[:HOME]:
        again = from_home(bench, base, one.fitted, one.score)
        if again is not one.fitted:
            found[found.index(one)] = assess(bench, base, again, one.score, tried)
    return sorted(found, key=lambda f: -f.cross_gain)


def best_fit(bench: Workbench, base: Fitted, score: Score, goal: float | None = None) -> Fitted | None:
    """The best fit from a few strengths, what else is free following; None if none can be simulated, or gains.

    ``goal`` is the deviance of a rival: a fit that stays far behind it, or behind the model without the effect, need
    not be exact.

    Where sigma is what a case says it is off by, effects are far from small, and a search over all of a swinging
    motion stops in a valley beside the one that it should be in. There it begins with the first part of each trial.
    """
    goal = base.deviance if goal is None else min(goal, base.deviance)
    best = _from_early(bench, base, score, goal) if bench.case.noise is not None else None
    if best is not None and best.deviance < base.deviance - ENOUGH * max(score.chi2, 0.0):
        return best
    for share in STARTS:
        added = [(score, {p: share * v for p, v in score.strength.items()})]
        fitted = _fit(bench, base, added, goal, share > STARTS[-1] and bench.case.noise is not None)
        if fitted is not None and (best is None or fitted.deviance < best.deviance):
            best = fitted
        if best is None:
            continue
        if best.deviance < base.deviance - HOPELESS * max(score.chi2, 0.0):
            break
    return None if best is None else begun_again(bench, base, best, goal)


def shrunk(bench: Workbench, fitted: Fitted, score: Score) -> tuple[Fitted, Score]:
    """The fit of a candidate of many strengths with a prior that these are alike in size, where sigma is a misfit.

    Trials that determine some combinations of its strengths badly would move them anywhere, and what others are then
    predicted to do is of no motion at all. The width of the prior is what the evidence prefers, over the root of the
    variance factor, for so many residuals count as one.
    """
    candidate = score.candidate
    if bench.case.noise is None or len(candidate.strength) < MANY:
        return fitted, score
    away = np.array([(fitted.values[p] - score.nulls[p]) / score.scales[p] for p in candidate.strength])
    places, factor, J = (
        [fitted.place(p) for p in candidate.strength],
        variance_factor(fitted),
        fitted.jacobian,
    )
    P = Basis.of(np.delete(J, places, axis=1)).out(J[:, places])
    width = likely_width(P.T @ P / factor, away) / float(np.sqrt(factor))
    known = {p: (score.nulls[p], width * score.scales[p]) for p in candidate.strength}
    known_of = replace(candidate, priors=known)
    others = [c for c in fitted.candidates if c is not candidate]
    again = bench.fit([*others, known_of], fitted.values, fitted.own, flat=flat_of(bench, fitted))
    return again, replace(score, candidate=known_of)


def likely_width(H: np.ndarray, found: np.ndarray) -> float:
    """Standard deviation of strengths, all alike, that makes what was found most likely (MacKay 1992, by EM).

    Parameters
    ----------
    H : ndarray, shape (m, m)
        Inverse of the covariance with which they were found.
    found : ndarray, shape (m,)
        The strengths, without a prior.
    """
    square, one = float(np.mean(found**2)), np.eye(len(found))
    for _ in range(TIMES):
        C = np.linalg.inv(H + one / max(square, 1e-300))
        z = C @ (H @ found)
        square = float(z @ z + np.trace(C)) / len(found)
    return float(np.sqrt(square))


def begun_again(bench: Workbench, base: Fitted, fitted: Fitted, goal: float | None = None) -> Fitted:
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
        again = bench.fit(fitted.candidates, fitted.values, own, goal=goal)
    except UNABLE:
        return fitted
    return again if again.deviance < fitted.deviance else fitted


def from_home(bench: Workbench, base: Fitted, fitted: Fitted, score: Score) -> Fitted:
    """The fit of an effect, or a better one that begins where the case does, first with the effect alone.

    Without the effect the search may have gone far along what the trials hardly tell, as a common factor of stiffness,
    drag and strength, and stops on the long way back.
    """
    nominal = {q.path: q for q in bench.problem().quantities if q.trial is None and q.log}
    far = any(abs(q.coordinate(fitted.values[path])) > WANDERED for path, q in nominal.items())
    if not far or bench.case.noise is not None or fitted.deviance < COMPLETE * fitted.samples:
        return fitted
    values = {path: value for path, value in base.values.items() if path not in nominal}
    values |= begin_at(bench, base, score, 0.0)
    kinds, flat = fitted.candidates, flat_of(bench, base)
    try:
        first = bench.fit(kinds, values, flat=ROUGHEST, held=tuple(nominal))
        again = bench.fit(kinds, first.values, first.own, flat=flat, goal=fitted.deviance)
    except UNABLE:
        return fitted
    return again if again.deviance < fitted.deviance else fitted


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
    z, *_ = np.linalg.lstsq(np.hstack([one.columns, other.columns]), -r, rcond=1e-8)
    count = len(one.candidate.strength)
    changes = []
    for score, own in ((one, z[:count]), (other, z[count:])):
        paths = score.candidate.strength
        changes.append((score, {p: float(c * score.scales[p]) for p, c in zip(paths, own, strict=True)}))
    return _fit(bench, base, changes)


def _fit(
    bench: Workbench, base: Fitted, added: Sequence[tuple[Score, dict[str, float]]], goal: float | None = None,
    tame: bool = False,
) -> Fitted | None:  # fmt: skip
    """A fit from given changes of the strengths of effects, what else is free following them to first order.

    None if that is no place to begin at, where it must be ``tame``.
    """
    try:
        candidates, values, own = begun_with(bench, base, added)
        if tame and _wild(bench, base, candidates, values, own):
            return None
        return bench.fit(candidates, values, own, flat=flat_of(bench, base), goal=goal)
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


def assess(bench: Workbench, base: Fitted, fitted: Fitted, score: Score, tried: int) -> Refit:
    """What a refit gained."""
    factor = variance_factor(fitted)
    gain = (base.deviance - fitted.deviance) / factor
    dof = score.candidate.size
    p = min(1.0, tried * float(chi2_of.sf(max(gain, 0.0), dof)))
    alone, together, noise = left_out(base), left_out(fitted), list(bench.noise)
    groups = [fitted.group(k) for k in range(len(together))]
    if bench.judges is not None:
        groups += [rec.group if rec.group in groups else rec.name for rec in bench.judges.recordings]
        alone = np.append(alone, _deviances(bench.judges, base))
        together = np.append(together, _deviances(bench.judges, fitted))
        noise += bench.judges.noise
    sizes = np.array([next(iter(own.values())).typical for own in noise])
    change = change_sigma(base, fitted, bench.noise)
    return Refit(score, fitted, gain, factor, p, alone, together, sizes, groups, change)


def _deviances(judges: Workbench, model: Fitted) -> np.ndarray:
    """Deviance of each of the trials that a model was not fitted to; infinite where it has no motion."""
    try:
        fitted = judges.fit(model.candidates, model.values, common=False)
        return np.array([form.c for form in reduced(fitted)[0]])
    except UNABLE:
        if len(judges.recordings) == 1:
            return np.array([np.inf])
        return np.concatenate([_deviances(judges.subset([k]), model) for k in range(len(judges.recordings))])
