"""Noise of an instrument: a white part, a slow part of each marker, one common to all, and outliers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rodnet.errors import RecordingError


@dataclass(frozen=True)
class NoiseModel:
    """How measured positions differ from true ones (docs, theory: noise).

    Of marker m, coordinate a: e = w + s_m + c. The white part w is independent from frame to frame; the slow
    part s_m and the part c common to all markers (a camera that moves) are Ornstein-Uhlenbeck processes.

    Parameters
    ----------
    white : float or array_like, shape (M,)
        Standard deviation of the white part, of one coordinate [m].
    slow : float or array_like, shape (M,)
        Standard deviation of the slow part of each marker [m].
    time : float
        Correlation time of the slow part [s].
    common : float
        Standard deviation of the common part [m].
    common_time : float
        Correlation time of the common part [s].
    dof : float
        Degrees of freedom of Student's t that the white part follows; infinite for a normal one.
    unsure : float
        Relative standard error of the power of what lasts long, where the slow part is an estimate.

    Raises
    ------
    RecordingError
        If a value is negative or not finite, or everything is zero.
    """

    white: Any
    slow: Any = 0.0
    time: float = 0.5
    common: float = 0.0
    common_time: float = 1.0
    dof: float = np.inf
    unsure: float = 0.0

    def __post_init__(self) -> None:
        for name in ("white", "slow"):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.ndim > 1 or not np.isfinite(value).all() or (value < 0.0).any():
                raise RecordingError(f"noise: {name} = {value} must be standard deviations in metres")
            object.__setattr__(self, name, value if value.ndim else float(value))
        for name in ("time", "common_time", "common", "unsure"):
            number = float(getattr(self, name))
            if not (np.isfinite(number) and number >= 0.0) or (name.endswith("time") and number == 0.0):
                raise RecordingError(f"noise: {name} = {number} must be positive")
            object.__setattr__(self, name, number)
        if not self.dof > 2.0:
            raise RecordingError(f"noise: dof = {self.dof} must be more than 2, or there is no variance")
        if not np.all(np.asarray(self.white) > 0.0):
            raise RecordingError(
                "noise: the white part must be more than zero; take the instrument's resolution"
            )

    def __str__(self) -> str:
        """Standard deviations, of markers that differ the least and the largest, and how long they last."""
        parts = [f"white {_span(self.white)}"]
        if np.any(self.slow):
            parts.append(f"slow {_span(self.slow)} for {self.time:.3g} s")
        if self.common:
            parts.append(f"common {self.common:.3g} for {self.common_time:.3g} s")
        if np.isfinite(self.dof):
            parts.append(f"white of Student's t with {self.dof:.3g} degrees of freedom")
        return f"noise: {', '.join(parts)}"

    def total(self, count: int) -> np.ndarray:
        """Standard deviation of one coordinate of each marker [m], shape (count,)."""
        white, slow = (np.broadcast_to(v, (count,)) for v in (self.white, self.slow))
        return np.sqrt(white**2 + slow**2 + self.common**2)

    @property
    def typical(self) -> float:
        """Standard deviation of one coordinate [m], rms over the markers."""
        white, slow = (float(np.mean(np.square(v))) for v in (self.white, self.slow))
        return float(np.sqrt(white + slow + self.common**2))

    def scaled(self, factor: float) -> NoiseModel:
        """Return the same with all standard deviations so many times as large."""
        return replace(self, white=factor * self.white, slow=factor * self.slow, common=factor * self.common)

    def covariance(self, t: np.ndarray, marker: int = 0) -> np.ndarray:
        """Covariance of one coordinate of a marker between frames [m^2], shape (T, T)."""
        lag = np.abs(np.subtract.outer(t, t))
        white, slow = (
            float(np.asarray(v).reshape(-1)[marker if np.ndim(v) else 0]) for v in (self.white, self.slow)
        )
        return (
            white**2 * np.eye(len(t))
            + slow**2 * np.exp(-lag / self.time)
            + self.common**2 * np.exp(-lag / self.common_time)
        )

    def effective_samples(self, t: np.ndarray, marker: int = 0) -> float:
        """How many independent frames would tell a constant as well as these correlated ones."""
        C = self.covariance(np.asarray(t, dtype=float), marker)
        return float(C[0, 0] * np.linalg.solve(C, np.ones(len(t))).sum())

    def whiten(self, t: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, float]:
        """Turn residuals into independent ones of unit variance.

        The innovations of a Kalman filter, so what is linear stays linear: derivatives of a prediction are
        whitened with the residual.

        Parameters
        ----------
        t : ndarray, shape (T,)
            Times [s].
        residual : ndarray, shape (T, M, 3) or (T, M, 3, columns)
            Measured less predicted [m]; NaN where nothing was measured, in the first column of trailing ones.

        Returns
        -------
        whitened : ndarray
            Of the same shape; zero where nothing was measured.
        logdet : float
            Logarithm of the covariance's determinant, of what was measured.
        """
        r = np.asarray(residual, dtype=float)
        shape, (frames, count) = r.shape, r.shape[:2]
        seen = np.isfinite(r[..., 0] if r.ndim == 4 else r).all(axis=2)  # what else is not finite shows
        r = r.reshape(frames, count, -1)
        white, slow = (np.broadcast_to(v, (count,)).astype(float) for v in (self.white, self.slow))
        if self.common == 0.0:
            out, logdet = _whiten_apart(t, r, seen, white**2, slow**2, self.time)
        else:
            out, logdet = _whiten_together(
                t, r, seen, white**2, slow**2, self.time, self.common**2, self.common_time
            )
        return out.reshape(shape), 3.0 * logdet

    def sample(self, t: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw errors of ``count`` markers [m], shape (T, count, 3)."""
        t = np.asarray(t, dtype=float)
        white, slow = (np.broadcast_to(v, (count,))[:, None] for v in (self.white, self.slow))
        shape = (len(t), count, 3)
        if np.isfinite(self.dof):
            w = rng.standard_t(self.dof, shape) * np.sqrt((self.dof - 2.0) / self.dof)
        else:
            w = rng.standard_normal(shape)
        own, shared = rng.standard_normal(shape), rng.standard_normal((len(t), 1, 3))
        return white * w + slow * _ou(t, own, self.time) + self.common * _ou(t, shared, self.common_time)

    def to_dict(self) -> dict[str, Any]:
        """Return the values, as JSON takes them."""
        return {
            k: v.tolist() if isinstance(v, np.ndarray) else (None if v == np.inf else v)
            for k, v in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> NoiseModel:
        """Return the model that `to_dict` described."""
        return cls(**{**values, "dof": np.inf if values.get("dof") is None else values["dof"]})


def _span(value: Any) -> str:
    least, largest = f"{np.min(value):.3g}", f"{np.max(value):.3g}"
    return least if least == largest else f"{least} to {largest}"


def _ou(t: np.ndarray, z: np.ndarray, time: float) -> np.ndarray:
    """Ornstein-Uhlenbeck processes of unit variance from normal deviates."""
    rho = np.exp(-np.diff(t) / time)
    x = z.copy()
    for k in range(1, len(t)):
        x[k] = rho[k - 1] * x[k - 1] + np.sqrt(1.0 - rho[k - 1] ** 2) * z[k]
    return x


def _whiten_apart(
    t: np.ndarray, r: np.ndarray, seen: np.ndarray, white: np.ndarray, slow: np.ndarray, time: float
) -> tuple[np.ndarray, float]:
    """Innovations where markers have nothing in common: one scalar filter each."""
    out, mean, var, logdet = np.zeros_like(r), np.zeros(r.shape[1:]), slow.copy(), 0.0
    for k in range(len(t)):
        if k:
            rho = np.exp(-(t[k] - t[k - 1]) / time)
            mean *= rho
            var = rho**2 * var + (1.0 - rho**2) * slow
        s, S = seen[k], var + white
        innovation = np.where(s[:, None], r[k] - mean, 0.0)
        out[k] = innovation / np.sqrt(S)[:, None]
        logdet += float(np.log(S[s]).sum())
        gain = np.where(s, var / S, 0.0)
        mean += gain[:, None] * innovation
        var = var * (1.0 - gain)
    return out, logdet


def _whiten_together(
    t: np.ndarray, r: np.ndarray, seen: np.ndarray, white: np.ndarray, slow: np.ndarray, time: float,
    common: float, common_time: float,
) -> tuple[np.ndarray, float]:  # fmt: skip
    """Innovations with a part common to all markers: one filter whose last state it is."""
    count = r.shape[1]
    stationary = np.diag(np.append(slow, common))
    H = np.hstack([np.eye(count), np.ones((count, 1))])
    out, mean, P, logdet = np.zeros_like(r), np.zeros((count + 1, r.shape[2])), stationary.copy(), 0.0
    for k in range(len(t)):
        if k:
            step = t[k] - t[k - 1]
            rho = np.append(np.full(count, np.exp(-step / time)), np.exp(-step / common_time))
            mean *= rho[:, None]
            P = P * np.outer(rho, rho) + stationary * (1.0 - np.outer(rho, rho))
        s = seen[k]
        if not s.any():
            continue
        h = H[s]
        root = np.linalg.cholesky(h @ P @ h.T + np.diag(white[s]))
        whitened = np.linalg.solve(root, r[k, s] - h @ mean)
        gain = np.linalg.solve(root, h @ P)  # root^-1 H P
        out[k, s] = whitened
        logdet += 2.0 * float(np.log(np.diag(root)).sum())
        mean += gain.T @ whitened
        P = P - gain.T @ gain
    return out, logdet
