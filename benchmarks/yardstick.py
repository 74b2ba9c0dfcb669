"""What this machine can do at best: compiled loops without anything around them.

The yardstick of a time step is a banded LU of as many unknowns as the robot has, with the bandwidth
of a rod (a spring couples 11 consecutive unknowns) known to the compiler and without pivoting: about
the least that an implicit method for rods can do per iteration.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from benchmarks.timing import Clock, Work, best_loop

BAND = 10
WIDTH = 2 * BAND + 1
_compiled = njit(cache=True, error_model="numpy")


@_compiled
def factor(bands, lu):
    """LU of a banded matrix; row i holds the columns i - 10 ... i + 10, and 10 empty rows follow."""
    lu[:] = bands
    for k in range(lu.shape[0] - BAND):
        inverse = 1.0 / lu[k, BAND]
        for i in range(1, BAND + 1):
            multiplier = lu[k + i, BAND - i] * inverse
            lu[k + i, BAND - i] = multiplier
            for j in range(1, BAND + 1):
                lu[k + i, BAND - i + j] -= multiplier * lu[k, BAND + j]


@_compiled
def solve(lu, b, x):
    """Solve with the factors; ``x`` has 10 more entries than ``b`` before and after."""
    n = b.shape[0]
    for k in range(n):
        s = b[k]
        for j in range(BAND):
            s -= lu[k, j] * x[k + j]
        x[k + BAND] = s
    for k in range(n - 1, -1, -1):
        s = x[k + BAND]
        for j in range(1, BAND + 1):
            s -= lu[k, BAND + j] * x[k + BAND + j]
        x[k + BAND] = s / lu[k, BAND]


@_compiled
def _repeat(bands, lu, b, x, count):
    for _ in range(count):
        factor(bands, lu)
        x[:] = 0.0
        solve(lu, b, x)


class Banded:
    """A banded system of a given size."""

    def __init__(self, size: int) -> None:
        rng = np.random.default_rng(0)
        self.bands = rng.standard_normal((size + BAND, WIDTH))
        self.bands[:, BAND] += 4.0 * BAND
        columns = np.arange(size + BAND)[:, None] + np.arange(-BAND, BAND + 1)
        self.bands[(columns < 0) | (columns >= size)] = 0.0
        self.bands[size:] = 0.0
        self.lu, self.b = np.empty_like(self.bands), rng.standard_normal(size)
        self.x = np.zeros(size + 2 * BAND)

    def solution(self) -> np.ndarray:
        """Factorise and solve once."""
        self.run(1)
        return self.x[BAND:-BAND]

    def run(self, count: int) -> None:
        """Factorise and solve so many times, in compiled code throughout."""
        _repeat(self.bands, self.lu, self.b, self.x, count)

    def contender(self, count: int) -> Work:
        """Work for `timing.interleave`."""
        return lambda: self.run(count)


@_compiled
def _triad(a, b, c, count):
    for k in range(count):
        for i in range(a.shape[0]):
            a[i] = b[i] + 0.5 * c[i]
        b[k % b.shape[0]] += 1.0


@_compiled
def _multiply_add(count, start):
    x = np.full(64, start)
    for _ in range(count):
        for i in range(64):
            x[i] = x[i] * 0.999999 + 1e-9
    return x.sum()


@njit(cache=True, fastmath={"contract"})
def _fused(count, start):
    x = np.full(64, start)
    for _ in range(count):
        for i in range(64):
            x[i] = x[i] * 0.999999 + 1e-9
    return x.sum()


def machine_rates(clock: Clock) -> dict[str, float]:
    """Streaming rates from the first-level cache and from memory [byte/s], and rate of additions and products [1/s]."""
    rates = {}
    for name, size in (("cache", 1024), ("memory", 4_000_000)):
        a, b, c = np.ones((3, size))
        count = max(1, 4_000_000 // size)
        seconds = best_loop(lambda: _triad(a, b, c, count), clock, at_least=2e-2)  # noqa: B023
        rates[f"{name}_bytes_per_s"] = 24.0 * size * count / seconds
    seconds = best_loop(lambda: _multiply_add(200_000, 1.0), clock)
    rates["flops_per_s"] = 2.0 * 64 * 200_000 / seconds
    seconds = best_loop(lambda: _fused(200_000, 1.0), clock)
    rates["flops_per_s"] = max(rates["flops_per_s"], 2.0 * 64 * 200_000 / seconds)
    return rates
