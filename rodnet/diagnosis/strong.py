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
FEW = 2  # strengths that a candidate may have


def strong(bench: Workbench, model: Fitted, scores: Sequence[Score], tried: Collection[str]) -> list[Score]:
    """Scores of candidates of one strength or two that explain much at one far from the null value, best first.

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
        paths = score.candidate.strength
        if len(paths) > FEW or score.candidate.id in tried or not score.nulls:
            continue
        way = _direction(score)
        size = float(np.linalg.norm(score.columns[rows] @ way))
        if not size > 0.0:
            continue
        bounds = bench.bounds((*model.candidates, score.candidate))
        for share in STRENGTHS:
            there, beyond = {}, False
            for p, part in zip(paths, share * np.sqrt(left) / size * way, strict=True):
                value, (low, high) = score.nulls[p] + float(part) * score.scales[p], bounds[p]
                if part and not low < value < high:
                    value, beyond = 0.5 * (score.nulls[p] + (low if part < 0.0 else high)), True
                there[p] = value
            rest = _left(some, fitted, basis, score, {**score.shape, **there})
            if rest is not None:
                changes = {p: value - score.nulls[p] for p, value in there.items()}
                found.append((rest, replace(score, strength=changes, follow=None, chi2=left - rest)))
            if rest is None or beyond:
                break
    best: dict[str, Score] = {}
    for rest, score in sorted(found, key=lambda one: one[0]):
        if rest < (1.0 - SHARE) * left:
            best.setdefault(score.candidate.id, score)
    return list(best.values())[:MOST]


def _direction(score: Score) -> np.ndarray:
    """Where strengths go from their null values, over their scales: as scored, and a single one anyway."""
    way = np.array([score.strength.get(p, 0.0) / score.scales[p] for p in score.candidate.strength])
    if len(way) == 1:
        return np.where(way < 0.0, -1.0, 1.0)
    return way / max(float(np.linalg.norm(way)), 1e-300)


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
