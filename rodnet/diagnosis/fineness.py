"""A time step and a mesh that are fine enough for what is to be named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rodnet.diagnosis import numerics
from rodnet.diagnosis.in_motion import begun_in_motion
from rodnet.diagnosis.outliers import cleaned
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.scales import LEAST
from rodnet.diagnosis.searched import search
from rodnet.diagnosis.verdict import TIMES
from rodnet.diagnosis.workbench import Fitted, Workbench

# [sigma] numerical error that a refit leaves, beyond which time step or mesh are refined: what carrying leaves of it
# is a sixth of the smallest effect that is named; and where sigma is a misfit
FINE, ROUGH = LEAST / (2.0 * TIMES * numerics.CARRIED), 0.3
REFINED = 2  # times at most
DEARER = 2.0  # times as long as before takes what half the time step, or twice the edges, are used for
# of the error that is left at most; else what is finer did not help, and the error comes of what is missing
HELPED = 0.7


def calibrated(
    bench: Workbench, tell: Callable[[str], None], patience: Patience = ENDLESS, refined: int = REFINED
) -> tuple[Fitted, numerics.Numerics, Workbench, Workbench, Fitted, bool]:
    """Fit the model as it is, and refine what is too coarse as often as it is worth it.

    Parameters
    ----------
    bench : Workbench
        The training trials.
    tell : callable
        Told of the progress.
    patience : Patience
        What of the rest could not be done any more with what is finer is a reason not to refine.
    refined : int
        How often at most.

    Returns
    -------
    tuple
        The fit to all trials, its numerical error, the trials, those of them that are searched, the fit to these, and
        whether something was not refined for want of time.
    """
    tell("calibrating the model as it is")
    bench, plain = cleaned(bench, bench.fit(values=bench.start))
    still, bench = bench, begun_in_motion(bench, plain)
    if bench is not still:
        tell("initial velocities are free, as initial positions are")
        plain = bench.fit(values=plain.values, own=plain.own)
    fine = FINE if bench.case.noise is None else ROUGH
    most: dict[str, float] = {}
    coarser: dict[str, float] = {}
    late = False
    for level in range(refined + 1):
        some, fitted = search(bench, plain)
        tell("measuring the numerical error")
        error = numerics.measure(some, fitted)
        coarse = [
            kind
            for kind, value in error.kept.items()
            if fine < value <= most.get(kind, np.inf) and kind not in error.failed
        ]
        if not coarse or level == refined:
            break
        what = " and the ".join(coarse)
        late = not patience.allows(DEARER ** len(coarse) * patience.rest())
        if late:
            tell(
                f"the {what} stays as it is: a diagnosis with a finer one would take longer than it may (minutes)"
            )
            break
        coarser = {kind: error.kept[kind] for kind in coarse} | coarser  # the case's own stays
        most |= {kind: HELPED * error.kept[kind] for kind in coarse}
        tell(f"refining the {what}: its error is {error.worst:.2g} sigma")
        case = bench.case
        for kind in coarse:
            case = numerics.REFINE[kind](case)
        bench = replace(bench, case=case)
        plain = bench.fit(values=plain.values, own=plain.own)
    return plain, replace(error, coarser=coarser), bench, some, fitted, late
