"""Other places of a local effect: where a fit begins as well, and which explain as much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rodnet.diagnosis.begin import best_fit
from rodnet.diagnosis.far import at_places
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Scanned, Score
from rodnet.diagnosis.workbench import Fitted, Workbench

VALLEY = 0.6  # share of the best place's score, at which a fit may begin at another, too
KEPT = 12.0  # of deviance over the variance factor, by which a fit elsewhere may be worse to be kept in mind


def elsewhere(
    bench: Workbench, base: Fitted, fitted: Fitted, score: Score
) -> tuple[Fitted, tuple[Fitted, ...]]:
    """The fit of a local effect, or a better one that begins at another place where the score has a maximum.

    More drag in the middle of a rod is, to first order, much like less of it at the tip, and no search from one of
    these places comes to the other. Far from first order it may be that where the score has none: there it begins
    where full runs of a trial leave least. Fits that are hardly worse than the best are returned beside it.
    """
    path = score.candidate.place or score.candidate.onset
    if path not in score.shape or bench.case.noise is not None:
        return fitted, ()
    found, best = [fitted], fitted
    tops = [one for one in maxima(score, path) if one.chi2 >= VALLEY * score.chi2]
    starts = [
        replace(score, shape=one.shape, strength=one.strength, chi2=one.chi2, follow=one.follow)
        for one in tops
        if one.shape[path] != score.shape[path]
    ]
    if score.begin is None and (far := at_places(bench, base, score)) is not None:
        starts.append(far)
    for start in starts:
        if _beside(score, path, start.shape[path], best):
            continue
        again = best_fit(bench, base, start, best.deviance)
        if again is not None:
            found.append(again)
            best = min(best, again, key=lambda f: f.deviance)
    most = best.deviance + KEPT * variance_factor(best)
    return best, tuple(one for one in found if one is not best and one.deviance < most)


def maxima(score: Score, path: str) -> list[Scanned]:
    """Places of a bank where a score has a maximum along one of its shape parameters, the highest first."""
    best: dict[float, Scanned] = {}
    for one in sorted(score.scanned, key=lambda s: s.chi2):
        best[one.shape[path]] = one
    row = [best[at] for at in sorted(best)]
    chi2 = np.array([-np.inf, *(one.chi2 for one in row), -np.inf])
    tops = (chi2[1:-1] > chi2[:-2]) & (chi2[1:-1] >= chi2[2:])
    return sorted((one for one, top in zip(row, tops, strict=True) if top), key=lambda s: -s.chi2)


def _beside(score: Score, path: str, at: float, fitted: Fitted) -> bool:
    """Whether a place that was scanned is next to where a fit has come to."""
    places = np.unique([one.shape[path] for one in score.scanned])
    return bool(np.sum(np.abs(places - at) < abs(fitted.values[path] - at)) <= 2)
