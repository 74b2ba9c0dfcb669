"""What later effects have made needless, or shown to be the wrong one, is deleted or exchanged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rodnet.diagnosis.anew import beside_all
from rodnet.diagnosis.begin import begin_at, flat_of
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted, Attempt, chained
from rodnet.diagnosis.crossval import left_out
from rodnet.diagnosis.equivalence import rivals, simplest
from rodnet.diagnosis.folds import shaky
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.scales import CLASS, variance_factor
from rodnet.diagnosis.screen import Score, screen
from rodnet.diagnosis.slow import apart
from rodnet.diagnosis.verdict import GAIN, judge
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench
from rodnet.diagnosis.worth import worth_a_refit

NEEDED = 12.0  # of deviance that the model must lose without an effect


def needed(
    bench: Workbench, base: Fitted, accepted: list[Accepted], model: Fitted, first: Sequence[Score],
    tell: Callable[[str], None],
) -> tuple[list[Accepted], Fitted]:  # fmt: skip
    """Delete what later effects have made needless; the last is needed, or it would not have been accepted.

    Beside what is needless, an effect may have found another place than it has without: it is looked for from the place
    where it scored first, too.
    """
    before, again = (accepted, model), True
    while again:
        again = False
        for one in accepted[:-1]:
            others = [a for a in accepted if a is not one]
            if one.sure and not all(a.sure for a in others):
                continue  # nor is a name given up for what has none
            values = {p: v for p, v in model.values.items() if p not in one.candidate.paths}
            ids = [a.candidate.id for a in others]
            placed = [begin_at(bench, base, s, 1.0) for s in first if s.candidate.id in ids and s.shape]
            for start in (values, *(values | there for there in placed)):
                shorter = without(bench, others, start, model)
                if shorter is not None:
                    tell(f"without {one.candidate.id} the rest explains as much")
                    accepted, model, again = others, shorter, True
                    break
            if again:
                break
    if len(accepted) == len(before[0]):
        return accepted, model
    try:
        return chained(bench, base, accepted, model), model
    except UNABLE:  # one of the models that they join cannot be run
        return before


def without(
    bench: Workbench, others: Sequence[Accepted], values: Mapping[str, float], model: Fitted
) -> Fitted | None:
    """The fit of the other effects, if it is as good as that of all."""
    try:
        shorter = bench.fit([a.candidate for a in others], values, model.own, goal=model.deviance)
    except UNABLE:
        return None
    factor = variance_factor(model)
    rise = shorter.deviance - model.deviance
    if rise < NEEDED * factor:
        return shorter
    kept = float(np.sum(left_out(shorter) - left_out(model)))
    return shorter if kept < GAIN * factor and not (shaky(model) or shaky(shorter)) else None


@dataclass(frozen=True)
class Exchanged:
    """What is left where effects have been exchanged.

    Attributes
    ----------
    bench, base : Workbench, Fitted
        The trials with the numerical error of the model with all effects, and the fit without any.
    accepted, model : list of Accepted, Fitted
        The effects, and the model with all.
    numerical : float
        Numerical error [sigma].
    anew : bool
        Whether that has been measured again.
    hurried : bool
        Whether some were not asked about for want of time.
    attempts : list of Attempt
        What was refitted.
    """

    bench: Workbench
    base: Fitted
    accepted: list[Accepted]
    model: Fitted
    numerical: float
    anew: bool
    hurried: bool
    attempts: list[Attempt]


def exchanged(
    bench: Workbench, base: Fitted, accepted: list[Accepted], model: Fitted, bank: Sequence[Candidate],
    first: Sequence[Score], numerical: float, tell: Callable[[str], None], patience: Patience = ENDLESS,
) -> Exchanged:  # fmt: skip
    """Exchange effects for what explains more beside the others, one at a time; delete what is needless then.

    The first of several is chosen while the others are not there, and may be what stands in for two of them: forward
    selection alone never mends that (stepwise regression with replacement; Miller 2002, Subset Selection, 3.6).
    The last was chosen beside all others.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base, model : Fitted
        The model without any effect, and with all.
    accepted : list of Accepted
        The effects, in order.
    bank : sequence of Candidate
        What may take their places.
    first : sequence of Score
        Scores at the model as it is.
    numerical : float
        Numerical error [sigma].
    tell : callable
        Told of the progress.
    patience : Patience
        Whether to look for one more exchange.

    Returns
    -------
    Exchanged
    """
    tried: set[str] = set()
    attempts: list[Attempt] = []
    new = hurried = False
    while len(accepted) > 1:
        left = [a for a in accepted[:-1] if a.candidate.id not in tried]
        if not left:
            break
        if not patience.allows():
            tell("no more is exchanged: it would take longer than a diagnosis may (minutes)")
            hurried = True
            break
        one = left[0]
        tried.add(one.candidate.id)
        others = [a for a in accepted if a is not one]
        ids = {a.candidate.id for a in others}  # it may be at another place itself
        values = {p: v for p, v in model.values.items() if p not in one.candidate.paths}
        tell(f"looking for what explains more than {one.candidate.id} beside the others")
        try:
            rest = bench.fit([a.candidate for a in others], values, model.own, flat=flat_of(bench, base))
            scores = screen(bench, rest, [c for c in bank if c.id not in ids], tell)
        except UNABLE:
            continue
        quick, _ = apart(bench, rest, worth_a_refit(scores))
        found = refit(bench, rest, quick, sum(s.tried for s in scores), tell)
        judged = [Attempt(r, judge(r, numerical), len(accepted)) for r in found]
        attempts += judged
        good = [a.refit for a in judged if a.judgement.accepted]
        if not good:
            continue
        best, alike = simplest(good, found, bench.noise, numerical)
        more = max(best.score.candidate.size - one.candidate.size, 0)
        if model.deviance - best.fitted.deviance < (CLASS + 2.0 * more) * variance_factor(model):
            continue
        with_it = [*others, Accepted(best, rest, rivals(best, alike))]
        try:
            with_it = chained(bench, base, with_it, best.fitted)
        except UNABLE:  # one of the models that they join cannot be run
            continue
        tell(f"{best.id} explains more than {one.candidate.id} beside the others")
        accepted, model = needed(bench, base, with_it, best.fitted, first, tell)
        again = beside_all(bench, base, accepted, model, numerical, tell)
        if again is not None:
            new, (bench, base, accepted, model, numerical) = True, again
        # what stood in for something beside the wrong one may be clear beside this one
        accepted = [a if a.sure else replace(a, sure=judge(a.refit, numerical).accepted) for a in accepted]
    return Exchanged(bench, base, accepted, model, numerical, new, hurried, attempts)
