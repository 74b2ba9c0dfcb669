"""Vector algebra over sites, for laws of one's own."""

from __future__ import annotations

import numpy as np


def norm(v: np.ndarray) -> np.ndarray:
    """Length of each vector, shape (n, 1) for ``v`` of shape (n, 3), so that it multiplies vectors."""
    return np.sqrt(np.sum(np.asarray(v) ** 2, axis=-1, keepdims=True))


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar product of each pair of vectors, shape (n, 1)."""
    return np.sum(np.asarray(a) * np.asarray(b), axis=-1, keepdims=True)
