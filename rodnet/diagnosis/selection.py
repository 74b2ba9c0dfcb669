"""Which effects belong into the model: forward one by one, pairs where one alone explains nothing, and backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rodnet.diagnosis.anew import anew, beside_all
from rodnet.diagnosis.backward import Exchanged, exchanged, needed
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted, Attempt, Selection, to_the_end
from rodnet.diagnosis.classes import classes_again
from rodnet.diagnosis.equivalence import rivals, simplest
from rodnet.diagnosis.folds import checked
from rodnet.diagnosis.grips import beside_grips
from rodnet.diagnosis.misread import uncarried
from rodnet.diagnosis.pairs import hidden, instead_of
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.refit import MANY, RIVAL, Refit, refit
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.scales import CLASS
from rodnet.diagnosis.screen import Score, screen
from rodnet.diagnosis.slow import affordable, apart
from rodnet.diagnosis.strong import strong
from rodnet.diagnosis.verdict import Judgement, complete, judge, outweighs, silent
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.diagnosis.worth import nearly, worth_a_refit

MOST = 3  # effects that are added
SOME = 0.075  # [sigma] left by one effect that two others may explain
BEHIND = Judgement(
    False, ("it is not refitted with the numerical error of the best, which explains far more",)
)
GONE = Judgement(False, ("what was accepted after it explains as much without it, or more with another",))
NOISE = Judgement(False, ("not every trial gains, and what is left may be noise",))

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
        Numerical error of the model as it is, of what is left of it [sigma]; that of the model with an effect, where it
        is larger, takes its place.
    stage : callable
        ``stage(name, function, *arguments)`` computes, or takes what an earlier run has computed.
    tell : callable
        Told of the progress.
    patience : Patience
        Whether to look for one more effect, after the first, when the last took so long.
    """
    model = base
    first: list[Score] = []
    scores: list[Score] = []
    scored: list[str] = []
    accepted: list[Accepted] = []
    attempts: list[Attempt] = []
    chosen: set[str] = set()
    mended: list[str] = []
    stale = False  # whether the scores are of another model
    misfit, new, hurried, began = bench.case.noise is not None, False, False, patience.spent()
    tested = test_remainder(base, bench.noise)
    unknown = uncarried(bench)

    def settle(number: int) -> None:
        """Carry the numerical error of the model with all effects, if it is another one."""
        nonlocal bench, base, accepted, model, numerical, new, tested
        name = f"numerical error beside {number}"
        found = stage(name, beside_all, bench, base, accepted, model, numerical, tell)
        if found is not None:
            new, (bench, base, accepted, model, numerical) = True, found
            tested = test_remainder(model, bench.noise)

    def mend() -> None:
        """Delete what later effects have made needless, and exchange what explains less than another would."""
        nonlocal bench, base, accepted, model, numerical, new, hurried, tested, attempts, mended
        chosen.update(one.refit.id for one in accepted)
        name = f"needless after {turn}"
        accepted, model = stage(name, needed, bench, base, accepted, model, first, tell)
        if len(accepted) > 1 and not misfit:
            other: Exchanged = stage(
                f"exchanged after {turn}", exchanged, bench, base, accepted, model, bank, first, numerical, tell,
                patience,
            )  # fmt: skip
            bench, base, accepted, model, numerical = (
                other.bench, other.base, other.accepted, other.model, other.numerical,
            )  # fmt: skip
            attempts, hurried, new = [*attempts, *other.attempts], hurried or other.hurried, new or other.anew
        mended, tested = [one.refit.id for one in accepted], test_remainder(model, bench.noise)

    def enough() -> bool:
        """Whether what is left needs no further explanation."""
        return silent(tested) or (len(accepted) == MOST - 1 and complete(tested))

    def fresh() -> list[Score]:
        """The scores; those of the first round anew, if the model as it is has another numerical error now."""
        nonlocal scores, stale, hurried
        if stale:
            found = stage("screen 1 anew", screen, bench, base, bank, tell, numerical)
            scores, late = stage("time for 1 anew", affordable, bench, base, found, tell, patience)
            stale, hurried = False, hurried or late
        return scores

    settled, turn = 1, 0
    while len(accepted) < MOST:
        took = patience.spent() - began
        if len(accepted) > settled and not misfit:
            settle(settled := len(accepted))
            if not (mended or enough()):  # a third beside a wrong one would be wrong, too
                mend()
                settled = len(accepted)
            if enough():
                break
        if accepted and not patience.allows(took):
            if misfit or not complete(tested):
                tell("one more effect is not looked for: it would take longer than a diagnosis may (minutes)")
                hurried = True
            break
        number, turn, began = len(accepted) + 1, turn + 1, patience.spent()
        others = [c for c in bank if c.id not in {a.candidate.id for a in accepted}]
        scores = stage(f"screen {turn}", screen, bench, model, others, tell, numerical)
        first, scored = first or scores, [c.id for c in model.candidates]
        scores, late = stage(f"time for {turn}", affordable, bench, model, scores, tell, patience)
        stale = False
        hurried = hurried or late
        tested = beside_grips(model, scores, bench.noise, tested) if unknown else tested
        if tested.grips:
            break
        doubt = bool(accepted) and not misfit and complete(tested)
        refits = stage(f"refit {turn}", _refits, bench, model, scores, numerical, doubt, tell, patience)
        hurried = hurried or any(one.hurried for one in refits)
        judged = [Attempt(one, _judge(one, numerical, doubt), number) for one in refits]
        good = [one.refit for one in judged if one.judgement.accepted]
        if good and number == 1 and not misfit:
            tried = _places(scores)
            again = stage("numerical error beside", anew, bench, base, refits, good, tried, numerical, tell)
            if again is not None:
                new, stale, (bench, base, refits, numerical) = True, True, again
                before = {one.id for one in good}  # accepted, some of them by trials left out in earnest
                some = [one for one in refits if one.id in before]
                some = stage("left out beside it", checked, bench, base, some, numerical, tell)
                refits = [*some, *(one for one in refits if one.id not in before)]
                model, known = base, {one.id for one in refits}
                far = [replace(a, judgement=BEHIND) for a in judged if a.refit.id not in known]
                judged = [Attempt(one, judge(one, numerical), number) for one in refits]
                good = [one.refit for one in judged if one.judgement.accepted]
                attempts += far
                tested = tested if good else test_remainder(base, bench.noise)
        attempts += judged
        if good:
            best, alike = simplest(good, refits, bench.noise, numerical)
            tested = test_remainder(best.fitted, bench.noise)
            whole = misfit or complete(tested)
            accepted.append(Accepted(best, model, rivals(best, alike, whole)))
            model = best.fitted
            if not whole or misfit:
                continue
            if number == 1 and best.score.candidate.size > 1 and tested.excess > SOME:
                every = fresh() if best.score.candidate.size > MANY else scores  # of which only places count
                two = stage(
                    "two instead of one", instead_of, bench, base, best, every, refits, numerical, tell
                )
                if two:
                    accepted, model = two, two[-1].refit.fitted
                    attempts += [Attempt(a.refit, Judgement(True, ()), number) for a in two]
                    tested = test_remainder(model, bench.noise)
            if len(accepted) < MOST - 1 and not silent(tested):
                continue
            break  # what nothing is left of needs no further explanation
        helpful = [one.refit for one in judged if one.judgement.helps]
        if not complete(tested) and len(accepted) <= MOST - 2 and not (misfit and (accepted or helpful)):
            pair = stage("pairs", hidden, bench, model, fresh(), refits, numerical, tell)
            if pair:
                accepted += pair
                attempts += [Attempt(a.refit, Judgement(True, ()), number) for a in pair]
                model, tested = pair[-1].refit.fitted, test_remainder(pair[-1].refit.fitted, bench.noise)
                if not complete(tested) and not misfit:
                    continue
                break
        if helpful and not complete(tested) and all(one.sure for one in accepted):
            best = max(helpful, key=lambda one: one.relief)
            accepted.append(Accepted(best, model, [], sure=False))
            model, tested = best.fitted, test_remainder(best.fitted, bench.noise)
            if misfit:  # beside what stands in for something, what is missing too may be clear
                continue
        break
    if len(accepted) > settled and not misfit:
        settle(len(accepted))
    if [one.refit.id for one in accepted] != mended:
        mend()
    accepted, model = stage("to the end", to_the_end, bench, base, accepted, model)
    if any(one.equivalents for one in accepted):
        accepted, model, late = stage(
            "classes again", classes_again, bench, base, accepted, model, numerical, tell, patience
        )
        hurried = hurried or late
    gone = chosen - {one.refit.id for one in accepted}
    attempts = [
        replace(a, judgement=GONE) if a.refit.id in gone and a.judgement.accepted else a for a in attempts
    ]
    left = test_remainder(model, bench.noise)
    if unknown and [c.id for c in model.candidates] == scored:
        left = beside_grips(model, fresh(), bench.noise, left)
    if accepted and not misfit and not outweighs(accepted[-1].refit, left):
        tell(f"{accepted[-1].refit.id} explains less than is left")
        accepted = [*accepted[:-1], replace(accepted[-1], sure=False)]
    return Selection(model, accepted, attempts, first, left, bench, base, numerical, new, hurried)


def _judge(one: Refit, numerical: float, doubt: bool) -> Judgement:
    """Whether a refit is accepted; where what is left may be noise that lasts, every trial must gain."""
    judgement = judge(one, numerical)
    return NOISE if doubt and judgement.accepted and not np.all(one.gains > 0.0) else judgement


def _refits(
    bench: Workbench, model: Fitted, scores: Sequence[Score], numerical: float, doubt: bool,
    tell: Callable[[str], None], patience: Patience,
) -> list[Refit]:  # fmt: skip
    """Refits of the few candidates that are worth it: while none is acceptable, those too that promise less.

    Beside one that helps at least, only what may explain as much.
    """

    def beside(some: list[Score]) -> list[Refit]:
        """Refits of some more."""
        least = RIVAL * max((one.gain * one.factor for one in good), default=0.0)
        more = refit(bench, model, some, _places(scores), tell, found)
        for one in more:
            tell(one.told())
        near = [one for one in more if one.gain * one.factor >= least]
        behind = [
            one for one in more if one.gain * one.factor < least
        ]  # no rival, whatever trials left out say
        return [*checked(bench, model, near, numerical, tell, patience), *behind]

    quick, slow = apart(bench, model, worth_a_refit(scores))
    found = _rounds(bench, model, quick, _places(scores), numerical, doubt, tell, patience)
    good = [one for one in found if _judge(one, numerical, doubt).accepted]
    if slow:
        enough = any(_whole(bench, one) for one in good)
        best = np.inf if enough else max((one.score.chi2 + CLASS * one.factor for one in good), default=0.0)
        for score in (s for s in slow if s.chi2 <= best):
            tell(f"{score.candidate.id} is slow to run and promises no more: it is not refitted")
        slow = [s for s in slow if s.chi2 > best]
        found += _rounds(bench, model, slow, _places(scores), numerical, doubt, tell, patience, found)
    good = [one for one in found if _judge(one, numerical, doubt).accepted]
    asked: set[str] = set()
    while good and bench.case.noise is None:  # what stands for the others may be another one after each round
        most = max(good, key=lambda one: one.gain * one.factor)
        stands = [most, simplest(good, found, bench.noise, numerical)[0]]
        one = next((one for one in stands if one.id not in asked), None)
        if one is None:
            break
        asked.add(one.id)
        close, _ = apart(bench, model, nearly(scores, one.score, {one.id for one in found}))
        found += beside(close)
        good = [one for one in found if _judge(one, numerical, doubt).accepted]
    if bench.case.noise is None and not any(_whole(bench, one) for one in good):
        beyond = max(model.deviance - model.samples, 1e-300)
        gained = max(((model.deviance - one.fitted.deviance) / beyond for one in good), default=0.0)
        quick, slow = apart(bench, model, strong(bench, model, scores, {one.id for one in found}, gained))
        far = [*quick, *(s for s in slow if s.chi2 > gained * beyond)]
        found += beside(far)
    return sorted(found, key=lambda one: -one.cross_gain)


def _rounds(
    bench: Workbench, model: Fitted, left: list[Score], places: int, numerical: float,
    doubt: bool, tell: Callable[[str], None], patience: Patience, before: Sequence[Refit] = (),
) -> list[Refit]:  # fmt: skip
    """Refits of some candidates beside those made before, the best first, until one is acceptable."""
    found: list[Refit] = []
    if bench.case.noise is not None:  # far from first order, what holds on trials left out comes first
        left = sorted(left, key=lambda s: -float(s.promise.sum()))
        if model.candidates:  # and beside what was found nothing else is tried
            left = [s for s in left if s.promise.sum() > 0.0] or left[:1]
    while left:
        some = refit(bench, model, left, places, tell, before)
        found += checked(bench, model, some, numerical, tell, patience)
        tried = {one.id for one in found}
        judged = [_judge(one, numerical, doubt) for one in found]
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
