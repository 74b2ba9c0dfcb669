"""Sweeps over parameters with one and two workers."""

from __future__ import annotations

import importlib.util

from benchmarks.cases import Options, Result

TITLE = "Sweeps"


def measure(options: Options) -> Result:
    """Compare one worker with two, once rodnet has sweeps."""
    if importlib.util.find_spec("rodnet.sweep") is None:
        return Result(TITLE, "This rodnet has no rodnet.sweep.")
    return Result(TITLE, "Not measured yet.")
