"""Effects too strong for first order: what candidates explain at strengths far from their null values."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score, screen, worst
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
    ends = np.cumsum([0, *(len(f.residual) for f in model.fits)])
    rows = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in chosen])
    asked = []
    for score in (s for s in scores if s.candidate.id not in tried and s.nulls):
        sign = -1.0 if any(v < 0.0 for v in score.strength.values()) else 1.0
        asked.append((score, score.columns[rows], tuple(sign * share for share in STRENGTHS)))
    left = _beside(fitted)
    return _best(_scan(some, fitted, asked), left, (1.0 - SHARE) * left)


def strong_from_start(
    bench: Workbench, model: Fitted, scores: Sequence[Score], tried: Collection[str]
) -> list[Score]:
    """Scores of candidates of one strength that explain much where a calibration begins, best first.

    What is far from first order can drag the nominal parameters far from what they are, and from there it looks like
    something else. Beside the values that the case begins with, each candidate is run at the strength, to either side,
    at which its effect would be as large as what is left.

    Parameters
    ----------
    bench, model, scores, tried
        As in `strong`; the model has no effects.

    Raises
    ------
    RodnetError
        If the trials cannot be simulated there.
    """
    chosen = sorted(worst(model)[:TRIALS])
    some = bench.subset(chosen)
    nominal = {q.path for q in bench.problem().quantities if q.trial is None and q.log}
    problem = some.problem((), {p: v for p, v in model.values.items() if p not in nominal})
    begun = some.evaluate(problem, np.zeros(len(problem.quantities)), ())
    known = {
        s.candidate.id: s for s in scores if s.candidate.id not in tried and len(s.candidate.strength) == 1
    }
    there = screen(some, begun, [s.candidate for s in known.values()])
    asked = [
        (replace(known[s.candidate.id], shape=s.shape), s.columns, (1.0, -1.0)) for s in there if s.nulls
    ]
    return _best(_scan(some, begun, asked), _beside(begun), _beside(model.of_trials(chosen)))


def _beside(fitted: Fitted) -> float:
    """Sum of squares beside what the model can do."""
    return float(np.sum(Basis.of(fitted.jacobian).out(fitted.residual) ** 2))


def _scan(
    bench: Workbench, model: Fitted, asked: Sequence[tuple[Score, np.ndarray, tuple[float, ...]]]
) -> list[tuple[float, Score]]:
    """What is left of a few trials with candidates of one strength, at shares of that which would explain all."""
    basis, left = Basis.of(model.jacobian), _beside(model)
    found: list[tuple[float, Score]] = []
    for score, columns, shares in asked:
        if len(score.candidate.strength) != 1 or not (size := float(np.linalg.norm(columns))) > 0.0:
            continue
        (path,) = score.candidate.strength
        step, null = np.sqrt(left) / size * score.scales[path], score.nulls[path]
        low, high = bench.bounds((*model.candidates, score.candidate))[path]
        ended: set[float] = set()  # sides beyond which nothing can be run
        for share in shares:
            side = float(np.sign(share))
            if side in ended:
                continue
            value = null + float(share * step)
            if beyond := not low < value < high:
                value = 0.5 * (null + (low if side < 0.0 else high))
            if value == null:
                continue
            rest = _left(bench, model, basis, score, {**score.shape, path: value})
            if rest is not None:
                there = {path: value - null}
                found.append((rest, replace(score, strength=there, follow=None, chi2=left - rest)))
            if rest is None or beyond:
                ended.add(side)
    return found


def _best(found: Sequence[tuple[float, Score]], left: float, most: float) -> list[Score]:
    """The few that leave least, and less than what is asked for."""
    best: dict[str, Score] = {}
    for rest, score in sorted(found, key=lambda one: one[0]):
        if rest < min(most, left):
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
