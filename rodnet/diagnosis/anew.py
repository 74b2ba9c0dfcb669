"""The numerical error of a model with an effect, which is another one than without it: carried, and all refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rodnet.diagnosis.begin import ROUGHEST, fitted_on, flat_of, from_there
from rodnet.diagnosis.chosen import Accepted, chained
from rodnet.diagnosis.equivalence import simplest
from rodnet.diagnosis.folds import checked
from rodnet.diagnosis.numerics import renewed
from rodnet.diagnosis.refit import RIVAL, Refit, assess, exact
from rodnet.diagnosis.scales import CLASS, variance_factor
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
    measured there again. Of explanations that are as good it is the one that stands for them: many strengths that gain
    a trifle more by what nobody knows of them make a numerical error of their own.
    """
    best, _ = simplest(list(good), list(refits), bench.noise, numerical)
    other = _followed(bench, best.fitted, tell)
    if other is None:
        return None
    over, there, left = other
    numerical = max(numerical, left)
    best = replace(best, fitted=there)
    refits = [best if one.id == best.id else one for one in refits]
    near = [one for one in refits if one.gain * one.factor >= RIVAL * best.gain * best.factor]
    base = _restated(over, base)
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
        found.append(replace(assess(over, base, fitted, one.score, tried), others=one.others))
    found = checked(over, base, exact(over, base, found, tried), numerical, tell)
    for one in found:
        tell(one.told())
    return over, base, found, numerical


def beside_all(
    bench: Workbench, base: Fitted, accepted: list[Accepted], model: Fitted, numerical: float,
    tell: Callable[[str], None],
) -> tuple[Workbench, Fitted, list[Accepted], Fitted, float] | None:  # fmt: skip
    """Trials with the numerical error of the model with all effects, all of them refitted, and what is left [sigma].

    None where it is as before. Each effect was found when the error was that of a model without it, and may have come
    in, or have stayed, for what that lacks.
    """
    other = _followed(bench, model, tell)
    if other is None:
        return None
    over, model, left = other
    try:
        base = _restated(over, base)
        accepted = chained(over, base, accepted, model)
    except UNABLE:
        return None
    return over, base, accepted, model, max(numerical, left)


def _restated(over: Workbench, base: Fitted) -> Fitted:
    """The model without an effect, fitted to the trials beside another numerical error."""
    return fitted_on(over, over.fit(values=base.values, own=base.own, flat=ROUGHEST, known=base))


def _followed(
    bench: Workbench, there: Fitted, tell: Callable[[str], None]
) -> tuple[Workbench, Fitted, float] | None:
    """Trials with the numerical error of a model with effects, its fit to them, and what is left.

    None if it is as before, or explains less: where a law is all but a step, what it fits to, it fits to the mesh as it
    is, and a finer one has another edge.
    """
    other = renewed(bench, there)
    if other is None:
        return None
    over, error = other
    before, ids = there, " and ".join(c.id for c in there.candidates)
    tell(f"the numerical error is another one with {ids}")
    for again in range(AGAIN + 1):
        try:
            there = from_there(over, there)
        except UNABLE:
            return None
        more = renewed(over, there) if again < AGAIN else None
        if more is None:
            break
        over, error = more
    if there.deviance > before.deviance + CLASS * variance_factor(before):
        tell(f"{ids} explains less with it: the numerical error stays as it was")
        return None
    return over, there, error.left
