"""Explanations that are simulated far slower than the model: refitted last, and only where they promise more.

A law that remembers what happened in the medium may take ten times as long to run, and its derivatives a hundred
times. Where something simple explains all there is, or scores as well, that time would tell nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.begin import begun_with
from rodnet.diagnosis.edited import with_candidates
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench
from rodnet.errors import RodnetError
from rodnet.robot import Robot
from rodnet.solve.model import Model
from rodnet.sweeps.collect import Serial
from rodnet.tangent.fast import fits
from rodnet.tangent.memories import followed
from rodnet.tangent.remembered_media import MediumTangent

# times the model's own time with derivatives: what is fast takes up to four times as long, and a machine with other
# work twice that
SLOW = 10.0
RUNS = 3  # of which the fastest counts
EVALUATIONS = 4  # with derivatives, that a refit takes at least
WHOLE = 6.0  # times what a run takes, that differences of whole evaluations for one column do
# the same of all columns together, where the tangent knows all memories; and for each column as long as a run takes,
# where a medium holds one
FOLLOWED = 3.0
ANY = np.finfo(float).max  # [s]
WEAK = 0.02  # share of the strength that the score test found, to be measured with


def apart(bench: Workbench, model: Fitted, scores: Sequence[Score]) -> tuple[list[Score], list[Score]]:
    """Explanations that are fitted about as fast as the model is, and those that take much longer, in their order.

    Parameters
    ----------
    bench : Workbench
        The trials, of which the first is run once with each.
    model : Fitted
        The model without them.
    scores : sequence of Score
        The explanations.
    """
    if not scores:
        return [], []
    one, alone = _first(bench), model.of_trials([0])
    robot = _robot(one, model)
    most = SLOW * derivative_times(robot, len(model.quantities)) * _seconds(one, alone, None, np.inf)
    late = []
    for score in scores:
        times = _times(score, robot, model)
        late.append(times * _seconds(one, alone, score, most / times) > most)
    quick, slow = ([s for s, l in zip(scores, late, strict=True) if l is wanted] for wanted in (False, True))
    return quick, slow


def affordable(
    bench: Workbench,
    model: Fitted,
    scores: Sequence[Score],
    tell: Callable[[str], None],
    patience: Patience = ENDLESS,
) -> tuple[list[Score], bool]:
    """Explanations that there is time to refit, and whether there are others.

    Those are measured by a run of the first trial whose derivatives take differences for each column.

    Parameters
    ----------
    bench : Workbench
        The trials.
    model : Fitted
        The model without them.
    scores : sequence of Score
        The explanations.
    tell : callable
        Told of what is left out.
    patience : Patience
        How long a refit may take.
    """
    one, alone = _first(bench), model.of_trials([0])
    robot, kept, late = _robot(one, model), [], False
    for score in scores:
        seconds = _refit_seconds(one, alone, score, robot) * len(bench.recordings)
        if not seconds or patience.allows(seconds):
            kept.append(score)
        else:
            late = True
            tell(
                f"no time for {score.candidate.id}, which would take {seconds / 60.0:.0f} min to refit (minutes)"
            )
    return kept, late


def _refit_seconds(bench: Workbench, model: Fitted, score: Score, robot: Robot) -> float:
    """Processor time of a refit to one trial at least [s]; none where derivatives are quick, or nothing moves."""
    times = _times(score, robot, model)
    return EVALUATIONS * times * _seconds(bench, model, score, ANY) if times > FOLLOWED else 0.0


def _times(score: Score, robot: Robot, model: Fitted) -> float:
    """How many times as long as a run with an effect one with derivatives takes, about."""
    try:
        built = None if score.candidate.observe else score.candidate.build(robot)
        if built is not None:
            return derivative_times(built, len(model.quantities) + len(score.strength))
    except RodnetError:
        pass
    return FOLLOWED


def _robot(bench: Workbench, model: Fitted) -> Robot:
    """The robot of the first trial, with the effects of the model."""
    first = bench.case.part(bench.recordings[0])
    return with_candidates(bench.case, model.candidates, ()).robot(first)


def derivative_times(robot: Robot, columns: int) -> float:
    """How many times as long as a run one with derivatives takes, about.

    Those of a memory of which the tangent does not know take some whole evaluations for each column.
    """
    model = Model(robot)
    known = followed(model) if fits(model) else set()
    if not fits(model) or any(b.memory is not None and k not in known for k, b in enumerate(model.bound)):
        return 1.0 + WHOLE * columns
    return FOLLOWED + columns if any(MediumTangent.knows(b) for b in model.bound) else FOLLOWED


def _seconds(bench: Workbench, model: Fitted, score: Score | None, enough: float) -> float:
    """Processor time of a run without derivatives; none where there is no motion, for then it does not take long.

    Unless the first run takes little enough, later ones count: the first may have to build what is kept after it,
    such as a drive that is read otherwise. What else the machine does must not decide what is refitted.
    """
    try:
        if score is None:
            problem = bench.problem(model.candidates, model.values, model.own)
        else:
            problem = bench.problem(*begun_with(bench, model, [(score, _weak(score))]))
        taken = [np.inf]
        while len(taken) <= RUNS and (min(taken) > enough or score is None):
            began = time.thread_time()
            problem.fits(np.zeros(len(problem.quantities)), slopes=False)
            taken.append(time.thread_time() - began)
    except UNABLE:
        return 0.0
    return min(taken)


def _first(bench: Workbench) -> Workbench:
    """The first trial, run in this process, which keeps what the first run has built."""
    return replace(bench.subset([0]), tell=lambda text: None, executor=Serial())


def _weak(score: Score) -> dict[str, float]:
    """Strengths to measure with."""
    return {p: WEAK * v for p, v in score.strength.items()}
