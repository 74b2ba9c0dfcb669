"""Which effects belong into the model: forward one by one, pairs where one alone explains nothing, and backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from rodnet.diagnosis.anew import anew
from rodnet.diagnosis.backward import exchanged, needed
from rodnet.diagnosis.begin import best_fit, fit_both
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted, Attempt, Selection
from rodnet.diagnosis.classes import classes_again
from rodnet.diagnosis.folds import checked
from rodnet.diagnosis.grips import beside_grips
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.refit import RIVAL, Refit, assess, refit
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score, promised, screen
from rodnet.diagnosis.slow import apart
from rodnet.diagnosis.strong import strong
from rodnet.diagnosis.verdict import CLASS, GAIN, Judgement, complete, judge, rivals, simplest
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.diagnosis.worth import worth_a_refit

MOST = 3  # effects that are added
TOP, PAIRS = 16, 3  # candidates of which pairs are made, and pairs that are refitted
BEHIND = Judgement(
    False, ("it is not refitted with the numerical error of the best, which explains far more",)
)
GONE = Judgement(False, ("what was accepted after it explains as much without it, or more with another",))

Stage = Callable[..., Any]


def select(
    bench: Workbench, base: Fitted, bank: Sequence[Candidate], numerical: float, stage: Stage,
    tell: Callable[[str], None], patience: Patience = ENDLESS,
) -> Selection:  # fmt: skip
    """Choose effects from a bank.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base : Fitted
        The model as it is.
    bank : sequence of Candidate
        What is tried.
    numerical : float
        Numerical error [sigma].
    stage : callable
        ``stage(name, function, *arguments)`` computes, or takes what an earlier run has computed.
    tell : callable
        Told of the progress.
    patience : Patience
        Whether to look for one more effect, after the first, when the last took so long.
    """
    model, every = base, bank
    first: list[Score] = []
    scores: list[Score] = []
    scored: list[str] = []
    accepted: list[Accepted] = []
    attempts: list[Attempt] = []
    misfit, new, hurried, began = bench.case.noise is not None, False, False, patience.spent()
    tested = test_remainder(base, bench.noise)
    while len(accepted) < MOST:
        if accepted and not patience.allows(patience.spent() - began):
            tell("one more effect is not looked for: it would take longer than a diagnosis may (minutes)")
            hurried = True
            break
        number, began = len(accepted) + 1, patience.spent()
        bank = [c for c in bank if c.id not in {a.candidate.id for a in accepted}]
        scores = stage(f"screen {number}", screen, bench, model, bank, tell)
        first, scored = first or scores, [c.id for c in model.candidates]
        tested = tested if misfit else beside_grips(model, scores, bench.noise, tested)
        if tested.grips:
            break
        refits = stage(f"refit {number}", _refits, bench, model, scores, numerical, tell)
        judged = [Attempt(one, judge(one, numerical), number) for one in refits]
        good = [one.refit for one in judged if one.judgement.accepted]
        if good and number == 1 and not misfit:
            tried = _places(scores)
            again = stage("numerical error beside", anew, bench, base, refits, good, tried, numerical, tell)
            if again is not None:
                new, (bench, base, refits) = True, again
                model, known = base, {one.id for one in refits}
                far = [replace(a, judgement=BEHIND) for a in judged if a.refit.id not in known]
                judged = [Attempt(one, judge(one, numerical), number) for one in refits]
                good = [one.refit for one in judged if one.judgement.accepted]
                attempts += far
        attempts += judged
        if good:
            best, alike = simplest(good, refits, bench.noise, numerical)
            accepted.append(Accepted(best, model, rivals(best, alike)))
            model, tested = best.fitted, test_remainder(best.fitted, bench.noise)
            if complete(tested) and not misfit:  # what nothing is left of needs no further explanation
                break
            continue
        helpful = [one.refit for one in judged if one.judgement.helps]
        if not complete(tested) and len(accepted) <= MOST - 2 and not (misfit and (accepted or helpful)):
            pair = stage("pairs", _pair, bench, model, scores, refits, numerical, tell)
            if pair:
                accepted += pair
                attempts += [Attempt(a.refit, Judgement(True, ()), number) for a in pair]
                model, helpful = pair[-1].refit.fitted, []
        if helpful and not complete(tested) and all(one.sure for one in accepted):
            best = max(helpful, key=lambda one: one.relief)
            accepted.append(Accepted(best, model, [], sure=False))
            model, tested = best.fitted, test_remainder(best.fitted, bench.noise)
            if misfit:  # beside what stands in for something, what is missing too may be clear
                continue
        break
    chosen = {one.refit.id for one in accepted}
    accepted, model = stage("without what is needless", needed, bench, base, accepted, model, first, tell)
    many = len(accepted) > 2 or (len(accepted) > 1 and not complete(test_remainder(model, bench.noise)))
    if many and not misfit and all(one.sure for one in accepted):
        accepted, model, late, more = stage(
            "exchanged", exchanged, bench, base, accepted, model, every, first, numerical, tell, patience
        )
        attempts, hurried = [*attempts, *more], hurried or late
    if any(one.equivalents for one in accepted[:-1]):
        accepted, model, late = stage(
            "classes again", classes_again, bench, base, accepted, model, numerical, tell, patience
        )
        hurried = hurried or late
    gone = chosen - {one.refit.id for one in accepted}
    attempts = [
        replace(a, judgement=GONE) if a.refit.id in gone and a.judgement.accepted else a for a in attempts
    ]
    left = test_remainder(model, bench.noise)
    if not misfit and [c.id for c in model.candidates] == scored:
        left = beside_grips(model, scores, bench.noise, left)
    return Selection(model, accepted, attempts, first, left, bench, base, new, hurried)


def _refits(
    bench: Workbench, model: Fitted, scores: Sequence[Score], numerical: float, tell: Callable[[str], None]
) -> list[Refit]:  # fmt: skip
    """Refits of the few candidates that are worth it: while none is acceptable, those too that promise less.

    Beside one that helps at least, only what may explain as much.
    """
    quick, slow = apart(bench, model, worth_a_refit(scores))
    found = _rounds(bench, model, quick, _places(scores), numerical, tell)
    good = [one for one in found if judge(one, numerical).accepted]
    if slow:
        enough = any(_whole(bench, one) for one in good)
        best = np.inf if enough else max((one.score.chi2 + CLASS * one.factor for one in good), default=0.0)
        for score in (s for s in slow if s.chi2 <= best):
            tell(f"{score.candidate.id} is slow to run and promises no more: it is not refitted")
        slow = [s for s in slow if s.chi2 > best]
        found += _rounds(bench, model, slow, _places(scores), numerical, tell, found)
    if bench.case.noise is None and not any(judge(one, numerical).accepted for one in found):
        some = refit(
            bench, model, strong(bench, model, scores, {one.id for one in found}), _places(scores), tell
        )
        for one in some:
            tell(one.told())
        found += checked(bench, model, some, numerical, tell)
    return sorted(found, key=lambda one: -one.cross_gain)


def _rounds(
    bench: Workbench, model: Fitted, left: list[Score], places: int, numerical: float,
    tell: Callable[[str], None], before: Sequence[Refit] = (),
) -> list[Refit]:  # fmt: skip
    """Refits of some candidates beside those made before, the best first, until one is acceptable."""
    found: list[Refit] = []
    if bench.case.noise is not None:  # far from first order, what holds on trials left out comes first
        left = sorted(left, key=lambda s: -float(s.promise.sum()))
        if model.candidates:  # and beside what was found nothing else is tried
            left = [s for s in left if s.promise.sum() > 0.0] or left[:1]
    while left:
        some = refit(bench, model, left, places, tell, before)
        found += checked(bench, model, some, numerical, tell)
        tried = {one.id for one in found}
        judged = [judge(one, numerical) for one in found]
        for one in found:
            if one.id in {s.id for s in some}:
                tell(one.told())
        if not some or any(j.accepted for j in judged):
            break
        misfit = bench.case.noise is not None
        gained = [
            min(one.gain * one.factor, np.inf if misfit else one.score.chi2)
            for one, j in zip(found, judged, strict=True)
            if j.helps
        ]
        least = RIVAL * max(gained, default=0.0)
        left = [s for s in left if s.candidate.id not in tried and s.chi2 >= least]
    return found


def _whole(bench: Workbench, one: Refit) -> bool:
    """Whether a refit leaves nothing."""
    return complete(test_remainder(one.fitted, bench.noise))


def _places(scores: Sequence[Score]) -> int:
    """Number of all places of all candidates."""
    return sum(s.tried for s in scores)


def _pair(
    bench: Workbench, model: Fitted, scores: Sequence[Score], refits: Sequence[Refit], numerical: float,
    tell: Callable[[str], None],
) -> list[Accepted]:  # fmt: skip
    """Two effects that hide each other: each must be acceptable beside the other.

    All pairs of the best are scored to first order, and those refitted that promise most on trials left out.
    """
    r = Basis.of(model.jacobian).out(model.residual)
    pairs = [
        (_promise(model, r, *ab), *ab) for ab in combinations([s for s in scores if s.chi2 > 0.0][:TOP], 2)
    ]
    promising = sorted([one for one in pairs if one[0] > 0.0], key=lambda one: -one[0])
    alone = {one.id: one.fitted for one in refits}
    places = _places(scores) ** 2
    found: list[tuple[float, list[Accepted]]] = []
    for _, a, b in promising[:PAIRS]:
        gained = max((model.deviance - deviance for deviance, _ in found), default=0.0)
        if float(r @ r) - _left(r, a, b) < RIVAL * gained:
            continue  # they cannot explain as much
        if a.candidate.family == b.candidate.family and set(a.strength) & set(b.strength):
            continue
        tell(f"refit with {a.candidate.id} and {b.candidate.id}")
        for score in (a, b):
            if score.candidate.id not in alone:
                fitted = best_fit(bench, model, score)
                if fitted is not None:
                    alone[score.candidate.id] = fitted
        if a.candidate.id not in alone or b.candidate.id not in alone:
            continue
        both, least = fit_both(bench, model, a, b), min(alone[s.candidate.id].deviance for s in (a, b))
        if both is None or both.deviance > least:
            both = best_fit(bench, alone[a.candidate.id], b)
        if both is None:
            continue
        beside_a = assess(bench, alone[a.candidate.id], both, b, places)
        beside_b = assess(bench, alone[b.candidate.id], both, a, places)
        if judge(beside_a, numerical).accepted and judge(beside_b, numerical).accepted:
            first = assess(bench, model, alone[a.candidate.id], a, places)
            pair = [Accepted(first, model, []), Accepted(beside_a, alone[a.candidate.id], [])]
            found.append((both.deviance, pair))
    if not found:
        return []
    least, best = min(found, key=lambda one: one[0])
    near = CLASS * best[-1].refit.factor
    alike = [one for one in found if one[0] < least + near]
    _, best = min(alike, key=lambda one: (sum(a.candidate.size for a in one[1]), one[0]))  # the simplest
    return _classed(best, [pair for _, pair in alike if pair is not best])


def _classed(best: list[Accepted], others: Sequence[list[Accepted]]) -> list[Accepted]:
    """A pair whose members know what stands in their place beside the other in pairs that explain as much."""
    ids = {one.candidate.id for one in best}
    found = []
    for k, one in enumerate(best):
        places: dict[str, Refit] = {}
        for pair in others:
            theirs = {m.candidate.id for m in pair}
            if ids & theirs != ids - {one.candidate.id}:
                continue
            (other,) = (m for m in pair if m.candidate.id not in ids)
            alone = k == 0 and other is pair[0]
            places[other.candidate.id] = (
                other.refit if alone else replace(other.refit, fitted=pair[-1].refit.fitted)
            )
        found.append(replace(one, equivalents=[*one.equivalents, *places.values()]))
    return found


def _promise(model: Fitted, r: np.ndarray, a: Score, b: Score) -> float:
    """By how much the deviance of trials left out falls with two effects to first order; 0 if one is needless."""
    both = np.hstack([a.columns, b.columns])
    gain = float(promised(model, both).sum())
    alone = max(float(s.promise.sum()) * s.factor for s in (a, b))
    z, *_ = np.linalg.lstsq(both, -r, rcond=1e-8)
    return gain if gain > alone + GAIN * variance_factor(model, r + both @ z) else 0.0


def _left(r: np.ndarray, a: Score, b: Score) -> float:
    """What two effects together leave of a residual, to first order."""
    P = np.hstack([a.columns, b.columns])
    z, *_ = np.linalg.lstsq(P, -r, rcond=1e-8)
    return float(np.sum((r + P @ z) ** 2))
