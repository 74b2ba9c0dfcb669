"""What a diagnosis may claim: the rules by which scores and refits become words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.remainder import Remainder

ALPHA = 1e-3  # of all tests of one kind together
GAIN = 6.0  # of deviance on trials left out: three nats
LEAST = 0.1  # [sigma] smallest effect that is named
TIMES = 3.0  # an effect must be so many times the numerical error
CARRIED = 0.3  # share of the numerical error that is left once its differences are fitted along
CLASS = 9.2  # of deviance: candidates as near as that explain the data as well
FEWEST = 5  # trials for a name
NOTICED = 0.1  # [sigma] smooth remainder below which a model is taken for complete


@dataclass(frozen=True)
class Judgement:
    """Whether a refit is accepted, and why not."""

    accepted: bool
    reasons: tuple[str, ...]


def judge(refit: Refit, numerical: float) -> Judgement:
    """Whether a candidate belongs into the model."""
    reasons = []
    if not refit.p < ALPHA:
        reasons.append(f"chance alone would gain as much with a probability of {refit.p:.2g}")
    if refit.cross_gain < GAIN:
        reasons.append(f"it gains {0.5 * refit.cross_gain:.2g} nats on trials left out, less than 3")
    elif len(refit.gains) >= 3 and not beats_trials(refit.gains):
        reasons.append("its gain on trials left out varies so much from trial to trial that it may be none")
    if refit.effect_sigma < LEAST:
        reasons.append(f"its effect is {refit.effect_sigma:.2g} sigma, too small to name")
    if refit.effect_sigma < TIMES * CARRIED * numerical:
        reasons.append(f"its effect is near the numerical error of {numerical:.2g} sigma")
    return Judgement(not reasons, tuple(reasons))


def beats_trials(gains: np.ndarray) -> bool:
    """Whether trials gain on the whole: the unit of evidence is the trial."""
    if np.all(gains > 0.0):
        return True
    mean, sd = float(np.mean(gains)), float(np.std(gains, ddof=1))
    return mean > 0.0 and float(student.sf(mean / (sd / np.sqrt(len(gains)) + 1e-300), len(gains) - 1)) < 0.1


def equivalents(best: Refit, others: list[Refit]) -> list[Refit]:
    """Refits that explain the data as well as the best."""
    return [o for o in others if o is not best and best.gain - o.gain * o.factor / best.factor < CLASS]


def complete(remainder: Remainder) -> bool:
    """Whether nothing is left that noise would not leave."""
    return remainder.p > ALPHA or remainder.excess < NOTICED


def word(
    found: int, classes: int, trials: int, whole: bool, robust: bool, numerics_ok: bool, alarmed: bool
) -> str:
    """The verdict.

    Parameters
    ----------
    found : int
        Number of accepted terms.
    classes : int
        Number of them that something else explains as well.
    trials : int
        Number of training trials.
    whole : bool
        Whether the remainder test passes.
    robust : bool
        Whether every accepted term holds beside a remainder.
    numerics_ok : bool
        Whether the numerical error is small enough.
    alarmed : bool
        Whether there is a mismatch at all.
    """
    if not alarmed:
        return "none"
    if not numerics_ok:
        return "unresolved-numerics"
    if not found:
        return "surrogate"
    if not whole:
        return "partial" if robust else "surrogate"
    if classes or trials < FEWEST:
        return "class"
    return "named"
