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


def mm(length: float) -> str:
    """Return a length [m] in the unit that suits it, ``12.3 mm``."""
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6)):
        if abs(length) >= size or unit == "um":
            return f"{length / size:.3g} {unit}"
    raise AssertionError


def place(point: np.ndarray) -> str:
    """Return a position [m] in words, ``(1.2, 0, 3) mm``."""
    return "(" + ", ".join(f"{round(1e3 * x, 3) + 0.0:.4g}" for x in point) + ") mm"
