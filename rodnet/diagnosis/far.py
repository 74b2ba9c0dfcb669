"""Effects far from their null values: full runs of one trial tell what they leave there, at a few strengths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rodnet.diagnosis.begin import at_home
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

FAR = 10.0  # variance factor of a model, from which on first order tells little
STRENGTHS = (1.0, 3.0, 10.0, 30.0)  # over that at which it would be as large as what is left, to first order
ONWARDS = (1e2, 3e2, 1e3, 3e3)  # the same, tried as long as each takes off more than those before
MORE = 0.02  # of the sum of squares, that more is
ASTRAY = 2.0  # times that sum, beyond which larger strengths are not tried
FEW = 2  # strengths that a candidate may have
AT_PLACES = (1.0, 3.0, 10.0)  # over that which is best at a place, to first order


@dataclass(frozen=True)
class Point:
    """Where candidates are run: a model of one trial, what it can do, and the sum of squares of what it cannot.

    ``begin`` is the model that a refit begins with, if not the one that was scored.
    """

    model: Fitted
    basis: Basis
    left: float
    begin: Fitted | None = None

    @property
    def beyond(self) -> float:
        """By how much that is more than noise would leave."""
        return self.left - self.model.samples

    @classmethod
    def of(cls, model: Fitted, trial: int, begin: Fitted | None = None) -> Point:
        """Of a trial of a model."""
        some = model.of_trials([trial])
        basis = Basis.of(some.jacobian)
        return cls(some, basis, float(np.sum(basis.out(some.residual) ** 2)), begin)


def points(bench: Workbench, model: Fitted) -> tuple[int, list[Point]]:
    """The trial that a model can do least about, and the model there as it is, and as the case begins if it went far.

    No point where no more is left than noise.
    """
    every = [Point.of(model, k) for k in range(len(model.fits))]
    most = [p.left / max(len(f.residual), 1) for p, f in zip(every, model.fits, strict=True)]
    trial = int(np.argmax(most))
    if not min(model.deviance - model.samples, every[trial].beyond) > 0.0:
        return trial, []
    home = at_home(bench, model)
    there = [] if home is None else [Point.of(home, trial, home)]
    return trial, [every[trial], *(p for p in there if p.beyond > 0.0)]


def runs(
    bench: Workbench, point: Point, score: Score, way: Sequence[np.ndarray],
    bounds: Mapping[str, tuple[float, float]],
) -> Iterator[tuple[dict[str, float], float]]:  # fmt: skip
    """Changes of a candidate's strengths on a way away from their null values, and the share that each leaves."""
    least = 1.0
    for k, parts in enumerate(way):
        values, inside = valued(score, parts, bounds)
        rest = unexplained(bench, point, score, {**score.shape, **values})
        if rest is None:
            return
        share = 1.0 - (point.left - rest) / point.beyond
        yield {p: value - score.nulls[p] for p, value in values.items()}, share
        onwards = k + 1 < len(STRENGTHS) or share < least - MORE
        if not (inside and onwards) or rest > ASTRAY * point.left:
            return
        least = min(least, share)


def at_places(bench: Workbench, model: Fitted, score: Score) -> Score | None:
    """A local effect as it leaves least of a trial, of all places of its bank, at several strengths at each.

    None where first order is good, and where no place takes off anything.
    """
    if variance_factor(model) < FAR or len(score.candidate.strength) > FEW:
        return None
    trial, some = points(bench, model)
    one, bounds = bench.subset([trial]), bench.bounds((*model.candidates, score.candidate))
    found = None
    best = min((point.beyond for point in some), default=0.0)
    for point in some:
        for place in score.scanned:
            there = replace(score, shape=place.shape)
            parts = np.array([place.strength.get(p, 0.0) / score.scales[p] for p in score.candidate.strength])
            before = 0.0
            for changes, rest in runs(one, point, there, [k * parts for k in AT_PLACES], bounds):
                if rest * point.beyond < best:
                    best, gain = rest * point.beyond, (1.0 - rest) * (model.deviance - model.samples)
                    found = replace(
                        there, strength=changes, follow=None, ran=before > rest, chi2=gain, begin=point.begin
                    )
                before = rest
    return found


def valued(
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


def unexplained(bench: Workbench, point: Point, score: Score, values: dict[str, float]) -> float | None:
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
