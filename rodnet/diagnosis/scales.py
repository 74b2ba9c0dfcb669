"""The two scales of a diagnosis: what the instrument adds, and what the best model so far leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rodnet.diagnosis.workbench import Fitted
from rodnet.inference.readings import by_samples
from rodnet.inference.result import SIGNIFICANT, memory_of
from rodnet.recordings.noise import NoiseModel


def variance_factor(fitted: Fitted, explained: float = 0.0) -> float:
    """Variance of the residuals over the noise's, times how many in a row count as one; at least 1.

    Parameters
    ----------
    fitted : Fitted
        The model.
    explained : float
        Part of its deviance that is to be explained by something not in it yet.
    """
    free = sum(q.prior is None for q in fitted.quantities)
    dof = max(fitted.samples - free, 1)
    excess = max(sum(float(f.residual @ f.residual) for f in fitted.fits) - explained, 0.0) / dof
    memory, lags = memory_of(fitted.fits)
    chance = 2.0 * np.sqrt(lags / fitted.samples)  # of a sum of correlations of noise
    noisy = excess <= 1.0 + SIGNIFICANT * np.sqrt(2.0 / dof)
    if noisy and (explained or memory <= 1.0 + SIGNIFICANT * chance):
        return 1.0
    return max(1.0, excess * memory)


Noise = Sequence[Mapping[str, NoiseModel]]  # of the instruments of each trial


def change_sigma(before: Fitted, after: Fitted, noise: Noise) -> float:
    """Rms change of the prediction between two models, over the standard deviation of the noise.

    Over all observed coordinates of all instruments, and not prewhitened: sigma is that of one coordinate of one
    sample, the slow part included.
    """
    total, count = 0.0, 0
    for a, b, own in zip(before.fits, after.fits, noise, strict=True):
        for measured, one, other, model in zip(
            a.measured, a.predicted, b.predicted, own.values(), strict=True
        ):
            seen = np.isfinite(by_samples(measured)).all(axis=2)
            change = by_samples(other - one)
            sigma = model.total(change.shape[1])
            change = (change / sigma[:, None])[seen]
            total, count = total + float(np.sum(change**2)), count + change.size
    return float(np.sqrt(total / max(count, 1)))
