"""What counts beside a remainder: an effect mixed with something else is named only if it holds all the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.begin import flat_of
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.crossval import best_change, reduced, variances
from rodnet.diagnosis.findings import LEVEL, Interval
from rodnet.diagnosis.folds import in_earnest
from rodnet.diagnosis.forces import (
    BEATEN,
    ForceColumns,
    Placebo,
    beside_force,
    force_columns,
    library_of,
    placebo,
)
from rodnet.diagnosis.library import simple
from rodnet.diagnosis.refit import assess
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.verdict import GAIN, TIMES
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

SLIGHT = 0.02  # of a strength: next to none, where none itself is at the end of a logarithmic scale
CHANCE = 3.84  # of deviance that a trial left out may lose by chance


@dataclass(frozen=True)
class Beside:
    """Whether an effect holds beside a remainder.

    Attributes
    ----------
    reasons : tuple of str
        Why not; empty if it does.
    strengths : dict
        Values of its strengths with a flexible residual force fitted alongside.
    beaten : float
        Share of the placebos that gain less on trials left out.
    """

    reasons: tuple[str, ...]
    strengths: dict[str, float]
    beaten: float

    @property
    def holds(self) -> bool:
        """Whether it does."""
        return not self.reasons


def hold(
    one: Accepted, model: Fitted, strengths: dict[str, float], drawn: Placebo, numerical: float
) -> Beside:
    """Judge an accepted effect beside what the final model leaves.

    Parameters
    ----------
    one : Accepted
        The effect.
    model : Fitted
        The final model.
    strengths : dict
        Its strengths with a flexible force alongside.
    drawn : Placebo
        Placebos about the model that it joined.
    numerical : float
        Numerical error [sigma].
    """
    gains, reasons = one.refit.gains, []
    searched = gains[: len(one.parent.fits)]  # placebos have no judges
    raw = float(searched.sum()) * one.refit.factor
    if np.any(gains < -CHANCE) or (
        len(gains) > 1 and float(gains.sum() - gains.max()) < GAIN * (1.0 - 1.0 / len(gains))
    ):
        reasons.append("its gain does not hold leaving out each trial in turn")
    region = _Region.of(model, one.candidate.strength)
    if not region.holds(strengths):
        shown = {p: region.interval(p) for p in one.candidate.strength}
        off = [p for p, (low, high) in shown.items() if not low <= strengths[p] <= high] or list(shown)
        told = ", ".join(
            f"{p} would be {strengths[p]:.3g}, outside {shown[p][0]:.3g} to {shown[p][1]:.3g}" for p in off
        )
        reasons.append(f"{told}, with a flexible residual force alongside")
    if region.holds(_next_to_none(one, model)):
        reasons.append("as far as the trials disagree about its strength, it may be none")
    beaten = drawn.beaten(raw)
    if beaten < BEATEN:
        reasons.append(f"it beats {100 * beaten:.0f} % of the placebos on trials left out, not 95 %")
    if one.refit.effect_sigma < TIMES * numerical:
        reasons.append("its effect is less than three times the numerical error that is left")
    return Beside(tuple(reasons), strengths, beaten)


def hold_all(
    bench: Workbench, accepted: Sequence[Accepted], model: Fitted, forces: ForceColumns, candidates: int,
    numerical: float, seed: int, tell: Callable[[str], None],
) -> list[Beside]:  # fmt: skip
    """Judge each of some effects beside what the model with all of them leaves.

    Parameters
    ----------
    bench : Workbench
        The trials.
    accepted : sequence of Accepted
        The effects.
    model : Fitted
        The model with all.
    forces : ForceColumns
        Unnamed forces at that model.
    candidates : int
        How many explanations there were to choose from.
    numerical : float
        Numerical error [sigma].
    seed : int
        Of the placebos.
    tell : callable
        Told of the progress.
    """
    tell("testing what was accepted beside what is left")
    some, found = simple(library_of(bench)), []
    for k, one in enumerate(beside_the_others(bench, accepted, model)):
        around = force_columns(bench, one.parent, some)
        drawn = placebo(one.parent, around, candidates - k, len(one.candidate.paths), seed)
        strengths = beside_force(model, forces, one.candidate.strength)
        found.append(hold(one, model, strengths, drawn, numerical))
    return found


def beside_the_others(bench: Workbench, accepted: Sequence[Accepted], model: Fitted) -> list[Accepted]:
    """The same effects, each with what it gains beside all others.

    The first of them may have gained nothing before another was there. Where sigma is a misfit, they are as they were
    accepted.
    """
    if len(accepted) < 2 or bench.case.noise is not None:
        return list(accepted)
    found = []
    for one in accepted:
        others = [a.candidate for a in accepted if a is not one]
        values = {p: v for p, v in model.values.items() if p not in one.candidate.paths}
        try:
            parent = bench.fit(others, values, model.own, flat=flat_of(bench, model))
        except UNABLE:
            found.append(one)
            continue
        new = replace(
            assess(bench, parent, model, one.refit.score, 1), p=one.refit.p, others=one.refit.others
        )
        again = in_earnest(bench, parent, new, one.refit)
        found.append(replace(one, refit=again, parent=parent))
    return found


def with_intervals(
    beside: Sequence[Beside], accepted: Sequence[Accepted], model: Fitted, known: Mapping[str, Interval]
) -> list[Beside]:
    """How effects hold, now that intervals are known: what they say may be none is not named.

    The likelihood's profile sees what the region about the best value, to first order, does not.
    """
    found = []
    for one, held in zip(accepted, beside, strict=False):
        slight = _next_to_none(one, model)
        inside = [known[p].low <= v <= known[p].high for p, v in slight.items() if p in known]
        if inside and all(inside):
            held = replace(held, reasons=(*held.reasons, "as far as its interval tells, it may be none"))
        found.append(held)
    return found


def _next_to_none(one: Accepted, model: Fitted) -> dict[str, float]:
    nulls = one.refit.score.nulls
    return {p: nulls[p] + SLIGHT * (model.values[p] - nulls[p]) for p in one.candidate.strength}


def by_trials(model: Fitted) -> tuple[np.ndarray, int]:
    """Variance of each common coordinate as the trials disagree about it, over the noise's, and of how much evidence.

    Where a model leaves something out its residuals are alike within a trial, and how far what a trial says is from
    what the others do is told by leaving out one after the other, each with its group, to first order: by how much
    that moves the value, over how well the others know it. Where trials are alike this is the jackknife (Tukey 1958);
    where one alone tells a value it moves far without that trial, and nobody disagrees.

    Returns
    -------
    times : ndarray, shape (common coordinates,)
        Variances over those of noise of unit size.
    count : int
        Number of trials, or groups of them.
    """
    forms, prior = reduced(model)
    groups = sorted({f.group for f in forms})
    count = len(groups)
    times, shares = np.zeros(len(prior.S)), np.zeros(len(prior.S))
    if count < 2:
        return times, count
    known = variances(forms, prior)
    for g in groups:
        others = [f for f in forms if f.group != g]
        moved, without = best_change(others, prior) ** 2, variances(others, prior)
        times += moved / without
        shares += 1.0 - known / without  # of what is known, the group's: one in all where a value is alone
    return times / np.maximum(shares, 1.0), count


@dataclass(frozen=True)
class _Region:
    """Where the strengths of an effect are: for one, an interval.

    As wide as the residuals make it, or as wide as the trials disagree.
    """

    model: Fitted
    places: dict[str, int]
    covariance: np.ndarray

    @classmethod
    def of(cls, model: Fitted, paths: Sequence[str]) -> _Region:
        places = {p: model.place(p) for p in paths}
        rows = np.array(list(places.values()))
        factor = variance_factor(model)
        C = factor * model.covariance()[np.ix_(rows, rows)]
        apart, _ = by_trials(model)
        common = [q.path for q in model.quantities if q.trial is None]
        times = np.sqrt(np.maximum(apart[[common.index(p) for p in paths]] / factor, 1.0))
        C = C * np.outer(times, times)
        return cls(model, places, C)

    def holds(self, strengths: Mapping[str, float]) -> bool:
        """Whether values lie in it, all together; one at the infinite end of a scale does not."""
        away = np.array([self._at(p, strengths[p]) - self._at(p, self.model.values[p]) for p in self.places])
        if not np.isfinite(away).all():
            return False
        distance = float(away @ np.linalg.pinv(self.covariance, hermitian=True) @ away)
        return distance <= float(chi2_of.ppf(LEVEL, len(self.places)))

    def interval(self, path: str) -> tuple[float, float]:
        """Ends of the interval of one of them alone."""
        k = list(self.places).index(path)
        half = float(np.sqrt(chi2_of.ppf(LEVEL, 1) * self.covariance[k, k]))
        q, here = self.model.quantities[self.places[path]], self._at(path, self.model.values[path])
        low, high = sorted((q.value(here - half), q.value(here + half)))
        return low, high

    def _at(self, path: str, value: float) -> float:
        return float(self.model.quantities[self.places[path]].coordinate(value))
