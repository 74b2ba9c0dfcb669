"""Eight columns of a block at a time, as compiled kernels see them.

Eight numbers fit into vector registers, and read before anything is written they leave no doubt about
arrays that overlap, which would keep the compiler from using these. Indices without a sign spare the test
whether one counts from the end of an array. Blocks are flat: ``at(row, columns, panel)`` is where a row's
eight columns begin.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rodnet.compiled import config, kernel

U = np.uint64
WIDTH = 8
_1, _2, _3, _4, _5, _6, _7 = (U(k) for k in range(1, 8))


def wide(function: Callable[..., Any]) -> Any:
    """Compile a kernel with vector instructions for code without loops, which numba leaves out by itself."""
    made = kernel(function)
    if config.DISABLE_JIT:
        return made
    plain = made.compile

    def compile_wide(signature: Any) -> Any:
        before, config.SLP_VECTORIZE = config.SLP_VECTORIZE, 1
        try:
            return plain(signature)
        finally:
            config.SLP_VECTORIZE = before

    made.compile = compile_wide
    return made


@kernel
def at(row, columns, panel):
    """Where eight columns of a row begin."""
    return U(row) * columns + panel


@kernel
def load(y, o):
    """Eight numbers."""
    return y[o], y[o + _1], y[o + _2], y[o + _3], y[o + _4], y[o + _5], y[o + _6], y[o + _7]


@kernel
def store(y, o, a):
    """Write eight numbers."""
    y[o], y[o + _1], y[o + _2], y[o + _3] = a[0], a[1], a[2], a[3]
    y[o + _4], y[o + _5], y[o + _6], y[o + _7] = a[4], a[5], a[6], a[7]


@kernel
def add(a, f, b):
    """Sum of a and f times b."""
    return (
        a[0] + f * b[0], a[1] + f * b[1], a[2] + f * b[2], a[3] + f * b[3],
        a[4] + f * b[4], a[5] + f * b[5], a[6] + f * b[6], a[7] + f * b[7],
    )  # fmt: skip


@kernel
def times(f, a):
    """Product with a number f."""
    return f * a[0], f * a[1], f * a[2], f * a[3], f * a[4], f * a[5], f * a[6], f * a[7]


@kernel
def across(y, j, i):
    """Difference of eight numbers at two places."""
    return (
        y[j] - y[i], y[j + _1] - y[i + _1], y[j + _2] - y[i + _2], y[j + _3] - y[i + _3],
        y[j + _4] - y[i + _4], y[j + _5] - y[i + _5], y[j + _6] - y[i + _6], y[j + _7] - y[i + _7],
    )  # fmt: skip
