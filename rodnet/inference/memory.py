"""How many residuals in a row count as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def memory_of(whitened: Sequence[np.ndarray]) -> tuple[float, int]:
    """How many residuals in a row count as one: 1 + 2 sum of correlations, to the first that is not positive.

    And how many correlations these are. Residuals are frame by frame, shapes (F, M, d), of all instruments of all
    trials.
    """
    own, total, lag = list(whitened), 1.0, 1
    longest = max(len(w) for w in own)
    power = sum(float((w**2).sum()) for w in own)
    while lag < longest // 2 and power > 0.0:
        shared = sum(float((w[lag:] * w[:-lag]).sum()) for w in own if len(w) > lag) / power
        if shared <= 0.0:
            break
        total += 2.0 * shared
        lag += 1
    return total, lag
