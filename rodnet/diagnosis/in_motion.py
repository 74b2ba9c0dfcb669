"""Initial velocities: who does not know in which shape a trial begins does not know that it begins at rest, either.

A robot is brought to where its recording begins, by a hand or a gripper, and softly bent rods go on to swing for a
while. Where a case frees initial positions alone, initial velocities of the same modes are each trial's own, too, if
they would show in the recordings (docs, theory: diagnosis).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

POSITION, VELOCITY = "initial.position", "initial.velocity"
SHOWN = 1.0  # norm of what a velocity as large as is expected changes of a trial's whitened residuals


def begun_in_motion(bench: Workbench, fitted: Fitted) -> Workbench:
    """The trials with initial velocities of their own, where their initial positions are and velocities would show.

    Those modes are free whose velocity, as large as its prior expects, changes the sum of squares by one or more, at
    some recorded drive: what changes less can be fitted to nothing.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        A model of them.

    Returns
    -------
    Workbench
        ``bench`` itself where nothing is added: where sigma is what a model is off by, where the case says what is
        known of initial velocities, or where none would show.
    """
    case = bench.case
    own = [path.partition("[")[0] for path in case.per_trial]
    if case.noise is not None or POSITION not in own or VELOCITY in own:
        return bench
    free = replace(bench, case=replace(case, per_trial=(*case.per_trial, VELOCITY)))
    try:
        problem = free.problem(fitted.candidates, fitted.values, fitted.own)
        known = free.evaluate(problem, np.zeros(len(problem.quantities)), fitted.candidates)
    except UNABLE:
        return bench
    shown: set[str] = set()
    for k, q in enumerate(known.quantities):
        if q.trial is not None and q.path.startswith(VELOCITY):
            column = known.jacobian_of(q.trial)[:, k] * (q.prior.std() / q.scale)
            shown |= {q.path} if np.linalg.norm(column) >= SHOWN else set()
    paths = sorted(shown, key=lambda path: int(path.partition("[")[2].rstrip("]")))
    return replace(bench, case=replace(case, per_trial=(*case.per_trial, *paths))) if paths else bench
