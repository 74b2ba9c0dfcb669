"""What a calibration found: parameters with intervals, what the data determine, residuals, and the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from rodnet.errors import ParameterError, RodnetError
from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.fitted import Fitted, FittedValue
from rodnet.inference.identifiability import Identifiability, identify, invert
from rodnet.inference.instruments import make_trials, marker_noise, noise_like
from rodnet.inference.losses import slope_of, variance_of
from rodnet.inference.memory import memory_of
from rodnet.inference.predictions import Prediction, predict, rms
from rodnet.inference.problem import Problem
from rodnet.inference.quantities import robot_values
from rodnet.inference.simpler import stored
from rodnet.names import meant
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

LEVEL = 0.95
SIGNIFICANT = 4.0  # standard deviations of what the noise alone would do, beyond which a model misfits
AT_BOUND = 1e-4  # of a coordinate


@dataclass(frozen=True)
class Optimum:
    """Where a search has ended: coordinates, half the sum of squares, whether it converged, and how."""

    z: np.ndarray
    cost: float
    success: bool
    message: str
    interrupted: bool = False


@dataclass(frozen=True)
class Estimate:
    """A value with its unit and its 95 % interval; ``sd`` is of its logarithm where ``log``, else of itself."""

    value: float
    unit: str
    low: float
    high: float
    sd: float
    log: bool

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}] {self.unit}"


@dataclass(frozen=True)
class Profile:
    """A profile likelihood: all else refitted along one parameter.

    Attributes
    ----------
    path : str
        The parameter.
    values : ndarray
        Its values, in order.
    rise : ndarray
        By how much the deviance is above its minimum.
    low, high : float
        Where it is above by 3.84: the 95 % interval. Infinite, or the bound, where it never is.
    """

    path: str
    values: np.ndarray
    rise: np.ndarray
    low: float
    high: float


class CalibrationResult:
    """Parameters of a robot and how well recordings determine them.

    Attributes
    ----------
    parameters : dict
        `Estimate` by path, of what is common to all trials; tied ones included.
    per_trial : dict
        Of each trial by name, `Estimate` by path.
    names : list of str
        Of the rows of ``covariance``: paths, with ``" @ trial"`` for those of one trial.
    covariance : ndarray, shape (k, k)
        In the parameters' units.
    residuals : dict
        Prewhitened residuals of each trial, a list of arrays (F, M, d) in the order of its instruments.
    measured, predicted : dict
        What was compared, by trial, likewise (F, ...).
    rms : dict
        Root mean square of what is left by instrument, in its own unit.
    chi2, samples : float, int
        Sum of the squared prewhitened residuals, and their number.
    variance_factor : float
        By which variances are larger than noise alone makes them.
    outliers : int
        Samples left out.
    identifiability : Identifiability
        Which parameters are determined, and which only in combination.
    success, message : bool, str
        Whether the search converged, and how it ended.
    loss : str
        What was minimised.
    interrupted : bool
        Whether Ctrl-C ended it.
    """

    parameters: dict[str, Estimate]
    per_trial: dict[str, dict[str, Estimate]]
    names: list[str]
    covariance: np.ndarray
    residuals: dict[str, list[np.ndarray]]
    measured: dict[str, list[np.ndarray]]
    predicted: dict[str, list[np.ndarray]]
    rms: dict[str, float]
    chi2: float
    samples: int
    variance_factor: float
    outliers: int
    identifiability: Identifiability
    _sd: np.ndarray
    _curved: float

    loss: str
    priors: Mapping[str, Any]
    start: Mapping[str, float]
    noise: Any

    def __init__(self, case: Case, problem: Problem, trials: Sequence[Comparison], optimum: Optimum) -> None:
        self.case, self._problem, self._trials, self._best = case, problem, trials, optimum
        self.priors, self.start, self.noise = {}, {}, None
        self.success, self.message, self.interrupted = optimum.success, optimum.message, optimum.interrupted

    @classmethod
    def of(
        cls, case: Case, trials: Sequence[Comparison], problem: Problem, best: Optimum,
        joint: tuple[np.ndarray, np.ndarray], fits: list[Fit], misfit: bool | str, loss: str,
    ) -> CalibrationResult:  # fmt: skip
        """Evaluate the uncertainty at an optimum."""
        self = cls(case, problem, trials, best)
        self.loss, self._curved = loss, 1.0
        J = joint[1]
        data = np.concatenate([f.residual for f in fits])
        self.samples, self.chi2 = len(data), float(data @ data)
        self.residuals = {n: f.whitened for n, f in zip(problem.names, fits, strict=True)}
        self.measured = {n: f.measured for n, f in zip(problem.names, fits, strict=True)}
        self.predicted = {n: f.predicted for n, f in zip(problem.names, fits, strict=True)}
        self.rms = rms(trials, fits, problem.rejected)
        self.outliers = sum(int(m.sum()) for trial in problem.rejected for m in trial)
        quantities, notes = problem.quantities, []
        dof = max(self.samples - sum(q.prior is None for q in quantities), 1)
        self.variance_factor, independent = 1.0, float(self.samples)
        if loss != "linear":
            self.variance_factor, self._curved = variance_of(data, loss), slope_of(data, loss)
            notes.append(f"robust loss: variances times {self.variance_factor:.3g}")
        elif misfit:
            whitened = [w for f in fits for w in f.whitened]
            (memory, lags), excess = memory_of(whitened), self.chi2 / dof
            chance = 2.0 * np.sqrt(lags / self.samples)  # of a sum of correlations of noise
            significant = (
                excess > 1.0 + SIGNIFICANT * np.sqrt(2.0 / dof) or memory > 1.0 + SIGNIFICANT * chance
            )
            if misfit is True or significant:
                self.variance_factor, independent = max(excess * memory, 1.0), self.samples / max(memory, 1.0)
                notes.append(
                    f"the model misfits: residuals are {np.sqrt(excess):.3g} times the noise, one in {memory:.3g} "
                    f"is independent; intervals are widened by {np.sqrt(self.variance_factor):.3g}"
                )
        quantile = float(norm.ppf(0.5 + 0.5 * LEVEL))
        if self.variance_factor > 1.0:
            quantile = float(student.ppf(0.5 + 0.5 * LEVEL, max(independent - (self.samples - dof), 1.0)))
        information = J.T @ J
        coordinates = self.variance_factor * invert(information)
        self._sd = np.sqrt(np.diag(coordinates))
        # the effect of what is near zero is linear in it, not in its logarithm
        most = {
            q.path: float(min(q.value(z) * (1.0 + quantile * sd), q.high))
            for q, z, sd in zip(quantities, best.z, self._sd, strict=True)
            if q.trial is None and q.vanished(z)
        }
        # and that of what is near infinity in its inverse
        least = {
            q.path: float(max(q.value(z) / (1.0 + quantile * sd), q.low))
            for q, z, sd in zip(quantities, best.z, self._sd, strict=True)
            if q.trial is None and q.grown(z)
        }
        self.identifiability = identify(quantities, information, self.variance_factor, most, least)
        slopes = np.array([q.slope(z) for q, z in zip(quantities, best.z, strict=True)])
        self.covariance = coordinates * np.outer(slopes, slopes)
        self.names = [
            q.path if q.trial is None else f"{q.path} @ {problem.names[q.trial]}" for q in quantities
        ]
        self._intervals(quantile, notes, most, least)
        if notes:
            self.message += "; " + "; ".join(notes)
        return self

    def _intervals(
        self, quantile: float, notes: list[str], most: Mapping[str, float], least: Mapping[str, float]
    ) -> None:
        self.parameters = {}
        self.per_trial = {name: {} for name in self._problem.names}
        for q, z, sd in zip(self._problem.quantities, self._best.z, self._sd, strict=True):
            low, high = q.value(z - quantile * sd), q.value(z + quantile * sd)
            if q.trial is None and q.path in most:
                low, high = 0.0, most[q.path]
            if q.trial is None and q.path in least:
                low = least[q.path]
            if not q.log and q.trial is None and (z - q.bounds[0] < AT_BOUND or q.bounds[1] - z < AT_BOUND):
                notes.append(f"'{q.path}' lies at a bound")
            if q.log and q.trial is None and q.high == np.inf and q.bounds[1] - z < AT_BOUND:
                notes.append(
                    f"'{q.path}' grew as far as it is searched: whatever is larger fits as well, or begin elsewhere "
                    "(start=)"
                )
            one = Estimate(q.value(z), q.unit, low, high, float(sd if q.log else sd * q.scale), q.log)
            (self.parameters if q.trial is None else self.per_trial[self._problem.names[q.trial]])[q.path] = (
                one
            )
        self._add_tied(quantile)

    def _add_tied(self, quantile: float) -> None:
        for row, path in enumerate(self.case.tied):
            z = self._best.z
            value = self._problem.values(z, 0)[path]
            scales, matrix = self._problem.chain(z, 0)
            slope = matrix[len(scales) - len(self.case.tied) + row]
            inner = slope / [q.slope(c) for q, c in zip(self._problem.quantities, z, strict=True)]
            sd = float(np.sqrt(inner @ self.covariance @ inner))
            unit = self._unit(path)
            self.parameters[path] = Estimate(
                value, unit, value - quantile * sd, value + quantile * sd, sd, False
            )

    def _unit(self, path: str) -> str:
        known = self._trials[0].robot.parameters
        return known[path].unit if path in known else "1"

    # -- use --------------------------------------------------------------------------------------
    @property
    def values(self) -> dict[str, float]:
        """Values of what is common to all trials, by path."""
        return {path: one.value for path, one in self.parameters.items()}

    @property
    def held(self) -> dict[str, float]:
        """Values that were given (``start``) of what is not free, by path: the model has them, too."""
        return dict(self._problem.fixed)

    def robot(self, rec: Recording | None = None) -> Robot:
        """Return the calibrated robot of a recording, by default of the first trial."""
        robot = self._trials[0].robot if rec is None else self.case.robot(self.case.part(rec))
        every = {**self.held, **self.values}
        if rec is None:
            every |= {p: one.value for p, one in self.per_trial[self._problem.names[0]].items()}
        own = {p: v for p, v in every.items() if self._trials[0].kind(p) == "robot"}
        return robot.with_parameters(robot_values(robot, own))

    @property
    def instruments(self) -> dict[str, list[tuple[str, str]]]:
        """Name and unit of each instrument of each trial."""
        told = [[(one.name, one.unit) for one in t.instruments] for t in self._trials]
        return dict(zip(self._problem.names, told, strict=True))

    @property
    def units(self) -> dict[str, str]:
        """Units of the instruments by name."""
        return {one.name: one.unit for t in self._trials for one in t.instruments}

    @property
    def times(self) -> dict[str, np.ndarray]:
        """Times of the frames of each trial, from its first [s]."""
        return {name: t.rec.t for name, t in zip(self._problem.names, self._trials, strict=True)}

    def comparison(self, rec: Recording) -> Comparison:
        """Return another recording as a trial.

        The noise of its instruments is as in the calibration: what was given, else its own; else that of the first
        trial with such an instrument (of markers, with these); else it is estimated. What cannot be told is left out.
        """
        modes = self._trials[0].mode_count
        trial = Comparison(self.case, rec, {}, modes)
        known = noise_like(self._trials, trial) | marker_noise(trial)
        given = self.noise
        if given is None or isinstance(given, Mapping):
            here = {one.name for one in trial.instruments}
            given = {n: m for n, m in {**known, **(given or {})}.items() if n in here}
        trial.noise = known
        with suppress(RodnetError):  # which matters only if something is fitted to it
            trial.noise = make_trials(self.case, [rec], given, modes)[0].noise
        return trial

    def predictions(self, recordings: Sequence[Recording], *, own: bool = False) -> dict[str, Prediction]:
        """Predict other recordings with the common parameters, by name.

        Parameters
        ----------
        recordings : sequence of Recording
            What is predicted, open loop.
        own : bool
            Whether to fit, in each, what has a value in each trial (initial states); else nothing is fitted.
        """
        return predict(self, recordings, own)

    def profile(self, path: str, *, workers: int | None = None, evaluations: int = 30) -> Profile:
        """Profile likelihood of a parameter: fix it, refit all else, at values to either side.

        Raises
        ------
        ParameterError
            If it was not free.
        """
        from rodnet.inference.profile import profile

        paths = [q.path for q in self._problem.quantities if q.trial is None]
        if path not in paths:
            raise ParameterError(
                f"profile: {path!r} was not free; {meant(path, paths)}free were {', '.join(paths)}"
            )
        k = paths.index(path)
        return profile(
            self._problem, self._best, k, float(self._sd[k]), self.variance_factor * self._curved, evaluations, workers,
            self.loss,
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the arrays, as JSON takes it."""
        from rodnet.numbers import plain

        table = lambda items: {  # noqa: E731
            p: {"value": f.value, "unit": f.unit, "low": f.low, "high": f.high} for p, f in items.items()
        }
        found = {
            "case": self.case.name,
            "parameters": table(self.parameters),
            "per_trial": {name: table(items) for name, items in self.per_trial.items() if items},
            "success": self.success,
            "message": self.message,
            "interrupted": self.interrupted,
            "chi2": self.chi2,
            "samples": self.samples,
            "variance_factor": self.variance_factor,
            "outliers": self.outliers,
            "rms": self.rms,
            "identifiability": self.identifiability.sentences,
            "covariance": {"names": self.names, "values": self.covariance},
            "noise": {
                n: {k: m.to_dict() for k, m in t.noise.items()}
                for n, t in zip(self._problem.names, self._trials, strict=True)
            },
        }
        return dict(plain(found))

    def fitted(self) -> Fitted:
        """Return the values as `Fitted`, what ``fitted.json`` holds and predictions read."""
        finite = lambda v: v if np.isfinite(v) else None  # noqa: E731
        values = {
            p: FittedValue(e.value, e.unit, finite(e.low), finite(e.high)) for p, e in self.parameters.items()
        }
        values |= {p: FittedValue(v, self._unit(p)) for p, v in self.held.items()}
        files = [str(t.rec.path or t.rec.name) for t in self._trials]
        digests = {n: t.digest for n, t in zip(self._problem.names, self._trials, strict=True)}
        notes: dict[str, Any] = {"digests": digests, "calibration": self.to_dict()}
        try:
            simpler = stored(self.case.simpler([t.rec for t in self._trials]))
        except RodnetError as error:  # what was fitted is not lost for what it is compared with
            simpler, notes["simpler"] = {}, str(error)
        return Fitted(self.case.name, values, files, notes, simpler)

    def save(self, directory: str | Path) -> Path:
        """Write ``fitted.json`` into a directory; `Fitted.load` reads it, ``notes`` has all that is known.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        return self.fitted().save(directory)

    def __str__(self) -> str:
        width = max((len(p) for p in self.parameters), default=0)
        lines = [f"{path:<{width}}  {one}" for path, one in self.parameters.items()]
        return "\n".join([*lines, *self.identifiability.sentences, self.message])

    def __repr__(self) -> str:
        fitted = ", ".join(f"{p} = {f.value:.4g} {f.unit}" for p, f in self.parameters.items())
        return f"CalibrationResult({fitted}; {self.message})"
