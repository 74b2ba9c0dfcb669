"""Effects too strong for first order: what candidates explain at strengths far from their null values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.far import FAR, FEW, ONWARDS, STRENGTHS, Point, points, runs, unexplained, valued
from rodnet.diagnosis.refit import RIVAL
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.workbench import Fitted, Workbench

SHARE = 0.2  # of the sum of squares beside noise and what the model can do, that must go at a strength
HOME = 0.5  # the same at the case's own values, where more is left that other values would take off
# times a tenth of what an author takes for usual: what has a threshold has no first order
PLAIN = (3.0, 10.0)
MOST = 3  # candidates
AGAIN = 3  # strengths of a candidate at which the other trials are run


def strong(
    bench: Workbench, model: Fitted, scores: Sequence[Score], tried: Collection[str], least: float = 0.0
) -> list[Score]:
    """Scores of candidates of one strength or two that explain much only far from the null value, best first.

    What saturates (a rod whose spin a medium all but stops) explains little by its derivative where it is absent, and
    what runs late by more than a quarter of a turn, nothing or less; what has a threshold (grains that jam) may do
    nothing at all there. Runs of the trial that the model can do least about tell, at a few strengths, those that the
    author of a law takes for usual among them; where the model has gone far from the case's values to hide the effect,
    beside these, too. What other trials contradict at that strength is not looked for. Nothing is run where a model
    leaves little, for there first order is good.

    Parameters
    ----------
    bench : Workbench
        The trials.
    model : Fitted
        The model as far as it goes.
    scores : sequence of Score
        Of all candidates at that model.
    tried : collection of str
        Ids of those that were refitted already.
    least : float
        Share of the sum of squares that the best of these takes off: what takes off far less at a strength that is not
        fitted, nor is what else is free, is not looked for.
    """
    if variance_factor(model) < FAR:
        return []
    untried = [s for s in scores if len(s.candidate.strength) <= FEW and s.candidate.id not in tried]
    if not untried:
        return []
    bench.tell(f"{len(untried)} candidates at strengths far from those that score")
    trial, some = points(bench, model)
    if not some:
        return []
    one = bench.subset([trial])
    ends = np.cumsum([0, *(len(f.residual) for f in model.fits)])
    beyond = model.deviance - model.samples
    found: list[tuple[float, Score]] = []
    for score in untried:
        bounds = bench.bounds((*model.candidates, score.candidate))
        ways = _plain(score, bounds) if score.candidate.usual else []
        way = _direction(score)
        size = float(np.linalg.norm(score.columns[ends[trial] : ends[trial + 1]] @ way))
        if size > 0.0:  # else it does nothing to first order
            ways.append([k * np.sqrt(some[0].left) / size * way for k in (*STRENGTHS, *ONWARDS)])
        for point in some:
            enough = SHARE if point.begin is None else HOME
            for steps in ways:
                before = 0.0
                for changes, rest in runs(one, point, score, steps, bounds):
                    if rest < 1.0 - max(enough, RIVAL * least):
                        gain = (1.0 - rest) * beyond
                        begun = replace(score, strength=changes, follow=None, chi2=gain, begin=point.begin)
                        found.append((rest, replace(begun, ran=before > rest)))
                    before = rest
    kept: dict[str, Score] = {}
    asked: Counter[str] = Counter()
    for _, score in sorted(found, key=lambda run: run[0]):
        id = score.candidate.id
        if len(kept) == MOST or id in kept or asked[id] == AGAIN:
            continue
        asked[id] += 1
        if _of_all(bench, model, score) >= max(SHARE, RIVAL * least):
            kept[id] = score
    return list(kept.values())


def _of_all(bench: Workbench, model: Fitted, score: Score) -> float:
    """Share of what all trials leave that goes at a strength at which one of them is explained."""
    begin = model if score.begin is None else score.begin
    values = {**score.shape, **{p: score.nulls[p] + change for p, change in score.strength.items()}}
    gone = beyond = 0.0
    for k in range(len(begin.fits)):
        point = Point.of(begin, k)
        left = unexplained(bench.subset([k]), point, score, values)
        gone += 0.0 if left is None else point.left - left
        beyond += point.beyond
    return gone / max(beyond, 1e-300)


def _direction(score: Score) -> np.ndarray:
    """Where strengths go from their null values, over their scales: as scored, and a single one anyway."""
    way = np.array([score.strength.get(p, 0.0) / score.scales[p] for p in score.candidate.strength])
    if len(way) == 1:
        return np.where(way < 0.0, -1.0, 1.0)
    return way / max(float(np.linalg.norm(way)), 1e-300)


def _plain(score: Score, bounds: Mapping[str, tuple[float, float]]) -> list[list[np.ndarray]]:
    """Ways of each strength by itself, and of all together, in scales, to each side that they may be changed to."""
    count = len(score.candidate.strength)
    alone = [*np.eye(count), *([np.ones(count)] if count > 1 else [])]
    ways = [[side * k * one for k in PLAIN] for one in alone for side in (1.0, -1.0)]
    return [way for way in ways if valued(score, way[0], bounds)[1]]
