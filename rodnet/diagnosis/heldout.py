"""Trials that the search has not seen: how well a model predicts them, and a ledger of every time they were opened."""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import CaseError, RecordingError
from rodnet.inference.evaluate import measures
from rodnet.inference.instruments import make_trials, narrowed
from rodnet.inference.packing import unpack_trial
from rodnet.inference.readings import by_samples
from rodnet.recordings.estimate import estimate_noise
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.observation import Markers
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
    files : list of dict
        Of each trial ``name``, ``kind`` and the measures of `rodnet.evaluate`: the case's ``metric``, and mean
        distances over free markers.
    """

    fitted: Fitted
    error: float
    sigma: float
    trials: np.ndarray
    files: list[dict[str, Any]]


def open_trials(held: Workbench, model: Fitted) -> Opened:
    """Predict held-out trials with a model's common values."""
    fitted = held.fit(model.candidates, model.values, common=False)
    squares = []
    for fit, own in zip(fitted.fits, comparable(held), strict=True):
        errors = [fit.samples(k, fit.measured[k] - fit.predicted[k]) for k in own]
        squares.append(np.concatenate([(error**2).sum(axis=2).ravel() for error in errors]))
    trials = np.array([np.sqrt(np.nanmean(s)) for s in squares])
    total = float(np.sqrt(np.nanmean(np.concatenate(squares))))
    white = np.concatenate([f.residual for f in fitted.fits])
    problem, files = held.problem(model.candidates, model.values, common=False), []
    for packed, fit in zip(problem.packed, fitted.fits, strict=True):
        trial = unpack_trial(packed)
        told = measures(trial.case, trial.rec, trial.instruments, fit.predicted)
        files.append({"name": trial.rec.name, "kind": held.case.kind_of(trial.rec), **told})
    return Opened(fitted, total, float(np.sqrt(np.mean(white**2))), trials, files)


def unseen_noise(
    bench: Workbench, recordings: Sequence[Recording], noise: Any
) -> tuple[list[dict[str, NoiseModel]], bool]:
    """Noise of trials that the search does not see, and whether it is that of the training trials alone.

    It is what is given. Else that of markers is estimated from all trials together, for the instrument is the same, and
    one trial alone tells the slow part of its noise to a fifth; where they have other markers, from the trials
    themselves. What is too short to tell the noise of something else has that of the same instruments in training.

    Raises
    ------
    RecordingError
        If nothing was recorded, or the noise is unknown there and other markers were seen than in training.
    """
    first = bench.recordings[0]
    alike = all(rec.names == first.names for rec in recordings)
    linked = all(np.array_equal(rec.edges, first.edges) for rec in recordings)
    training = list(bench.recordings) if alike and linked else []
    try:
        trials = make_trials(bench.case, [*training, *recordings], noise, bench.modes)
        return [dict(t.noise) for t in trials[len(training) :]], False
    except RecordingError:
        if not alike:
            raise
        known = {**bench.noise[0], **(noise if isinstance(noise, Mapping) else {})}
        return [dict(t.noise) for t in make_trials(bench.case, recordings, known, bench.modes)], True


def comparable(held: Workbench) -> list[list[int]]:
    """Numbers of the instruments of each trial that read in the unit of the first: metres are not rpm."""
    found = []
    for rec in held.recordings:
        part = held.case.part(rec)
        units = [one.unit for one in held.case.observations(part, held.case.robot(part))]
        found.append([k for k, unit in enumerate(units) if unit == units[0]])
    return found


def floor_of(opened: Opened, held: Workbench) -> float | None:
    """Rms distance that the noise alone makes, in the first instrument's unit; None where it is not known.

    Where a case says what a model is off by (``noise``), that is no noise: it is estimated from the recordings.
    """
    every = [list(n.values()) for n in held.noise] if held.case.noise is None else _recorded(held)
    if every is None:
        return None
    squares, samples = 0.0, 0
    for fit, models, own in zip(opened.fitted.fits, every, comparable(held), strict=True):
        for k in own:
            seen = by_samples(fit.measured[k])
            many = np.isfinite(seen).all(axis=2).sum(axis=0)
            # whitened are the coordinates that were recorded
            squares += float(fit.whitened[k].shape[2] * (many * models[k].total(len(many)) ** 2).sum())
            samples += int(many.sum())
    return float(np.sqrt(squares / samples))


def _recorded(held: Workbench) -> list[list[NoiseModel]] | None:
    """Noise that the recordings of each trial tell, by instrument; None where the first ones do not see markers."""
    try:
        told = estimate_noise([held.case.part(rec) for rec in held.recordings]).model
    except RecordingError:
        return None
    found = []
    for rec, own in zip(held.recordings, comparable(held), strict=True):
        part = held.case.part(rec)
        instruments = held.case.observations(part, held.case.robot(part))
        if not all(isinstance(instruments[k], Markers) for k in own):
            return None
        model = part.noise or told  # of what is no marker nothing is asked
        found.append(
            [narrowed(model, part, one) if isinstance(one, Markers) else model for one in instruments]
        )
    return found


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


def openings(ledger: Path | None, recordings: Sequence[Recording]) -> int | None:
    """How many times the ledger has it that one of some trials was opened; None without a ledger.

    Raises
    ------
    CaseError
        For a line of the ledger that does not say which recordings were opened.
    """
    if ledger is None:
        return None
    if not ledger.is_file():
        return 0
    known, count = {hash for rec in recordings for hash in (_hash(rec), _by_markers(rec))}, 0
    for number, line in enumerate(ledger.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            count += bool(line and known & set(json.loads(line)["recordings"].values()))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise CaseError(
                f"line {number} of the ledger '{ledger}' is no entry of one, so that openings cannot be counted: "
                "mend or remove that line, or name another file (ledger=)"
            ) from None
    return count


def _hash(rec: Recording) -> str:
    if rec.path is not None and rec.path.is_file():
        return hashlib.sha256(rec.path.read_bytes()).hexdigest()
    return rec.digest


def _by_markers(rec: Recording) -> str:
    """What ledgers up to November 2026 have of recordings that are in no file."""
    return hashlib.sha256(np.ascontiguousarray(rec.markers).tobytes()).hexdigest()


def common_columns(held: Workbench, model: Fitted, opened: Opened) -> np.ndarray:
    """Derivatives of the held-out residuals by the common coordinates of a model, shape (n, c)."""
    problem = held.problem(model.candidates, {**model.values}, opened.fitted.own)
    both = held.evaluate(problem, np.zeros(len(problem.quantities)), model.candidates)
    return both.by_coordinates_of(model)[: both.samples]
