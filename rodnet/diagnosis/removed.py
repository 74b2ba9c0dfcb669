"""What a repair takes off the errors on files not seen: by file, by kind, with an interval over files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

DRAWS = 10000
LEVEL = 0.9
# of what the share is told, and its unit
MEASURES = {"mean_mm_5s": "mm", "mean_mm_1s": "mm", "metric": ""}


@dataclass(frozen=True)
class Removed:
    """A mean error over files before and after a repair.

    Attributes
    ----------
    measure : str
        ``"mean_mm_5s"`` and ``"mean_mm_1s"``: mean distance over free markers, over so many seconds [mm];
        ``"metric"``: the case's own.
    kind : str
        Of the recordings; empty for all of them.
    files : int
        How many.
    before, after : float
        Mean error over files.
    share, low, high : float
        Share of the mean error that is removed, and its 90 % interval: files drawn again.
    """

    measure: str
    kind: str
    files: int
    before: float
    after: float
    share: float
    low: float
    high: float


def removed(
    before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]], seed: int = 0
) -> list[Removed]:
    """Compare the measures of files, all together and kind by kind where there are several.

    Parameters
    ----------
    before, after : sequence of mapping
        Of each file ``name``, ``kind`` and `MEASURES`.
    seed : int
        Of the draws.
    """
    kinds = list(dict.fromkeys(str(one["kind"]) for one in before))
    found = []
    for kind in ["", *(kinds if len(kinds) > 1 else [])]:
        rows = [(a, b) for a, b in zip(before, after, strict=True) if kind in ("", a["kind"])]
        for measure in MEASURES:
            pairs = [(a[measure], b[measure]) for a, b in rows]
            if any(v is None for pair in pairs for v in pair):
                continue
            one = _removed(np.array(pairs, dtype=float), np.random.default_rng(seed))
            found.append(Removed(measure, kind, len(pairs), *one))
    return found


def _removed(pairs: np.ndarray, rng: np.random.Generator) -> tuple[float, ...]:
    before, after = pairs.mean(axis=0)
    drawn = pairs[rng.integers(len(pairs), size=(DRAWS, len(pairs)))].mean(axis=1)
    shares = 1.0 - drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300)
    low, high = np.percentile(shares, [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)])
    return float(before), float(after), float(1.0 - after / max(before, 1e-300)), float(low), float(high)
