"""Leaving out one trial at a time, or all of its group, to first order: no fit is repeated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rodnet.diagnosis.workbench import RANK, Fitted


@dataclass(frozen=True)
class Reduced:
    """A trial's deviance as a function of the change of the common parameters, its own refitted.

    ``c + 2 b.d + d.S d`` with the change ``d`` of the coordinates; ``group`` is that of the trial.
    """

    S: np.ndarray
    b: np.ndarray
    c: float
    group: str = ""

    def at(self, d: np.ndarray) -> float:
        """Deviance after a change."""
        return float(self.c + 2.0 * self.b @ d + d @ self.S @ d)


def reduced(fitted: Fitted, extra: np.ndarray | None = None) -> tuple[list[Reduced], Reduced]:
    """Quadratic forms of the trials, and of the priors of what is common.

    ``extra`` are derivatives of the trials' residuals by more that is common, shape (samples, m).
    """
    trial_of = np.array([-1 if q.trial is None else q.trial for q in fitted.quantities])
    common = trial_of < 0
    r0, J0 = fitted.prior
    with_prior = [k for k, q in enumerate(fitted.quantities) if q.prior is not None]
    prior_of = np.array([trial_of[k] for k in with_prior], dtype=int)
    forms, begin = [], 0
    more = 0 if extra is None else extra.shape[1]
    for k, fit in enumerate(fitted.fits):
        rows = prior_of == k
        J = np.concatenate([fitted.jacobian_of(k), J0[rows]])
        r = np.concatenate([fit.residual, r0[rows]])
        A, B = J[:, common], J[:, trial_of == k]
        if extra is not None:
            own = np.zeros((len(J), more))
            own[: len(fit.residual)] = extra[begin : begin + len(fit.residual)]
            begin += len(fit.residual)
            A = np.hstack([A, own])
        if B.shape[1]:
            U, s, _ = np.linalg.svd(B, full_matrices=False)
            U = U[:, s > RANK * max(s[0], 1e-300)]
            A, r = A - U @ (U.T @ A), r - U @ (U.T @ r)
        forms.append(Reduced(A.T @ A, A.T @ r, float(r @ r), fitted.group(k)))
    rows = prior_of == -1
    A, r = np.hstack([J0[rows][:, common], np.zeros((int(rows.sum()), more))]), r0[rows]
    return forms, Reduced(A.T @ A, A.T @ r, float(r @ r))


def best_change(forms: list[Reduced], prior: Reduced) -> np.ndarray:
    """Change of the common coordinates that minimises the sum."""
    S, b = sum(f.S for f in forms) + prior.S, sum(f.b for f in forms) + prior.b
    if not len(b):
        return np.zeros(0)
    size = np.sqrt(np.maximum(np.diag(np.asarray(S)), 1e-300))
    return -np.linalg.pinv(S / np.outer(size, size), rcond=RANK, hermitian=True) @ (b / size) / size


def variances(forms: list[Reduced], prior: Reduced) -> np.ndarray:
    """Variances of the common coordinates, as far as trials tell them by noise of unit size alone."""
    S = np.asarray(sum(f.S for f in forms) + prior.S)
    size = np.sqrt(np.maximum(np.diag(S), 1e-300))
    return np.asarray(np.diag(np.linalg.inv(S / np.outer(size, size) + RANK * np.eye(len(S)))) / size**2)


def left_out(fitted: Fitted) -> np.ndarray:
    """Deviance of each trial predicted from all the others that are not of its group, shape (trials,).

    The common parameters are those that the others give, to first order about the fit to all; what a trial has of
    its own (its initial state) is fitted to it. A single trial has no others: its deviance is that of the fit.
    """
    forms, prior = reduced(fitted)
    if len(forms) == 1:
        return np.array([forms[0].c])
    told = {f.group: best_change([g for g in forms if g.group != f.group], prior) for f in forms}
    return np.array([f.at(told[f.group]) for f in forms])


def cross_gains(forms: list[Reduced], prior: Reduced, directions: np.ndarray) -> np.ndarray:
    """By how much the deviance of each trial, predicted from those of other groups, falls with more that is common.

    Parameters
    ----------
    forms, prior
        Of `reduced`, with ``extra`` of m columns.
    directions : ndarray, shape (n, m, p)
        Each a choice of p combinations of these columns that are free beside what is common already.

    Returns
    -------
    ndarray, shape (n, trials)
    """
    alone = _predicted(forms, prior, np.zeros((1, directions.shape[1], 0)))
    return alone - _predicted(forms, prior, directions)


def _predicted(forms: list[Reduced], prior: Reduced, T: np.ndarray) -> np.ndarray:
    """Deviance of each trial predicted from the others, for each of several choices, shape (n, trials)."""
    c = prior.S.shape[0] - T.shape[1]
    S = np.array([_chosen(f.S, c, T) for f in forms])  # (trials, n, c + p, c + p)
    b = np.array([_chosen_vector(f.b, c, T) for f in forms])
    one = [f.group for f in forms]
    away = np.array([[len(forms) == 1 or g != h for h in one] for g in one], dtype=float)  # alone, none are
    others_S = _chosen(prior.S, c, T) + np.tensordot(away, S, 1)
    others_b = _chosen_vector(prior.b, c, T) + np.tensordot(away, b, 1)
    if not S.shape[-1]:
        return np.broadcast_to([f.c for f in forms], (len(T), len(forms)))
    size = np.sqrt(np.maximum(np.einsum("...ii->...i", others_S), 1e-300))
    small = others_S / (size[..., :, None] * size[..., None, :]) + RANK * np.eye(S.shape[-1])
    d = -np.linalg.solve(small, (others_b / size)[..., None])[..., 0] / size
    out = np.einsum("kni,kni->kn", d, 2.0 * b) + np.einsum("kni,knij,knj->kn", d, S, d)
    return np.asarray((out + np.array([f.c for f in forms])[:, None]).T)


def _chosen(S: np.ndarray, c: int, T: np.ndarray) -> np.ndarray:
    """A quadratic form in what is common and in chosen combinations of the rest, shape (n, c + p, c + p)."""
    n, p = len(T), T.shape[2]
    out = np.empty((n, c + p, c + p))
    out[:, :c, :c] = S[:c, :c]
    out[:, :c, c:] = S[:c, c:] @ T
    out[:, c:, :c] = np.swapaxes(out[:, :c, c:], 1, 2)
    out[:, c:, c:] = np.swapaxes(T, 1, 2) @ S[c:, c:] @ T
    return out


def _chosen_vector(b: np.ndarray, c: int, T: np.ndarray) -> np.ndarray:
    out = np.empty((len(T), c + T.shape[2]))
    out[:, :c], out[:, c:] = b[:c], b[c:] @ T
    return out
