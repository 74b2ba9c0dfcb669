"""Linear-Gaussian posterior of what trials were pushed by, its strengths chosen by evidence."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import minimize

from rodnet.diagnosis.screen import Basis

RANGE = 9.0  # of the logarithm of a strength, to either side of where a search begins
SEARCH = {"maxiter": 40, "ftol": 1e-7, "gtol": 1e-3}
LOUD = 9.0  # variance of what is expected of an effect over the noise's, where a search begins


@dataclass(frozen=True)
class Posterior:
    """Coefficients of all trials' columns, in multiples of their scales.

    Attributes
    ----------
    mean : list of ndarray, shapes (K,)
        By trial.
    covariance : list of ndarray, shapes (K, K)
        By trial.
    prior : ndarray, shape (channels,)
        Standard deviation of the coefficients of a channel, beforehand.
    evidence : float
        Logarithm of the probability of the residuals, up to what is the same for all priors [nats].
    variance : float
        Of the residuals that are left, over the noise's; at least 1.
    slope : ndarray, shape (channels,)
        Derivative of the evidence by the logarithms of ``prior``.
    """

    mean: list[np.ndarray]
    covariance: list[np.ndarray]
    prior: np.ndarray
    evidence: float
    variance: float
    slope: np.ndarray


class Smoother:
    """Residuals of trials ``r + U u + G a``: free parameters u, and of each trial coefficients a with a prior.

    Parameters
    ----------
    residuals : sequence of ndarray, shapes (n,)
        Of the trials, and of whatever else depends on the free parameters alone.
    jacobians : sequence of ndarray, shapes (n, p)
        Derivatives by the free parameters.
    columns : iterable of ndarray, shapes (n, K)
        Derivatives by the coefficients, of the first trials; of the others none are asked. Asked for once.
    channel : ndarray of int, shape (K,)
        Which channel a column belongs to: the columns of one have one prior.
    """

    def __init__(
        self, residuals: Sequence[np.ndarray], jacobians: Sequence[np.ndarray],
        columns: Iterable[np.ndarray], channel: np.ndarray,
    ) -> None:  # fmt: skip
        U = Basis.of(np.concatenate(jacobians)).U
        r = np.concatenate(residuals)
        ends = np.cumsum([len(one) for one in residuals])
        parts = [slice(int(e) - len(one), int(e)) for e, one in zip(ends, residuals, strict=True)]
        self.count = int(np.max(channel)) + 1
        self.samples = len(r) - U.shape[1]
        self._gram: list[np.ndarray] = []
        self._right: list[np.ndarray] = []
        self._mixed: list[np.ndarray] = []
        for part, G in zip(parts, columns, strict=False):  # one after the other: they may be large
            self._gram.append(G.T @ G)
            self._right.append(G.T @ r[part])
            self._mixed.append(G.T @ U[part])
        self.channel = [np.asarray(channel)] * len(self._gram)
        self._square, self._common = float(r @ r), U.T @ r

    def mapped(self, maps: Sequence[np.ndarray], channel: Sequence[np.ndarray]) -> Smoother:
        """The same for other coefficients b, a = M b: by trial maps (K, L), or their diagonals, and channels (L,)."""
        other = copy.copy(self)
        other.channel = [np.asarray(c) for c in channel]
        other.count = 1 + max(int(c.max()) for c in other.channel)
        if maps[0].ndim == 1:
            other._gram = [m[:, None] * gram * m for m, gram in zip(maps, self._gram, strict=True)]
            other._right = [m * right for m, right in zip(maps, self._right, strict=True)]
            other._mixed = [m[:, None] * mixed for m, mixed in zip(maps, self._mixed, strict=True)]
        else:
            other._gram = [M.T @ gram @ M for M, gram in zip(maps, self._gram, strict=True)]
            other._right = [M.T @ right for M, right in zip(maps, self._right, strict=True)]
            other._mixed = [M.T @ mixed for M, mixed in zip(maps, self._mixed, strict=True)]
        return other

    @property
    def loud(self) -> np.ndarray:
        """Priors with which each channel by itself is expected to change the residuals by 3 sigma, (channels,)."""
        seen = np.zeros(self.count)
        for gram, mixed, channel in zip(self._gram, self._mixed, self.channel, strict=True):
            np.add.at(seen, channel, np.diag(gram) - (mixed**2).sum(axis=1))
        return np.sqrt(LOUD * self.samples / np.maximum(seen, 1e-12 * max(seen.max(), 1e-300)))

    def at(self, prior: np.ndarray) -> Posterior:
        """Posterior for given priors."""
        sizes = [prior[channel] for channel in self.channel]
        rank = len(self._common)
        S, s = np.eye(rank), self._common.copy()
        solved, logdet, square = [], 0.0, self._square
        for size, gram, right, mixed in zip(sizes, self._gram, self._right, self._mixed, strict=True):
            factor, failed = dpotrf(size[:, None] * gram * size + np.eye(len(size)), lower=1)
            inverse, _ = dpotri(factor, lower=1)
            if failed:
                raise np.linalg.LinAlgError("the columns of a force are not finite")
            inverse = np.tril(inverse) + np.tril(inverse, -1).T
            b, B = size * right, size[:, None] * mixed
            logdet += 2.0 * float(np.log(np.diag(factor)).sum())
            S -= B.T @ inverse @ B
            s -= B.T @ inverse @ b
            square -= float(b @ inverse @ b)
            solved.append((inverse, b, B))
        if rank:
            values, vectors = np.linalg.eigh(S)
            values = np.maximum(values, 1e-12)
            back = (vectors / values) @ vectors.T
            square -= float(s @ back @ s)
            logdet += float(np.log(values).sum())
        else:
            back = S
        variance = max(1.0, square / self.samples)
        u = -back @ s
        mean, covariance, slope = [], [], np.zeros(self.count)
        for size, channel, (inverse, b, B) in zip(sizes, self.channel, solved, strict=True):
            a = -inverse @ (b + B @ u)
            C = inverse + inverse @ B @ back @ B.T @ inverse
            np.add.at(slope, channel, a**2 / variance - (1.0 - np.diag(C)))
            mean.append(size * a)
            covariance.append(variance * size[:, None] * C * size)
        evidence = -0.5 * (self.samples * np.log(variance) + square / variance + logdet)
        return Posterior(mean, covariance, np.sqrt(variance) * prior, evidence, variance, slope)

    def explained(self, found: Posterior) -> tuple[list[float], float]:
        """Shares of the channels in what they explain, and share of the squares beyond noise that they explain."""
        parts = np.zeros(self.count)
        for a, right, mixed, channel in zip(found.mean, self._right, self._mixed, self.channel, strict=True):
            np.add.at(parts, channel, -a * (right - mixed @ self._common))
        total = float(parts.sum())
        square = self._square - float(self._common @ self._common)
        excess = max(square - self.samples, 1e-12 * square)
        shares = np.maximum(parts, 0.0) / max(float(np.maximum(parts, 0.0).sum()), 1e-300)
        return shares.tolist(), min(total / excess, 1.0) if excess > 0.0 else 0.0

    def best(self, among: Sequence[int] | None = None) -> Posterior:
        """Posterior for the priors that make the residuals most probable; of channels not ``among`` they are zero."""
        free = np.arange(self.count) if among is None else np.array(sorted(among), dtype=int)
        if not len(free):
            return self.at(np.zeros(self.count))
        start = np.log(self.loud)
        found: list[Posterior] = []
        for quiet in ([], *([k] for k in free if len(free) > 1)):
            begin = start[free] - np.where(np.isin(free, quiet), 5.0, 0.0)
            found.append(self._climb(free, begin, start[free]))
        return max(found, key=lambda one: one.evidence)

    def around(self, prior: np.ndarray, free: Sequence[int]) -> Posterior:
        """Posterior for the best priors of some channels, those of the others as given."""
        middle = np.log(np.maximum(prior[list(free)], 1e-300))
        return self._climb(np.array(free), middle, middle, prior)

    def _climb(
        self, free: np.ndarray, begin: np.ndarray, middle: np.ndarray, others: np.ndarray | None = None
    ) -> Posterior:
        last: list[Posterior] = []
        fixed = np.zeros(self.count) if others is None else others

        def cost(z: np.ndarray) -> tuple[float, np.ndarray]:
            prior = fixed.copy()
            prior[free] = np.exp(z)
            one = self.at(prior)
            last[:] = [one]
            return -one.evidence, -one.slope[free]

        bounds = [(m - RANGE, m + RANGE) for m in middle]
        done = minimize(cost, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=SEARCH)
        cost(done.x)
        return last[0]
