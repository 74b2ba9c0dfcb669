"""How far trials would set explanations apart: expected differences of deviance, numerical errors taken off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rodnet.diagnosis.carried import Carried
from rodnet.diagnosis.fineness import FINE, REFINED, ROUGH
from rodnet.diagnosis.numerics import CARRIED, KINDS, measure
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import RodnetError
from rodnet.recordings.recording import Recording

SECOND_ORDER = 4.0  # times that twice the edges make the error of a mesh smaller


def powers(
    bench: Workbench, models: Sequence[Fitted], recs: Sequence[Recording], own: bool, numerical: float
) -> np.ndarray:
    """Expected difference of deviance between models in each trial, their parameters known as well as they are.

    That is what is left when one of two models is refitted to what the other does, whichever leaves less. Of a
    difference of norm d the numerical error, of norm e, may be to blame for e, in repetitions for the same of each:
    (d - e)^2 tells.

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
    ndarray, shape (trials, models, models)
        Symmetric, zeros where a model cannot be simulated: which the workbench is told, and nothing raised.
    """
    found = np.zeros((len(recs), len(models), len(models)))
    if not len(recs):
        return found
    noise = (
        [bench.noise[k % len(bench.noise)] for k in range(len(recs))] if own else [bench.noise[0]] * len(recs)
    )
    new = bench.with_trials(recs, noise)
    for k in range(len(recs)):
        single = new.subset([k])
        fits = [_simulated(single, model, k if own else None) for model in models]
        able = [fit for fit in fits if fit is not None]
        if len(able) < 2:
            continue
        blamed = numerical * np.sqrt(len(able[0].fits[0].residual))
        if not own and numerical > 0.0:
            first = next(i for i, fit in enumerate(fits) if fit is not None)
            blamed = _error(single, able[0], models[first], blamed, len(bench.recordings) + 1)
        for i, a in enumerate(fits):
            for j, b in enumerate(fits[:i]):
                if a is None or b is None:
                    continue
                apart = np.sqrt(min(_distance(a, b, models[i]), _distance(b, a, models[j])))
                found[k, i, j] = found[k, j, i] = max(apart - blamed, 0.0) ** 2
    return found


def _simulated(single: Workbench, model: Fitted, k: int | None) -> Fitted | None:
    """A model's prediction of one trial; None where it is beyond what the robot, or its gripper, can do."""
    try:
        problem = single.problem(model.candidates, model.values, None if k is None else [model.own[k]])
        return single.evaluate(problem, np.zeros(len(problem.quantities)), model.candidates)
    except RodnetError as error:
        single.tell(f"{single.recordings[0].name} is left out: {error}")
        return None


def _error(single: Workbench, fit: Fitted, known: Fitted, otherwise: float, trials: int) -> float:
    """Norm of the numerical error of a trial that has not been recorded, as far as a refit leaves it [sigma].

    Some trials are much harder to simulate than those that there are. With such a one among all the time step and the
    mesh are refined, until together they are fine enough.
    """
    error = measure(single, fit)
    if error.failed:
        return otherwise
    share = CARRIED if isinstance(single.case.observe, Carried) else 1.0
    kinds = [
        sum(c for path, c in error.columns.items() if path.endswith(f"[{j}]")) for j in range(len(KINDS))
    ]
    now = max(float(np.sqrt(_left(np.asarray(e), fit, known))) for e in kinds)
    fine = (FINE if single.case.noise is None else ROUGH) * np.sqrt(trials * len(fit.fits[0].residual))
    return share * max(min(now, float(fine)), now / SECOND_ORDER**REFINED)


def _of_common(model: Fitted) -> np.ndarray:
    """Covariance of what is common to the trials."""
    common = np.array([q.trial is None for q in model.quantities])
    return np.asarray(model.covariance()[np.ix_(common, common)])


def _distance(a: Fitted, b: Fitted, known: Fitted) -> float:
    """What is left of the difference of two models in a trial when the first, as well as it is known, is refitted."""
    return _left(a.fits[0].residual - b.fits[0].residual, a, known)


def _left(d: np.ndarray, a: Fitted, known: Fitted) -> float:
    """What a refit of a model, as well as it is known, leaves of a difference; what a trial has of its own is free."""
    U = Basis.of(a.jacobian_of(0)[:, [q.trial is not None for q in a.quantities]]).U
    d = d - U @ (U.T @ d)
    K = a.by_coordinates_of(known, 0)
    K = K - U @ (U.T @ K)
    values, vectors = np.linalg.eigh(_of_common(known))
    K = K @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    small = np.eye(K.shape[1]) + K.T @ K
    return max(float(d @ d - (K.T @ d) @ np.linalg.solve(small, K.T @ d)), 0.0)
