"""Full refits of a few candidates beside the nominal parameters, and what they gain on trials left out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.begin import best_fit, fitted_on, flat_of, from_home, promised
from rodnet.diagnosis.crossval import left_out, reduced
from rodnet.diagnosis.places import elsewhere
from rodnet.diagnosis.scales import change_sigma, variance_factor
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

RIVAL = 0.6  # share of the best gain that a score must promise
ALIKE = 0.9  # share of the best one's score from which on a score is as good: sums to first order are no more exact
HOME = 2  # refits that begin where the case does, and at other places, too
TIMES = 100  # that the width of a prior is found again
MANY = 4  # strengths, from which on they have a prior
NEVER = 1e9  # deviance of a trial that a model cannot run


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
    earnest : bool
        Whether trials that first order tells nothing of were left out by fits of their own.
    others : tuple of Fitted
        The same at other places, where it explained hardly less.
    least : float, optional
        Of two effects as one explanation, what the lesser gains beside the other, over ``factor``.
    whole : Fitted, optional
        What explains as much in the place of another effect: the model with it there, beside all that was found later.
    seconds : float
        How long it took to fit.
    hurried : bool
        Whether trials would have been left out in earnest, and there was no time for that.
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
    earnest: bool = False
    others: tuple[Fitted, ...] = ()
    least: float | None = None
    whole: Fitted | None = None
    seconds: float = 0.0
    hurried: bool = False

    @property
    def at_stake(self) -> float:
        """What another explanation may be a trifle of: of two effects, only one may be wrong."""
        return self.gain if self.least is None else min(self.gain, self.least)

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

    def told(self) -> str:
        """What it gains, for who waits for it."""
        if len(self.gains) < 2:
            return f"{self.id} gains {0.5 * self.gain:.3g} nats in the fit of the only trial"
        better = int(np.sum(self.gains > 0.0))
        return (
            f"{self.id} gains {0.5 * self.gain:.3g} nats in the fit, {0.5 * self.cross_gain:.3g} on trials left out "
            f"({better} of {len(self.gains)} better, {100 * self.relief:.0f} % of their errors)"
        )

    @property
    def crossed(self) -> float | None:
        """The same, if there is more than one trial."""
        return self.cross_gain if len(self.gains) > 1 else None


def refit(
    bench: Workbench, base: Fitted, scores: Sequence[Score], tried: int,
    progress: Callable[[str], None] = lambda text: None, before: Sequence[Refit] = (),
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
    progress : callable
        Told which is refitted.
    before : sequence of Refit
        What was refitted before: what promises far less is not refitted.
    """
    found: list[Refit] = []
    for score in scores:
        best = max((*before, *found), key=lambda one: one.gain, default=None)
        if best is not None and not _may_rival(score, best, (*before, *found), bench.case.noise is not None):
            continue  # what it might explain beside the best is asked again
        progress(f"refit with {score.candidate.id}")
        began = time.monotonic()
        fitted = best_fit(bench, base, score, None if best is None else best.fitted.deviance)
        if fitted is not None:
            fitted, score = shrunk(bench, fitted, score)
            one = assess(bench, base, fitted, score, tried)
            found.append(replace(one, seconds=time.monotonic() - began))
    most = max((one.gain for one in before), default=0.0)
    for one in sorted(found, key=lambda f: f.fitted.deviance)[:HOME]:
        if one.gain < RIVAL * most:  # far behind what is known, another start takes long and leads nowhere
            continue
        again, others = elsewhere(bench, base, from_home(bench, base, one.fitted, one.score), one.score)
        new = one if again is one.fitted else assess(bench, base, again, one.score, tried)
        found[found.index(one)] = replace(new, others=others, seconds=one.seconds)
    return sorted(exact(bench, base, found, tried, before), key=lambda f: -f.cross_gain)


def exact(
    bench: Workbench, base: Fitted, found: Sequence[Refit], tried: int, before: Sequence[Refit] = ()
) -> list[Refit]:  # fmt: skip
    """Refits, those that explain most fitted on as far as they are to be told apart."""
    most = max((base.deviance - one.fitted.deviance for one in (*before, *found)), default=0.0)
    goal, refits = np.inf, []
    for one in sorted(found, key=lambda f: f.fitted.deviance):
        if base.deviance - one.fitted.deviance + promised(one.fitted) >= ALIKE * most:
            fitted = fitted_on(bench, one.fitted, goal if np.isfinite(goal) else None)
            goal = min(goal, fitted.deviance)
            if fitted is not one.fitted:
                new = assess(bench, base, fitted, one.score, tried)
                one = replace(new, others=one.others, seconds=one.seconds)
        refits.append(one)
    return refits


def _may_rival(score: Score, best: Refit, known: Sequence[Refit], misfit: bool) -> bool:
    """Whether a candidate may explain as much as the best refit, and hold as well on trials left out.

    Where sigma is a misfit, gains and promises far from first order differ between candidates that score alike: what
    scores as well as the best is refitted whatever it promises.
    """
    if not misfit:
        return score.chi2 >= RIVAL * min(best.gain * best.factor, best.score.chi2)
    if score.chi2 >= ALIKE * best.score.chi2:
        return True
    promises = [float(one.score.promise.sum()) for one in known]
    return score.chi2 >= RIVAL * best.gain * best.factor and float(score.promise.sum()) >= RIVAL * max(
        promises
    )


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
    slopes = [score.scales[p] / fitted.slope(p) for p in candidate.strength]  # of logarithms, too
    P = Basis.of(np.delete(J, places, axis=1)).out(J[:, places] * slopes)
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


def assess(bench: Workbench, base: Fitted, fitted: Fitted, score: Score, tried: int) -> Refit:
    """What a refit gained."""
    factor = variance_factor(fitted)
    gain = (base.deviance - fitted.deviance) / factor
    dof = score.candidate.size
    p = min(1.0, tried * float(chi2_of.sf(max(gain, 0.0), dof)))
    alone, together, noise = left_out(base), left_out(fitted), list(bench.noise)
    groups = [fitted.group(k) for k in range(len(together))]
    if (judges := _unlike(bench)) is not None:
        alike = len({rec.group for rec in (*bench.recordings, *judges.recordings)}) == 1
        groups += [rec.name if alike else rec.group for rec in judges.recordings]
        without, with_it = _comparable(_deviances(judges, base), _deviances(judges, fitted))
        alone, together = np.append(alone, without), np.append(together, with_it)
        noise += judges.noise
    sizes = np.array([next(iter(own.values())).typical for own in noise])
    change = change_sigma(base, fitted, bench.noise)
    return Refit(score, fitted, gain, factor, p, alone, together, sizes, groups, change)


def _unlike(bench: Workbench) -> Workbench | None:
    """The judges that no trial is fitted with whose group is theirs: left out is a group as a whole."""
    judges = bench.judges
    if judges is None or len({rec.group for rec in (*bench.recordings, *judges.recordings)}) == 1:
        return judges
    searched = {rec.group for rec in bench.recordings}
    others = [k for k, rec in enumerate(judges.recordings) if rec.group not in searched]
    return judges.subset(others) if others else None


def _comparable(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deviances of judges by two models: what neither can run tells nothing of them, and what one can, very much."""
    none = np.isinf(one) & np.isinf(other)
    return tuple(np.where(none, 0.0, np.minimum(d, NEVER)) for d in (one, other))  # type: ignore[return-value]


def _deviances(judges: Workbench, model: Fitted) -> np.ndarray:
    """Deviance of each of the trials that a model was not fitted to; infinite where it has no motion."""
    try:
        fitted = judges.fit(model.candidates, model.values, common=False)
        return np.array([form.c for form in reduced(fitted)[0]])
    except UNABLE:
        if len(judges.recordings) == 1:
            return np.array([np.inf])
        return np.concatenate([_deviances(judges.subset([k]), model) for k in range(len(judges.recordings))])
