"""What errors of where each trial is held leave: records of drives have noise, and where they begin is one sample.

A rod is driven by what an encoder or a camera has recorded. Smoothing keeps about the noise of one sample, and as
motions are told from where they begin, the first sample's error stays for the whole trial.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rodnet.diagnosis.records import RecordNoise
from rodnet.diagnosis.remainder import Remainder, test_remainder
from rodnet.diagnosis.scales import Noise
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.verdict import complete
from rodnet.diagnosis.workbench import Fitted

GRIPS = ("grasp-offset", "grasp-twist", "root-direction")  # where a rod is held, and how it is turned there
SMALL = 0.5  # [sigma] of a remainder: a larger one is no error of a record
# times what a record's own noise makes, where that is known: a spline follows some of it, is off by more than the noise
# where it begins, and a dozen shifts are 1.5 times as large as a rule once in a thousand sets
LARGER = 3.0
# at most what a smoothed record wanders by along a trial, over what a grip that stays takes off: of shifts and turns
# 0.7 as a rule, 1.2 in one of a hundred sets of four trials, and what begins elsewhere may take some off, too
WANDER = 1.25
MOST = 0.25  # [sigma] that may be left beside grips
RIVAL = 0.6  # share of what the grips explain, from which on one explanation for all trials is the better one
# share of what an explanation does with a strength of its own for each trial, that it must do with one for all of them:
# errors of four trials agree as well by chance in three of a hundred sets, along one direction, and in none along three
AGREE = 0.85
UNKNOWN = RecordNoise()


def beside_grips(
    fitted: Fitted, scores: Sequence[Score], noise: Noise, tested: Remainder, records: RecordNoise = UNKNOWN
) -> Remainder:
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
    records : RecordNoise
        Of the drives, as far as it is known.

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
    if grips > LARGER * expected(fitted, grips_of, records):
        return tested
    return (
        replace(again, grips=grips) if complete(again) or again.excess < min(WANDER * grips, MOST) else tested
    )


def expected(fitted: Fitted, scores: Sequence[Score], records: RecordNoise) -> float:
    """Rms [sigma] of what the noise of one sample of its record makes in each trial; infinite where it is unknown."""
    basis, total = Basis.of(fitted.jacobian), 0.0
    for score in scores:
        size = records.shift if score.candidate.family == "grasp-offset" else records.turn
        if size is None:
            return float("inf")
        sizes = np.array([size / score.scales[p] for p in score.candidate.strength])
        total += sum(float(np.sum(basis.out(block * sizes) ** 2)) for block in _blocks(fitted, score))
    return float(np.sqrt(total / fitted.samples))


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
