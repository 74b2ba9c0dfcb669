"""Searching the minimum of a calibration: several starts, failed simulations, outliers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from rodnet.errors import ConvergenceError
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.problem import Problem, reject
from rodnet.inference.result import Optimum

INSIDE = 1e-6  # distance of a start from bounds, of a coordinate
SPREAD = 0.7  # of other starts, of a coordinate
ROUNDS = 4  # of leaving out outliers
FLAT = 1e-8  # relative change of the sum of squares, or of coordinates, at which a fit ends


def search(
    problem: Problem, loss: str, starts: int, seed: int, evaluations: int, tell: Callable[[str], None]
) -> Optimum:
    """Search from several places, and return the best minimum."""
    rng, count = np.random.default_rng(seed), len(problem.quantities)
    found: list[Optimum] = []
    for k in range(starts):
        z = np.zeros(count) if k == 0 else SPREAD * rng.standard_normal(count)
        one = minimise(problem, z, loss, evaluations, tell)
        if one is not None:
            found.append(one)
            tell(f"start {k + 1} of {starts}: {one.message}")
    if not found:
        raise ConvergenceError(f"no start can be simulated: {problem.failures[-1]}")
    return min(found, key=lambda one: one.cost)


def minimise(
    problem: Problem, z: np.ndarray, loss: str, evaluations: int, tell: Callable[[str], None],
    fixed: Sequence[int] = (), flat: float = FLAT,
) -> Optimum | None:  # fmt: skip
    """Minimise from one place; None if it cannot be simulated there. ``fixed`` coordinates stay.

    It ends where the sum of squares changes by less than ``flat`` of itself.
    """
    low, high = (np.array(b) for b in zip(*(q.bounds for q in problem.quantities), strict=True))
    z = np.clip(
        z, np.where(np.isfinite(low), low + INSIDE, low), np.where(np.isfinite(high), high - INSIDE, high)
    )
    move = np.setdiff1d(np.arange(len(z)), fixed)
    begin = problem.joint(z)
    if begin is None:
        return None
    size = len(begin[0])

    def full(y: np.ndarray) -> np.ndarray:
        out = z.copy()
        out[move] = y
        return out

    def residual(y: np.ndarray) -> np.ndarray:
        joint = problem.joint(full(y))
        if joint is None:
            tell("a trial cannot be simulated there: shorter step")
            return np.full(size, np.inf)  # the optimiser takes a shorter step
        tell(f"evaluation {problem.evaluations}: residual {np.sqrt(np.mean(joint[0] ** 2)):.4g} sd")
        return joint[0]

    def jacobian(y: np.ndarray) -> np.ndarray:
        joint = problem.joint(full(y))
        assert joint is not None
        return joint[1][:, move]

    found = least_squares(
        residual, z[move], jacobian, (low[move], high[move]), method="trf", loss=loss, x_scale=1.0,
        ftol=flat, xtol=FLAT, gtol=None, max_nfev=evaluations,
    )  # fmt: skip
    return Optimum(full(found.x), float(found.cost), bool(found.success), _message(found, evaluations))


def _message(found: Any, evaluations: int) -> str:
    if found.success:
        return f"converged in {found.nfev} evaluations"
    return (
        f"not converged in {evaluations} evaluations; allow more (evaluations=), or begin elsewhere (start=)"
    )


def without_outliers(
    problem: Problem, trials: Sequence[Comparison], best: Optimum, threshold: float, loss: str, evaluations: int,
    tell: Callable[[str], None],
) -> Optimum:  # fmt: skip
    """Leave out what stands out of the noise, and fit again, until nothing changes."""
    for _ in range(ROUNDS):
        fits: list[Fit] | None = problem.at(best.z)
        assert fits is not None
        masks = [reject(t, f, threshold) for t, f in zip(trials, fits, strict=True)]
        same = all(np.array_equal(a, b) for new, old in zip(masks, problem.rejected, strict=True)
                   for a, b in zip(new, old, strict=True))  # fmt: skip
        if same:
            break
        problem.rejected = masks
        problem.forget()
        tell(f"{sum(int(m.sum()) for trial in masks for m in trial)} outliers left out")
        again = minimise(problem, best.z, loss, evaluations, tell)
        if again is None:
            break
        best = again
    return best
