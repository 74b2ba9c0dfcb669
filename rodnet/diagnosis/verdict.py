"""What a diagnosis may claim: the rules by which scores and refits become words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.remainder import Remainder
from rodnet.diagnosis.scales import ALPHA, CLASS, LEAST, TIMES
from rodnet.diagnosis.screen import Score
from rodnet.numbers import number

GAIN = 6.0  # of deviance on trials left out: three nats
CROSS = 0.02  # of what an explanation gains, that its gain on trials left out may be off by: that is to first order
PLAUSIBLE = 20.0  # times a change worth considering: a strength that is not plausible any more
SEVERAL = 3  # explanations at least, all as good, of which nothing can be said
FEWEST, LEARNT = 5, 3  # trials for a name, and of them those that it was found in
# chance that the mean gain of a trial is none, at most: of complete models, and of others
LIKELY, SURE = 0.1, 0.05
RELIEF = 0.02  # share of the errors on trials left out that a surrogate must take off
# [sigma] smooth remainder below which a model is taken for complete: a drive's record and another code leave 0.15
NOTICED = 0.2
# times what their noise lets expect, that errors of drives' records may be: 1.1 where it is slow, which smoothing keeps
ASTRAY = 2.0
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
    """Whether a refit shows that something is missing, even if it is not accepted: but for the numerical error it is.

    It may be that error, if it is no larger than three times that.
    """
    return judge(refit, 0.0).accepted


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


def complete(remainder: Remainder) -> bool:
    """Whether nothing is left that noise would not leave, that of a drive's record too."""
    small = remainder.p > ALPHA or remainder.excess < NOTICED or remainder.grips > 0.0
    return small and remainder.records < ASTRAY


def silent(remainder: Remainder) -> bool:
    """Whether nothing is left if the noise is as it was estimated, too."""
    return complete(replace(remainder, p=min(remainder.p, remainder.estimated)))


def outweighs(refit: Refit, left: Remainder) -> bool:
    """Whether the last effect explains more than it leaves, where that is no noise.

    If not, it may be a part of something larger that has no name: of what is off in the law of another effect.
    """
    if left.p > ALPHA or left.grips > 0.0:
        return True
    return bool(refit.gain * refit.factor > left.excess**2 * refit.fitted.samples)


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
