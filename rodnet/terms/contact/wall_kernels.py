"""Compiled loops over the nodes or edges that a wall may touch."""

import math

import numpy as np

from rodnet.compiled import kernel
from rodnet.kinematics.kernels import STATE
from rodnet.packed import unpack
from rodnet.terms.contact.law import CLOSEST, STEEPEST, THICKER, barrier, contact_block

PLANE, INSIDE, OUTSIDE = 0, 1, 2

# sites: law, one or two nodes and their radius; the wall's point, and its normal or axis
WALL = "law:d2 nodes:i2 radius:d1 point:d1 axis:d1 slots:i3"


@kernel
def wall_gap(kind, size, radius, point, axis, x0, x1, m, n):
    """Gap of a site, its vectors ``m`` and ``n``, and the place 0..1 on an edge from ``x0`` to ``x1``.

    ``size`` is the tube's radius. Returns the gap, the place, the derivative of the place by a shift of
    the closest point's distance vector (1 over its curvature; 0 at an end), and that distance rho.
    """
    if kind == PLANE:
        gap = -radius
        for a in range(3):
            m[a] = n[a] = axis[a]
            gap += axis[a] * (x0[a] - point[a])
        return gap, 0.0, 0.0, 1.0
    along = 0.0
    for a in range(3):
        m[a] = x0[a] - point[a]
        along += axis[a] * m[a]
    for a in range(3):
        m[a] -= along * axis[a]
    s, soft, square = 0.0, 0.0, 0.0
    if kind == OUTSIDE:
        c = 16.0 * THICKER * radius * (size + radius)
        rise, slope, curvature = 0.0, -0.5 * c, c
        for a in range(3):
            rise += axis[a] * (x1[a] - x0[a])
        for a in range(3):
            e = x1[a] - x0[a] - rise * axis[a]
            slope += m[a] * e
            curvature += e * e
        s = -slope / curvature
        if 0.0 < s < 1.0:
            soft = 1.0 / curvature
        else:
            s = 0.0 if s <= 0.0 else 1.0
        for a in range(3):
            m[a] += s * (x1[a] - x0[a] - rise * axis[a])
        square = c * ((s - 0.5) * (s - 0.5) - 0.25)
    distance = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    square += distance
    distance = math.sqrt(distance)
    rho = math.sqrt(max(square, 0.0))
    sign = -1.0 if kind == INSIDE else 1.0
    for a in range(3):
        n[a] = sign * m[a] / distance if distance > 0.0 else 0.0
        m[a] = sign * m[a] / rho if rho > 0.0 else 0.0
    gap = size - radius - rho if kind == INSIDE else rho - size - radius
    return gap, s, soft, rho


@kernel
def wall_forces(kind, size, grip, wall, state, cv, F, data, with_jac):
    """Add the forces of a wall; returns the largest normal force. ``grip`` scales the friction."""
    law, nodes, radius, point, axis, slots = unpack(wall, WALL)
    x, v, _, _, _, _, _, _, _ = unpack(state, STATE)
    count = nodes.shape[1]
    m, n, V, e, h = np.empty(3), np.empty(3), np.empty(3), np.zeros(3), np.zeros(3)
    w, dgap, own = np.zeros(4), np.zeros(12), np.empty(4)
    dm, dn, dV, dw = np.zeros((3, 12)), np.zeros((3, 12)), np.zeros((3, 12)), np.zeros((4, 12))
    f, J, ds = np.zeros(12), np.zeros((12, 12)), np.zeros(6)
    largest = 0.0
    for k in range(nodes.shape[0]):
        i, j = nodes[k, 0], nodes[k, count - 1]
        gap, s, soft, rho = wall_gap(kind, size, radius[k], point, axis, x[i], x[j], m, n)
        if gap >= law[k, 1]:
            continue
        if not gap > 0.0:
            F[3 * i] = np.inf
            return np.inf
        own[:] = law[k]
        own[2] *= grip
        w[0], w[1] = 1.0 - s, s
        for a in range(3):
            V[a] = (1.0 - s) * v[i, a] + s * v[j, a]
        if with_jac:
            _wall_derivatives(kind, count, s, soft, rho, m, n, axis, x[i], x[j], v[i], v[j], cv, w, e, h,
                              ds, dgap, dm, dn, dV, dw)  # fmt: skip
        N = contact_block(count, own, gap, m, n, V, w, dgap, dm, dn, dV, dw, f, J, with_jac)
        largest = max(largest, N)
        for p in range(3 * count):
            F[3 * nodes[k, p // 3] + p % 3] += f[p]
            if with_jac:
                for q in range(3 * count):
                    data[slots[k, p, q]] -= J[p, q]
    return largest


@kernel
def _wall_derivatives(kind, count, s, soft, rho, m, n, axis, x0, x1, v0, v1, cv, w, e, h,
                      ds, dgap, dm, dn, dV, dw):  # fmt: skip
    """Derivatives of a wall's gap, vectors and weights by the positions of its node or edge."""
    if count == 2:
        rise = 0.0
        for a in range(3):
            rise += axis[a] * (x1[a] - x0[a])
        for a in range(3):  # s follows from slope(s) = 0, with m rho the distance vector
            e[a] = x1[a] - x0[a] - rise * axis[a]
            h[a] = v1[a] - v0[a]
            ds[a] = -soft * (w[0] * e[a] - m[a] * rho)
            ds[3 + a] = -soft * (w[1] * e[a] + m[a] * rho)
            dw[0, a], dw[1, a], dw[0, 3 + a], dw[1, 3 + a] = -ds[a], ds[a], -ds[3 + a], ds[3 + a]
    length = math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) * rho
    sign = -1.0 if kind == INSIDE else 1.0
    for p in range(3 * count):
        i, b = p // 3, p % 3
        dgap[p] = w[i] * m[b]
        for a in range(3):
            dV[a, p] = h[a] * ds[p]
        dV[b, p] += cv * w[i]
        if kind == PLANE:
            continue
        radial = 0.0
        for a in range(3):
            shift = e[a] * ds[p] - w[i] * axis[a] * axis[b]
            if a == b:
                shift += w[i]
            dn[a, p] = sign * shift
            radial += n[a] * dn[a, p]
        for a in range(3):
            dm[a, p] = (dn[a, p] - sign * m[a] * dgap[p]) / rho
            dn[a, p] = (dn[a, p] - radial * n[a]) / length


@kernel
def wall_energy(kind, size, wall, state):
    """Energy that the barrier stores [J]."""
    law, nodes, radius, point, axis, _ = unpack(wall, WALL)
    x, _, _, _, _, _, _, _, _ = unpack(state, STATE)
    m, n = np.empty(3), np.empty(3)
    total = 0.0
    for k in range(nodes.shape[0]):
        i, j = nodes[k, 0], nodes[k, nodes.shape[1] - 1]
        gap, _, _, _ = wall_gap(kind, size, radius[k], point, axis, x[i], x[j], m, n)
        total += barrier(gap, law[k, 0], law[k, 1])[0]
    return total


@kernel
def wall_gaps(kind, size, wall, x, gaps):
    """Gap of every site [m]."""
    _, nodes, radius, point, axis, _ = unpack(wall, WALL)
    m, n = np.empty(3), np.empty(3)
    for k in range(nodes.shape[0]):
        i, j = nodes[k, 0], nodes[k, nodes.shape[1] - 1]
        gaps[k] = wall_gap(kind, size, radius[k], point, axis, x[i], x[j], m, n)[0]


@kernel
def wall_step(kind, size, wall, x, dx):
    """Share of the displacement ``dx`` on which every gap stays open, by conservative advancement."""
    law, nodes, radius, point, axis, _ = unpack(wall, WALL)
    m, n, y0, y1 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    share = 1.0
    for k in range(nodes.shape[0]):
        i, j = nodes[k, 0], nodes[k, nodes.shape[1] - 1]
        rate = 0.0
        if kind == PLANE:
            rate = -(axis[0] * dx[i, 0] + axis[1] * dx[i, 1] + axis[2] * dx[i, 2])
        else:
            for q in (i, j):
                rise = axis[0] * dx[q, 0] + axis[1] * dx[q, 1] + axis[2] * dx[q, 2]
                square = dx[q, 0] * dx[q, 0] + dx[q, 1] * dx[q, 1] + dx[q, 2] * dx[q, 2] - rise * rise
                rate = max(rate, STEEPEST * math.sqrt(max(square, 0.0)))
        gap, _, _, _ = wall_gap(kind, size, radius[k], point, axis, x[i], x[j], m, n)
        floor = CLOSEST * min(gap, law[k, 1])
        if (gap - floor) >= rate * share:
            continue
        if not gap > 0.0:
            return 0.0
        t = 0.0
        for _ in range(200):
            t += (gap - 0.9 * floor) / rate
            if t >= share:
                break
            for a in range(3):
                y0[a], y1[a] = x[i, a] + t * dx[i, a], x[j, a] + t * dx[j, a]
            gap, _, _, _ = wall_gap(kind, size, radius[k], point, axis, y0, y1, m, n)
            if gap < floor:
                break
        share = min(share, t)
    return share
