"""Which of the training trials are searched where all would take long: the others judge what was found.

Where sigma is noise, every trial makes the search sharper. Where it is what a model is off by, the trial is the unit of
evidence, and one that nothing was fitted to says as much as one left out of a fit, for the price of a single run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rodnet.diagnosis.screen import worst
from rodnet.diagnosis.workbench import Fitted, Workbench

FEWEST = 5  # trials that are searched, if there are so many
WORK = 80_000  # nodes times time steps, of all trials that are searched


def count(bench: Workbench) -> int:
    """Number of trials that are searched: as many as are cheap."""
    trials = len(bench.recordings)
    if bench.case.noise is None:
        return trials
    part = bench.case.part(bench.recordings[0])
    robot = bench.case.robot(part)
    each = len(robot.graph.x0) * part.duration / bench.case.simulation(part, robot)["dt"]
    return min(trials, max(FEWEST, int(WORK / each)))


def search(bench: Workbench, fitted: Fitted) -> tuple[Workbench, Fitted]:
    """Return the trials that are searched, the others their judges, and the model fitted to them.

    They are taken evenly from those that the model fits worst to those that it fits best.

    Parameters
    ----------
    bench : Workbench
        All training trials.
    fitted : Fitted
        The model as it is, fitted to all of them.
    """
    number = count(bench)
    if number == len(bench.recordings):
        return bench, fitted
    ranks = worst(fitted)
    chosen = sorted(ranks[int(k)] for k in np.linspace(0, len(ranks) - 1, number))
    rest = [k for k in range(len(ranks)) if k not in chosen]
    some = replace(bench.subset(chosen), judges=bench.subset(rest))
    own = [fitted.own[k] for k in chosen]
    return some, some.fit(fitted.candidates, fitted.values, own)
