"""Small tools for curves given by points: arc length, even spacing, tangents, ends."""

from __future__ import annotations

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


def end_line(points: np.ndarray, count: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """Point and unit tangent at the start of a curve, pointing out of it, from its first points."""
    head = points[:count]
    if len(head) < 2:
        return head[0], np.zeros(3)
    s = arc_length(head)
    fit = np.polynomial.polynomial.polyfit(s, head, 2 if len(head) > 3 else 1)
    return fit[0], -fit[1] / np.linalg.norm(fit[1])
