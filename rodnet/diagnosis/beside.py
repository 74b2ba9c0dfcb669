"""What counts beside a remainder: an effect mixed with something else is named only if it holds all the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.findings import LEVEL, interval
from rodnet.diagnosis.forces import BEATEN, Placebo
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.verdict import CARRIED, GAIN, TIMES
from rodnet.diagnosis.workbench import Fitted

CHANCE = 3.84  # of deviance that a trial left out may lose by chance


@dataclass(frozen=True)
class Beside:
    """Whether an effect holds beside a remainder.

    Attributes
    ----------
    reasons : tuple of str
        Why not; empty if it does.
    strengths : dict
        Values of its strengths with a flexible residual force fitted alongside.
    beaten : float
        Share of the placebos that gain less on trials left out.
    """

    reasons: tuple[str, ...]
    strengths: dict[str, float]
    beaten: float

    @property
    def holds(self) -> bool:
        """Whether it does."""
        return not self.reasons


def hold(
    one: Accepted, model: Fitted, strengths: dict[str, float], drawn: Placebo, numerical: float
) -> Beside:
    """Judge an accepted effect beside what the final model leaves.

    Parameters
    ----------
    one : Accepted
        The effect.
    model : Fitted
        The final model.
    strengths : dict
        Its strengths with a flexible force alongside.
    drawn : Placebo
        Placebos about the model that it joined.
    numerical : float
        Numerical error [sigma].
    """
    gains, reasons = one.refit.gains, []
    raw = one.refit.cross_gain * one.refit.factor
    if np.any(gains < -CHANCE) or (
        len(gains) > 1 and float(gains.sum() - gains.max()) < GAIN * (1.0 - 1.0 / len(gains))
    ):
        reasons.append("its gain does not hold leaving out each trial in turn")
    if not _within(model, strengths):
        shown = {p: interval(model, p) for p in one.candidate.strength}
        off = [p for p in shown if not shown[p].low <= strengths[p] <= shown[p].high] or list(shown)
        told = ", ".join(
            f"{p} would be {strengths[p]:.3g}, outside {shown[p].low:.3g} to {shown[p].high:.3g}" for p in off
        )
        reasons.append(f"{told}, with a flexible residual force alongside")
    beaten = drawn.beaten(raw)
    if beaten < BEATEN:
        reasons.append(f"it beats {100 * beaten:.0f} % of the placebos on trials left out, not 95 %")
    if one.refit.effect_sigma < TIMES * CARRIED * numerical:
        reasons.append("its effect is less than three times the numerical error that is left")
    return Beside(tuple(reasons), strengths, beaten)


def _within(model: Fitted, strengths: dict[str, float]) -> bool:
    """Whether values lie in the region that the model gives them all together: for one it is the interval."""
    places = [model.place(p) for p in strengths]
    away = np.array(
        [
            model.quantities[k].coordinate(v) - model.quantities[k].coordinate(model.values[p])
            for k, (p, v) in zip(places, strengths.items(), strict=True)
        ]
    )
    C = variance_factor(model) * model.covariance()[np.ix_(places, places)]
    distance = float(away @ np.linalg.pinv(C, hermitian=True) @ away)
    return distance <= float(chi2_of.ppf(LEVEL, len(places)))
