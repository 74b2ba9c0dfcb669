"""Gradients of the spring strains and of the edges' rotations in plain NumPy, for analysis."""

from __future__ import annotations

import numpy as np

from rodnet.kinematics.frames import cross


def strain_gradients(V: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Vectors g_k with d eps_k = g_k . (rotation of W - rotation of V), shape (n, 3, 3), rows k.

    Parameters
    ----------
    V, W : ndarray, shape (n, 3, 3)
        Frames carried by the two edges of each spring, directors as columns.
    """
    a1, a2, a3 = np.moveaxis(V, -1, 0)
    b1, b2, b3 = np.moveaxis(W, -1, 0)
    chi = 1.0 + np.sum(a3 * b3, axis=-1, keepdims=True)
    n = cross(b3, a3)
    k1 = (np.sum(a1 * b3 - a3 * b1, axis=-1, keepdims=True)) / chi
    k2 = (np.sum(a2 * b3 - a3 * b2, axis=-1, keepdims=True)) / chi
    g1 = (cross(b3, a1) - cross(b1, a3) - k1 * n) / chi
    g2 = (cross(b3, a2) - cross(b2, a3) - k2 * n) / chi
    return np.stack([g1, g2, (a3 + b3) / chi], axis=-2)


def edge_couple(
    moment: np.ndarray, tangent: np.ndarray, holonomy: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """Force conjugate to the edge vector of a moment on an edge, A_e^T m, shape (n, 3) [N].

    Parameters
    ----------
    moment, tangent, holonomy : ndarray, shape (n, 3)
        Moment [N m], unit tangent, and s = (ts x t) / (1 + ts.t).
    length : ndarray, shape (n,)
        Edge length [m].
    """
    axial = np.sum(moment * tangent, axis=-1, keepdims=True)
    return (cross(moment, tangent) - axial * holonomy) / length[:, None]
