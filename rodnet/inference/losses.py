"""Robust losses: functions of the squared residual that count large ones less, as scipy defines them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Function = Callable[[np.ndarray], np.ndarray]


class Loss(NamedTuple):
    """A loss and its first and second derivative by the squared residual."""

    value: Function
    first: Function
    second: Function


LOSSES: dict[str, Loss] = {
    "linear": Loss(lambda s: s, np.ones_like, np.zeros_like),
    "soft_l1": Loss(
        lambda s: 2.0 * (np.sqrt(1.0 + s) - 1.0),
        lambda s: (1.0 + s) ** -0.5,
        lambda s: -0.5 * (1.0 + s) ** -1.5,
    ),
    "huber": Loss(
        lambda s: np.where(s <= 1.0, s, 2.0 * np.sqrt(np.maximum(s, 1.0)) - 1.0),
        lambda s: np.where(s <= 1.0, 1.0, np.maximum(s, 1.0) ** -0.5),
        lambda s: np.where(s <= 1.0, 0.0, -0.5 * np.maximum(s, 1.0) ** -1.5),
    ),
    "cauchy": Loss(np.log1p, lambda s: 1.0 / (1.0 + s), lambda s: -((1.0 + s) ** -2.0)),
    "arctan": Loss(
        np.arctan, lambda s: 1.0 / (1.0 + s**2), lambda s: -2.0 * s / (1.0 + s**2) ** 2
    ),
}  # fmt: skip


def cost(r: np.ndarray, loss: str) -> float:
    """Half the sum of the losses of residuals, what a search minimises."""
    return 0.5 * float(LOSSES[loss].value(r**2).sum())


def variance_of(r: np.ndarray, loss: str) -> float:
    """Variance of the M-estimator against least squares with unit noise, <psi^2> / <psi'>^2."""
    first = LOSSES[loss].first(r**2)
    return float(np.mean((r * first) ** 2)) / slope_of(r, loss) ** 2


def slope_of(r: np.ndarray, loss: str) -> float:
    """Mean <psi'>, by which losses curve less than squares do."""
    first, second = (f(r**2) for f in LOSSES[loss][1:])
    return max(float(np.mean(first + 2.0 * r**2 * second)), 1e-3)
