"""What explained as much as an effect is asked again when later effects are in the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from rodnet.diagnosis.begin import best_fit, fitted_on, from_there
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted, chained
from rodnet.diagnosis.equivalence import (
    by_chance,
    distinct,
    evidence,
    further_needed,
    livelier,
    numerically_alike,
    plainer,
    rivals,
    trifle,
    unnamed,
)
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.refit import MANY, Refit
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.scales import CLASS, variance_factor
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import complete
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench


def classes_again(
    bench: Workbench, base: Fitted, accepted: list[Accepted], model: Fitted, numerical: float,
    tell: Callable[[str], None], patience: Patience = ENDLESS,
) -> tuple[list[Accepted], Fitted, bool]:  # fmt: skip
    """Ask again what explains as much as an effect, now that the later ones are in the model.

    What explained as much while they were not may be far behind, or ahead: then it takes the effect's place.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base, model : Fitted
        The model without any effect, and with all.
    accepted : list of Accepted
        The effects, in order.
    numerical : float
        Numerical error [sigma].
    tell : callable
        Told of the progress.
    patience : Patience
        What is not asked any more stays in its class.

    Returns
    -------
    tuple of (list of Accepted, Fitted, bool)
        The effects with the classes that are left, the model with all, and whether some were not asked for want of
        time.
    """
    found, swapped, hurried, k, before = list(accepted), False, False, 0, model
    while k < len(found):
        one, others = found[k], [a for a in found if a is not found[k]]
        ids = {a.candidate.id for a in others}
        factor = variance_factor(model)
        alike, ahead = [], None
        for rival in one.equivalents:
            if rival.id in ids:
                continue
            inside = {c.id for c in rival.fitted.candidates}
            # compared beside all others already
            if one.compared and k == len(found) - 1 and inside == {rival.id, *ids}:
                alike += rivals(one.refit, [replace(rival, whole=rival.fitted)])
                continue
            if not patience.allows():
                tell(f"{rival.id} stays in the class: to ask again would take longer than a diagnosis may")
                alike.append(rival)
                hurried = True
                continue
            tell(f"asking again whether {rival.id} explains as much as {one.candidate.id}")
            instead = _in_its_place(bench, rival, [a.candidate for a in others], model, one.compared)
            if instead is None:
                alike.append(rival)  # which is not to say that it explains less
                continue
            rise = (instead.deviance - model.deviance) / factor
            more = further_needed(rival, one.refit)
            lively = livelier(model, factor)
            further = rival.score.candidate.size - one.candidate.size
            stake = one.refit.gain * one.refit.factor / factor
            idle = more > 0 and -rise < max(by_chance(more, model, factor), unnamed(more, model, factor))
            no_better = more > 0 and -rise < trifle(stake, further, instead, factor, bench.noise, numerical)
            ahead_by = max((CLASS + 2.0 * max(further, 0)) * lively, evidence(further, model, factor))
            better = rise < -ahead_by and not idle and not no_better
            if better and (ahead is None or instead.deviance < ahead[1].deviance):
                ahead = rival, instead
            behind = max(evidence(-further, instead, factor), unnamed(-further, instead, factor))
            near = rise < max(CLASS * livelier(instead, factor), behind)
            near = near or numerically_alike(model, instead, numerical)
            if not near and plainer(rival.score.candidate, one.candidate):
                little = trifle(stake, -further, model, factor, bench.noise, numerical)
                near = rise < little and complete(test_remainder(instead, bench.noise))
            idle = idle or (no_better and more >= MANY)  # few parameters that gain a trifle stay in the class
            if better or (near and not idle):
                alike.append(replace(rival, whole=instead))
        if ahead is None:
            found[k] = replace(one, equivalents=distinct(alike, partial(_needless, factor)))
            k += 1
            continue
        better_one, model = ahead
        tell(f"{better_one.id} explains more than {one.candidate.id} beside what was found later")
        swapped = True
        instead_of = [one.refit, *(r for r in one.equivalents if r is not better_one)]
        found[k] = Accepted(better_one, one.parent, instead_of, one.sure, compared=False)
        k = 0  # the others are beside another effect now
    if not swapped:
        return found, model, hurried
    try:
        return chained(bench, base, found, model), model, hurried
    except UNABLE:  # one of the models that they join cannot be run
        return accepted, before, hurried


def _needless(factor: float, other: Refit, one: Refit) -> bool:
    """Whether the further parameters of one explanation gain nothing beside all effects; unknown, they may."""
    more = further_needed(other, one)
    if other.whole is None or one.whole is None or more <= 0:
        return False
    ahead = (one.whole.deviance - other.whole.deviance) / factor
    return ahead < max(by_chance(more, one.whole, factor), unnamed(more, one.whole, factor))


def _in_its_place(
    bench: Workbench, rival: Refit, others: Sequence[Candidate], model: Fitted, fresh: bool
) -> Fitted | None:
    """The model with a rival in the place of an effect; None if it can't be.

    Where its fit holds what the model has no more (or an effect of a pair), the others come first. Where it
    is not ``fresh``, it was fitted beside another numerical error.
    """
    inside = {c.id for c in rival.fitted.candidates}
    if inside <= {rival.id, *(c.id for c in others)}:
        first, later = rival.fitted, [c for c in others if c.id not in inside]
        if not fresh:
            try:
                first = from_there(bench, first)
            except UNABLE:
                return None
    else:
        kept = {path for c in model.candidates if c.id not in {o.id for o in others} for path in c.paths}
        try:
            first = bench.fit(others, {p: v for p, v in model.values.items() if p not in kept}, model.own)
        except UNABLE:
            return None
        later = [rival.score.candidate]
    found = _followed(bench, first, later, model.deviance, {**rival.fitted.values, **model.values})
    return None if found is None else fitted_on(bench, found, model.deviance)


def _followed(
    bench: Workbench, first: Fitted, later: Sequence[Candidate], goal: float, known: Mapping[str, float]
) -> Fitted | None:
    """A model with effects added one by one, each begun where its score beside the others says; None if it can't.

    What does nothing to first order (it has a threshold) begins with values at which it did something.
    """
    model = first
    for candidate in later:
        try:
            scores = screen(bench, model, [candidate])
        except UNABLE:
            return None
        if not scores:
            return None
        score = scores[0]
        if not score.survives > 0.0:
            changes = {p: known[p] - score.nulls[p] for p in candidate.strength}
            score = replace(score, strength=changes, shape={p: known[p] for p in candidate.shape})
        fitted = best_fit(bench, model, score, goal)
        if fitted is None:
            return None
        model = fitted
    return model
