"""Two effects at once: such as hide each other, and such for which a single one stands in."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.begin import best_fit, fit_both
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.equivalence import IDLE, rivals, simplest
from rodnet.diagnosis.refit import MANY, RIVAL, Refit, assess
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.scales import CLASS, variance_factor
from rodnet.diagnosis.screen import Basis, Score, promised, strongest
from rodnet.diagnosis.verdict import GAIN, complete, judge
from rodnet.diagnosis.workbench import Fitted, Workbench

TOP, PAIRS = 16, 3  # candidates of which pairs are made, and pairs that are refitted
MASKED = 4  # candidates that alone would have the wrong sign, beside these
INSTEAD = 2  # pairs that are fitted in the place of one effect

Tell = Callable[[str], None]
Scored = tuple[Score, Score]


@dataclass(frozen=True, eq=False)
class Both:
    """Two effects that were fitted together: each as it was accepted, and both as one explanation."""

    each: list[Accepted]
    whole: Refit


def hidden(
    bench: Workbench,
    model: Fitted,
    scores: Sequence[Score],
    refits: Sequence[Refit],
    numerical: float,
    tell: Tell,
) -> list[Accepted]:
    """Two effects that hide each other: each must be acceptable beside the other; none if there are no such.

    All pairs of the best are scored to first order, and those refitted that promise most on trials left out.

    Parameters
    ----------
    bench : Workbench
        The trials.
    model : Fitted
        What they would join.
    scores : sequence of Score
        Of all candidates at that model.
    refits : sequence of Refit
        Of some of them, alone beside that model.
    numerical : float
        Numerical error that is left [sigma].
    tell : callable
        Told of the progress.

    Returns
    -------
    list of Accepted
        Both, or nothing: of pairs that explain the data as well that of the fewest parameters, by the rule that
        chooses among single effects. The equivalents of each are what explains as much in its place beside the other.
    """
    r = Basis.of(model.jacobian).out(model.residual)
    alone, places = {one.id: one.fitted for one in refits}, _places(scores) ** 2
    found: list[Both] = []
    for a, b in _promising(model, r, _pairs(scores, r))[:PAIRS]:
        gained = max((model.deviance - one.whole.fitted.deviance for one in found), default=0.0)
        if float(r @ r) - _left(r, a, b) < RIVAL * gained:
            continue  # they cannot explain as much
        pair = _fitted(bench, model, a, b, alone, places, numerical, tell)
        if pair:
            found.append(pair)
    return _best(bench, found, numerical) if found else []


def _best(bench: Workbench, found: Sequence[Both], numerical: float) -> list[Accepted]:
    """What stands for all pairs that explain the data as well, each of its members with what else might stand there."""
    wholes = [pair.whole for pair in found]
    best, alike = simplest(wholes, wholes, bench.noise, numerical)
    others = rivals(best, alike, complete(test_remainder(best.fitted, bench.noise)))
    each = {pair.whole.id: pair.each for pair in found}
    return _classed(each[best.id], [each[one.id] for one in others])


def _as_one(a: Score, b: Score) -> Score:
    """Both effects as a single explanation, which has the parameters of both."""
    one, other = a.candidate, b.candidate
    id = f"{one.id} and {other.id}"
    both = replace(
        other, id=id, family=id, on="", strength=(*one.strength, *other.strength),
        shape=(*one.shape, *other.shape), priors={**one.priors, **other.priors},
    )  # fmt: skip
    lean = sum(min(s.lean, len(s.candidate.strength)) for s in (a, b))
    return replace(b, candidate=both, lean=lean)


def instead_of(
    bench: Workbench, base: Fitted, one: Refit, scores: Sequence[Score], refits: Sequence[Refit], numerical: float,
    tell: Tell,
) -> list[Accepted]:  # fmt: skip
    """Two effects that explain more than one of as many parameters or more does; none if there are no such.

    A soft spot near the root can stand for a root that gives beside a stiffness that changes along the rod: what it
    leaves is no more than errors of a drive's record, and so nothing further would be looked for. Pairs are made of
    what was refitted, for each of two causes explains a part by itself, and to first order strong effects tell little;
    and where the one has many parameters, of what is simple and promises most together, too.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base : Fitted
        The model as it is.
    one : Refit
        The single effect.
    scores : sequence of Score
        Of all candidates at the model as it is.
    refits : sequence of Refit
        Of some of them, alone beside it; pairs are made of these.
    numerical : float
        Numerical error that is left [sigma].
    tell : callable
        Told of the progress.

    Returns
    -------
    list of Accepted
        Both, or nothing; of several pairs and of what explains as much, as `hidden` chooses.
    """
    size, alone = one.score.candidate.size, {other.id: other.fitted for other in refits}
    others = sorted((o for o in refits if o.id != one.id), key=lambda o: -o.gain * o.factor)
    some = [
        (a.score, b.score)
        for a, b in sorted(combinations(others, 2), key=lambda ab: -sum(o.gain * o.factor for o in ab))
        if a.score.candidate.size + b.score.candidate.size <= size
    ][:INSTEAD]
    if size > MANY:  # it may stand for any two, whether or not each explains much by itself
        r = Basis.of(base.jacobian).out(base.residual)
        had = [{a.candidate.id, b.candidate.id} for a, b in some]
        simple = _pairs([s for s in scores if s.candidate.size < MANY], r)
        more = (
            both
            for both in simple
            if sum(s.candidate.size for s in both) <= size and {s.candidate.id for s in both} not in had
        )
        some += _promising(base, r, more)[:INSTEAD]
    pairs = [_fitted(bench, base, a, b, alone, _places(scores) ** 2, numerical, tell) for a, b in some]
    least = CLASS * variance_factor(one.fitted)
    found = [p for p in pairs if p is not None and one.fitted.deviance - p.whole.fitted.deviance > least]
    if not found:
        return []
    best = _best(bench, found, numerical)
    tell(f"{' and '.join(a.candidate.id for a in best)} together explain more than {one.id}")
    return best


def _places(scores: Sequence[Score]) -> int:
    return sum(s.tried for s in scores)


def _pairs(scores: Sequence[Score], r: np.ndarray) -> Iterable[Scored]:
    """Pairs of what scores best, and of what has the wrong sign alone, for another may have pushed it there."""
    some = [s for s in scores if s.chi2 > 0.0][:TOP]
    masked = sorted((s for s in scores if s.chi2 <= 0.0 < s.survives), key=lambda s: -_overlap(s, r))
    for a, b in combinations([*some, *masked[:MASKED]], 2):
        same = a.candidate.family == b.candidate.family and set(a.strength) & set(b.strength)
        if not same and (a.chi2 > 0.0 or b.chi2 > 0.0):
            yield a, b


def _overlap(score: Score, r: np.ndarray) -> float:
    z, *_ = np.linalg.lstsq(score.columns, -r, rcond=1e-8)
    return float(np.sum((score.columns @ z) ** 2))


def _promising(model: Fitted, r: np.ndarray, pairs: Iterable[Scored]) -> list[Scored]:
    """Pairs that promise something on trials left out beyond what either does, the best for their size first."""
    ranked: list[tuple[float, int, Scored]] = []
    for a, b in pairs:
        gain = _promise(model, r, a, b)
        if gain > 0.0:
            chance = float(chi2_of.isf(IDLE, a.candidate.size + b.candidate.size))
            ranked.append((chance - gain, len(ranked), (a, b)))
    return [both for *_, both in sorted(ranked)]


def _fitted(
    bench: Workbench, model: Fitted, a: Score, b: Score, alone: dict[str, Fitted], places: int, numerical: float,
    tell: Tell,
) -> Both | None:  # fmt: skip
    """Both effects, fitted together, if each is acceptable beside the other; ``alone`` keeps fits of one."""
    tell(f"refit with {a.candidate.id} and {b.candidate.id}")
    for score in (a, b):
        if score.candidate.id not in alone:
            fitted = best_fit(bench, model, score)
            if fitted is None:
                return None
            alone[score.candidate.id] = fitted
    both, least = fit_both(bench, model, a, b), min(alone[s.candidate.id].deviance for s in (a, b))
    if both is None or both.deviance > least:
        both = best_fit(bench, alone[a.candidate.id], b)
    if both is None:
        return None
    beside_a = assess(bench, alone[a.candidate.id], both, b, places)
    beside_b = assess(bench, alone[b.candidate.id], both, a, places)
    if not (judge(beside_a, numerical).accepted and judge(beside_b, numerical).accepted):
        return None
    first = assess(bench, model, alone[a.candidate.id], a, places)
    whole = assess(bench, model, both, _as_one(a, b), places)
    return Both(
        [Accepted(first, model, []), Accepted(beside_a, alone[a.candidate.id], [])],
        replace(whole, least=(least - both.deviance) / whole.factor),
    )


def _classed(best: list[Accepted], others: Sequence[list[Accepted]]) -> list[Accepted]:
    """A pair whose members know what stands in their place beside the other in pairs that explain as much."""
    ids = {one.candidate.id for one in best}
    found = []
    for k, one in enumerate(best):
        places: dict[str, Refit] = {}
        for pair in others:
            theirs = {m.candidate.id for m in pair}
            if ids & theirs != ids - {one.candidate.id}:
                continue
            (other,) = (m for m in pair if m.candidate.id not in ids)
            alone = k == 0 and other is pair[0]
            places[other.candidate.id] = (
                other.refit if alone else replace(other.refit, fitted=pair[-1].refit.fitted)
            )
        found.append(replace(one, equivalents=rivals(one.refit, list(places.values()), whole=False)))
    return found


def _together(r: np.ndarray, a: Score, b: Score) -> tuple[np.ndarray, np.ndarray]:
    """Columns of two effects, and the strengths with which they explain most, none on the side where it cannot be."""
    both = np.hstack([a.columns, b.columns])
    return both, strongest(both, r, np.concatenate([a.one_sided, b.one_sided]))


def _promise(model: Fitted, r: np.ndarray, a: Score, b: Score) -> float:
    """By how much the deviance of trials left out falls with two effects to first order; 0 if one is needless."""
    both, z = _together(r, a, b)
    count = len(a.one_sided)
    if not (z[:count].any() and z[count:].any()):
        return 0.0
    whole = np.hstack([_unprojected(model, score) for score in (a, b)])
    gain = float(promised(model, whole[:, z != 0.0]).sum())
    alone = max(float(s.promise.sum()) * s.factor for s in (a, b))
    factor = variance_factor(model, r + both @ z)
    return gain / factor if gain > alone + GAIN * factor else 0.0


def _unprojected(model: Fitted, score: Score) -> np.ndarray:
    """Columns of an effect with what the nominal parameters can do; those have priors, which is not for nothing."""
    known = score.follow is not None and len(score.follow) == len(model.quantities)
    return score.unprojected(model.jacobian) if known else score.columns


def _left(r: np.ndarray, a: Score, b: Score) -> float:
    """What two effects together leave of a residual, to first order."""
    both, z = _together(r, a, b)
    return float(np.sum((r + both @ z) ** 2))
