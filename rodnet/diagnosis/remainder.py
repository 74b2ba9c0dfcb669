"""Whether anything is left in the residuals that noise would not leave, where, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import f as f_of

from rodnet.diagnosis.scales import Noise
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.workbench import Fitted
from rodnet.inference.corrections import is_record

TIMES, ALONG = 6, 4  # smooth functions of time and of the number of the marker
FEWEST = 30  # residuals beside the smooth ones, to tell anything
MARGIN = 0.03  # variance of the smooth part over that of the rest that an estimate of the noise may be off by
ALONE = 1e-6  # share of a smooth direction that others must leave of it
SURELY = 2.0  # standard errors of what lasts long in an estimate of the noise


@dataclass(frozen=True)
class Remainder:
    """A test of what a model leaves, against what is smooth in time and along the body.

    Attributes
    ----------
    p : float
        Probability of as much smooth remainder from noise alone.
    ratio : float
        Variance in the smooth directions over that of the rest: 1 without a remainder.
    excess : float
        Rms of the smooth part over all samples, in standard deviations of the noise.
    where : dict of dict
        Shares of the smooth part by instrument and marker, by their names.
    when : list of float
        Shares of the smooth part by tenth of a trial's time.
    trials : list of float
        By trial.
    grips : float
        [sigma] what was left beside that, and is as if each trial were held a little elsewhere.
    estimated : float
        The probability, if the noise is as it was estimated; ``p`` allows for how wrong an estimate may be.
    tested : bool
        Whether there are samples enough to tell anything.
    records : float
        Rms of the errors of drives' records that are carried along, over what their noise lets expect.
    """

    p: float
    ratio: float
    excess: float
    where: dict[str, dict[str, float]]
    when: list[float]
    trials: list[float]
    grips: float = 0.0
    estimated: float = 1.0
    tested: bool = True
    records: float = 0.0


def test_remainder(fitted: Fitted, noise: Noise = (), beside: np.ndarray | None = None) -> Remainder:
    """Compare the smooth part of the whitened residuals with the rest, nominal parameters projected out.

    The directions are products of cosines of time and of the marker's number, by coordinate and by trial. That they
    are compared with the rest makes the test independent of the level of the noise; how slow it is must be known, and
    where that is an estimate, ``noise`` of the trials' instruments says by how much the smooth part may be off. What
    is ``beside`` the nominal parameters, columns of shape (n, k), is projected out with them.
    """
    basis = Basis.of(fitted.jacobian if beside is None else np.hstack([fitted.jacobian, beside]))
    r, blocks, places = basis.out(fitted.residual), [], []
    end = 0
    for fit in fitted.fits:
        tenths = np.minimum(10.0 * (fit.t - fit.t[0]) / max(fit.t[-1] - fit.t[0], 1e-300), 9.0).astype(int)
        for white, seen, label in zip(fit.whitened, fit.seen, fit.labels, strict=True):
            columns, at = _smooth(white, seen)
            start, end = end, end + len(columns)
            blocks.append((slice(start, end), _directions(columns)))
            places.append((start, end, at, label, tenths))
    part, m = _part(blocks, basis, r)
    n = fitted.samples
    rest = n - m - basis.U.shape[1]
    shares = _shares(part, places, [len(f.residual) for f in fitted.fits])
    if rest < FEWEST:  # nothing rough to compare with
        return Remainder(1.0, 1.0, 0.0, *shares, tested=False, records=_misread(fitted))
    smooth, rough = float(part @ part) / m, max(float(r @ r - part @ part), 1e-300) / rest
    unsure = max((model.unsure for own in noise for model in own.values()), default=0.0)
    p, estimated = (
        float(f_of.sf(smooth / rough / (1.0 + MARGIN + wrong), m, rest)) for wrong in (SURELY * unsure, 0.0)
    )
    excess = float(np.sqrt(max(part @ part - m * rough, 0.0) / n))
    return Remainder(p, smooth / rough, excess, *shares, estimated=estimated, records=_misread(fitted))


def _misread(fitted: Fitted) -> float:
    """Rms of errors of drives' records over their prior's standard deviation; 0 where there are none."""
    shares = [
        fitted.own[q.trial][q.path] / q.prior.std()
        for q in fitted.quantities
        if q.trial is not None and q.prior is not None and is_record(q.path)
    ]
    return float(np.sqrt(np.mean(np.square(shares)))) if shares else 0.0


def _directions(columns: np.ndarray) -> np.ndarray:
    """Orthonormal directions of columns, shape (n, m)."""
    Q, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(Q[:, s > ALONE * s.max(initial=0.0)])


def _part(blocks: Sequence[tuple[slice, np.ndarray]], basis: Basis, r: np.ndarray) -> tuple[np.ndarray, int]:
    """What of a residual without the nominal parameters is in smooth directions without them, and how many these are.

    The smooth directions Q have rows of their own each, and only the few that the nominal parameters U resemble,
    those of W = Q^T U, are changed by taking these out: of all of them together nothing has to be decomposed.
    """
    y = np.concatenate([Q.T @ r[rows] for rows, Q in blocks])
    W = np.concatenate([Q.T @ basis.U[rows] for rows, Q in blocks])
    A, c, _ = np.linalg.svd(W, full_matrices=False)
    left = 1.0 - c**2  # of their squares
    kept = left > ALONE**2
    z = A.T @ y
    x = y + A @ (np.where(kept, z / np.where(kept, left, 1.0), 0.0) - z)
    part, begin = -basis.U @ (W.T @ x), 0
    for rows, Q in blocks:
        part[rows] += Q @ x[begin : begin + Q.shape[1]]
        begin += Q.shape[1]
    return part, len(y) - int(np.sum(~kept))


def _smooth(white: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smooth functions at the samples that there are, and their (frame, marker); rows as in a residual."""
    frames, markers, axes = white.shape
    tau = (np.arange(frames) + 0.5) / frames
    along = (np.arange(markers) + 0.5) / markers
    time = np.cos(np.pi * np.outer(tau, np.arange(min(TIMES, frames))))
    body = np.cos(np.pi * np.outer(along, np.arange(min(ALONG, markers))))
    both = np.einsum("fi,mj->fmij", time, body).reshape(frames, markers, -1)
    out = np.zeros((frames, markers, axes, axes, both.shape[2]))
    for a in range(axes):
        out[:, :, a, a] = both
    at = np.repeat(np.argwhere(seen), axes, axis=0)
    return out[seen].reshape(-1, axes * both.shape[2]), at


def _shares(
    part: np.ndarray,
    places: Sequence[tuple[int, int, np.ndarray, tuple[str, list[str]], np.ndarray]],
    lengths: Sequence[int],
) -> tuple[dict[str, dict[str, float]], list[float], list[float]]:
    """Shares of the squares of a part by instrument and marker, by tenth of the time, and by trial."""
    where: dict[str, dict[str, float]] = {}
    when = np.zeros(10)
    total = max(float(part @ part), 1e-300)
    for start, end, at, (name, samples), tenths in places:
        power = part[start:end] ** 2 / total
        there = where.setdefault(name, {})
        for k, share in enumerate(np.bincount(at[:, 1], power, len(samples))):
            there[samples[k]] = there.get(samples[k], 0.0) + float(share)
        np.add.at(when, tenths[at[:, 0]], power)
    ends = np.cumsum([0, *lengths])
    trials = [float(part[a:b] @ part[a:b]) / total for a, b in pairwise(ends)]
    return where, when.tolist(), trials
