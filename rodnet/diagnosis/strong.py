"""Effects too strong for first order: what candidates explain at strengths far from their null values."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score, worst
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench

FAR = 10.0  # variance factor of a model, from which on first order tells little
TRIALS = 2  # that are simulated, those that are fitted worst
STRENGTHS = (
    1.0,
    5.0,
    25.0,
)  # over that at which the effect would be as large as what is left, to first order
SHARE = 0.5  # of the sum of squares beside what the model can do, that must go at a strength
MOST = 2  # candidates


def strong(bench: Workbench, model: Fitted, scores: Sequence[Score], tried: Collection[str]) -> list[Score]:
    """Scores of candidates of one strength that explain much at one far from the null value, best first.

    What saturates (a rod whose spin a medium all but stops) explains little by its derivative where it is absent. Runs
    at a few strengths tell. Nothing is run where a model leaves little, for there first order is good.

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
    """
    if variance_factor(model) < FAR:
        return []
    chosen = sorted(worst(model)[:TRIALS])
    some, fitted = bench.subset(chosen), model.of_trials(chosen)
    basis = Basis.of(fitted.jacobian)
    left = float(np.sum(basis.out(fitted.residual) ** 2))
    ends = np.cumsum([0, *(len(f.residual) for f in model.fits)])
    rows = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in chosen])
    found: list[tuple[float, Score]] = []
    for score in scores:
        if len(score.candidate.strength) != 1 or score.candidate.id in tried or not score.nulls:
            continue
        (path,), size = score.candidate.strength, float(np.linalg.norm(score.columns[rows]))
        if not size > 0.0:
            continue
        step = np.sqrt(left) / size * score.scales[path]
        low, high = bench.bounds((*model.candidates, score.candidate))[path]
        sign = -1.0 if score.strength.get(path, 0.0) < 0.0 else 1.0
        for share in STRENGTHS:
            value = score.nulls[path] + float(sign * share * step)
            beyond = not low < value < high
            if beyond:
                value = 0.5 * (score.nulls[path] + (low if sign < 0.0 else high))
            rest = _left(some, fitted, basis, score, {**score.shape, path: value})
            if rest is not None:
                there = {path: value - score.nulls[path]}
                found.append((rest, replace(score, strength=there, follow=None, chi2=left - rest)))
            if rest is None or beyond:
                break
    best: dict[str, Score] = {}
    for rest, score in sorted(found, key=lambda one: one[0]):
        if rest < (1.0 - SHARE) * left:
            best.setdefault(score.candidate.id, score)
    return list(best.values())[:MOST]


def _left(
    bench: Workbench, model: Fitted, basis: Basis, score: Score, values: dict[str, float]
) -> float | None:  # fmt: skip
    """Sum of squares beside what the model can do, with an effect at given values; None if that cannot be run."""
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
    return float(np.sum(basis.out(residual) ** 2))
