"""Which candidates are worth a full refit."""

from __future__ import annotations

from collections.abc import Sequence

from rodnet.diagnosis.scales import ALPHA, CLASS
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.verdict import GAIN

FEW = 4  # candidates that are refitted
RIVALS = 2  # more of them, where they score as well as the best
FAINT = 0.02  # share of a signal that a refit of the nominal parameters leaves, below which first order is no guide


def worth_a_refit(scores: Sequence[Score]) -> list[Score]:
    """The candidates worth a refit: the one that explains most, and those that promise most on trials left out.

    One of which next to nothing is left beside the nominal parameters explains that by a huge strength, and only to
    first order: it must promise something. And what scores as well as the best, for that may be the same explanation
    by another name.
    """
    good = [s for s in scores if s.p < ALPHA]
    if not good:
        return []
    clear = [s for s in good if s.survives > FAINT]
    best = max(clear or good, key=lambda s: s.chi2)
    hopeful = [s for s in good if s is not best and float(s.promise.sum()) > GAIN]
    hopeful.sort(key=lambda s: -float(s.promise.sum()))
    alike = [s for s in hopeful[FEW - 1 :] if s.chi2 > best.chi2 - CLASS * best.factor]
    return [best, *hopeful[: FEW - 1], *alike[:RIVALS]]
