"""What an import found on its way: repairs that it made and warnings that name a remedy."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Findings:
    """Notes on harmless repairs, and warnings; a warning is also a Python warning."""

    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    announced: int = 0

    def note(self, text: str) -> None:
        """Keep a remark for the report."""
        self.notes.append(text)

    def warn(self, text: str) -> None:
        """Keep a warning for the report; `announce` issues it."""
        self.warnings.append(text)

    def announce(self, source: str) -> None:
        """Issue the warnings since the last time, to the caller of ``rodnet.from_...``."""
        new, self.announced = self.warnings[self.announced :], len(self.warnings)
        for text in new:
            warnings.warn(f"{source}: {text}", stacklevel=3)


UNITS = (("m", 1.0), ("mm", 1e-3), ("um", 1e-6))


def digits(value: float) -> str:
    """Return a number with three digits and no exponent, ``1230`` or ``0.0123``."""
    return f"{float(f'{value:.3g}') + 0.0:.15g}"


def unit_of(*lengths: float) -> tuple[str, float]:
    """Return the unit that suits lengths [m], by the largest of them, and its size [m]."""
    largest = max((float(f"{abs(length):.3g}") for length in lengths), default=0.0)  # as it will be printed
    return next(((unit, size) for unit, size in UNITS if largest >= size * (1.0 - 1e-9)), UNITS[-1])


def mm(length: float) -> str:
    """Return a length [m] in the unit that suits it, ``12.3 mm``."""
    unit, size = unit_of(length)
    return f"{digits(length / size)} {unit}"


def place(point: np.ndarray, unit: tuple[str, float] = UNITS[1]) -> str:
    """Return a position [m] in words, ``(1.2, 0, 3) mm``."""
    name, size = unit
    near = 1e-3 * float(np.abs(point).max(initial=0.0))  # what is nothing beside the other coordinates
    return "(" + ", ".join(digits(x / size) if abs(x) >= near else "0" for x in point) + f") {name}"
