"""A law alone in place of effects that were accepted: what has the wrong name must not bend the law beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rodnet.diagnosis.chosen import Selection
from rodnet.diagnosis.crossval import left_out
from rodnet.diagnosis.folds import by_fits
from rodnet.diagnosis.forces import force_columns, library_of
from rodnet.diagnosis.law import Draft, draft
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.verdict import GAIN, Judgement
from rodnet.diagnosis.workbench import Workbench

EXPLAINED = Judgement(False, ("a law in what the model as it is leaves explains more than it does",))


def law_alone(
    bench: Workbench, chosen: Selection, numerical: float, tell: Callable[[str], None]
) -> Draft | None:
    """Draft a law in the place of the effects that were accepted; None if no law gains anything.

    Parameters
    ----------
    bench : Workbench
        The trials.
    chosen : Selection
        The effects.
    numerical : float
        Numerical error [sigma].
    tell : callable
        Told of the progress.
    """
    tell("looking for a law in the place of what was accepted")
    return draft(bench, chosen.base, force_columns(bench, chosen.base, library_of(bench)), numerical, tell)


def instead(
    bench: Workbench,
    chosen: Selection,
    beside: Draft | None,
    alone: Draft | None,
    tell: Callable[[str], None],
) -> tuple[Selection, Draft] | None:
    """Keep a law alone in the place of effects if trials left out gain more by it.

    Parameters
    ----------
    bench : Workbench
        The trials.
    chosen : Selection
        The effects, which leave something.
    beside : Draft or None
        The law that was drafted beside them.
    alone : Draft or None
        That of `law_alone`.
    tell : callable
        Told of the progress.

    Returns
    -------
    tuple of (Selection, Draft), or None
        The model without any effect, and the law; None where the effects stay.
    """
    if alone is None or not alone.judgement.accepted:
        return None
    now = beside.refit.fitted if beside is not None and beside.judgement.accepted else chosen.model
    of_alone, least = float(left_out(alone.refit.fitted).sum()), GAIN * alone.refit.factor
    if float(left_out(now).sum()) - of_alone < least:
        return None
    more = float(by_fits(bench, now, "what was accepted", tell).sum()) - of_alone
    if more < least:
        return None
    tell(f"a law alone explains more: {0.5 * more / alone.refit.factor:.3g} nats on trials left out")
    return _none_of(chosen, bench), alone


def _none_of(chosen: Selection, bench: Workbench) -> Selection:
    """What was chosen, without any of the effects."""
    ids = {one.refit.id for one in chosen.accepted}
    attempts = [
        replace(a, judgement=EXPLAINED) if a.refit.id in ids and a.judgement.accepted else a
        for a in chosen.attempts
    ]
    left = test_remainder(chosen.base, bench.noise)
    return replace(chosen, model=chosen.base, accepted=[], attempts=attempts, remainder=left)
