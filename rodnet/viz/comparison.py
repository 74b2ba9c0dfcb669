"""The arrays of a comparison between a recording and a simulation, checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from rodnet.errors import ParameterError


def check_comparison(t: Any, measured: Any, predicted: Any, marker_edges: Any) -> tuple[np.ndarray, ...]:
    """Return the arrays of a comparison, checked.

    Raises
    ------
    ParameterError
        If the shapes do not fit together.
    """
    t, measured, predicted = (np.asarray(a, dtype=float) for a in (t, measured, predicted))
    pairs = np.asarray(marker_edges, dtype=np.int64).reshape(-1, 2)
    good = t.ndim == 1 and len(t) and measured.ndim == 3 and measured.shape[::2] == (len(t), 3)
    if not good or predicted.shape != measured.shape or not measured.shape[1]:
        raise ParameterError(
            f"a comparison needs t (T,), measured and predicted (T, M, 3); got {t.shape}, {measured.shape} "
            f"and {predicted.shape}"
        )
    if len(pairs) and not 0 <= pairs.min() <= pairs.max() < measured.shape[1]:
        raise ParameterError(f"marker_edges names markers beyond 0 to {measured.shape[1] - 1}")
    if not (np.isfinite(measured) & np.isfinite(predicted)).all(axis=2).any():
        raise ParameterError("no marker has both a measured and a predicted position at any time")
    return t, measured, predicted, pairs
