"""How far trials would set explanations apart: expected differences of deviance, numerical errors taken off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rodnet.diagnosis.carried import Carried
from rodnet.diagnosis.fineness import FINE, REFINED, ROUGH
from rodnet.diagnosis.numerics import CARRIED, measure, orders, refinements
from rodnet.diagnosis.outliers import with_all
from rodnet.diagnosis.scales import Noise, variance_factor
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording


@dataclass(frozen=True)
class Powers:
    """What trials, any of them and any number of times, are expected to add to the deviance between explanations.

    That is what is left when one of two explanations is refitted to what the other does in all of these trials, known
    as well as it is by those that there are, whichever leaves less, over the variance factor. Of a difference of norm d
    the numerical error, of norm e, may be to blame for e, in repetitions for the same of each: (d - e)^2 tells.

    Attributes
    ----------
    known : list of ndarray, shape (m, c)
        Of each explanation: the trials that there are rise by the square of this times a change of what is common.
    factors : list of float
        Variance factors of the explanations.
    parts : list of dict
        Of each trial, by pair ``(i, j)`` of explanations, an array of shape (m, c + 1): derivatives by what is common
        to all trials of what i leaves, and by how much j leaves something else, what is the trial's own eliminated.
        Without what cannot be simulated.
    errors : list of float
        Norm of the numerical error of each trial [sigma].
    """

    known: list[np.ndarray]
    factors: list[float]
    parts: list[dict[tuple[int, int], np.ndarray]]
    errors: list[float]

    def between(self, i: int, j: int, counts: Mapping[int, int]) -> float:
        """Expected difference of deviance between two explanations, of trials by number, done so often."""
        done = [(t, n) for t, n in counts.items() if (i, j) in self.parts[t] and (j, i) in self.parts[t]]
        if not done:
            return 0.0
        each = (
            (np.vstack([np.sqrt(n) * self.parts[t][a, b] for t, n in done]), a) for a, b in ((i, j), (j, i))
        )
        apart = np.sqrt(min(_least(rows, self.known[a]) for rows, a in each))
        error = np.sqrt(sum(n * self.errors[t] ** 2 for t, n in done))
        return float(max(apart - error, 0.0) ** 2 / max(self.factors[i], self.factors[j]))

    def beside(self, other: Powers) -> Powers:
        """Return the same with other trials of the same explanations."""
        return replace(self, parts=[*self.parts, *other.parts], errors=[*self.errors, *other.errors])


def powers(
    bench: Workbench, models: Sequence[Fitted], recs: Sequence[Recording], own: bool, numerical: float
) -> Powers:
    """Simulate trials with each explanation, and linearise.

    Parameters
    ----------
    bench : Workbench
        The trials that there are.
    models : sequence of Fitted
        The explanations, fitted to these.
    recs : sequence of Recording
        The trials that are asked for.
    own : bool
        Whether these are the workbench's, whose numerical error is known; that of others is measured.
    numerical : float
        Numerical error of the trials that there are [sigma], rms.

    Returns
    -------
    Powers
        Where an explanation cannot be simulated, the workbench is told, and nothing raised.
    """
    new = bench if own else _planned(bench, recs)
    parts, errors = [], []
    for k in range(len(recs)):
        single = new.subset([k])
        fits = [_simulated(single, model, k if own else None) for model in models]
        able = {i: fit for i, fit in enumerate(fits) if fit is not None}
        parts.append(
            {
                (i, j): _beside(a, models[i], a.fits[0].residual - b.fits[0].residual)
                for i, a in able.items()
                for j, b in able.items()
                if i != j
            }
        )
        errors.append(0.0)
        if len(able) > 1:
            first = next(iter(able))
            size = np.sqrt(len(able[first].fits[0].residual))
            measured = not own and numerical > 0.0
            errors[k] = _error(single, able[first], models[first]) if measured else numerical * size
    return Powers([_known(model) for model in models], [variance_factor(m) for m in models], parts, errors)


def _planned(bench: Workbench, recs: Sequence[Recording]) -> Workbench:
    """The workbench of trials that are planned: noise as in a typical one, and no numerical error of another."""
    observe = bench.case.observe
    case = with_all(bench.case)
    if isinstance(observe, Carried):
        case = replace(bench.case, observe=Carried(with_all(observe.case), {}, {}, observe.count))
    return replace(bench, case=case).with_trials(recs, [_typical(bench.noise)] * len(recs))


def _typical(noise: Noise) -> Mapping[str, NoiseModel]:
    """Noise of each instrument in the trial in the middle: where sigma is a misfit, trials have sigmas of their own."""
    found = {}
    for name in dict.fromkeys(name for own in noise for name in own):
        models = sorted((own[name] for own in noise if name in own), key=lambda model: model.typical)
        found[name] = models[len(models) // 2]
    return found


def _simulated(single: Workbench, model: Fitted, k: int | None) -> Fitted | None:
    """A model's prediction of one trial; None where it is beyond what the robot, its gripper or the case can do."""
    try:
        problem = single.problem(model.candidates, model.values, None if k is None else [model.own[k]])
        return single.evaluate(problem, np.zeros(len(problem.quantities)), model.candidates)
    except Exception as error:  # the case's own functions may raise anything, and all else is done
        single.tell(f"{single.recordings[0].name} is left out: {type(error).__name__}: {error}")
        return None


def _error(single: Workbench, fit: Fitted, known: Fitted) -> float:
    """Norm of the numerical error of a trial that has not been recorded, as far as a refit leaves it [sigma].

    Some trials are much harder to simulate than those that there are. With such a one among all the time step and the
    mesh are refined, until together they are fine enough.
    """
    error = measure(single, fit)
    if error.failed:
        return float("inf")
    rec = single.case.part(single.recordings[0])
    order = orders(single.case.simulation(rec, single.case.robot(rec)))
    share = CARRIED if isinstance(single.case.observe, Carried) else 1.0
    samples = known.samples + len(fit.fits[0].residual)
    fine = (FINE if single.case.noise is None else ROUGH) * np.sqrt(samples)
    R, left = _known(known), []
    for j, done in enumerate(refinements(single.case)):
        kind = sum(c for path, c in error.columns.items() if path.endswith(f"[{j}]"))
        now = np.sqrt(_least(_beside(fit, known, np.asarray(kind)), R))
        left.append(max(min(now, fine), now / 2.0 ** (order[j] * max(REFINED - done, 0))))
    return float(share * max(left))


def _known(model: Fitted) -> np.ndarray:
    """What the trials that there are say of what is common to them: the square of it times a change is its cost."""
    own = np.array([q.trial is not None for q in model.quantities], dtype=bool)
    R = np.asarray(np.linalg.qr(model.jacobian, mode="r"))
    return Basis.of(R[:, own]).out(R[:, ~own])


def _beside(fit: Fitted, known: Fitted, change: np.ndarray) -> np.ndarray:
    """Derivatives of what a trial leaves by what is common to all, and a change, what is the trial's own eliminated."""
    own = [q.trial is not None for q in fit.quantities]
    rows = np.column_stack([fit.by_coordinates_of(known, 0), change])
    return np.asarray(np.linalg.qr(Basis.of(fit.jacobian_of(0)[:, own]).out(rows), mode="r"))


def _least(rows: np.ndarray, R: np.ndarray) -> float:
    """Square of what is left of a change (the last column) when all else moves, as far as it is not known.

    What nothing is known of costs nothing.
    """
    d = np.concatenate([rows[:, -1], np.zeros(len(R))])
    return float(np.sum(Basis.of(np.vstack([rows[:, :-1], R])).out(d) ** 2))
