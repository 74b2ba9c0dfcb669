"""The two scales of a diagnosis: what the instrument adds, and what the best model so far leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rodnet.diagnosis.workbench import Fitted
from rodnet.inference.memory import memory_of
from rodnet.inference.readings import by_samples
from rodnet.inference.result import SIGNIFICANT
from rodnet.recordings.noise import NoiseModel

ALPHA = 1e-3  # of all tests of one kind together
# [sigma] smallest effect that is named: a gripper's record that begins off by its noise makes 0.15
LEAST = 0.2
TIMES = 3.0  # an effect must be so many times the numerical error
CLASS = 9.2  # of deviance: candidates as near as that explain the data as well
TRIFLE = 0.02  # of what an explanation gains, that further parameters must: a model is off by as much


def variance_factor(fitted: Fitted, left: np.ndarray | None = None) -> float:
    """Variance of the residuals over the noise's, times how many count as one, in time and over the body; at least 1.

    Parameters
    ----------
    fitted : Fitted
        The model.
    left : ndarray, shape (n,), optional
        Its residuals once something that is not in it yet is explained; by default they are as they are.
    """
    whitened = [w for f in fitted.fits for w in f.whitened] if left is None else _framed(fitted, left)
    power = sum(float(np.sum(w**2)) for w in whitened)
    free = sum(q.prior is None for q in fitted.quantities)
    dof = max(fitted.samples - free, 1)
    excess = power / dof
    memory, lags = memory_of(whitened)
    chance = 2.0 * np.sqrt(lags / fitted.samples)  # of a sum of correlations of noise
    if excess <= 1.0 + SIGNIFICANT * np.sqrt(2.0 / dof) and memory <= 1.0 + SIGNIFICANT * chance:
        return 1.0
    along, _ = memory_of([w.swapaxes(0, 1) for w in whitened])
    return max(1.0, excess * memory * along)


def _framed(fitted: Fitted, left: np.ndarray) -> list[np.ndarray]:
    """Residuals frame by frame, as those of the model are; zero where nothing was measured."""
    found, begin = [], 0
    for fit in fitted.fits:
        for white, seen in zip(fit.whitened, fit.seen, strict=True):
            size = int(seen.sum()) * white.shape[2]
            framed = np.zeros_like(white)
            framed[seen] = left[begin : begin + size].reshape(-1, white.shape[2])
            found.append(framed)
            begin += size
    return found


Noise = Sequence[Mapping[str, NoiseModel]]  # of the instruments of each trial


def change_sigma(before: Fitted, after: Fitted, noise: Noise) -> float:
    """Rms change of the prediction between two models, over the standard deviation of the noise.

    Over all observed coordinates of all instruments, and not prewhitened: sigma is that of one coordinate of one
    sample, the slow part included.
    """
    total, count = changes(before, after, noise)
    return float(np.sqrt(total.sum() / max(count.sum(), 1)))


def largest_change(before: Fitted, after: Fitted, noise: Noise) -> float:
    """The same of the trial in which it is largest: one that tells two models apart does so whatever the others do."""
    total, count = changes(before, after, noise)
    return float(np.sqrt(np.max(total / np.maximum(count, 1))))


def changes(before: Fitted, after: Fitted, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the squared changes of the prediction in each trial, over the noise's variance, and their number.

    Errors of drives' records are no part of it: those of all trials together may have stood in for the effect.
    """
    total, count = np.zeros((2, len(before.fits)))
    for k, (a, b, own) in enumerate(zip(before.fits, after.fits, noise, strict=True)):
        for number, (measured, one, other, model) in enumerate(
            zip(a.measured, a.as_recorded, b.as_recorded, own.values(), strict=True)
        ):
            seen = np.isfinite(by_samples(measured)).all(axis=2)
            change = a.samples(number, other - one)
            sigma = model.total(change.shape[1])
            change = (change / sigma[:, None])[seen]
            total[k] += float(np.sum(change**2))
            count[k] += change.size
    return total, count
