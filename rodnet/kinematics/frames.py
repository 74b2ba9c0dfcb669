"""Frames and parallel transport in plain NumPy (set-up and analysis; the compiled twins are in `kernels`)."""

from __future__ import annotations

import numpy as np


def unit(v: np.ndarray) -> np.ndarray:
    """Return ``v`` / |v| along the last axis."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def any_normal(t: np.ndarray) -> np.ndarray:
    """Return a unit vector normal to the unit vector ``t``, shape (3,), chosen without numbering.

    It is the horizontal normal ez x t where that is well defined, else ex.
    """
    normal = np.cross((0.0, 0.0, 1.0), t)
    if np.linalg.norm(normal) < 1e-6:
        normal = np.array([1.0, 0.0, 0.0]) - t[0] * t
    return normal / np.linalg.norm(normal)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector product along the last axis; much quicker than `numpy.cross` on few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def transport(d: np.ndarray, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
    """Parallel transport: rotate ``d`` by the smallest rotation that takes ``t0`` to ``t1``.

    Shapes ``(..., 3)``, unit tangents. Antiparallel tangents have no smallest rotation: ``nan``.
    """
    b = cross(t0, t1)
    c = np.sum(t0 * t1, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return c * d + cross(b, d) + b * np.sum(b * d, axis=-1, keepdims=True) / (1.0 + c)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation matrices, shape (..., 3, 3), of rotation vectors [rad], shape (..., 3)."""
    from scipy.spatial.transform import Rotation

    vector = np.asarray(vector, dtype=float)
    return Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix().reshape(*vector.shape[:-1], 3, 3)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """Rotation vectors [rad], shape (..., 3), of rotation matrices, shape (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    matrix = np.asarray(matrix, dtype=float)
    return Rotation.from_matrix(matrix.reshape(-1, 3, 3)).as_rotvec().reshape(*matrix.shape[:-2], 3)


def mean_rotation(one: np.ndarray, other: np.ndarray, share: float) -> np.ndarray:
    """The rotation nearest to ``(1 - share) one + share other``, all of shape (..., 3, 3), that are no half turn apart.

    On the way from one to the other, by an angle alpha of their phi with
    ``(1 - share) sin(alpha) = share sin(phi - alpha)``.
    """
    between = np.swapaxes(one, -1, -2) @ other
    spin = 0.5 * (between - np.swapaxes(between, -1, -2))  # sin(phi) times the axis
    sin = np.sqrt(0.5 * np.sum(spin**2, axis=(-2, -1), keepdims=True))
    cos = 0.5 * (np.trace(between, axis1=-2, axis2=-1)[..., None, None] - 1.0)
    x, y = 1.0 - share + share * cos, share * sin
    size = np.hypot(x, y)
    # sin(alpha) / sin(phi) and (1 - cos(alpha)) / sin(phi)^2, of any phi
    along, bent = share / size, share**2 / (size * (size + x))
    return np.asarray(one + one @ (along * spin + bent * (spin @ spin)))


def about_z(angle: np.ndarray) -> np.ndarray:
    """Rotation matrices about the third axis by ``angle`` [rad], shape (..., 3, 3)."""
    angle = np.asarray(angle, dtype=float)
    out = np.zeros((*angle.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0] = np.sin(angle)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = 1.0
    return out


def material_frames(t: np.ndarray, d1: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Material frames with columns (m1, m2, t), shape (..., 3, 3) (paper, material frame equation).

    Parameters
    ----------
    t, d1 : ndarray, shape (..., 3)
        Unit tangents and first reference directors.
    theta : ndarray, shape (...)
        Twist angles [rad].
    """
    d2 = cross(t, d1)
    c, s = np.cos(theta)[..., None], np.sin(theta)[..., None]
    return np.stack([c * d1 + s * d2, c * d2 - s * d1, t], axis=-1)


def relative_strains(V: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Strains (kappa1, kappa2, tau) [rad], shape (..., 3), between frames V and W, shape (..., 3, 3)."""
    C = np.swapaxes(V, -1, -2) @ W
    chi = 1.0 + C[..., 2, 2]
    sin = C[..., 1, 0] - C[..., 0, 1]
    cos = C[..., 0, 0] + C[..., 1, 1]
    return np.stack(
        [(C[..., 0, 2] - C[..., 2, 0]) / chi, (C[..., 1, 2] - C[..., 2, 1]) / chi, np.arctan2(sin, cos)],
        axis=-1,
    )


def relative_rotation(strains: np.ndarray) -> np.ndarray:
    """Rotation C, shape (..., 3, 3), whose strains are (kappa1, kappa2, tau): inverse of `relative_strains`."""
    k1, k2, tau = np.moveaxis(np.asarray(strains, dtype=float), -1, 0)
    # kappa = 2 tan(phi/2) cos(tau/2) in the frame half way between the two edges
    half = np.cos(tau / 2.0)
    tan = np.hypot(k1, k2) / (2.0 * half)
    phi = 2.0 * np.arctan(tan)
    angle = np.arctan2(k1, -k2)  # the rotation axis is (-kappa2, kappa1) in the half-way frame
    axis = np.stack([np.cos(angle + tau / 2.0), np.sin(angle + tau / 2.0), np.zeros_like(tau)], axis=-1)
    return rotation(phi[..., None] * axis) @ about_z(tau)


def carry_director(tangents: np.ndarray, director: np.ndarray) -> np.ndarray:
    """Carry a director along a rod without twist, edge by edge, shape (n, 3).

    Parameters
    ----------
    tangents : ndarray, shape (n, 3)
        Unit tangents in order.
    director : ndarray, shape (3,)
        Director on the first edge; made normal to it.

    Returns
    -------
    ndarray, shape (n, 3)
        NaN from an edge on that is antiparallel to the one before.
    """
    from rodnet.kinematics.turn_kernels import carry

    out = np.empty_like(tangents)
    carry(np.ascontiguousarray(tangents), np.asarray(director, dtype=float), out)
    return out
