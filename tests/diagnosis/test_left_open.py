"""What a trial alone can tell: others that leave it open do not speak against it."""

from types import SimpleNamespace

import numpy as np
import pytest

from rodnet.diagnosis import folds


def linear(J, residuals):
    """A fit of one effect of two values whose trials are linear."""
    return SimpleNamespace(
        quantities=[SimpleNamespace(trial=None, prior=None)] * 2, prior=(np.zeros(0), np.zeros((0, 2))),
        fits=[SimpleNamespace(residual=r) for r in residuals], jacobian_of=J.__getitem__, group=str,
        candidates=[SimpleNamespace(paths=["one", "two"])],
    )  # fmt: skip


@pytest.mark.parametrize("hardly", [1e-3, 0.3])
def test_a_trial_counts_by_its_predictive_density(monkeypatch, hardly):
    """Of linear trials Laplace's method is exact: the others' density of the trial, whatever they know."""
    monkeypatch.setattr(folds, "smooth_variance", lambda fitted: 1.0)
    rng = np.random.default_rng(0)
    J = [rng.standard_normal((40, 2)) * (1.0, hardly) for _ in range(3)] + [rng.standard_normal((40, 2))]
    y = [rng.standard_normal(40) for _ in J]
    best = -np.linalg.lstsq(np.concatenate(J), np.concatenate(y), rcond=None)[0]
    fitted = linear(J, [r + j @ best for r, j in zip(y, J, strict=True)])

    A, b = np.concatenate(J[:3]), np.concatenate(y[:3])
    told, (least,) = np.linalg.lstsq(A, -b, rcond=None)[:2]
    V = np.eye(40) + J[3] @ np.linalg.inv(A.T @ A) @ J[3].T
    off = y[3] + J[3] @ told
    density = off @ np.linalg.solve(V, off) + np.linalg.slogdet(V)[1]
    assert folds._open(fitted, 3, [0, 1, 2], float(least)) == pytest.approx(density, rel=1e-3)


def test_others_that_contradict_it_are_heard(monkeypatch):
    monkeypatch.setattr(folds, "smooth_variance", lambda fitted: 1.0)
    J = [np.eye(2)] * 4
    fitted = linear(J, [np.array([3.0, 3.0])] * 3 + [np.array([-9.0, -9.0])])
    assert folds._open(fitted, 3, [0, 1, 2], 0.0) is None  # 54 less without it
