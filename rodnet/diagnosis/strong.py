"""Effects too strong for first order: what candidates explain at strengths far from their null values."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from rodnet.diagnosis.begin import at_home
from rodnet.diagnosis.refit import RIVAL
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

FAR = 10.0  # variance factor of a model, from which on first order tells little
STRENGTHS = (1.0, 3.0, 10.0, 30.0)  # over that at which it would be as large as what is left, to first order
ONWARDS = (1e2, 3e2, 1e3, 3e3)  # the same, tried as long as each takes off more than those before
MORE = 0.02  # of the sum of squares, that more is
SHARE = 0.2  # of the sum of squares beside noise and what the model can do, that must go at a strength
HOME = 0.5  # the same at the case's own values, where more is left that other values would take off
ASTRAY = 2.0  # times that sum, beyond which larger strengths are not tried
# times a tenth of what an author takes for usual: what has a threshold has no first order
PLAIN = (3.0, 10.0)
MOST = 3  # candidates
FEW = 2  # strengths that a candidate may have


def strong(
    bench: Workbench, model: Fitted, scores: Sequence[Score], tried: Collection[str], least: float = 0.0
) -> list[Score]:
    """Scores of candidates of one strength or two that explain much only far from the null value, best first.

    What saturates (a rod whose spin a medium all but stops) explains little by its derivative where it is absent, and
    what runs late by more than a quarter of a turn, nothing or less; what has a threshold (grains that jam) may do
    nothing at all there. Runs of the trial that the model can do least about tell, at a few strengths, those that the
    author of a law takes for usual among them; where the model has gone far from the case's values to hide the effect,
    beside these, too. Nothing is run where a model leaves little, for there first order is good.

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
    points = [_Point.of(model, k) for k in range(len(model.fits))]
    most = [p.left / max(len(f.residual), 1) for p, f in zip(points, model.fits, strict=True)]
    trial = int(np.argmax(most))
    one = bench.subset([trial])
    ends = np.cumsum([0, *(len(f.residual) for f in model.fits)])
    beyond = model.deviance - model.samples
    if not min(beyond, points[trial].beyond) > 0.0:
        return []
    here, home = points[trial], at_home(bench, model)
    there = None if home is None else _Point.of(home, trial)
    found: list[tuple[float, Score]] = []
    for score in untried:
        bounds = bench.bounds((*model.candidates, score.candidate))
        ways = _plain(score, bounds) if score.candidate.usual else []
        way = _direction(score)
        size = float(np.linalg.norm(score.columns[ends[trial] : ends[trial + 1]] @ way))
        if size > 0.0:  # else it does nothing to first order
            ways.append([k * np.sqrt(here.left) / size * way for k in (*STRENGTHS, *ONWARDS)])
        for point, enough, begin in ((here, SHARE, None), (there, HOME, home)):
            if point is None or not point.beyond > 0.0:
                continue
            for changes, rest in chain.from_iterable(_runs(one, point, score, w, bounds) for w in ways):
                if rest < 1.0 - max(enough, RIVAL * least):
                    gain = (1.0 - rest) * beyond
                    found.append(
                        (rest, replace(score, strength=changes, follow=None, chi2=gain, begin=begin))
                    )
    kept: dict[str, Score] = {}
    for _, score in sorted(found, key=lambda run: run[0]):
        kept.setdefault(score.candidate.id, score)
    return list(kept.values())[:MOST]


@dataclass(frozen=True)
class _Point:
    """Where candidates are run: a model of one trial, what it can do, and the sum of squares of what it cannot."""

    model: Fitted
    basis: Basis
    left: float

    @property
    def beyond(self) -> float:
        """By how much that is more than noise would leave."""
        return self.left - self.model.samples

    @classmethod
    def of(cls, model: Fitted, trial: int) -> _Point:
        """Of a trial of a model."""
        some = model.of_trials([trial])
        basis = Basis.of(some.jacobian)
        return cls(some, basis, float(np.sum(basis.out(some.residual) ** 2)))


def _runs(
    bench: Workbench, point: _Point, score: Score, way: Sequence[np.ndarray],
    bounds: Mapping[str, tuple[float, float]],
) -> Iterator[tuple[dict[str, float], float]]:  # fmt: skip
    """Changes of a candidate's strengths on a way away from their null values, and the share that each leaves."""
    least = 1.0
    for k, parts in enumerate(way):
        values, inside = _values(score, parts, bounds)
        rest = _left(bench, point, score, {**score.shape, **values})
        if rest is None:
            return
        share = 1.0 - (point.left - rest) / point.beyond
        yield {p: value - score.nulls[p] for p, value in values.items()}, share
        onwards = k + 1 < len(STRENGTHS) or share < least - MORE
        if not (inside and onwards) or rest > ASTRAY * point.left:
            return
        least = min(least, share)


def _values(
    score: Score, parts: np.ndarray, bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], bool]:  # fmt: skip
    """Strengths so many scales from their null values, and whether these are within bounds: if not, half way there."""
    values, inside = {}, True
    for p, part in zip(score.candidate.strength, parts, strict=True):
        null, (low, high) = score.nulls[p], bounds[p]
        value = null + float(part) * score.scales[p]
        if part and not low < value < high:
            value, inside = 0.5 * (null + (low if part < 0.0 else high)), False
        values[p] = value
    return values, inside


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
    return [way for way in ways if _values(score, way[0], bounds)[1]]


def _left(bench: Workbench, point: _Point, score: Score, values: dict[str, float]) -> float | None:
    """Sum of squares beside what the model can do, with an effect at given values; None if that cannot be run."""
    model = point.model
    try:
        problem = bench.problem(
            (*model.candidates, score.candidate), {**model.values, **values}, model.own, free=[]
        )
        fits = problem.fits(np.zeros(len(problem.quantities)), slopes=False)
    except UNABLE:
        return None
    if fits is None:
        return None
    bench.simulated += len(fits)
    residual = np.concatenate([*(f.residual for f in fits), model.prior[0]])
    return float(np.sum(point.basis.out(residual) ** 2))
