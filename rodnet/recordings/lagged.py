"""Products of samples some frames apart, of pieces that are evenly sampled."""

from __future__ import annotations

import numpy as np

SAME_RATE = 0.01  # relative
TOO_SHORT = 0.2  # of the longest piece

Piece = tuple[np.ndarray, float]  # evenly sampled, frames by whatever [m], and the step [s]


def of_one_rate(pieces: list[Piece]) -> list[Piece]:
    """Those of the frame rate that most of the time was recorded at."""
    if not pieces:
        return []
    seconds, steps = np.array([len(x) * step for x, step in pieces]), np.array([step for _, step in pieces])
    same = np.abs(np.subtract.outer(steps, steps)) <= SAME_RATE * steps
    most = same[np.argmax(same @ seconds)]
    return [piece for piece, of_it in zip(pieces, most, strict=True) if of_it]


def long_ones(pieces: list[Piece]) -> list[Piece]:
    """Those not much shorter than the longest: the shortest sets the lags at which all are compared."""
    longest = max((len(x) for x, _ in pieces), default=0)
    return [piece for piece in pieces if len(piece[0]) >= TOO_SHORT * longest]


def lagged_products(x: np.ndarray, lags: int) -> np.ndarray:
    """Mean products of samples 0 to ``lags`` frames apart, shape (lags + 1, E); of those that there are."""
    return np.array([known_mean(x[k:] * x[: len(x) - k]) for k in range(lags + 1)])


def known_mean(x: np.ndarray) -> np.ndarray:
    """Mean over frames of what there is, shape (E,); NaN where there is nothing."""
    known = np.isfinite(x)
    count = known.sum(axis=0)
    return np.where(count > 0, np.where(known, x, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def lagged_of(rho: float, count: int, lags: int) -> np.ndarray:
    """What `lagged_products` is to be expected of an Ornstein-Uhlenbeck process of unit variance, its mean taken away.

    ``rho`` is its correlation from frame to frame.
    """
    sums = np.cumsum(rho ** np.arange(count))
    rows = (sums + sums[::-1] - 1.0) / count  # correlation of a frame with the mean
    return np.array(
        [rho**k + rows.mean() - rows[k:].mean() - rows[: count - k].mean() for k in range(lags + 1)]
    )


def lagged_without_drift(rho: float, count: int, lags: int) -> np.ndarray:
    """Likewise with its mean and slope taken away."""
    from scipy.linalg import toeplitz

    clock = np.arange(count) - 0.5 * (count - 1)
    U = np.stack([np.full(count, count**-0.5), clock / np.linalg.norm(clock)], axis=1)
    C = toeplitz(rho ** np.arange(count))
    CU = C @ U
    C -= U @ CU.T
    C -= (CU - U @ (U.T @ CU)) @ U.T
    return np.array([np.mean(np.diagonal(C, k)) for k in range(lags + 1)])
