"""The numerical error of a model with an effect, which is another one than without it: carried, and all refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rodnet.diagnosis.begin import ROUGHEST, flat_of
from rodnet.diagnosis.folds import checked
from rodnet.diagnosis.numerics import renewed
from rodnet.diagnosis.refit import RIVAL, Refit, assess
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

AGAIN = 2  # times that the numerical error of the model with an effect is measured once more


def anew(
    bench: Workbench, base: Fitted, refits: Sequence[Refit], good: Sequence[Refit], tried: int, numerical: float,
    tell: Callable[[str], None],
) -> tuple[Workbench, Fitted, list[Refit], float] | None:  # fmt: skip
    """Trials with the numerical error of the model with an effect, refits beside that, and what is left of it [sigma].

    None where it is as before. What was refitted and explains far less than the best is not refitted again, and not
    among them.

    A model without the effect moves otherwise, and so may do what a finer mesh changes of it. Carried along, that
    would be a remainder of the true explanation, and a part of false ones. Where it moves the effect far, it is
    measured there again.
    """
    best = max(good, key=lambda one: one.gain)
    other, there = renewed(bench, best.fitted), best.fitted
    if other is None:
        return None
    over, error = other
    tell(f"the numerical error is another one with {best.id}")
    for _ in range(AGAIN):
        try:
            there = over.fit(
                there.candidates, there.values, there.own, flat=flat_of(over, there), known=there
            )
        except UNABLE:
            break
        more = renewed(over, there)
        if more is None:
            break
        over, error = more
    numerical = max(numerical, error.left)
    best = replace(best, fitted=there)
    refits = [best if one.id == best.id else one for one in refits]
    near = [one for one in refits if one.gain * one.factor >= RIVAL * best.gain * best.factor]
    base = over.fit(values=base.values, own=base.own, flat=ROUGHEST, known=base)
    found: list[Refit] = []
    for one in sorted(near, key=lambda one: one.fitted.deviance):
        fitted, goal = one.fitted, min((f.fitted.deviance for f in found), default=None)
        try:
            fitted = over.fit(
                fitted.candidates,
                fitted.values,
                fitted.own,
                flat=flat_of(over, base),
                goal=goal,
                known=fitted,
            )
        except UNABLE:
            tell(f"{one.id} cannot be refitted with it")
            continue
        found.append(assess(over, base, fitted, one.score, tried))
    found = checked(over, base, found, numerical, tell)
    for one in found:
        tell(one.told())
    return over, base, found, numerical
