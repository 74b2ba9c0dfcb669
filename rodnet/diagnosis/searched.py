"""What counts where sigma is no noise but what a model is off by: the trial is the unit of evidence.

Trials count by their distances. Few are searched where all would take long, and the others judge what was found: one
that nothing was fitted to says as much as one left out of a fit, for the price of a single run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rodnet.diagnosis.screen import worst
from rodnet.diagnosis.workbench import Fitted, Workbench

FEWEST = 5  # trials that are searched, if there are so many
LEAST = 0.2  # of what is left of the trial in the middle: what is nearly right says no more for it
WORK = 30_000  # nodes times time steps, of all trials that are searched


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
    """Return the trials that are searched, weighed, the others as their judges, and the model fitted to them.

    They are taken evenly from those that the model fits worst to those that it fits best. Where sigma is noise, all
    trials are searched as they are.

    Parameters
    ----------
    bench : Workbench
        All training trials.
    fitted : Fitted
        The model as it is, fitted to all of them.
    """
    if bench.case.noise is None:
        return bench, fitted
    even, ranks = weighed(bench, fitted), worst(fitted)
    chosen = sorted(ranks[int(k)] for k in np.linspace(0, len(ranks) - 1, count(bench)))
    rest = [k for k in range(len(ranks)) if k not in chosen]
    some = replace(even.subset(chosen), judges=even.subset(rest) if rest else None)
    own = [fitted.own[k] for k in chosen]
    return some, some.fit(fitted.candidates, fitted.values, own)


def weighed(bench: Workbench, fitted: Fitted) -> Workbench:
    """Return the trials with sigmas by which squares count as distances do: the root of what a model leaves in each.

    Its mean squares differ as much as the motions, and a single trial that swings past the model would decide all.
    Errors are told as mean distances; a small change of these is one of the sum of squares over this sigma.
    """
    left = np.array([np.sqrt(np.mean(f.residual**2)) for f in fitted.fits])
    left = np.sqrt(np.maximum(left, LEAST * np.median(left)))
    noise = [
        {name: model.scaled(float(size)) for name, model in own.items()}
        for own, size in zip(bench.noise, left, strict=True)
    ]
    return bench.with_trials(bench.recordings, noise)
