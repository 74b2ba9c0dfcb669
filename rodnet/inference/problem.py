"""The joint least-squares problem of all trials: residuals, priors, and what one vector of coordinates means."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from rodnet.inference.comparison import Comparison, Fit, by_samples
from rodnet.inference.packing import evaluate_trial
from rodnet.inference.quantities import Quantity, with_ties
from rodnet.interrupts import Interrupt

CHANGE = 1e-6  # of differences of functions that tie parameters, of the coordinate
LAGS = 5  # frames before and after, that an outlier lies beside
NEARBY = 25  # frames to either side, among which a residual is usual or not
MEDIAN = 0.6745  # of the size of a normal variable of unit variance
LIMIT = 1e150  # residual of what cannot be computed


@dataclass
class Problem:
    """Everything that a fit minimises.

    Attributes
    ----------
    quantities : list of Quantity
        The unknowns, in the order of the vector of coordinates.
    packed : list of bytes
        The trials, for any process.
    names : list of str
        Of the trials.
    tied : mapping
        Functions of the values of the unknowns.
    executor : Executor
        Where trials are evaluated.
    rejected : list of list of ndarray
        Samples left out, of each instrument of each trial.
    fixed : dict
        Values of what is not free, where they differ from the robot as it was built.
    interrupt : Interrupt, optional
        Tells whether somebody wants the search to end.
    continuous : bool
        Whether jumps between segments count.
    """

    quantities: list[Quantity]
    packed: list[bytes]
    names: list[str]
    tied: Mapping[str, Callable[[Mapping[str, float]], float]]
    executor: Executor
    rejected: list[list[np.ndarray]]
    fixed: dict[str, float]
    interrupt: Interrupt | None = None
    continuous: bool = True

    def __post_init__(self) -> None:
        self._last: tuple[bytes, list[Fit]] | None = None
        self._held: tuple[bytes, list[Fit]] | None = None
        self.failures: list[str] = []
        self.evaluations = 0

    # -- values ---------------------------------------------------------------------------------
    def values(self, z: np.ndarray, trial: int) -> dict[str, float]:
        """Values of everything that a trial depends on, by path."""
        found = dict(self.fixed)
        found.update(
            {q.path: q.value(c) for q, c in zip(self.quantities, z, strict=True) if q.trial in (None, trial)}
        )
        return with_ties(self.tied, found)

    def chain(self, z: np.ndarray, trial: int) -> tuple[dict[str, float], np.ndarray]:
        """Scales of the paths that a trial is differentiated by, and their derivatives by all coordinates."""
        mine = [(k, q) for k, q in enumerate(self.quantities) if q.trial in (None, trial)]
        scales = {q.path: q.scale for _, q in mine}
        values = self.values(z, trial)
        scales.update({path: abs(values[path]) or 1.0 for path in self.tied})
        matrix = np.zeros((len(scales), len(self.quantities)))
        for row, (k, q) in enumerate(mine):
            matrix[row, k] = q.slope(z[k])
        for row, path in enumerate(self.tied, start=len(mine)):
            for k, _ in mine:
                ends = []
                for s in (1.0, -1.0):
                    moved = z.copy()
                    moved[k] += s * CHANGE
                    ends.append(self.values(moved, trial)[path])
                matrix[row, k] = (ends[0] - ends[1]) / (2.0 * CHANGE)
        return scales, matrix

    # -- evaluation -------------------------------------------------------------------------------
    def fits(self, z: np.ndarray, slopes: bool = True) -> list[Fit] | None:
        """Evaluate all trials; None if one of them cannot be computed (``failures`` says why)."""
        jobs = []
        matrices = []
        for k, packed in enumerate(self.packed):
            scales, matrix = self.chain(z, k) if slopes else (None, None)
            matrices.append(matrix)
            jobs.append(
                self.executor.submit(evaluate_trial, packed, self.values(z, k), scales, self.rejected[k])
            )
        self.evaluations += 1
        found: list[Fit] = []
        for job in jobs:
            one = job.result()
            if isinstance(one, str):
                self.failures.append(one)
            else:
                found.append(one)
        if len(found) < len(jobs):
            return None
        return [
            f
            if m is None or f.jacobian is None
            else replace(f, jacobian=f.jacobian @ m, jump_slopes=f.jump_slopes @ m)
            for f, m in zip(found, matrices, strict=True)
        ]

    def priors(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of the priors, and their derivatives."""
        with_prior = [k for k, q in enumerate(self.quantities) if q.prior is not None]
        r, J = np.zeros(len(with_prior)), np.zeros((len(with_prior), len(z)))
        for row, k in enumerate(with_prior):
            r[row], J[row, k] = self.quantities[k].prior_residual(z[k])
        return r, J

    def joint(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residual and Jacobian of everything, priors and before them jumps last; None if a trial fails."""
        fits = self.at(z)
        if fits is None:
            return None
        r, J = self.priors(z)
        jacobians = [f.jacobian for f in fits if f.jacobian is not None]
        bonds = [f for f in fits if self.continuous]
        return (
            np.concatenate([*(f.residual for f in fits), *(f.jumps for f in bonds), r]),
            np.concatenate([*jacobians, *(f.jump_slopes for f in bonds), J]),
        )

    def at(self, z: np.ndarray) -> list[Fit] | None:
        """Like `fits`, remembered: the optimiser asks for residual and Jacobian one after the other."""
        key = np.asarray(z, dtype=float).tobytes()
        if self._held is not None and self._held[0] == key:
            return self._held[1]
        if self._last is None or self._last[0] != key:
            fits = self.fits(np.asarray(z, dtype=float))
            if fits is None:
                return None
            self._last = key, fits
        return self._last[1]

    def know(self, z: np.ndarray, fits: list[Fit]) -> None:
        """Take what is known without a run for an evaluation."""
        self.evaluations += 1
        self._last = np.asarray(z, dtype=float).tobytes(), fits

    def forget(self) -> None:
        """Forget what was computed, after a change of what is left out."""
        self._last = self._held = None

    def hold(self) -> None:
        """Keep what was computed last at hand: it is the best so far."""
        self._held = self._last

    @property
    def interrupted(self) -> bool:
        """Whether somebody wants the search to end."""
        return self.interrupt is not None and self.interrupt.check()


def reject(trial: Comparison, fit: Fit, threshold: float) -> list[np.ndarray]:
    """Samples that are outliers: they lie beside those before and after, and their prewhitened residual is large.

    Both by more than ``threshold`` times what is usual of the same marker at about the same time: a model that
    misfits for a while is no reason to leave out what was measured. One outlier upsets the prediction of the next
    frames of its marker, so only the first of a row is taken away, and the residual prewhitened again, until
    nothing stands out.

    Returns
    -------
    list of ndarray, shapes (F, M)
    """
    found = []
    for number, one in enumerate(trial.instruments):
        error = fit.samples(number, fit.measured[number] - fit.predicted[number])
        out = np.zeros(error.shape[:2], dtype=bool)
        noise = trial.noise[one.name]
        aside = _aside(error)
        alone = np.nan_to_num(aside, nan=0.0).max(axis=2) > threshold * _usual(aside, noise.white)
        usual = None
        for _ in range(len(error)):
            white, _ = noise.whiten(trial.rec.t, np.where(out[..., None], np.nan, error))
            if usual is None:
                usual = _usual(np.where(np.isfinite(error), np.abs(white), np.nan), 1.0)
            large = alone & (np.abs(white).max(axis=2) > threshold * usual)
            first = large & ~np.vstack([np.zeros((1, large.shape[1]), dtype=bool), large[:-1]])
            if not first.any():
                break
            out |= first
        found.append(out)
    return found


def _aside(error: np.ndarray) -> np.ndarray:
    """By how much samples (F, M, d) lie beside the line through those before and after; NaN where nobody knows.

    Where there are none on one side, by how much beside the line through two on the other, times half: of noise that
    makes as much.
    """
    found, ends = np.full(error.shape, np.nan), np.full(error.shape, np.nan)
    for lag in range(1, min(LAGS, (len(error) - 1) // 2) + 1):
        middle = 0.5 * (error[: -2 * lag] + error[2 * lag :])
        inner = found[lag:-lag]
        np.fmin(inner, np.abs(error[lag:-lag] - middle), out=inner)
        first, last = ends[: -2 * lag], ends[2 * lag :]
        bend = 0.5 * np.abs(error[: -2 * lag] - 2.0 * error[lag:-lag] + error[2 * lag :])
        np.fmin(first, bend, out=first)
        np.fmin(last, bend, out=last)
    return np.where(np.isnan(found), ends, found)


def _usual(size: np.ndarray, least: float) -> np.ndarray:
    """Standard deviation, (F, M), that sizes (F, M, d) have around each sample, by their median."""
    half = min(NEARBY, (len(size) - 1) // 2)
    around = np.pad(size, ((half, half), (0, 0), (0, 0)), mode="reflect") if half else size
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, axis=0)
    flat = windows.reshape(*size.shape[:2], -1)
    flat = np.where(np.isnan(flat).all(axis=2, keepdims=True), 0.0, flat)  # nothing was seen nearby
    return np.asarray(np.maximum(least, np.nanmedian(flat, axis=2) / MEDIAN))


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def none_rejected(trials: Sequence[Comparison]) -> list[list[np.ndarray]]:
    """Masks that leave nothing out."""
    return [[np.zeros(by_samples(m).shape[:2], dtype=bool) for m in trial.measured] for trial in trials]
