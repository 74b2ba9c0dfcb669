"""How long a diagnosis takes: the runs that its stages need, the seconds that one takes, and what is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.columns import places
from rodnet.diagnosis.locate import TRIALS
from rodnet.diagnosis.searched import count
from rodnet.diagnosis.workbench import Workbench

EVALUATIONS = 6  # of a fit, as a rule
REFITS = 4  # of a round
FINER = 4.0  # runs that those with half the time step and twice the edges cost, in runs as they are
PLACES = 0.1  # of a run, that one more place of a candidate costs in the same run
# stages by what is told when they begin, in order
BEGIN = {
    "calibrate": ("calibrating", "refining"), "numerics": ("measuring",), "scores": ("columns of", "score of"),
    "refits": ("refit with",), "held out": ("opening",), "rest": ("drawing", "profiles", "looking for"),
    "location": ("locating",),
}  # fmt: skip


class Clock:
    """Tells of the progress with an estimate of the time left.

    Parameters
    ----------
    runs : mapping
        Runs that each stage is expected to need.
    counts : mapping
        How often each stage is told of.
    each : float
        Seconds per run, all workers together.
    tell : callable
        Where the texts go.
    now : callable
        The time [s].
    """

    def __init__(
        self, runs: Mapping[str, float], counts: Mapping[str, int], each: float,
        tell: Callable[[str], None], now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.runs, self.counts, self.each = dict(runs), dict(counts), each
        self._tell, self._now, self._began = tell, now, now()
        self._seen = dict.fromkeys(self.runs, 0)

    def __call__(self, text: str) -> None:
        """Hand a text on; where a stage begins, with the time that is left."""
        stage = next((s for s, words in BEGIN.items() if s in self.runs and text.startswith(words)), None)
        if stage is None:
            self._tell(text)
            return
        left = self.left(stage)
        self._seen[stage] += 1
        self._tell(f"{text} ({duration(left)} left)")

    def left(self, stage: str) -> float:
        """Seconds from here on, by the pace so far."""
        order = list(self.runs)
        place = order.index(stage)
        share = min(self._seen[stage] / max(self.counts.get(stage, 1), 1), 1.0)
        # what was passed over was not needed
        before = sum(self.runs[s] for s in order[:place] if self._seen[s])
        done = before + share * self.runs[stage]
        ahead = (1.0 - share) * self.runs[stage] + sum(self.runs[s] for s in order[place + 1 :])
        spent = self._now() - self._began
        # as measured beforehand, until there is enough to go by
        known = done / (done + 0.2 * (done + ahead)) if done else 0.0
        pace = (1.0 - known) * self.each + known * (spent / done if done else 0.0)
        return ahead * pace


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
    for _ in range(2):  # the first may compile kernels
        problem = one.problem(values=bench.start)
        began = time.monotonic()
        problem.fits(np.zeros(len(problem.quantities)))
        each = (time.monotonic() - began) / max(min(workers, trials), 1)
    robot, duration_ = _robot(bench)
    scores, searched = sum(_runs(c, robot, duration_) for c in bank), count(bench)
    runs = {
        "calibrate": 2.0 * EVALUATIONS * trials, "numerics": FINER * trials, "scores": scores * searched,
        "refits": REFITS * EVALUATIONS * 1.5 * searched, "held out": (2.0 * EVALUATIONS + FINER) * held,
        "rest": 3.0 * (trials + held), "location": 8.0 * min(trials, TRIALS),
    }  # fmt: skip
    counts = {"scores": len(bank), "refits": REFITS}
    total = sum(runs.values())
    least = (total - runs["refits"]) * each
    tell(
        f"about {total:.0f} runs of {each:.2g} s: {duration(least)} if nothing is missing, "
        f"{duration(total * each)} or more if something is"
        + (f"; and so for each of {bootstrap} repetitions" if bootstrap else "")
    )
    return Clock(runs, counts, each, tell)


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


def duration(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 60.0:
        return f"about {max(round(seconds), 1)} s"
    if seconds < 5400.0:
        return f"about {round(seconds / 60.0)} min"
    return f"about {seconds / 3600.0:.2g} h"
