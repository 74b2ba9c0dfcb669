"""Units that files may be in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rodnet.errors import RecordingError

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}


def unit_factor(path: Path, name: str, unit: str, known: Mapping[str, float]) -> float:
    """Return what to multiply a column with, in which a file's ``unit`` stands; none is SI."""
    if unit and unit not in known:
        raise RecordingError(f"recording '{path}': '{name}' is in [{unit}]; use one of {', '.join(known)}")
    return known.get(unit, 1.0)
