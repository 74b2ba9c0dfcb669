"""Numbers as people read them, and as JSON knows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

SMALLEST = 1e-9  # chance, below which it is only said to be below


def number(value: float, form: str = ".3g") -> str:
    """Return a number in a format; what rounds to nothing has no sign."""
    text = f"{value:{form}}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def percent(share: float, form: str = ".0f") -> str:
    """Return a share as a percentage; what is not all of it is not told as 100 %."""
    if form == ".0f" and 0.995 <= share < 1.0:
        return f"{math.floor(1000.0 * share) / 10.0:.1f} %"
    return f"{number(100.0 * share, form)} %"


def chance(p: float, form: str = ".2g") -> str:
    """Return a probability for a table; none is 0, however small."""
    return f"< {SMALLEST:.0e}".replace("e-0", "e-") if p < SMALLEST else number(p, form)


def times(count: int) -> str:
    """Return how often something was done."""
    return "once" if count == 1 else f"{count} times"


def by_chance(p: float) -> str:
    """Return a probability for a sentence."""
    return "less than one in a billion" if p < SMALLEST else number(p, ".2g")


def p_value(p: float) -> str:
    """Return a probability as it is quoted in brackets: ``p = 0.03``."""
    return f"p {chance(p)}" if p < SMALLEST else f"p = {chance(p)}"


def plain(value: Any) -> Any:
    """Return a value as JSON knows it: NumPy numbers as numbers, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)
