"""Small tools for curves given by points: arc length, even spacing, tangents, ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


def arc_length(points: np.ndarray) -> np.ndarray:
    """Arc length at each point of a polyline [m], shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def interpolate(s: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Linear interpolation of rows, shape (len(s), 3)."""
    return np.stack([np.interp(s, known, values[:, k]) for k in range(values.shape[1])], axis=1)


def spread_evenly(points: np.ndarray, step: float, least: int = 3) -> np.ndarray:
    """Points about ``step`` [m] apart along a polyline, its ends included; at least ``least``."""
    s = arc_length(points)
    return interpolate(np.linspace(0.0, s[-1], max(round(s[-1] / step) + 1, least)), s, points)


def tangents(points: np.ndarray, closed: bool = False) -> np.ndarray:
    """Unit tangents of evenly spaced points: slopes of parabolas through five of them."""
    n = len(points)
    if closed:
        points = np.concatenate([points[-2:], points, points[:2]])
    half = min(2, (len(points) - 1) // 2)
    slope = np.empty_like(points)
    if half == 0:
        slope[:] = points[-1] - points[0]
    else:
        k = np.arange(-half, half + 1)
        middle = np.arange(len(points)).clip(half, len(points) - 1 - half)
        window = points[middle[:, None] + k]
        slope = np.einsum("k,nkc->nc", k / np.sum(k**2), window)
        bend = k**2 - np.mean(k**2)
        second = np.einsum("k,nkc->nc", bend / np.sum(bend**2), window)
        slope += 2.0 * second * (np.arange(len(points)) - middle)[:, None]
    if closed:
        slope = slope[2 : n + 2]
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300)


class End(NamedTuple):
    """The end of a curve, to be continued as a parabola.

    Attributes
    ----------
    point, outward : ndarray, shape (3,)
        Where it ends [m], and the unit tangent out of it.
    bend : ndarray, shape (3,)
        Half the curvature vector [1/m].
    """

    point: np.ndarray
    outward: np.ndarray
    bend: np.ndarray

    def at(self, s: np.ndarray) -> np.ndarray:
        """Points s [m] beyond the end, shape (n, 3)."""
        s = np.asarray(s)[:, None]
        return self.point + s * self.outward + s**2 * self.bend

    def toward(self, target: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
        """Point and unit tangent where the continuation passes a point, ``most`` [m] away or less."""
        s = float(np.clip((target - self.point) @ self.outward, 0.0, most))
        tangent = self.outward + 2.0 * s * self.bend
        return self.at(np.array([s]))[0], tangent / np.linalg.norm(tangent)


def curve_end(points: np.ndarray, count: int = 7) -> End:
    """Return the end of a curve at its start, by a parabola through its first points."""
    head = points[:count]
    if len(head) < 2:
        return End(head[0], np.zeros(3), np.zeros(3))
    s = arc_length(head)
    degree = 2 if len(head) > 4 else 1
    fit = np.polynomial.polynomial.polyfit(s, head, degree)
    outward = -fit[1] / np.linalg.norm(fit[1])
    bend = fit[2] if degree == 2 else np.zeros(3)
    return End(fit[0], outward, bend - (bend @ outward) * outward)
