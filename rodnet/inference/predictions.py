"""Predicting other recordings with calibrated parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import ConvergenceError, RodnetError
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.packing import pack_case, pack_trial
from rodnet.inference.problem import Problem, none_rejected
from rodnet.inference.quantities import TWISTED, with_ties
from rodnet.inference.readings import by_samples
from rodnet.inference.shots import why
from rodnet.recordings.recording import Recording

if TYPE_CHECKING:
    from rodnet.inference.result import CalibrationResult

EVALUATIONS = 50


@dataclass(frozen=True)
class Prediction:
    """A recording predicted with calibrated parameters.

    Attributes
    ----------
    instruments : list of (str, str)
        Name and unit of each.
    t : ndarray, shape (F,)
        Times of the frames, from the first [s].
    measured, predicted : list of ndarray, shapes (F, ...)
        Of each instrument.
    rms : dict
        Root mean square of their difference by instrument, in its unit.
    failure : str
        Why it could not be computed; empty if it was.
    own : dict
        Values that were fitted to this recording alone, by path.
    """

    instruments: list[tuple[str, str]]
    t: np.ndarray
    measured: list[np.ndarray]
    predicted: list[np.ndarray]
    rms: dict[str, float]
    failure: str = ""
    own: dict[str, float] | None = None


def predict(found: CalibrationResult, recordings: Sequence[Recording], own: bool) -> dict[str, Prediction]:
    """Predict recordings by name; see `CalibrationResult.predictions`."""
    from rodnet.inference.calibration import names_of

    each = own and bool(found.case.per_trial)
    return {name: _one(found, rec, each) for name, rec in zip(names_of(recordings), recordings, strict=True)}


def _one(found: CalibrationResult, rec: Recording, own: bool) -> Prediction:
    values = {**found.held, **found.values}
    try:
        trial = found.comparison(rec)
    except RodnetError as error:  # of one recording: the others are predicted
        return Prediction([], rec.t - rec.t[0], [], [], {}, why(error))
    fitted: dict[str, float] = {}
    eyes = [(one.name, one.unit) for one in trial.instruments]
    if own and (lacking := [one.name for one in trial.instruments if one.name not in trial.noise]):
        told = f"the noise of {', '.join(lacking)} is not known, with which its own values are to be fitted"
        return Prediction(eyes, trial.rec.t, trial.measured, [], {}, told)
    try:
        if own:
            fitted = _fitted(found, trial)
        if fitted:  # a tie may be to what each trial has of its own
            values = with_ties(found.case.tied, {**values, **fitted})
        seen, _ = trial.predict(values)
    except RodnetError as error:
        return Prediction(eyes, trial.rec.t, trial.measured, [], {}, why(error))
    axes = trial.recorded
    fit = Fit(trial.measured, seen, np.zeros(0), None, [], recorded=axes)
    none = [np.zeros(by_samples(m).shape[:2], dtype=bool) for m in trial.measured]
    return Prediction(eyes, trial.rec.t, trial.measured, seen, rms([trial], [fit], [none]), "", fitted)


def _fitted(found: CalibrationResult, trial: Comparison) -> dict[str, float]:
    """Values of what has one in each trial, all common ones being as found."""
    from rodnet.inference.calibration import make_quantities
    from rodnet.inference.search import minimise
    from rodnet.sweeps.collect import Serial

    case = replace(found.case, free=())
    own = {*case.per_trial, TWISTED}  # which comes by itself with an initial shape
    known, start = (
        {p: value for p, value in given.items() if own & {p, p.partition("[")[0]}}
        for given in (found.priors, found.start)
    )
    quantities = make_quantities(case, [trial], known, start, trial.mode_count)
    packed = pack_trial(pack_case(case), trial.rec, trial.noise, trial.mode_count)
    problem = Problem(
        quantities, [packed], [trial.rec.name], dict(case.tied), Serial(), none_rejected([trial]),
        {**found.held, **{p: v for p, v in found.values.items() if p not in case.tied}},
    )  # fmt: skip
    best = minimise(problem, np.zeros(len(quantities)), "linear", EVALUATIONS, lambda text: None)
    if best is None:
        raise ConvergenceError(problem.failures[-1])
    return {q.path: q.value(z) for q, z in zip(quantities, best.z, strict=True)}


def rms(
    trials: Sequence[Comparison], fits: Sequence[Fit], rejected: Sequence[Sequence[np.ndarray]]
) -> dict[str, float]:
    """Root mean square distance by instrument, of what was not left out, in its own unit."""
    squares: dict[str, list[np.ndarray]] = {}
    for trial, fit, masks in zip(trials, fits, rejected, strict=True):
        for k, one in enumerate(trial.instruments):
            error = fit.samples(k, fit.measured[k] - fit.predicted[k])[~masks[k]]
            squares.setdefault(one.name, []).append((error**2).sum(axis=-1))
    return {name: float(np.sqrt(np.nanmean(np.concatenate(s)))) for name, s in squares.items()}
