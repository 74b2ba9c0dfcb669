"""What errors of where each trial is held leave where nobody knows how noisy the record of its drive is.

A rod is driven by what an encoder or a camera has recorded. Smoothing keeps about the noise of one sample, and as
motions are told from where they begin, the first sample's error stays for the whole trial. Where recordings hold the
record, such errors are carried along (`misread`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rodnet.diagnosis.remainder import Remainder, test_remainder
from rodnet.diagnosis.scales import Noise
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.verdict import complete
from rodnet.diagnosis.workbench import Fitted

GRIPS = ("grasp-offset", "grasp-twist", "root-direction")  # where a rod is held, and how it is turned there
SMALL = 0.5  # [sigma] of a remainder: a larger one is no error of a record
# at most what a smoothed record wanders by along a trial, over what a grip that stays takes off: of shifts and turns
# 0.7 as a rule, 1.2 in one of a hundred sets of four trials, and what begins elsewhere may take some off, too
WANDER = 1.25
MOST = 0.25  # [sigma] that may be left beside grips
RIVAL = 0.6  # share of what the grips explain, from which on one explanation for all trials is the better one
# share of what an explanation does with a strength of its own for each trial, that it must do with one for all of them:
# errors of four trials agree as well by chance in three of a hundred sets, along one direction, and in none along three
AGREE = 0.85


def beside_grips(fitted: Fitted, scores: Sequence[Score], noise: Noise, tested: Remainder) -> Remainder:
    """The remainder of a model if every trial is held a little elsewhere, where that is all there is of it.

    An explanation that is the same in all trials is the better one if it does nearly as much with so much less, and
    the trials do not contradict each other about it.

    Parameters
    ----------
    fitted : Fitted
        The model.
    scores : sequence of Score
        Of all candidates at this model, those of `GRIPS` among them.
    noise : sequence
        Noise of the trials' instruments.
    tested : Remainder
        Of the model as it is.

    Returns
    -------
    Remainder
        What grips leave, and ``grips`` [sigma] what they take off; ``tested`` itself unless it is small and they leave
        of it no more than records wander by.
    """
    if complete(tested) or tested.excess > SMALL:
        return tested
    grips_of = [score for score in scores if score.candidate.family in GRIPS]
    blocks = by_trial(fitted, grips_of)
    least = RIVAL * explained(fitted, blocks)
    if not blocks.shape[1] or any(s.chi2 > least and _agreed(fitted, s) for s in scores):
        return tested
    again = test_remainder(fitted, noise, blocks)
    grips = float(np.sqrt(max(tested.excess**2 - again.excess**2, 0.0)))
    return (
        replace(again, grips=grips) if complete(again) or again.excess < min(WANDER * grips, MOST) else tested
    )


def explained(fitted: Fitted, columns: np.ndarray) -> float:
    """By how much the deviance would fall if residuals could move along columns, too."""
    basis = Basis.of(fitted.jacobian)
    more = Basis.of(basis.out(columns)).U
    return float(np.sum((more.T @ basis.out(fitted.residual)) ** 2))


def _agreed(fitted: Fitted, score: Score) -> bool:
    """Whether an explanation does as much with one strength for all trials as with one for each of them, nearly."""
    alone = by_trial(fitted, [score])
    return not alone.shape[1] or score.chi2 > AGREE * explained(fitted, alone)


def by_trial(fitted: Fitted, scores: Sequence[Score]) -> np.ndarray:
    """Derivatives of the residuals by strengths that each trial has by itself, shape (n, strengths times trials)."""
    found = [np.zeros((len(fitted.jacobian), 0))]
    found += [block[:, block.any(axis=0)] for score in scores for block in _blocks(fitted, score)]
    return np.hstack(found)


def _blocks(fitted: Fitted, score: Score) -> Iterator[np.ndarray]:
    """Of each trial, the derivatives of the residuals by its own strengths, shape (n, strengths)."""
    J = fitted.jacobian
    if score.follow is None or len(score.follow) != J.shape[1]:
        return
    ends = np.cumsum([0, *(len(f.residual) for f in fitted.fits)])
    raw = score.unprojected(J)
    for a, b in pairwise(ends):
        block = np.zeros_like(raw)
        block[a:b] = raw[a:b]
        yield block
