"""Trials that the search has not seen: how well a model predicts them, and a ledger of every time they were opened."""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.inference.readings import by_samples
from rodnet.recordings.recording import Recording


@dataclass(frozen=True)
class Opened:
    """A model on held-out trials; what each has of its own (its initial state) is fitted to it.

    Attributes
    ----------
    fitted : Fitted
        The model there, nothing common refitted.
    error : float
        Rms distance between measured and predicted samples, of the first instrument and what reads in its unit.
    sigma : float
        Rms of the whitened residuals.
    trials : ndarray, shape (trials,)
        Rms distance by trial.
    """

    fitted: Fitted
    error: float
    sigma: float
    trials: np.ndarray


def open_trials(held: Workbench, model: Fitted) -> Opened:
    """Predict held-out trials with a model's common values."""
    fitted = held.fit(model.candidates, model.values, common=False)
    squares = []
    for fit, own in zip(fitted.fits, comparable(held), strict=True):
        errors = [by_samples(fit.measured[k] - fit.predicted[k]) for k in own]
        squares.append(np.concatenate([(error**2).sum(axis=2).ravel() for error in errors]))
    trials = np.array([np.sqrt(np.nanmean(s)) for s in squares])
    total = float(np.sqrt(np.nanmean(np.concatenate(squares))))
    white = np.concatenate([f.residual for f in fitted.fits])
    return Opened(fitted, total, float(np.sqrt(np.mean(white**2))), trials)


def comparable(held: Workbench) -> list[list[int]]:
    """Numbers of the instruments of each trial that read in the unit of the first: metres are not rpm."""
    found = []
    for rec in held.recordings:
        part = held.case.part(rec)
        units = [one.unit for one in held.case.observations(part, held.case.robot(part))]
        found.append([k for k, unit in enumerate(units) if unit == units[0]])
    return found


def floor_of(opened: Opened, held: Workbench) -> float:
    """Rms distance that the noise alone makes, in the first instrument's unit."""
    squares, samples = 0.0, 0
    for fit, noise, own in zip(opened.fitted.fits, held.noise, comparable(held), strict=True):
        models = list(noise.values())
        for k in own:
            seen = by_samples(fit.measured[k])
            count = np.isfinite(seen).all(axis=2).sum(axis=0)
            squares += float(seen.shape[2] * (count * models[k].total(len(count)) ** 2).sum())
            samples += int(count.sum())
    return float(np.sqrt(squares / samples))


def note(ledger: Path | None, recordings: Sequence[Recording], what: str) -> None:
    """Append to the ledger that trials were opened: when, which (by hash), and for what."""
    if ledger is None:
        return
    entry = {
        "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "for": what,
        "recordings": {rec.name: _hash(rec) for rec in recordings},
    }
    ledger.parent.mkdir(parents=True, exist_ok=True)
    with ledger.open("a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")


def _hash(rec: Recording) -> str:
    if rec.path is not None and rec.path.is_file():
        return hashlib.sha256(rec.path.read_bytes()).hexdigest()
    return hashlib.sha256(np.ascontiguousarray(rec.markers).tobytes()).hexdigest()


def common_columns(held: Workbench, model: Fitted, opened: Opened) -> np.ndarray:
    """Derivatives of the held-out residuals by the common values of a model, shape (n, k)."""
    problem = held.problem(model.candidates, {**model.values}, opened.fitted.own)
    both = held.evaluate(problem, np.zeros(len(problem.quantities)), model.candidates)
    common = [k for k, q in enumerate(both.quantities) if q.trial is None]
    return np.concatenate([both.jacobian_of(k) for k in range(len(both.fits))])[:, common]
