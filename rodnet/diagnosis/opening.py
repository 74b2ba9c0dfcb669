"""Opening trials that the search has not seen: with the model as it is, and with each accepted model after it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rodnet.diagnosis import numerics
from rodnet.diagnosis.findings import HeldOut
from rodnet.diagnosis.heldout import Opened, open_trials
from rodnet.diagnosis.misread import RecordError, carrying_records
from rodnet.diagnosis.outliers import cleaned
from rodnet.diagnosis.searched import weighed
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench


def open_chain(
    held: Workbench, models: Sequence[Fitted], records: list[RecordError] | None, anew: bool, borrowed: bool,
    tell: Callable[[str], None],
) -> HeldOut | None:  # fmt: skip
    """Predict trials with one model after the other, the one as it is first.

    Parameters
    ----------
    held : Workbench
        The trials.
    models : sequence of Fitted
        The model as it is, and those with effects.
    records : list or None
        What records of drives may be off by, carried along with the numerical error; None if neither is.
    anew : bool
        Whether the numerical error is measured again with the first effect.
    borrowed : bool
        Whether their noise is that of the training trials.
    tell : callable
        Told of trials that not every model can be simulated in: they are left out.

    Returns
    -------
    HeldOut or None
        None if there is no trial in which every model can be simulated.
    """
    try:
        return HeldOut(*_chain(held, models, records, anew), borrowed)
    except UNABLE:
        names = [rec.name for rec in held.recordings]
        able = [k for k in range(len(names)) if _runs(held.subset([k]), models, records, anew)]
        failed = [name for k, name in enumerate(names) if k not in able]
        tell(f"cannot be simulated with every model: {', '.join(failed)}")
        if not able:
            return None
        return HeldOut(*_chain(held.subset(able), models, records, anew), borrowed, failed)


def _chain(
    held: Workbench, models: Sequence[Fitted], records: list[RecordError] | None, anew: bool
) -> tuple[list[Opened], Workbench]:
    """Trials with each model, and what they were opened with."""
    base, *others = models
    chain = [open_trials(held, base)]
    clean, _ = cleaned(held, chain[0].fitted, common=False)
    if clean is not held:
        held = clean
        chain = [open_trials(held, base)]
    if held.case.noise is not None:
        held = weighed(held, chain[0].fitted)
        chain = [open_trials(held, base)]
    over = held
    if records is not None:
        # their numerical error has shares that the training trials have told
        error, over = (
            numerics.measure(over, chain[0].fitted),
            carrying_records(over, chain[0].fitted, records),
        )
        held = over = numerics.carrying(over, error)
        chain = [open_trials(held, base)]
    if anew and others:
        other = numerics.renewed(held, open_trials(held, others[0]).fitted)
        over = held if other is None else other[0]
    return [*chain, *(open_trials(over, model) for model in others)], held


def _runs(single: Workbench, models: Sequence[Fitted], records: list[RecordError] | None, anew: bool) -> bool:
    """Whether a trial can be simulated with all of some models."""
    try:
        _chain(single, models, records, anew)
    except UNABLE:
        return False
    return True
