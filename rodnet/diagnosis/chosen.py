"""What was chosen: effects in the model, the models that they joined, and what was tried beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rodnet.diagnosis.begin import fitted_on, flat_of
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.folds import in_earnest
from rodnet.diagnosis.refit import Refit, assess
from rodnet.diagnosis.remainder import Remainder
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.verdict import Judgement
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench


@dataclass(frozen=True)
class Accepted:
    """An effect in the model, the model that it joined, and what explained as much when it did.

    ``sure`` if trials left out gain by it one like the other; if not, it stands in for what has no name. ``compared``
    while the model is that beside which what explained as much did so.
    """

    refit: Refit
    parent: Fitted
    equivalents: list[Refit]
    sure: bool = True
    compared: bool = True

    @property
    def candidate(self) -> Candidate:
        """The effect."""
        return self.refit.score.candidate


@dataclass(frozen=True)
class Attempt:
    """A refit, in which round, and whether it was accepted."""

    refit: Refit
    judgement: Judgement
    round: int


@dataclass(frozen=True)
class Selection:
    """What was chosen.

    Attributes
    ----------
    model : Fitted
        With all effects that were accepted.
    accepted : list of Accepted
        These, in order.
    attempts : list of Attempt
        All that was refitted.
    first : list of Score
        Scores at the model as it is.
    remainder : Remainder
        What the model leaves.
    bench : Workbench
        The trials.
    base : Fitted
        The model as it is.
    numerical : float
        Numerical error that is left, of the model as it is or with an effect, whichever is larger [sigma].
    anew : bool
        Whether their numerical error is that of a model with an effect, for that is another.
    hurried : bool
        Whether something was not looked for or asked again, for want of time.
    """

    model: Fitted
    accepted: list[Accepted]
    attempts: list[Attempt]
    first: list[Score]
    remainder: Remainder
    bench: Workbench
    base: Fitted
    numerical: float
    anew: bool = False
    hurried: bool = False

    def without_last(self, model: Fitted, judgement: Judgement, remainder: Remainder) -> Selection:
        """Return the same without the last effect that was accepted, which was judged again."""
        last = self.accepted[-1].refit.id
        attempts = [
            replace(a, judgement=judgement) if a.refit.id == last and a.judgement.accepted else a
            for a in self.attempts
        ]
        return replace(self, model=model, accepted=self.accepted[:-1], attempts=attempts, remainder=remainder)


def chained(bench: Workbench, base: Fitted, accepted: list[Accepted], model: Fitted) -> list[Accepted]:
    """The same effects, each beside those before it, where the model is another one than it was."""
    found: list[Accepted] = []
    parent = base
    for k, one in enumerate(accepted):
        fitted = model
        if k < len(accepted) - 1:
            inside = [a.candidate for a in accepted[: k + 1]]
            outside = {p for a in accepted[k + 1 :] for p in a.candidate.paths}
            values = {p: v for p, v in model.values.items() if p not in outside}
            # it leaves much, slowly; what it is known to is what a refit beside the base is
            fitted = bench.fit(inside, values, model.own, flat=flat_of(bench, base))
        new = replace(
            assess(bench, parent, fitted, one.refit.score, 1), p=one.refit.p, others=one.refit.others
        )
        again = in_earnest(bench, parent, new, one.refit)
        found.append(Accepted(again, parent, one.equivalents, one.sure, compared=False))
        parent = fitted
    return found


def to_the_end(
    bench: Workbench, base: Fitted, accepted: list[Accepted], model: Fitted
) -> tuple[list[Accepted], Fitted]:  # fmt: skip
    """The same effects, the model with all of them fitted on as far as its values are to be told."""
    again = fitted_on(bench, model)
    if again is model:
        return accepted, model
    try:
        on = chained(bench, base, accepted, again)
    except UNABLE:  # one of the models that they joined cannot be run
        return accepted, model
    return on, again
