"""What a finer time step and a finer mesh change in the predictions: measured, and carried along as a nuisance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from rodnet.diagnosis.carried import Carried
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import ConvergenceError, RodnetError
from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison
from rodnet.inference.packing import unpack_trial
from rodnet.inference.readings import by_samples
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.solve.steppers import make_stepper

# mean and standard deviation of the share of a difference that is missing, of a complete model
PRIOR = (1.0, 1.0)
KINDS = ("time step", "mesh")
# [sigma] by which differences are others than those that are carried along: what a parameter takes up of them is its
# error, many of its standard deviations where samples are many
NEW = 0.02
INSIDE = 0.1  # of the range that shares may have: where they begin at most
CARRIED = 0.3  # share of the error that is left once its differences are fitted along
FAR = 1.0  # coordinates of a change, beyond which derivatives do not tell what follows


@dataclass(frozen=True)
class Numerics:
    """Numerical error of the predictions at the recorded drive.

    Attributes
    ----------
    fields : list of dict
        Of each trial, by instrument: what half the time step and twice the mesh change, arrays of the shape of
        the readings.
    change : dict
        Rms change by kind, of the first instrument and what reads in its unit.
    sigma : dict
        Rms change by kind of the prewhitened residuals.
    kept : dict
        Likewise, after all parameters but the shares were refitted.
    failed : dict
        Why a finer run could not be had, by kind.
    columns : dict
        Derivatives of the residuals of all trials by the shares that `carried` makes free, shape (n,), by path.
    prior : tuple of float
        Mean and standard deviation that are known of these shares beforehand.
    coarser : dict
        What a refit left with the time step and the mesh of the case, by kind, of those that were refined since.
    """

    fields: list[dict[str, tuple[np.ndarray, ...]]]
    change: dict[str, float]
    sigma: dict[str, float]
    kept: dict[str, float]
    failed: dict[str, str]
    columns: dict[str, np.ndarray]
    prior: tuple[float, float] = PRIOR
    coarser: dict[str, float] = field(default_factory=dict)

    @property
    def worst(self) -> float:
        """Largest change of a whitened sample that a refit leaves, rms, in standard deviations of the noise.

        Infinite where a finer run failed: then it is not known.
        """
        return float("inf") if self.failed else max(self.kept.values(), default=0.0)

    @property
    def left(self) -> float:
        """What is left of that where the differences are fitted along [sigma]."""
        return CARRIED * self.worst


def measure(bench: Workbench, fitted: Fitted) -> Numerics:
    """Run every trial once more with half the time step, and with twice as many edges.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        The model, whose parameters are kept.

    Returns
    -------
    Numerics
        What that changes, in the unit of the readings and in standard deviations of the noise. A finer run that cannot
        be simulated raises nothing: ``failed`` has the reason.
    """
    coarse = [f.predicted for f in fitted.fits]
    finer: dict[str, list[list[np.ndarray]] | None] = {}
    failed = {}
    for kind, case in ((KINDS[0], halved(bench.case)), (KINDS[1], doubled(bench.case))):
        try:
            over = replace(bench, case=case)
            problem = over.problem(fitted.candidates, fitted.values, fitted.own)
            problem.fixed |= {p: v for p, v in fitted.values.items() if "." in p and p not in problem.fixed}
            fits = problem.fits(_coordinates(problem, fitted), slopes=False)
            if fits is None:
                raise ConvergenceError(problem.failures[-1])
            bench.simulated += 2 * len(fits)
            finer[kind] = [f.predicted for f in fits]
        except (RodnetError, ValueError) as error:  # functions of the case may know one mesh alone
            finer[kind], failed[kind] = None, str(error)
    problem = bench.problem(fitted.candidates, fitted.values, fitted.own)
    trials = [unpack_trial(packed) for packed in problem.packed]
    first = trials[0].instruments[0]
    # what only some trials have goes without shares: a parameter is common to all
    names = [one.name for one in trials[0].instruments
             if all(one.name in (other.name for other in trial.instruments) for trial in trials)]  # fmt: skip
    fields, whitened, alike = [], [], []
    shares: dict[str, list[np.ndarray]] = {share(name, k): [] for name in names for k in range(len(KINDS))}
    for k, trial in enumerate(trials):
        rows = []
        own: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for j, kind in enumerate(KINDS):
            runs, columns = finer[kind], []
            for number, one in enumerate(trial.instruments):
                change = coarse[k][number] * 0.0 if runs is None else runs[k][number] - coarse[k][number]
                own.setdefault(one.name, []).append(change)
                seen = np.isfinite(by_samples(trial.measured[number])).all(axis=2)
                table = np.where(seen[..., None], by_samples(change), np.nan)
                columns.append(trial.whitened(one, table)[seen].reshape(-1))
            rows.append(np.concatenate(columns))
            for name in names:
                shares[share(name, j)].append(
                    np.concatenate(
                        [
                            -c if one.name == name else np.zeros(len(c))
                            for one, c in zip(trial.instruments, columns, strict=True)
                        ]
                    )
                )
        fields.append({name: tuple(own[name]) for name in names})
        alike.append(
            [own[one.name] for one in trial.instruments if one.unit == first.unit]
        )  # metres are not rpm
        whitened.append(np.stack(rows, axis=1))
    both = np.concatenate(whitened)
    padded = np.zeros((len(fitted.residual), len(KINDS)))
    padded[: len(both)] = both
    free = [k for k, q in enumerate(fitted.quantities) if ".numerics[" not in q.path]  # shares hide no error
    kept = Basis.of(fitted.jacobian[:, free]).out(padded)[: len(both)]
    rms = lambda a: float(np.sqrt(np.mean(np.square(a))))  # noqa: E731
    change = {
        kind: rms(np.concatenate([changes[j].ravel() for some in alike for changes in some]))
        for j, kind in enumerate(KINDS)
    }
    sigma = {kind: rms(both[:, j]) for j, kind in enumerate(KINDS)}
    known = {path: np.concatenate(parts) for path, parts in shares.items()}
    kept_by = {kind: rms(kept[:, j]) for j, kind in enumerate(KINDS)}
    # sigma of a case is no noise: alike residuals in a row must not move what is known by itself
    factor = 1.0 if bench.case.noise is None else variance_factor(fitted)
    return Numerics(
        fields, change, sigma, kept_by, failed, known, (PRIOR[0], PRIOR[1] / float(np.sqrt(factor)))
    )


def lacking(trial: Comparison) -> tuple[float, float]:
    """Shares of what finer runs change that an infinitely fine one would take: 1 / (1 - 2^-p) at order p (Richardson).

    Of half the time step and of twice the mesh, which is of second order.
    """
    at_step, at_mesh = orders(trial.options)
    return 1.0 / (1.0 - 0.5**at_step), 1.0 / (1.0 - 0.5**at_mesh)


def orders(options: Mapping[str, Any]) -> tuple[int, int]:
    """Orders of convergence in the time step and the mesh, with given options of a simulation."""
    return make_stepper(options.get("stepper", "euler")).order, 2


def share(name: str, kind: int) -> str:
    """Path of an instrument's share of what a finer run changes."""
    return f"{name}.numerics[{kind}]"


def followed(fitted: Fitted, numerics: Numerics) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Values, common and by trial, of a fit with shares of the differences, to first order from that without them.

    The predictions are linear in the shares, and the fit has told its derivatives by all else.
    """
    paths = [p for p in numerics.columns if KINDS[int(p[-2])] not in numerics.failed]
    D = np.zeros((len(fitted.residual), len(paths)))
    for j, path in enumerate(paths):
        D[: len(numerics.columns[path]), j] = numerics.columns[path]
    mean, sd = numerics.prior
    basis = Basis.of(fitted.jacobian)
    P, one = basis.out(D), np.eye(len(paths)) / sd
    aim = np.concatenate([-basis.out(fitted.residual), np.full(len(paths), mean / sd)])
    low, high = Observation.declared()["numerics"].bounds
    inside = INSIDE * (high - low)  # where a search begins at a bound it is slow to leave it
    shares = lsq_linear(np.vstack([P, one]), aim, (low + inside, high - inside)).x
    change = basis.follow(fitted.residual + D @ shares)
    near = np.abs(change).max(initial=0.0) < FAR  # else these derivatives do not tell where to go
    values, own = fitted.moved(change) if near else (fitted.values, fitted.own)
    return values | dict(zip(paths, map(float, shares), strict=True)), own


def shares_inside(values: Mapping[str, float]) -> dict[str, float]:
    """Values with shares away from bounds: without an effect they may be there, and a search leaves them slowly."""
    low, high = Observation.declared()["numerics"].bounds
    some = {
        p: float(np.clip(v, low + 0.25 * (high - low), high - 0.25 * (high - low))) for p, v in values.items()
    }
    return {p: some[p] if ".numerics[" in p else v for p, v in values.items()}


def _coordinates(problem: Any, fitted: Fitted) -> np.ndarray:
    return np.zeros(len(problem.quantities))


def halved(case: Case) -> Case:
    """The case with half the time step."""
    return replace(case, options=_Options(case))


def doubled(case: Case) -> Case:
    """The case with every edge in two."""
    return replace(case, build=_Refined(case), options=_Prolonged(case))


@dataclass(frozen=True)
class _Options:
    case: Case

    def __call__(self, rec: Recording, robot: Robot) -> dict[str, Any]:
        options = self.case.simulation(rec, robot)
        return {**options, "dt": 0.5 * options["dt"]}


@dataclass(frozen=True)
class _Prolonged:
    """Options of the coarse robot, with what is given by node interpolated."""

    case: Case

    def __call__(self, rec: Recording, robot: Robot) -> dict[str, Any]:
        coarse = self.case.robot(rec)
        options = self.case.simulation(rec, coarse)
        velocity = options.get("velocity")
        if velocity is not None and np.ndim(velocity) == 2:
            parents = coarse.mesh_parents()
            options["velocity"] = np.asarray(velocity)[parents].mean(axis=1)
        return options


@dataclass(frozen=True)
class _Refined:
    case: Case

    def __call__(self, rec: Recording) -> Robot:
        return self.case.robot(rec).refined()


def refinements(case: Case) -> tuple[int, int]:
    """How often the time step was halved and the mesh doubled."""
    step = mesh = 0
    while isinstance(case.options, _Options | _Prolonged):
        step, mesh = step + isinstance(case.options, _Options), mesh + isinstance(case.options, _Prolonged)
        case = case.options.case
    return step, mesh


def carried(case: Case, recordings: Sequence[Recording], numerics: Numerics) -> Case:
    """The case whose predictions may have a share of the differences added, common to all trials.

    They take the place of those that it carries along already.
    """
    before = case.observe if isinstance(case.observe, Carried) else Carried(case, {})
    fields = {rec.name: own for rec, own in zip(recordings, numerics.fields, strict=True)}
    names = list(numerics.fields[0])
    free = [share(name, k) for name in names for k, kind in enumerate(KINDS) if kind not in numerics.failed]
    return replace(case, observe=replace(before, fields=fields), free=(*before.case.free, *free))


def carrying(bench: Workbench, numerics: Numerics) -> Workbench:
    """The trials with their numerical error as a nuisance."""
    case = carried(bench.case, bench.recordings, numerics)
    return replace(bench, case=case, priors={**bench.priors, **priors(case, numerics)})


def renewed(bench: Workbench, fitted: Fitted) -> tuple[Workbench, Numerics] | None:
    """The workbench with the differences of a model that has come far since they were measured; None if it has not."""
    if not isinstance(bench.case.observe, Carried):
        return None
    now, then = measure(bench, fitted), bench.case.observe.fields
    if now.failed:
        return None
    for name in now.fields[0]:  # one by one: metres are not rpm
        for j, kind in enumerate(KINDS):
            new = np.concatenate([fields[name][j].ravel() for fields in now.fields])
            old = np.concatenate([then[rec.name][name][j].ravel() for rec in bench.recordings])
            seen = np.isfinite(new) & np.isfinite(old)
            size = np.linalg.norm(new[seen])
            if size and now.sigma[kind] * np.linalg.norm((new - old)[seen]) > NEW * size:
                return carrying(bench, now), now
    return None


def priors(case: Case, numerics: Numerics) -> dict[str, tuple[float, float]]:
    """Priors of the shares that `carried` has made free."""
    return {path: numerics.prior for path in case.free if ".numerics[" in path}


REFINE = {KINDS[0]: halved, KINDS[1]: doubled}
