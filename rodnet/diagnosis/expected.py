"""How long a diagnosis takes: the runs that its stages need, the seconds that one takes, and what is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.columns import places
from rodnet.diagnosis.forces import library_of, searched_of
from rodnet.diagnosis.law import ROUNDS
from rodnet.diagnosis.locate import TRIALS
from rodnet.diagnosis.searched import count
from rodnet.diagnosis.workbench import Workbench

EVALUATIONS = 6  # of a fit, as a rule
REFITS = 4  # of a round
FINER = 4.0  # runs that those with half the time step and twice the edges cost, in runs as they are
ONE_MORE = 1.5  # runs that one with an effect costs
PLACES = 0.1  # of a run, that one more place of a candidate costs in the same run
# stages by what is told when they begin, in order; what begins with more of a text goes first
BEGIN = {
    "calibrate": ("calibrating", "refining"), "numerics": ("measuring",), "scores": ("columns of", "score of"),
    "refits": ("refit with", "looking for what"), "law": ("testing what", "looking for a law", "refit with a law"),
    "held out": ("opening",), "rest": ("drawing", "profiles", "looking for a trial"), "location": ("locating",),
}  # fmt: skip
MAY = ("refits", "law")  # come only if something is missing


class Clock:
    """Tells of the progress with an estimate of the time left, by the pace of this run.

    The least that is left is what comes whatever is found, the most what may come: refits, and a law. Of a stage that
    takes longer than expected it is only known that the others come after it.

    Parameters
    ----------
    runs : mapping
        Runs that each stage is expected to need, in their order.
    each : float
        Seconds per run, all workers together.
    tell : callable
        Where the texts go.
    now : callable
        The time [s].
    """

    def __init__(
        self, runs: Mapping[str, float], each: float, tell: Callable[[str], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.runs, self.each = dict(runs), each
        self._tell, self._now, self._last = tell, now, now()
        self._spent: dict[str, float] = {}  # [s] by stage

    def __call__(self, text: str) -> None:
        """Hand a text on; where it begins a stage or a part of one, with the time that is left."""
        known = [(len(word), s) for s, words in BEGIN.items() for word in words if text.startswith(word)]
        stage = max(known)[1] if known else ""
        if stage not in self.runs:
            self._tell(text)
            return
        self._enter(stage)
        least, most, late = self.left()
        self._tell(f"{text} ({f'at least {amount(least)}' if late else between(least, most)} left)")

    def _enter(self, stage: str) -> None:
        """Count the time to the stage that it was spent in; none begins before what has begun already."""
        now, order = self._now(), list(self.runs)
        if self._spent:
            last = next(reversed(self._spent))
            self._spent[last] += now - self._last
            stage = max(last, stage, key=order.index)
        self._last = now
        self._spent.setdefault(stage, 0.0)

    def left(self) -> tuple[float, float, bool]:
        """Seconds that are left at least and at most, and whether the stage takes longer than expected."""
        order, (*before, here) = list(self.runs), self._spent
        pace = self._pace(before)
        rest = self.runs[here] * pace - self._spent[here]
        late = rest < 0.0
        if late:
            pace = self._pace([*before, here])
        ahead = order[order.index(here) + 1 :]
        most = max(rest, 0.0) + pace * sum(self.runs[s] for s in ahead)
        least = pace * sum(self.runs[s] for s in ahead if s not in MAY)
        return least + (0.0 if here in MAY else max(rest, 0.0)), most, late

    def _pace(self, stages: Sequence[str]) -> float:
        """Seconds per run by what stages took: as measured beforehand, until there is enough to go by."""
        done, spent = (sum(known[s] for s in stages) for known in (self.runs, self._spent))
        known = done / (done + 0.2 * sum(self.runs.values())) if done else 0.0
        return (1.0 - known) * self.each + known * (spent / done if done else 0.0)


def expect(
    bench: Workbench, bank: Sequence[Candidate], held: int, tell: Callable[[str], None], workers: int = 1,
    bootstrap: int = 0,
) -> Clock:  # fmt: skip
    """Measure a run, say what is to be expected, and return what tells of the progress.

    Parameters
    ----------
    bench : Workbench
        The training trials.
    bank : sequence of Candidate
        What is tried.
    held : int
        Number of trials held out.
    tell : callable
        Takes what there is to say.
    workers : int
        Runs that go on at the same time.
    bootstrap : int
        How often all of it is repeated.
    """
    trials = len(bench.recordings)
    one = replace(bench.subset([0]), tell=lambda text: None)
    seconds = []
    for _ in range(3):  # the first in each process may compile kernels
        problem = one.problem(values=bench.start)
        began = time.monotonic()
        problem.fits(np.zeros(len(problem.quantities)))
        seconds.append(time.monotonic() - began)
    each = min(seconds) / max(min(workers, trials), 1)
    robot, duration_ = _robot(bench)
    scores, searched = sum(_runs(c, robot, duration_) for c in bank), count(bench)
    runs = {
        "calibrate": 2.0 * EVALUATIONS * trials, "numerics": FINER * trials, "scores": scores * searched,
        "refits": REFITS * EVALUATIONS * ONE_MORE * searched, "law": _law(bench) * searched,
        "held out": (2.0 * EVALUATIONS + FINER) * held, "rest": 3.0 * (trials + held),
        "location": 8.0 * min(trials, TRIALS),
    }  # fmt: skip
    most = sum(runs.values())
    least = most - sum(runs[stage] for stage in MAY)
    tell(
        f"about {least:.0f} runs of {each:.2g} s ({amount(least * each)}) if nothing is missing, about {most:.0f} "
        f"({amount(most * each)}) or more if something is that has no name"
        + (f"; and so for each of {bootstrap} repetitions" if bootstrap else "")
    )
    return Clock(runs, each, tell)


def _law(bench: Workbench) -> float:
    """Runs of each trial that a law costs: all columns of the library, and fits; where sigma is noise twice."""
    strengths = sum(len(piece.parameters) for piece in [*library_of(bench), *searched_of(bench)])
    drafts, rounds = (2.0, ROUNDS) if bench.case.noise is None else (1.0, 1)
    return drafts * (1.0 + PLACES * strengths + rounds * EVALUATIONS * ONE_MORE)


def _robot(bench: Workbench):
    rec = bench.case.part(bench.recordings[0])
    return bench.case.robot(rec), rec.duration


def _runs(candidate: Candidate, robot, span: float) -> float:
    """Runs that a candidate's scores cost: places that are added to one robot go in one run."""
    built = candidate.build(robot)
    if built is None:
        return 0.0
    count = len(places(candidate, built, span))
    added = built.graph is robot.graph and len(built.terms) > len(robot.terms)
    return 1.0 + PLACES * (count - 1) if added else float(count)


def between(least: float, most: float) -> str:
    """A range of times, or about one where it is narrow."""
    low, high = amount(least), amount(most)
    return f"about {high}" if low == high else f"{low} to {high}"


def amount(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 60.0:
        return f"{max(round(seconds), 1)} s"
    if seconds < 5400.0:
        return f"{round(seconds / 60.0)} min"
    return f"{seconds / 3600.0:.2g} h"
