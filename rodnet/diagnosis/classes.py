"""What explained as much as an effect is asked again when later effects are in the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rodnet.diagnosis.begin import best_fit
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted, chained
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.scales import change_sigma, variance_factor
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import CLASS, TIMES
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
    found, swapped, hurried, k = list(accepted), False, False, 0
    while k < len(found) - 1:
        one, others = found[k], {a.candidate.id for a in found if a is not found[k]}
        factor = variance_factor(model)
        alike, ahead = [], None
        for rival in one.equivalents:
            if rival.id in others:
                continue
            if not patience.allows():
                tell(f"{rival.id} stays in the class: to ask again would take longer than a diagnosis may")
                alike.append(rival)
                hurried = True
                continue
            tell(f"asking again whether {rival.id} explains as much as {one.candidate.id}")
            # one from a pair may have a later effect in it
            inside = {c.id for c in rival.fitted.candidates}
            later = [a.candidate for a in found[k + 1 :] if a.candidate.id not in inside]
            instead = _followed(bench, rival.fitted, later, model.deviance)
            if instead is None or {c.id for c in instead.candidates} != {rival.id, *others}:
                alike.append(rival)  # which is not to say that it explains less
                continue
            rise = (instead.deviance - model.deviance) / factor
            if rise < -CLASS and (ahead is None or instead.deviance < ahead[1].deviance):
                ahead = rival, instead
            if rise < CLASS or change_sigma(instead, model, bench.noise) < TIMES * numerical:
                alike.append(rival)
        if ahead is None:
            found[k] = replace(one, equivalents=alike)
            k += 1
            continue
        better, model = ahead
        tell(f"{better.id} explains more than {one.candidate.id} beside what was found later")
        swapped = True
        found[k] = Accepted(better, one.parent, [one.refit, *(r for r in one.equivalents if r is not better)])
    return (chained(bench, base, found, model) if swapped else found), model, hurried


def _followed(bench: Workbench, first: Fitted, later: Sequence[Candidate], goal: float) -> Fitted | None:
    """A model with effects added one by one, each begun where its score beside the others says; None if it can't."""
    model = first
    for candidate in later:
        try:
            scores = screen(bench, model, [candidate])
        except UNABLE:
            return None
        fitted = best_fit(bench, model, scores[0], goal) if scores else None
        if fitted is None:
            return None
        model = fitted
    return model
