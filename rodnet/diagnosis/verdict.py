"""What a diagnosis may claim: the rules by which scores and refits become words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.refit import MANY, Refit
from rodnet.diagnosis.remainder import Remainder, test_remainder
from rodnet.diagnosis.scales import ALPHA, CLASS, LEAST, TIMES, TRIFLE, Noise, variance_factor
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.workbench import Fitted
from rodnet.numbers import number

GAIN = 6.0  # of deviance on trials left out: three nats
# chance that more parameters gain so much where there is nothing for them to explain: less, and they are needed; and
# what they gain at most where fewer explain as much
IDLE, MOST_IDLE = 0.05, 0.01
CROSS = 0.02  # of what an explanation gains, that its gain on trials left out may be off by: that is to first order
COINCIDENCE = 0.02  # of a motion: what has more parameters and makes one as near by is no other explanation
PLAUSIBLE = 20.0  # times a change worth considering: a strength that is not plausible any more
SEVERAL = 3  # explanations at least, all as good, of which nothing can be said
FEWEST, LEARNT = 5, 3  # trials for a name, and of them those that it was found in
# chance that the mean gain of a trial is none, at most: of complete models, and of others
LIKELY, SURE = 0.1, 0.05
RELIEF = 0.02  # share of the errors on trials left out that a surrogate must take off
# what a family contains as special cases: these are no other explanations than it
CONTAINS = {
    "stiffness-profile": ("stiffness-defect", "stiffness-gradient", "root-compliance"),
    "natural-shape": ("natural-curvature", "kink"),
    "kink": ("natural-curvature",),  # a wide one
}
# [sigma] smooth remainder below which a model is taken for complete: a drive's record leaves 0.1
NOTICED = 0.15
# [sigma] that a complete model may leave of trials not seen beside the noise: a drive's record makes half a sigma
UNSEEN = 0.6


@dataclass(frozen=True)
class Judgement:
    """Whether a refit is accepted, and why not.

    Attributes
    ----------
    accepted : bool
        Whether it belongs into the model.
    reasons : tuple of str
        Why not.
    helps : bool
        Whether it predicts trials left out better on the whole, so that it may stand in for what has no name.
    """

    accepted: bool
    reasons: tuple[str, ...]
    helps: bool = False


def judge(refit: Refit, numerical: float) -> Judgement:
    """Whether a candidate belongs into the model."""
    reasons = []
    if not refit.p < ALPHA:
        reasons.append(f"chance alone would gain as much with a probability of {refit.p:.2g}")
    if refit.cross_gain < GAIN:
        where = "trials left out" if len(refit.gains) > 1 else "the only trial"
        reasons.append(f"it gains {number(0.5 * refit.cross_gain, '.2g')} nats on {where}, less than 3")
    elif len(refit.gains) >= 3 and not beats_trials(
        refit.by_group, LIKELY if refit.factor == 1.0 else SURE, CROSS * refit.gain
    ):
        reasons.append("its gain on trials left out varies so much from trial to trial that it may be none")
    if refit.effect_sigma < LEAST:
        reasons.append(f"its effect is {refit.effect_sigma:.2g} sigma, too small to name")
    if refit.effect_sigma < TIMES * numerical:
        reasons.append(f"its effect is near the numerical error that is left, {numerical:.2g} sigma")
    return Judgement(not reasons, tuple(reasons), helps(refit, numerical))


def helps(refit: Refit, numerical: float) -> bool:
    """Whether a refit that need be no name predicts trials left out better: most of them, and all of them together.

    Together as errors are told, by distances: one trial that it predicts much worse does not outweigh all others, as it
    would by squares.
    """
    matters = refit.effect_sigma >= max(LEAST, TIMES * numerical)
    most = len(refit.gains) >= LEARNT and float(np.median(refit.gains)) > 0.0
    return refit.p < ALPHA and matters and most and refit.relief > RELIEF


def noticed(refit: Refit) -> bool:
    """Whether a refit shows that something is missing, even if it is not accepted: not by chance, and large enough.

    It may be the numerical error, if it is no larger than three times that.
    """
    return refit.p < ALPHA and refit.cross_gain >= GAIN and refit.effect_sigma >= LEAST


def beats_trials(gains: np.ndarray, level: float, inexact: float = 0.0) -> bool:
    """Whether trials gain on the whole: the unit of evidence is the trial, beside a remainder above all.

    What hardly acts in most of them (an obstacle that one trial runs into) gains nothing there, more or less as its
    gains are inexact; then it must gain without the trial that gains most, too.
    """
    if np.all(gains > 0.0):
        return True
    if np.all(gains > -inexact) and float(gains.sum() - gains.max()) > GAIN:
        return True
    if len(gains) < 2:
        return False
    mean, sd = float(np.mean(gains)), float(np.std(gains, ddof=1))
    return (
        mean > 0.0 and float(student.sf(mean / (sd / np.sqrt(len(gains)) + 1e-300), len(gains) - 1)) < level
    )


def equivalents(best: Refit, others: list[Refit], noise: Noise, numerical: float) -> list[Refit]:
    """Refits that explain the data as well as the best, or would if the numerical error were against them."""
    return [
        o
        for o in others
        if o is not best
        and (
            best.gain - o.gain * o.factor / best.factor < CLASS * smooth_variance(o.fitted)
            or _ahead(best, o) < _idle(best, o, MOST_IDLE)
            or numerically_alike(best.fitted, o.fitted, numerical)
            or (_ahead(best, o) < _trifle(best, o) and _leaves_no_more(o, best, noise))
        )
    ]


def numerically_alike(one: Fitted, other: Fitted, numerical: float) -> bool:
    """Whether the numerical error [sigma] may be why one explanation fits better than another.

    If the other is true, and e is what the code lacks, the sum of squares falls by 2 e.d - d.d where predictions are
    changed by d, and noise adds some 2 |d| times its standard deviations (of what the one leaves, for the other may be
    wrong): at most what an error does that is all along d. Some trials that tell two explanations apart do so whatever
    the others do: those come first in which the two differ most for the error that there is.
    """
    left = [(a.residual, b.residual) for a, b in zip(one.fits, other.fits, strict=True)]
    half = np.array([b @ (b - a) for a, b in left])  # of what one is ahead by, and d.d
    size, error = np.array([np.sum((b - a) ** 2) for a, b in left]), errors_of_trials(one, numerical) ** 2
    noise = np.sqrt(CLASS * max(variance_factor(one), smooth_variance(one)))
    order = np.argsort(-size / np.maximum(error, 1e-300))
    half, size, error = (np.cumsum(some[order]) for some in (half, size, error))
    return bool(np.all(half <= np.sqrt(size) * (np.sqrt(error) + noise)))


def errors_of_trials(model: Fitted, numerical: float) -> np.ndarray:
    """Norm of each trial's numerical error [sigma], of so much rms of all: as much larger as finer runs change it more.

    As the derivatives by shares of the numerical error tell; alike in all trials where there are none.
    """
    count = np.array([len(f.residual) for f in model.fits], dtype=float)
    shares = [k for k, q in enumerate(model.quantities) if ".numerics[" in q.path]
    power = np.array([np.sum(model.jacobian_of(k)[:, shares] ** 2) for k in range(len(count))])
    if not power.sum() > 0.0:
        power = count
    return np.asarray(numerical * np.sqrt(count.sum() * power / power.sum()))


def simplest(
    good: list[Refit], refits: list[Refit], noise: Noise, numerical: float
) -> tuple[Refit, list[Refit]]:  # fmt: skip
    """What stands for all that explain the data as well, and all these; it must be acceptable by itself.

    From the best to the simplest that is as good, and on from that one: what is nearer than the numerical error may
    be a little farther from the best of several with more parameters.
    """
    best, names = max(good, key=lambda one: one.cross_gain), {one.id for one in good}
    while True:
        alike = [best, *equivalents(best, refits, noise, numerical)]
        one = min([o for o in alike if o.id in names], key=lambda o: o.score.candidate.size)
        if one.score.candidate.size == best.score.candidate.size:
            special = contained(best.score.candidate.family)
            same = [o for o in alike if o.id in names and o.score.candidate.family in special]
            return (max(same, key=lambda o: o.cross_gain) if same else best), alike
        best = one


def contained(family: str) -> tuple[str, ...]:
    """Families that are special cases of one, or the same by another name."""
    from rodnet import registry

    record = registry.terms().get(family)
    told = getattr(record.object, "contains", ()) if record is not None else ()
    return (*CONTAINS.get(family, ()), *told)


def rivals(one: Refit, alike: list[Refit], whole: bool = True) -> list[Refit]:
    """What else explains as much: a description that contains this one as a special case is no other explanation.

    Nor is one that takes more parameters to explain no more than these explain by chance; but where the model is not
    yet ``whole``, chance seems to explain much, and what takes more parameters is asked again when it is.
    """
    family = one.score.candidate.family
    return [
        o
        for o in alike
        if o is not one
        and family not in contained(o.score.candidate.family)
        and not (family == "root-compliance" and _at_an_end(o))
        and not (whole and _needless(o, one))
    ]


def _needless(other: Refit, one: Refit) -> bool:
    """Whether its further parameters gain no more than by chance, in the fit and on trials left out.

    Nor more than a trifle, if they are many: these follow the errors of a mesh and of another code, too. Few that gain
    it give no name, but who knows whether it is the truth's. Strengths that have nothing to do do not count, of
    neither: a current of three components, of which one explains what a weight does, is no more complicated than a
    weight, and another cause; but a tether that pulls that way is. Nor is an explanation that could make many motions
    and makes the very one that the simpler must make: a rod whose bends are turned as the grip would turn them.
    """
    more = further_needed(other, one)
    trifle = _trifle(other, one) if more >= MANY else 0.0
    return more > 0 and (
        _ahead(other, one) < max(_idle(other, one, IDLE), trifle) or _same_motion(other, one)
    )


def _same_motion(other: Refit, one: Refit) -> bool:
    """Whether two explanations make the same motion, but for a small part of what they change."""
    pairs = zip(one.fitted.fits, other.fitted.fits, strict=True)
    apart = sum(float(np.sum((b.residual - a.residual) ** 2)) for a, b in pairs)
    return apart < COINCIDENCE**2 * one.gain * one.factor


def further_needed(other: Refit, one: Refit) -> int:
    """Number of parameters that it needs more, of those that it has more: none if it has as many."""
    more = other.score.candidate.size - one.score.candidate.size
    return max(min(more, needed_size(other) - needed_size(one)), 0)


def needed_size(one: Refit) -> int:
    """Number of parameters without the strengths that have nothing to do."""
    candidate = one.score.candidate
    return candidate.size - len(candidate.strength) + min(one.score.lean, len(candidate.strength))


def _ahead(one: Refit, other: Refit) -> float:
    """By how much one lowers the deviance more than another, in the fit or on trials left out, whichever is more.

    The latter is told to first order: a fiftieth of a gain is no difference there.
    """
    scale = one.factor / other.factor
    crossed = one.cross_gain * scale - other.cross_gain - CROSS * other.gain
    return max(one.gain * scale - other.gain, crossed)


def _idle(other: Refit, one: Refit, chance: float) -> float:
    """Deviance that the further parameters of one explanation gain with some chance where there is nothing for them."""
    more = other.score.candidate.size - one.score.candidate.size
    by_chance = float(chi2.isf(chance, more)) * smooth_variance(one.fitted) if more > 0 else 0.0
    return max(by_chance, unnamed(more, one.fitted, one.factor))


def unnamed(more: int, model: Fitted, factor: float) -> float:
    """Deviance that many further parameters may gain by a change of the prediction that is too small to be named.

    Whatever has so many follows the errors of a mesh and of another code, too; few cannot.
    """
    return LEAST**2 * model.samples / factor if more >= MANY else 0.0


def smooth_variance(model: Fitted) -> float:
    """Variance over the noise's of what is smooth in what a model leaves, where that is too little to name.

    All that parameters change is smooth, so they gain so many times more by chance than of noise.
    """
    left = test_remainder(model)
    return max(left.ratio, 1.0) if left.p < ALPHA and complete(left) else 1.0


def _trifle(other: Refit, one: Refit) -> float:
    """Deviance that the further parameters of one explanation may gain and be no better: so much no model is good to.

    They take up what a model's mesh, or its idea of a gripper, is off by; those of which something is known beforehand,
    too: a drive's lags that are spread a little smooth the noise of its record.
    """
    trifle = TRIFLE * other.at_stake * other.factor / one.factor
    return trifle if plainer(one.score.candidate, other.score.candidate) else 0.0


def plainer(one: Candidate, other: Candidate) -> bool:
    """Whether an explanation has fewer parameters than another, those of which something is known counted, too."""
    return len(one.paths) < len(other.paths)


def _leaves_no_more(one: Refit, other: Refit, noise: Noise) -> bool:
    """Whether one explanation leaves nothing, or the other something, too."""
    return complete(test_remainder(one.fitted, noise)) or not complete(test_remainder(other.fitted, noise))


def _at_an_end(one: Refit) -> bool:
    """Whether it is a soft spot that reaches an end of its rod: a root that gives is one, too, without any width."""
    candidate, values = one.score.candidate, one.fitted.values
    if candidate.family != "stiffness-defect" or candidate.place is None:
        return False
    place, (width,) = values[candidate.place], (values[p] for p in candidate.shape if p.endswith(".width"))
    return min(place, 1.0 - place) <= width


def complete(remainder: Remainder) -> bool:
    """Whether nothing is left that noise would not leave, that of a drive's record too."""
    return remainder.p > ALPHA or remainder.excess < NOTICED or remainder.grips > 0.0


def silent(remainder: Remainder) -> bool:
    """Whether nothing is left if the noise is as it was estimated, too."""
    return complete(replace(remainder, p=min(remainder.p, remainder.estimated)))


def blind(scores: Sequence[Score]) -> bool:
    """Whether these trials can tell nothing at all of what was tried.

    Either nothing would have been seen at any plausible strength, or everything that would explains the data as well
    as the best.
    """
    visible = [s for s in scores if visibly(s)]
    if not visible:
        return True
    best = max(visible, key=lambda s: s.chi2)
    alike = [s for s in visible if best.chi2 - s.chi2 < CLASS * best.factor]
    return best.p < ALPHA and len(visible) >= SEVERAL and len(alike) == len(visible)


def visibly(score: Score) -> bool:
    """Whether a candidate was seen, or a plausible strength of it would have been."""
    return score.p < ALPHA or any(v < PLAUSIBLE * score.scales[p] for p, v in score.visible.items())


@dataclass(frozen=True)
class Evidence:
    """What the verdict depends on.

    Attributes
    ----------
    classes : tuple of bool
        Of each, whether something else explains as much.
    trials, training : int
        Number of all trials, and of those that the search has seen.
    whole : bool
        Whether the remainder test passes.
    holds : tuple of bool
        Of each effect, whether it holds beside the remainder, where there is one.
    sure : tuple of bool
        Of each effect, whether trials left out gain by it one like the other.
    resolved : bool
        Whether the numerical error is small enough.
    alarmed : bool
        Whether there is a mismatch at all.
    blind : bool
        Whether nothing can be told from these trials.
    improved : bool
        Whether held-out trials, if there are any that show what was found, are predicted better.
    many : bool
        Whether there are as many effects as are looked for: what takes so many may be one that is not in the bank.
    near : bool
        Whether there is something that is no chance but may be the numerical error.
    """

    classes: tuple[bool, ...]
    trials: int
    training: int
    whole: bool
    holds: tuple[bool, ...]
    sure: tuple[bool, ...]
    resolved: bool
    alarmed: bool
    blind: bool
    improved: bool
    many: bool = False
    near: bool = False


def few(e: Evidence) -> bool:
    """Whether the trials are too few for a name."""
    return e.trials < FEWEST or e.training < LEARNT


def word(e: Evidence) -> str:
    """The verdict."""
    if not e.alarmed:
        return "unresolved-numerics" if e.near else "unidentifiable" if e.blind else "none"
    if not e.resolved:
        return "unresolved-numerics"
    if not any(e.sure):
        return "surrogate"
    if not e.whole and not any(h and s for h, s in zip(e.holds, e.sure, strict=True)):
        return "surrogate"
    if not e.improved:
        return "surrogate"
    if e.blind:
        return "unidentifiable"
    if few(e):
        return "class"
    if not e.whole or not all(e.sure) or e.many:
        return "partial"
    return "class" if any(e.classes) else "named"


def status(number: int, e: Evidence, verdict: str) -> str:
    """What one effect may be called: ``"named"``, ``"class"`` or ``"surrogate"``; a law comes after all others."""
    if verdict in ("surrogate", "unresolved-numerics") or number >= len(e.sure):
        return "surrogate"
    if not e.sure[number] or (not e.whole and not e.holds[number]):
        return "surrogate"
    return "class" if e.classes[number] or few(e) or verdict == "unidentifiable" else "named"
