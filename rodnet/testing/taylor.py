"""Differences and Taylor tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np


def differences(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Derivative of a vector function by central differences of fourth order.

    Parameters
    ----------
    function : callable
        From ``(n,)`` to ``(m,)``.
    x, steps : ndarray, shape (n,)
        Where, and the step of each argument.

    Returns
    -------
    ndarray, shape (m, n)
    """
    if not len(x):
        return np.zeros((len(function(x)), 0))
    columns = []
    for k, h in enumerate(steps):
        step = np.zeros_like(x)
        step[k] = h
        near = np.asarray(function(x + step)) - function(x - step)
        far = np.asarray(function(x + 2.0 * step)) - function(x - 2.0 * step)
        columns.append((8.0 * near - far) / (12.0 * h))
    return np.stack(columns, axis=-1)


def taylor_slope(
    function: Callable[[float], float | np.ndarray],
    coefficients: Sequence[float | np.ndarray],
    largest: float = 1e-1,
    count: int = 10,
) -> float:
    """Order of the remainder of a Taylor polynomial, ``|f(h) - sum_k c_k h^k| ~ h^slope``.

    With correct derivatives of order n the slope is n + 1 (or more, by symmetry); with a wrong
    last one it is n.

    Parameters
    ----------
    function : callable
        Of the step ``h``, scalar or array valued.
    coefficients : sequence
        ``f(0)``, ``f'(0)``, ``f''(0) / 2`` and so on.
    largest : float
        Largest step; it is halved ``count - 1`` times.

    Returns
    -------
    float
        Median slope over the steps whose remainder stands out of round-off; infinity if none does.
    """
    steps = largest * 0.5 ** np.arange(count)
    values = [np.asarray(function(h), dtype=float) for h in steps]
    floor = (
        1e3  # terms whose rounding errors a sum may hold
        * np.finfo(float).eps
        * max(float(np.abs(v).max(initial=0.0)) for v in [*values, np.asarray(coefficients[0])])
    )
    remainders = []
    for h, value in zip(steps, values, strict=True):
        polynomial = sum(np.asarray(c) * h**k for k, c in enumerate(coefficients))
        remainders.append(float(np.linalg.norm(value - polynomial)))
    kept = [r for r in remainders if r > floor]
    if len(kept) < 3:
        return np.inf
    # the last steps that stand out are the most asymptotic ones
    slopes = np.log2(np.array(kept[:-1]) / np.array(kept[1:]))
    return float(np.median(slopes[-3:]))
