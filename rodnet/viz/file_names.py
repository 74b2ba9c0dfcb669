"""Names of files and branches from names of recordings, which may hold anything."""

from __future__ import annotations

import re
from collections.abc import Iterable


def file_names(names: Iterable[str]) -> list[str]:
    """Names with nothing but letters, digits, dots, dashes and underscores, no two the same."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^\w.-]", "_", name)
        number, one = 1, plain
        while one in found:
            number += 1
            one = f"{plain}_{number}"
        found.append(one)
    return found
