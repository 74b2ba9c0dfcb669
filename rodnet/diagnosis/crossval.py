"""Leaving out one trial at a time, to first order: no fit is repeated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rodnet.diagnosis.workbench import RANK, Fitted


@dataclass(frozen=True)
class Reduced:
    """A trial's deviance as a function of the change of the common parameters, its own refitted.

    ``c + 2 b.d + d.S d`` with the change ``d`` of the coordinates.
    """

    S: np.ndarray
    b: np.ndarray
    c: float

    def at(self, d: np.ndarray) -> float:
        """Deviance after a change."""
        return float(self.c + 2.0 * self.b @ d + d @ self.S @ d)


def reduced(fitted: Fitted) -> tuple[list[Reduced], Reduced]:
    """Quadratic forms of the trials, and of the priors of what is common."""
    trial_of = np.array([-1 if q.trial is None else q.trial for q in fitted.quantities])
    common = trial_of < 0
    r0, J0 = fitted.prior
    with_prior = [k for k, q in enumerate(fitted.quantities) if q.prior is not None]
    prior_of = np.array([trial_of[k] for k in with_prior], dtype=int)
    forms = []
    for k, fit in enumerate(fitted.fits):
        rows = prior_of == k
        J = np.concatenate([fitted.jacobian_of(k), J0[rows]])
        r = np.concatenate([fit.residual, r0[rows]])
        A, B = J[:, common], J[:, trial_of == k]
        if B.shape[1]:
            U, s, _ = np.linalg.svd(B, full_matrices=False)
            U = U[:, s > RANK * max(s[0], 1e-300)]
            A, r = A - U @ (U.T @ A), r - U @ (U.T @ r)
        forms.append(Reduced(A.T @ A, A.T @ r, float(r @ r)))
    rows = prior_of == -1
    A, r = J0[rows][:, common], r0[rows]
    return forms, Reduced(A.T @ A, A.T @ r, float(r @ r))


def best_change(forms: list[Reduced], prior: Reduced) -> np.ndarray:
    """Change of the common coordinates that minimises the sum."""
    S, b = sum(f.S for f in forms) + prior.S, sum(f.b for f in forms) + prior.b
    if not len(b):
        return np.zeros(0)
    return -np.linalg.pinv(np.asarray(S), rcond=RANK, hermitian=True) @ b


def left_out(fitted: Fitted) -> np.ndarray:
    """Deviance of each trial predicted from all the others, shape (trials,).

    The common parameters are those that the others give, to first order about the fit to all; what a trial has of
    its own (its initial state) is fitted to it.
    """
    forms, prior = reduced(fitted)
    return np.array([f.at(best_change([g for g in forms if g is not f], prior)) for f in forms])


def strength_without(fitted: Fitted, path: str) -> np.ndarray:
    """Value of a common parameter without each trial in turn, to first order, shape (trials,)."""
    forms, prior = reduced(fitted)
    common = [q for q in fitted.quantities if q.trial is None]
    k = [q.path for q in common].index(path)
    z = common[k].coordinate(fitted.values[path])
    return np.array(
        [common[k].value(z + best_change([g for g in forms if g is not f], prior)[k]) for f in forms]
    )
