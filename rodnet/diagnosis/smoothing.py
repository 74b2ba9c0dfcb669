"""Linear-Gaussian posterior of what trials were pushed by, its strengths chosen by evidence."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri
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
        self.looked = 0  # samples of the trials that are looked at
        parts = [slice(int(e) - len(one), int(e)) for e, one in zip(ends, residuals, strict=True)]
        self.count = int(np.max(channel)) + 1
        self.samples = len(r) - U.shape[1]
        self._gram: list[np.ndarray] = []
        self._right: list[np.ndarray] = []
        self._mixed: list[np.ndarray] = []
        for part, G in zip(parts, columns, strict=False):  # one after the other: they may be large
            self.looked += part.stop - part.start
            self._gram.append(G.T @ G)
            self._right.append(G.T @ r[part])
            self._mixed.append(G.T @ U[part])
        self.channel = [np.asarray(channel)] * len(self._gram)
        self._flat = [np.zeros(0, dtype=int)] * len(self._gram)  # among which the Gram matrices are diagonal
        self._square, self._common = float(r @ r), U.T @ r

    def mapped(self, maps: Sequence[np.ndarray], channel: Sequence[np.ndarray]) -> Smoother:
        """The same for other coefficients b, a = M b: by trial maps (K, L), or their diagonals, and channels (L,)."""
        other = copy.copy(self)
        other._flat = [np.zeros(0, dtype=int)] * len(maps)
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
        return np.sqrt(LOUD * self.looked / np.maximum(seen, 1e-12 * max(seen.max(), 1e-300)))

    def at(self, prior: np.ndarray) -> Posterior:
        """Posterior for given priors."""
        evidence, slope, variance, solved = self._solve(prior)
        mean = [prior[channel] * a for channel, (a, *_) in zip(self.channel, solved, strict=True)]
        covariance = []
        for channel, (_, root, G) in zip(self.channel, solved, strict=True):
            size, H = prior[channel], root.whole()
            covariance.append(variance * size[:, None] * (H.T @ H + G @ G.T) * size)
        return Posterior(mean, covariance, np.sqrt(variance) * prior, evidence, variance, slope)

    def _solve(
        self, prior: np.ndarray
    ) -> tuple[float, np.ndarray, float, list[tuple[np.ndarray, _Root, np.ndarray]]]:
        """Evidence, its slope, variance; by trial the coefficients over their priors, and roots of their covariance."""
        rank = len(self._common)
        S, s = np.eye(rank), self._common.copy()
        parts, logdet, square = [], 0.0, self._square
        for k, channel in enumerate(self.channel):
            size = prior[channel]
            root = _Root.of(self._gram[k], size, self._flat[k])
            y, Y = root.times(size * self._right[k]), root.times(size[:, None] * self._mixed[k])
            logdet += root.logdet
            S -= Y.T @ Y
            s -= Y.T @ y
            square -= float(y @ y)
            parts.append((root, y, Y))
        values, vectors = np.linalg.eigh(S) if rank else (np.ones(0), np.zeros((0, 0)))
        values = np.maximum(values, 1e-12)
        half = vectors / np.sqrt(values)
        u = -half @ (half.T @ s)
        square += float(s @ u)
        logdet += float(np.log(values).sum())
        variance = max(1.0, square / self.samples)
        slope, solved = np.zeros(self.count), []
        for channel, (root, y, Y) in zip(self.channel, parts, strict=True):
            a, G = -root.back(y + Y @ u), root.back(Y) @ half
            np.add.at(slope, channel, a**2 / variance - (1.0 - root.squares() - (G**2).sum(axis=1)))
            solved.append((a, root, G))
        evidence = -0.5 * (self.samples * np.log(variance) + square / variance + logdet)
        return evidence, slope, variance, solved

    def _turned(self) -> Smoother:
        """The same for other coefficients of the widest channel, each of which the residuals see by itself.

        They are as large beforehand as those that they stand for, so that nothing changes but the work.
        """
        maps, other = [], int(np.argmax(np.bincount(self.channel[0])))
        for gram, channel in zip(self._gram, self.channel, strict=True):
            mine = np.flatnonzero(channel == other)
            M = np.eye(len(channel))
            M[np.ix_(mine, mine)] = np.linalg.eigh(gram[np.ix_(mine, mine)])[1]
            maps.append(M)
        found = self.mapped(maps, self.channel)
        found.count = self.count
        found._flat = [np.flatnonzero(channel == other) for channel in self.channel]
        return found

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
        start, turned = np.log(self.loud), self._turned()
        found: list[tuple[float, np.ndarray]] = []
        for quiet in ([], *([k] for k in free if len(free) > 1)):
            begin = start[free] - np.where(np.isin(free, quiet), 5.0, 0.0)
            found.append(turned._climb(free, begin, start[free]))
        return self.at(max(found, key=lambda one: one[0])[1])

    def around(self, prior: np.ndarray, free: Sequence[int]) -> Posterior:
        """Posterior for the best priors of some channels, those of the others as given."""
        middle = np.log(np.maximum(prior[list(free)], 1e-300))
        return self.at(self._climb(np.array(free), middle, middle, prior)[1])

    def _climb(
        self, free: np.ndarray, begin: np.ndarray, middle: np.ndarray, others: np.ndarray | None = None
    ) -> tuple[float, np.ndarray]:
        """Largest evidence, and the priors."""
        prior = np.zeros(self.count) if others is None else others.copy()

        def cost(z: np.ndarray) -> tuple[float, np.ndarray]:
            prior[free] = np.exp(z)
            evidence, slope, *_ = self._solve(prior)
            return -evidence, -slope[free]

        bounds = [(m - RANGE, m + RANGE) for m in middle]
        done = minimize(cost, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=SEARCH)
        prior[free] = np.exp(done.x)
        return -float(done.fun), prior


@dataclass(frozen=True)
class _Root:
    """A matrix H with (1 + T A T)^-1 = H^T H, for T a diagonal and A positive: some coefficients apart, and the rest.

    Attributes
    ----------
    flat, rest : ndarray of int
        Coefficients among which A is diagonal, and the others.
    scale : ndarray
        Of the first rows of H, one for each of ``flat``, which it is all that they have.
    lower, mixed : ndarray, shapes (rest, rest), (rest, flat)
        The other rows.
    logdet : float
        Of 1 + T A T.
    """

    flat: np.ndarray
    rest: np.ndarray
    scale: np.ndarray
    lower: np.ndarray
    mixed: np.ndarray
    logdet: float

    @classmethod
    def of(cls, gram: np.ndarray, size: np.ndarray, flat: np.ndarray) -> _Root:
        """Factorise; only the lower triangle of what is not flat counts."""
        rest = (
            np.setdiff1d(np.arange(len(size)), flat, assume_unique=True)
            if len(flat)
            else np.arange(len(size))
        )
        D = 1.0 + gram[flat, flat] * size[flat] ** 2
        own = gram if not len(flat) else gram[np.ix_(rest, rest)]
        M = size[rest, None] * own * size[rest]
        M[np.arange(len(rest)), np.arange(len(rest))] += 1.0
        across = size[rest, None] * gram[np.ix_(rest, flat)] * (size[flat] / D)
        factor, failed = dpotrf(M - (across * D) @ across.T if len(flat) else M, lower=1)
        if failed:
            raise np.linalg.LinAlgError("the columns of a force are not finite")
        lower = dtrtri(factor, lower=1)[0] if len(rest) else factor  # LAPACK knows no empty matrix
        logdet = float(np.log(D).sum() + 2.0 * np.log(np.diag(factor)).sum())
        lower = np.tril(lower)
        return cls(flat, rest, 1.0 / np.sqrt(D), lower, -lower @ across, logdet)

    def times(self, x: np.ndarray) -> np.ndarray:
        """H x."""
        if not len(self.flat):
            return np.asarray(self.lower @ x)
        mine = x[self.flat]
        first = self.scale * mine if x.ndim == 1 else self.scale[:, None] * mine
        return np.concatenate([first, self.lower @ x[self.rest] + self.mixed @ mine])

    def back(self, y: np.ndarray) -> np.ndarray:
        """H^T y."""
        if not len(self.flat):
            return np.asarray(self.lower.T @ y)
        count, out = len(self.flat), np.empty((len(self.flat) + len(self.rest), *y.shape[1:]))
        first = self.scale * y[:count] if y.ndim == 1 else self.scale[:, None] * y[:count]
        out[self.flat], out[self.rest] = first + self.mixed.T @ y[count:], self.lower.T @ y[count:]
        return out

    def squares(self) -> np.ndarray:
        """Diagonal of H^T H."""
        out = np.empty(len(self.flat) + len(self.rest))
        out[self.flat] = self.scale**2 + (self.mixed**2).sum(axis=0)
        out[self.rest] = (self.lower**2).sum(axis=0)
        return out

    def whole(self) -> np.ndarray:
        """H itself."""
        return self.times(np.eye(len(self.flat) + len(self.rest)))
