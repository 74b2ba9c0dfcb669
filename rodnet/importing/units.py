"""Units of length: files keep them to themselves, so they are asked for, and doubted when odd."""

from __future__ import annotations

from typing import Any

import numpy as np

from rodnet.errors import MeshError
from rodnet.importing.findings import Findings, mm

METRES = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "cm": 1e-2, "centimeters": 1e-2, "mm": 1e-3, "millimeters": 1e-3,
    "um": 1e-6, "micrometers": 1e-6, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
}  # fmt: skip
SMALL, LARGE = 1e-3, 10.0  # sizes [m] that a robot made of rods rarely has
SMALLEST, LARGEST = 1e-12, 1e12  # and never has


def metres_per_unit(units: Any, known: str | None, source: str) -> float:
    """Return the metres in a unit of length.

    Parameters
    ----------
    units : str, float or None
        What the user said: a name or metres per unit.
    known : str or None
        What the file says.
    source : str
        Its name, for messages.

    Raises
    ------
    MeshError
        If neither says it, or it is no unit.
    """
    given = known if units is None else units
    if given is None:
        raise MeshError(
            f"{source} does not say its unit of length; pass units='mm' (or 'm', 'cm', 'um', 'in', or metres per unit)"
        )
    if isinstance(given, str):
        if given not in METRES:
            raise MeshError(
                f"{source}: units = {given!r} is not known; choose 'm', 'cm', 'mm', 'um', 'in' or metres per unit"
            )
        return METRES[given]
    if isinstance(given, bool) or not isinstance(given, int | float | np.number):
        raise MeshError(f"{source}: units = {given!r} must be a name like 'mm' or metres per unit")
    if not (np.isfinite(given) and given > 0):
        raise MeshError(f"{source}: units = {given!r} must be positive and finite")
    return float(given)


def check_size(size: float, scale: float, findings: Findings) -> None:
    """Doubt the unit of a robot that is ``size`` [m] long, read at ``scale`` metres per unit."""
    if not SMALLEST < size < LARGEST:
        raise MeshError(
            f"with {scale:g} m per unit the shape is {size:g} m long; pass other units=, or check the file"
        )
    if size > LARGE or size < SMALL:
        try_ = "mm" if size > LARGE else "m"
        other = size / scale * METRES[try_]
        if other == size:
            remedy = "check the file"
        else:
            remedy = f"if it is meant to be {mm(other)}, pass units='{try_}'"
        findings.warn(f"with {scale:g} m per unit the shape is {mm(size)} long; {remedy}")
