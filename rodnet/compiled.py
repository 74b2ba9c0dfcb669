"""The compiler of rodnet's kernels: numba, with one set of options, cached across processes."""

from __future__ import annotations

import functools

from numba import njit

# IEEE division (inf and NaN instead of an exception per division) lets loops vectorise
compiled = functools.partial(njit, cache=True, error_model="numpy")

kernel = compiled()
inlined = compiled(inline="always")
