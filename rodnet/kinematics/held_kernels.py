"""Compiled prescription of positions, twist angles and their rates."""

from __future__ import annotations

import math

from rodnet.compiled import kernel
from rodnet.packed import unpack

# ``placed`` and ``eliminated`` (n, 3) are 0 or 1; ``edges`` are those whose frame is prescribed, ``ends`` (n, 2) their
# nodes
HELD = "nodes:l1 placed:l2 eliminated:l2 edges:l1 ends:l2"


@kernel
def place(held, values, q):
    """Set prescribed positions, the first 3 n of ``values``."""
    nodes, placed, _, _, _ = unpack(held, HELD)
    for k in range(nodes.shape[0]):
        for i in range(3):
            if placed[k, i]:
                q[3 * nodes[k] + i] = values[3 * k + i]


@kernel
def orient(held, values, q, twist0, theta_near, tangents, directors):
    """Set prescribed twist angles, from the transported directors to the material ones behind the positions.

    They are unwrapped to the turn nearest ``theta_near``; ``tangents`` and ``directors`` are the transport's source.
    """
    nodes, _, _, edges, ends = unpack(held, HELD)
    for k in range(edges.shape[0]):
        e, i, j, m = edges[k], 3 * ends[k, 0], 3 * ends[k, 1], 3 * (nodes.shape[0] + k)
        tx, ty, tz = q[j] - q[i], q[j + 1] - q[i + 1], q[j + 2] - q[i + 2]
        il = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
        tx, ty, tz = tx * il, ty * il, tz * il
        ax, ay, az = tangents[e, 0], tangents[e, 1], tangents[e, 2]
        dx, dy, dz = directors[e, 0], directors[e, 1], directors[e, 2]
        bx, by, bz = ay * tz - az * ty, az * tx - ax * tz, ax * ty - ay * tx
        c = ax * tx + ay * ty + az * tz
        bd = (bx * dx + by * dy + bz * dz) / (1.0 + c)
        dx, dy, dz = (
            c * dx + by * dz - bz * dy + bx * bd,
            c * dy + bz * dx - bx * dz + by * bd,
            c * dz + bx * dy - by * dx + bz * bd,
        )
        mx, my, mz = values[m], values[m + 1], values[m + 2]
        sin = mx * (ty * dz - tz * dy) + my * (tz * dx - tx * dz) + mz * (tx * dy - ty * dx)
        angle = math.atan2(sin, mx * dx + my * dy + mz * dz)
        turns = math.floor((theta_near[e] - angle) / (2.0 * math.pi) + 0.5)
        q[twist0 + e] = angle + 2.0 * math.pi * turns


@kernel
def move(held, values, q, twist0, v, a):
    """Set rates and accelerations: ``values`` are those of the positions, (n, 3) each, and the rotation's rate (3,)."""
    nodes, _, eliminated, edges, ends = unpack(held, HELD)
    behind = 3 * nodes.shape[0]
    for k in range(nodes.shape[0]):
        for i in range(3):
            if eliminated[k, i]:
                v[3 * nodes[k] + i] = values[3 * k + i]
                a[3 * nodes[k] + i] = values[behind + 3 * k + i]
    for k in range(edges.shape[0]):
        i, j = 3 * ends[k, 0], 3 * ends[k, 1]
        square, spin = 0.0, 0.0
        for m in range(3):
            along = q[j + m] - q[i + m]
            square += along * along
            spin += along * values[2 * behind + m]
        v[twist0 + edges[k]] = spin / math.sqrt(square)
