"""The compiler of rodnet's kernels: numba, with one set of options, cached across processes.

What is compiled is kept where `rodnet.kernel_cache` says; the first time, a warning of the logger
``rodnet`` tells why there is a wait.
"""

from __future__ import annotations

import functools
import logging
import sys
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

from rodnet.kernel_cache import find_cache

config: Any = numba.config
CACHE = find_cache(config.CACHE_DIR)
# IEEE division (inf and NaN instead of an exception per division) lets loops vectorise
njit: Any = functools.partial(numba.njit, error_model="numpy")


def compiled(function: Callable[..., Any], **options: Any) -> Any:
    """Return a function that is compiled when it is first called, and kept for other processes."""
    before, config.CACHE_DIR = config.CACHE_DIR, str(CACHE or "")
    kept = CACHE is not None and function.__module__ in sys.modules  # else no process could load it again
    try:
        return njit(cache=kept, **options)(function)
    except RuntimeError:  # it comes from a prompt: there is no file that could tell its changes
        return njit(**options)(function)
    finally:
        config.CACHE_DIR = before


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of arrays and numbers, once for all processes: a decorator.

    It is ``numba.njit`` with rodnet's options and rodnet's place for what is compiled. Changes of the
    function's own file are noticed, but not those of other files that it takes constants or functions
    from.

    Parameters
    ----------
    function : callable
        For instance the per-site twin of a drag law, see `rodnet.DragModel`.

    Returns
    -------
    callable
        The function, compiled at its first call for the types of its arguments.
    """
    return compiled(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function as a part of those that call it: a decorator."""
    return compiled(function, inline="always")


class _Notice(event.Listener):
    """Tells, once, that rodnet's own kernels are being compiled."""

    def __init__(self) -> None:
        self.wanted = True
        self.first = CACHE is None or next(CACHE.rglob("*.nbi"), None) is None

    def on_start(self, event: Any) -> None:
        if self.wanted and str(event.data["dispatcher"].py_func.__module__).startswith("rodnet."):
            self.wanted = False
            what = "its kernels, about 20 s" if self.first else "kernels"
            kept = f"the next start finds them in {CACHE}"
            if CACHE is None:
                kept = "they cannot be kept: set NUMBA_CACHE_DIR to a directory that can be written to"
            logging.getLogger("rodnet").warning("rodnet: compiling %s; %s", what, kept)

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Notice())
