"""Colours of values: from cold (small) over grey to hot (large)."""

from __future__ import annotations

import numpy as np

COLD, MIDDLE, HOT = (70, 90, 160), (150, 150, 150), (255, 80, 40)  # small to large


def shades(values: np.ndarray) -> np.ndarray:
    """Colours from cold (0) to hot (1) of values of any shape, shape (..., 3)."""
    s = np.clip(np.nan_to_num(values), 0.0, 1.0)
    return np.stack(
        [np.interp(s, (0.0, 0.5, 1.0), c) for c in zip(COLD, MIDDLE, HOT, strict=True)], axis=-1
    ).astype(np.uint8)
