"""Compiled loops over the nodes or edges that a wall may touch."""

import math

import numpy as np

from rodnet.compiled import kernel
from rodnet.kinematics.kernels import STATE
from rodnet.packed import unpack
from rodnet.terms.contact.law import (
    CLOSEST,
    FRICTION,
    MOTION,
    POINT,
    REACH,
    SLOPES,
    STEEPEST,
    THICKER,
    contact_block,
    dot,
    take_motion,
)

PLANE, INSIDE, OUTSIDE = 0, 1, 2

# sites: law, edge, place on it (0 or 1, or -1 for the closest) and radius; the wall's point, and its normal
# or axis; the sites' degrees of freedom
WALL = "law:d2 edge:l1 place:d1 radius:d1 point:d1 axis:d1 dofs:i2 slots:i3"


@kernel
def wall_gap(kind, size, radius, place, point, axis, x0, x1, m, n):
    """Gap of a site on the edge from ``x0`` to ``x1``, and its vectors ``m`` and ``n``.

    ``size`` is the tube's radius. Returns the gap, the place 0..1 on the edge, one over the curvature that
    the place follows from (0 where it is fixed), and rho, what the gap is measured by.
    """
    s = max(place, 0.0)
    if kind == PLANE:
        gap = -radius
        for a in range(3):
            m[a] = n[a] = axis[a]
            gap += axis[a] * ((1.0 - s) * x0[a] + s * x1[a] - point[a])
        return gap, s, 0.0, 1.0
    along, rise = 0.0, 0.0
    for a in range(3):
        m[a] = x0[a] - point[a]
        along += axis[a] * m[a]
        rise += axis[a] * (x1[a] - x0[a])
    for a in range(3):
        m[a] -= along * axis[a]
    soft, square = 0.0, 0.0
    if place < 0.0:
        c = 16.0 * THICKER * radius * (size + radius)
        slope, curvature = -0.5 * c, c
        for a in range(3):
            e = x1[a] - x0[a] - rise * axis[a]
            slope += m[a] * e
            curvature += e * e
        s = min(max(-slope / curvature, 0.0), 1.0)
        soft = 1.0 / curvature if 0.0 < s < 1.0 else 0.0
        square = c * ((s - 0.5) * (s - 0.5) - 0.25)
    for a in range(3):
        m[a] += s * (x1[a] - x0[a] - rise * axis[a])
    distance = dot(m, m)
    rho = math.sqrt(max(square + distance, 0.0))
    distance = math.sqrt(distance)
    sign = -1.0 if kind == INSIDE else 1.0
    for a in range(3):
        n[a] = sign * m[a] / distance if distance > 0.0 else 0.0
        m[a] = sign * m[a] / rho if rho > 0.0 else 0.0
    gap = size - radius - rho if kind == INSIDE else rho - size - radius
    return gap, s, soft, rho


@kernel
def wall_forces(kind, size, grip, wall, state, cv, F, data, with_jac):
    """Add the forces of a wall; returns the largest normal force. ``grip`` scales the friction."""
    law, edge, place, radius, point, axis, dofs, slots = unpack(wall, WALL)
    arrays = unpack(state, STATE)
    x, edges = arrays[0], arrays[4]
    point_of, slopes, motion = np.zeros(POINT), np.zeros(SLOPES), np.zeros(MOTION)
    m, n, w, arm = point_of[0], point_of[1], point_of[2], point_of[3]
    own, f, J = np.empty(5), np.zeros(14), np.zeros((14, 14))
    largest = 0.0
    for k in range(edge.shape[0]):
        e = edge[k]
        x0, x1 = x[edges[e, 0]], x[edges[e, 1]]
        gap, s, soft, rho = wall_gap(kind, size, radius[k], place[k], point, axis, x0, x1, m, n)
        if gap >= law[k, REACH]:
            continue
        if not gap > 0.0:
            F[dofs[k, 0]] = np.inf
            return np.inf
        own[:] = law[k]
        own[FRICTION] *= grip
        w[0], w[1] = 1.0 - s, s
        for a in range(3):
            arm[a] = -radius[k] * n[a]
        take_motion(0, e, arrays, motion)
        if with_jac:
            _wall_derivatives(kind, soft, rho, radius[k], axis, x0, x1, point_of, slopes)
        N = contact_block(1, own, gap, cv, point_of, slopes, motion, f, J, with_jac)
        largest = max(largest, N)
        for p in range(7):
            F[dofs[k, p]] += f[p]
            if with_jac:
                for q in range(7):
                    data[slots[k, p, q]] -= J[p, q]
    return largest


@kernel
def _wall_derivatives(kind, soft, rho, radius, axis, x0, x1, point, slopes):
    """Derivatives of a wall's gap, vectors, weights and arm by the positions of the edge."""
    m, n, w = point[0], point[1], point[2]
    dgap, dm, dn, dw, darm = slopes[0], slopes[1:4], slopes[4:7], slopes[7:11], slopes[11:14]
    rise = dot(axis, x1) - dot(axis, x0)
    length = math.sqrt(dot(m, m)) * rho
    sign = -1.0 if kind == INSIDE else 1.0
    for p in range(6):
        i, b = p // 3, p % 3
        dgap[p] = w[i] * m[b]
        if kind == PLANE:
            continue
        # the place follows from its slope being zero; m rho is the distance vector
        across = x1[b] - x0[b] - rise * axis[b]
        ds = -soft * (w[i] * across + (m[b] * rho if i == 1 else -m[b] * rho))
        dw[0, p], dw[1, p] = -ds, ds
        radial = 0.0
        for a in range(3):
            shift = (x1[a] - x0[a] - rise * axis[a]) * ds - w[i] * axis[a] * axis[b]
            if a == b:
                shift += w[i]
            dn[a, p] = sign * shift
            radial += n[a] * dn[a, p]
        for a in range(3):
            dm[a, p] = (dn[a, p] - sign * m[a] * dgap[p]) / rho
            dn[a, p] = (dn[a, p] - radial * n[a]) / length
            darm[a, p] = -radius * dn[a, p]


@kernel
def wall_gaps(kind, size, wall, x, edges, gaps):
    """Gap of every site [m]."""
    _, edge, place, radius, point, axis, _, _ = unpack(wall, WALL)
    m, n = np.empty(3), np.empty(3)
    for k in range(edge.shape[0]):
        x0, x1 = x[edges[edge[k], 0]], x[edges[edge[k], 1]]
        gaps[k] = wall_gap(kind, size, radius[k], place[k], point, axis, x0, x1, m, n)[0]


@kernel
def wall_step(kind, size, wall, x, dx, edges):
    """Share of the displacement ``dx`` on which every gap stays open, by conservative advancement."""
    law, edge, place, radius, point, axis, _, _ = unpack(wall, WALL)
    m, n, y0, y1 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    share = 1.0
    for k in range(edge.shape[0]):
        i, j = edges[edge[k], 0], edges[edge[k], 1]
        rate = 0.0
        for end in range(2):
            if place[k] == 1.0 - end:
                continue
            d = dx[edges[edge[k], end]]
            along = dot(axis, d)
            if kind == PLANE:
                rate = max(rate, -along)
            else:
                rate = max(rate, STEEPEST * math.sqrt(max(dot(d, d) - along * along, 0.0)))
        gap, _, _, _ = wall_gap(kind, size, radius[k], place[k], point, axis, x[i], x[j], m, n)
        floor = CLOSEST * min(gap, law[k, REACH])
        if (gap - floor) >= rate * share:
            continue
        if not gap > 0.0:
            return 0.0
        gone = 0.0
        for _ in range(200):
            gone += (gap - 0.9 * floor) / rate
            if gone >= share:
                break
            for a in range(3):
                y0[a], y1[a] = x[i, a] + gone * dx[i, a], x[j, a] + gone * dx[j, a]
            gap, _, _, _ = wall_gap(kind, size, radius[k], place[k], point, axis, y0, y1, m, n)
            if gap < floor:
                break
        share = min(share, gone)
    return share
