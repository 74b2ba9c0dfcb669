"""Compiled turns of single frames: along a rod, and about an axis."""

from __future__ import annotations

import math

from rodnet.compiled import kernel


@kernel
def carry(tangents, director, out):
    """Parallel transport of a director along consecutive tangents (n, 3), made normal to each."""
    dx, dy, dz = director[0], director[1], director[2]
    for e in range(tangents.shape[0]):
        tx, ty, tz = tangents[e, 0], tangents[e, 1], tangents[e, 2]
        if e > 0:
            ax, ay, az = tangents[e - 1, 0], tangents[e - 1, 1], tangents[e - 1, 2]
            bx, by, bz = ay * tz - az * ty, az * tx - ax * tz, ax * ty - ay * tx
            c = ax * tx + ay * ty + az * tz
            bd = (bx * dx + by * dy + bz * dz) / (1.0 + c) if 1.0 + c > 1e-12 else math.nan
            dx, dy, dz = (
                c * dx + by * dz - bz * dy + bx * bd,
                c * dy + bz * dx - bx * dz + by * bd,
                c * dz + bx * dy - by * dx + bz * bd,
            )
        along = dx * tx + dy * ty + dz * tz
        dx, dy, dz = dx - along * tx, dy - along * ty, dz - along * tz
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        out[e, 0], out[e, 1], out[e, 2] = dx, dy, dz


@kernel
def turn_about(parts, angle, s, Q):
    """Set Q[s] = cos(angle) parts[0] + sin(angle) parts[1] + parts[2], a frame turned about an axis."""
    c, d = math.cos(angle), math.sin(angle)
    for i in range(3):
        for j in range(3):
            Q[s, i, j] = c * parts[0, i, j] + d * parts[1, i, j] + parts[2, i, j]
