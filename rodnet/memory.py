"""Freed memory goes back to the system, where the C library would keep it."""

from __future__ import annotations

import ctypes
import sys

LARGE = 10_000  # degrees of freedom, from which on it matters


def release(dof_count: int) -> None:
    """Return freed memory to the system after setting up something large; does nothing but on glibc.

    Setting up a robot leaves as much free memory in pieces as it keeps. Work arrays that come later are too
    large for these pieces, so without this both would count.
    """
    if dof_count < LARGE or not sys.platform.startswith("linux"):
        return
    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    except (OSError, AttributeError):  # another C library
        return
