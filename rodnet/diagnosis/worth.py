"""Which candidates are worth a full refit."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from rodnet.diagnosis.scales import ALPHA, CLASS
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.verdict import GAIN

FEW = 4  # candidates that are refitted
RIVALS = 2  # more of them, where they score as well as the best
CLOSE = 6  # more of them, where they score as well as what stands for the others
NEARLY = 0.9  # of the best score: first order is no better guide than that
FAINT = 0.02  # share of a signal that a refit of the nominal parameters leaves, below which first order is no guide


def nearly(scores: Sequence[Score], best: Score, tried: Collection[str]) -> list[Score]:
    """What was not refitted and scored as well, or nearly, as what then explained most: it may explain as much, too.

    A lag of a motor and one of the record move everything by nearly the same, and both gain more than they score.
    """
    left = [s for s in scores if s.candidate.id not in tried and s.p < ALPHA and s.survives > FAINT]
    left.sort(key=lambda s: (s.candidate.size, -s.chi2))
    alike = [s for s in left if s.chi2 > best.chi2 - CLASS * best.factor][:CLOSE]
    names = {s.candidate.id for s in alike}
    close = [s for s in left if s.chi2 > NEARLY * best.chi2 and s.candidate.id not in names]
    return [*alike, *close[: max(RIVALS - len(alike), 0)]]


def worth_a_refit(scores: Sequence[Score]) -> list[Score]:
    """The candidates worth a refit: the one that explains most, and those that promise most on trials left out.

    One of which next to nothing is left beside the nominal parameters explains that by a huge strength, and only to
    first order: it must promise something. And what scores as well as the best, for that may be the same explanation
    by another name; and what is simpler than all of these and scores nearly as well, for of two that explain the same
    the simpler one stands.
    """
    good = [s for s in scores if s.p < ALPHA]
    if not good:
        return []
    clear = [s for s in good if s.survives > FAINT]
    best = max(clear or good, key=lambda s: s.chi2)
    hopeful = [s for s in good if s is not best and float(s.promise.sum()) > GAIN]
    hopeful.sort(key=lambda s: -float(s.promise.sum()))
    rest = hopeful[FEW - 1 :]
    alike = [s for s in rest if s.chi2 > best.chi2 - CLASS * best.factor][:RIVALS]
    found = [best, *hopeful[: FEW - 1], *alike]
    least = min(s.candidate.size for s in found)
    simpler = [s for s in rest if s.candidate.size < least and s.chi2 > NEARLY * best.chi2]
    return [*found, *sorted(simpler, key=lambda s: s.candidate.size)[:1]]
