"""Models of the trials with or without candidate effects: fitted, and linearised where they were fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import lognorm

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.carried import pack_trials, restated
from rodnet.diagnosis.edited import with_candidates
from rodnet.errors import ConvergenceError, DerivativeError, TermError
from rodnet.inference.calibration import make_quantities
from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.instruments import make_trials
from rodnet.inference.problem import Problem, none_rejected
from rodnet.inference.quantities import Quantity, is_there, make_quantity
from rodnet.inference.result import Optimum
from rodnet.inference.search import follow, minimise
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording

FLAT = 1e-5  # relative change of the sum of squares at which a fit ends
ROUGH = 1e-3  # where sigma is what a model is off by, and many residuals in a row count as one
# of a model that has no motion, or no tangent there, or whose effects cannot be in one robot
UNABLE = (ConvergenceError, DerivativeError, TermError)
WEAK = 10.0  # factor about the case's value that a nominal parameter without a prior is within, one standard deviation
RANK = 1e-9  # of singular values, below which a direction of the nominal parameters does nothing


@dataclass(frozen=True)
class Fitted:
    """A model fitted to trials.

    Attributes
    ----------
    candidates : tuple of Candidate
        The effects in it beside the case's own.
    values : dict
        Values of what is common to all trials, by path.
    own : list of dict
        Of each trial by itself.
    deviance : float
        Sum of the squared prewhitened residuals, priors included.
    fits : list of Fit
        The trials at these values: residuals and their derivatives by ``quantities``.
    quantities : list of Quantity
        What was free.
    prior : tuple of ndarray
        Residuals of the priors, and their derivatives.
    converged : bool
        Whether the search ended well.
    groups : tuple of str
        Of the trials.
    """

    candidates: tuple[Candidate, ...]
    values: dict[str, float]
    own: list[dict[str, float]]
    deviance: float
    fits: list[Fit]
    quantities: list[Quantity]
    prior: tuple[np.ndarray, np.ndarray]
    converged: bool
    groups: tuple[str, ...]

    def group(self, trial: int) -> str:
        """What is left out with a trial: its group, or the trial alone where all are of one."""
        return self.groups[trial] if len(set(self.groups)) > 1 else f"{trial}"

    @property
    def residual(self) -> np.ndarray:
        """Prewhitened residuals of all trials and the priors, shape (n,)."""
        return np.concatenate([*(f.residual for f in self.fits), self.prior[0]])

    @property
    def jacobian(self) -> np.ndarray:
        """Their derivatives by the quantities, shape (n, k)."""
        return np.concatenate([*(self.jacobian_of(k) for k in range(len(self.fits))), self.prior[1]])

    def jacobian_of(self, trial: int) -> np.ndarray:
        """Derivatives of one trial's residual."""
        J = self.fits[trial].jacobian
        assert J is not None
        return J

    @property
    def samples(self) -> int:
        """Number of recorded numbers."""
        return sum(len(f.residual) for f in self.fits)

    def of_trials(self, chosen: Sequence[int]) -> Fitted:
        """Return the same of some of the trials, and without what the others have of their own."""
        kept = [k for k, q in enumerate(self.quantities) if q.trial is None or q.trial in chosen]
        with_prior = [k for k, q in enumerate(self.quantities) if q.prior is not None]
        rows = [row for row, k in enumerate(with_prior) if k in kept]
        fits = [replace(self.fits[k], jacobian=self.jacobian_of(k)[:, kept]) for k in chosen]
        r, J = self.prior[0][rows], self.prior[1][np.ix_(rows, kept)]
        quantities = [
            q if q.trial is None else replace(q, trial=list(chosen).index(q.trial))
            for q in (self.quantities[k] for k in kept)
        ]
        deviance = float(sum(f.residual @ f.residual for f in fits) + r @ r)
        own = [self.own[k] for k in chosen]
        groups = tuple(self.groups[k] for k in chosen)
        return replace(
            self, own=own, deviance=deviance, fits=fits, quantities=quantities, prior=(r, J), groups=groups
        )

    def covariance(self) -> np.ndarray:
        """Covariance of the coordinates of the quantities, if the noise is as said."""
        inverse = np.linalg.pinv(np.linalg.qr(self.jacobian, mode="r"), rcond=RANK)
        return np.asarray(inverse @ inverse.T)

    def sd(self, path: str) -> float:
        """Standard deviation of a common value, to first order."""
        k = self.place(path)
        return float(np.sqrt(self.covariance()[k, k]) * abs(self.slope(path)))

    def slope(self, path: str) -> float:
        """Derivative of a common value by its coordinate, where the model is."""
        q = self.quantities[self.place(path)]
        return q.slope(q.coordinate(self.values[path]))

    def by_coordinates_of(self, other: Fitted, trial: int | None = None) -> np.ndarray:
        """Derivatives of the residuals by the common coordinates of the same model of other trials, shape (n, c).

        What has no logarithm is told in scales, which go with the length of the trials or their frame rate. What there
        is not here (a share of a numerical error that is unknown) moves nothing.
        """
        J = self.jacobian if trial is None else self.jacobian_of(trial)
        paths = [q.path for q in other.quantities if q.trial is None]
        mine = {q.path for q in self.quantities if q.trial is None}
        out = np.zeros((len(J), len(paths)))
        for k, path in enumerate(paths):
            if path in mine:
                out[:, k] = J[:, self.place(path)] * (other.slope(path) / self.slope(path))
        return out

    def moved(self, change: np.ndarray) -> tuple[dict[str, float], list[dict[str, float]]]:
        """Values, common and by trial, after a change of the coordinates, within bounds."""
        values, own = dict(self.values), [dict(one) for one in self.own]
        for q, d in zip(self.quantities, change, strict=True):
            known = values if q.trial is None else own[q.trial]
            known[q.path] = q.value(float(np.clip(q.coordinate(known[q.path]) + d, *q.bounds)))
        return values, own

    def place(self, path: str) -> int:
        """Number of a common quantity."""
        return next(k for k, q in enumerate(self.quantities) if q.path == path and q.trial is None)


@dataclass
class Workbench:
    """Trials, their noise, and where they are simulated.

    Parameters
    ----------
    case : Case
        How a recording is simulated.
    recordings : sequence of Recording
        The trials.
    noise : list of dict
        Noise models of each trial's instruments by name.
    executor : Executor
        Where trials are simulated.
    priors, start : mapping
        As for `rodnet.calibrate`.
    modes : int
        Number of modes of initial positions and velocities.
    tell : callable
        Takes what there is to say of the progress.
    judges : Workbench, optional
        Training trials that nothing is fitted to: what they gain counts like that of a trial left out.
    """

    case: Case
    recordings: Sequence[Recording]
    noise: list[dict[str, NoiseModel]]
    executor: Executor
    priors: Mapping[str, Any] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    modes: int = 6
    tell: Callable[[str], None] = lambda text: None
    simulated: int = 0
    judges: Workbench | None = None

    @classmethod
    def of(cls, case: Case, recordings: Sequence[Recording], executor: Executor, noise: Any = None,
           **options: Any) -> Workbench:  # fmt: skip
        """Take the noise from what is given, the recordings, or an estimate from them."""
        built = make_trials(case, list(recordings), noise, options.get("modes", 4))
        return cls(case, list(recordings), [dict(t.noise) for t in built], executor, **options)

    def with_trials(
        self, recordings: Sequence[Recording], noise: Sequence[Mapping[str, NoiseModel]]
    ) -> Workbench:
        """Return the same for other trials, without judges."""
        return replace(self, recordings=list(recordings), noise=[dict(n) for n in noise], judges=None)

    @property
    def every(self) -> Workbench:
        """All training trials, those that are searched first, then their judges."""
        if (judges := self.judges) is None:
            return self
        return self.with_trials([*self.recordings, *judges.recordings], [*self.noise, *judges.noise])

    @property
    def simplest(self) -> Recording:
        """What is simulated of the first trial with the fewest rods: its parts are those that all trials have."""
        parts = [self.case.part(rec) for rec in self.recordings]
        return min(parts, key=lambda rec: len(self.case.robot(rec).graph.rods))

    def subset(self, trials: Sequence[int]) -> Workbench:
        """Return the same for some of the trials."""
        return self.with_trials([self.recordings[k] for k in trials], [self.noise[k] for k in trials])

    def problem(
        self, candidates: Sequence[Candidate] = (), values: Mapping[str, float] | None = None,
        own: Sequence[Mapping[str, float]] | None = None, free: Sequence[str] | None = None,
        common: bool = True,
    ) -> Problem:  # fmt: skip
        """Set up the residuals of a model with the candidates in it.

        Parameters
        ----------
        candidates : sequence of Candidate
            Effects in the robots; their parameters are free, with ``free`` only those named.
        values, own : mapping, sequence of mapping
            Where to begin, in common and by trial.
        free : sequence of str, optional
            Which parameters of the candidates are free.
        common : bool
            Whether anything common to the trials is free; if not, only what each has of its own.
        """
        paths = [p for c in candidates for p in c.paths] if free is None else list(free)
        case = with_candidates(self.case, candidates, paths if common else ())
        if not common:
            case = replace(case, free=())
        built = [Comparison(case, rec, noise, self.modes)
                 for rec, noise in zip(self.recordings, self.noise, strict=True)]  # fmt: skip
        begin = {**self.start, **(values or {})}
        quantities = make_quantities(
            case, built, self._priors(case, candidates), _known(begin, case, built[0]), self.modes
        )
        homes = self._homes(built[0]) if common else {}  # else nothing nominal is free
        quantities = [_weakly(q, homes) for q in quantities]
        scales: dict[str, float] = {}
        longest = max(trial.rec.duration for trial in built)
        for c in candidates:
            scales |= c.scales(built[0].robot, longest, built[0].instruments)
        quantities = [_scaled(q, scales) for q in quantities]
        if own is not None:
            quantities = [_begun(q, own) for q in quantities]
        packed = pack_trials(case, built, self.modes)
        taken = {q.path for q in quantities}
        robot, instruments = built[0].robot, built[0].instruments
        fixed = {p: float(v) for p, v in begin.items() if p not in taken and is_there(robot, instruments, p)}
        names = [rec.name for rec in self.recordings]
        return Problem(quantities, packed, names, dict(case.tied), self.executor, none_rejected(built), fixed)

    def names(self) -> list[str]:
        """What a value can be given for: what is free in the case, and the parameters of the first trial's robot."""
        robot = self.case.robot(self.simplest)
        return list(
            dict.fromkeys([*self.case.free, *self.case.per_trial, *self.case.tied, *robot.parameters])
        )

    def has(self, path: str) -> bool:
        """Whether there is something of this path, in the case, its robot or its instruments."""
        robot = self.case.robot(self.simplest)
        own = {*self.case.free, *self.case.per_trial, *self.case.tied}
        instruments = self.case.observations(self.simplest, robot)
        return path in own or path.partition("[")[0] in own or is_there(robot, instruments, path)

    def bounds(self, candidates: Sequence[Candidate]) -> dict[str, tuple[float, float]]:
        """Bounds of the parameters of the candidates."""
        case = with_candidates(self.case, candidates, ())
        rec = case.part(self.recordings[0])
        robot = case.robot(rec)
        instruments = case.observations(rec, robot)
        found: dict[str, tuple[float, float]] = {}
        for candidate in candidates:
            for path, p in candidate.parameters(robot, instruments).items():
                found[path] = (float(p.bounds[0]), float(p.bounds[1]))
        return found

    def _homes(self, first: Comparison) -> dict[str, float]:
        """Values of the positive nominal parameters that the case begins with."""
        known = {p: self.start.get(p) for p in self.case.free}
        made = [make_quantity(p, first.robot, first.instruments, 1.0, None, v) for p, v in known.items()]
        return {q.path: q.start for q in made if q.log}

    def _priors(self, case: Case, candidates: Sequence[Candidate]) -> dict[str, Any]:
        known, told = {*case.free, *case.per_trial}, dict(self.priors)
        for candidate in candidates:
            told |= candidate.priors
        return {p: v for p, v in told.items() if p in known or p.partition("[")[0] in known}

    def evaluate(
        self, problem: Problem, z: np.ndarray, candidates: Sequence[Candidate] = (), ok: bool = True
    ) -> Fitted:
        """Linearise at given coordinates.

        Raises
        ------
        ConvergenceError
            If a trial cannot be simulated.
        """
        fits = problem.at(z)
        if fits is None:
            raise ConvergenceError(problem.failures[-1])
        self.simulated += len(fits)
        r, J = problem.priors(z)
        deviance = float(sum(f.residual @ f.residual for f in fits) + r @ r)
        common = {q.path: q.value(c) for q, c in zip(problem.quantities, z, strict=True) if q.trial is None}
        own = [
            {q.path: q.value(c) for q, c in zip(problem.quantities, z, strict=True) if q.trial == k}
            for k in range(len(fits))
        ]
        return Fitted(
            tuple(candidates),
            {**problem.fixed, **common},
            own,
            deviance,
            fits,
            problem.quantities,
            (r, J),
            ok,
            tuple(rec.group for rec in self.recordings),
        )

    def fit(
        self, candidates: Sequence[Candidate] = (), values: Mapping[str, float] | None = None,
        own: Sequence[Mapping[str, float]] | None = None, evaluations: int = 30, common: bool = True,
        flat: float | None = None, goal: float | None = None, held: Sequence[str] = (),
        known: Fitted | None = None,
    ) -> Fitted:  # fmt: skip
        """Fit a model, from given values on; ``goal`` is the deviance of one beside which what is far behind is idle.

        Of what is free, ``held`` stays where it begins. What is ``known`` is the same model of the same trials beside
        other numerical errors: where it was fitted it is not run again.

        Raises
        ------
        ConvergenceError
            If a trial cannot be simulated at the start.
        """
        problem = self.problem(candidates, values, own, common=common)
        z = np.zeros(len(problem.quantities))
        if not len(z):
            return self.evaluate(problem, z, candidates)
        if known is not None and (fits := restated(problem, z, known)) is not None:
            problem.know(z, fits)
        flat = (FLAT if self.case.noise is None else ROUGH) if flat is None else flat
        goal = None if goal is None else 0.5 * goal
        fixed = [k for k, q in enumerate(problem.quantities) if q.path in held]
        best: Optimum | None
        if self.case.noise is None:
            best = follow(problem, z, evaluations, self.tell, fixed, flat, goal)
        else:  # far from small, effects are of unlike size
            best = minimise(
                problem, z, "linear", evaluations, self.tell, fixed, flat=flat, goal=goal, scale="jac"
            )
        if best is None:
            raise ConvergenceError(f"the fit cannot begin: {problem.failures[-1]}")
        return self.evaluate(problem, best.z, candidates, best.success)


def _known(values: Mapping[str, float], case: Case, trial: Comparison) -> dict[str, float]:
    """Values of what there is in the case."""
    known = {*case.free, *case.per_trial, *trial.robot.parameters}
    return {p: v for p, v in values.items() if p in known}


def _weakly(q: Quantity, homes: Mapping[str, float]) -> Quantity:
    """A nominal parameter that is positive, with a weak prior, lest it run off along what the trials do not tell."""
    if q.prior is not None or q.trial is not None or not q.log or q.path not in homes:
        return q
    return replace(q, prior=lognorm(np.log(WEAK), scale=homes[q.path]))


def _scaled(q: Quantity, scales: Mapping[str, float]) -> Quantity:
    scale = scales.get(q.path)
    return q if scale is None or q.log else replace(q, scale=float(scale))


def _begun(q: Quantity, own: Sequence[Mapping[str, float]]) -> Quantity:
    if q.trial is None or q.path not in own[q.trial]:
        return q
    return replace(q, start=float(own[q.trial][q.path]))
