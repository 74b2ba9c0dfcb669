"""Compiled loops over pairs of edges: closest points, forces, and how far a step may go."""

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
    contact_block,
    dot,
    take_motion,
)


@kernel
def _along(slope, curvature):
    """Minimum of ``slope z + curvature z^2 / 2`` over 0..1."""
    return min(max(-slope / curvature, 0.0), 1.0)


@kernel
def closest(x0, x1, y0, y1, c, delta, soft):
    """Places s, t on two edges that minimise |x(s) - y(t)|^2 + c (s - 1/2)^2 + c (t - 1/2)^2.

    ``delta`` (3,) receives x(s) - y(t), ``soft`` (3,) the inverse of the curvature matrix over what is not
    at an end: by (s, s), (s, t), (t, t). Returns s, t, and rho (0 where the edges cross).
    """
    a11, a12, a22, b1, b2 = c, 0.0, c, -0.5 * c, -0.5 * c
    for a in range(3):
        e, f, d = x1[a] - x0[a], y1[a] - y0[a], x0[a] - y0[a]
        a11 += e * e
        a12 -= e * f
        a22 += f * f
        b1 += d * e
        b2 -= d * f
    det = a11 * a22 - a12 * a12
    s, t = (a12 * b2 - a22 * b1) / det, (a12 * b1 - a11 * b2) / det
    soft[0], soft[1], soft[2] = a22 / det, -a12 / det, a11 / det
    if not (0.0 < s < 1.0 and 0.0 < t < 1.0):
        best = np.inf  # then the minimum is on the rim
        s, t = 0.0, 0.0
        for side in range(4):
            end = float(side % 2)
            if side < 2:
                p, q = end, _along(b2 + a12 * end, a22)
            else:
                p, q = _along(b1 + a12 * end, a11), end
            value = 0.5 * (a11 * p * p + a22 * q * q) + a12 * p * q + b1 * p + b2 * q
            if value < best:
                best, s, t = value, p, q
        soft[0] = 1.0 / a11 if 0.0 < s < 1.0 else 0.0
        soft[1] = 0.0
        soft[2] = 1.0 / a22 if 0.0 < t < 1.0 else 0.0
    square = c * ((s - 0.5) ** 2 + (t - 0.5) ** 2 - 0.5)
    for a in range(3):
        delta[a] = x0[a] - y0[a] + s * (x1[a] - x0[a]) - t * (y1[a] - y0[a])
        square += delta[a] * delta[a]
    return s, t, math.sqrt(max(square, 0.0))


@kernel
def pair_gaps(pairs, sizes, edges, x, gaps):
    """Gap of each pair of edges [m]; ``sizes`` (n, 2) are the sums of radii and the constants c."""
    delta, soft = np.empty(3), np.empty(3)
    for k in range(pairs.shape[0]):
        e, f = edges[pairs[k, 0]], edges[pairs[k, 1]]
        _, _, rho = closest(x[e[0]], x[e[1]], x[f[0]], x[f[1]], sizes[k, 1], delta, soft)
        gaps[k] = rho - sizes[k, 0]


@kernel
def pair_forces(pairs, sizes, shares, law, grip, edges, twist0, state, cv, F, J, with_jac):
    """Add the forces of pairs within reach; ``J`` (n, 14, 14) receives their derivatives.

    ``shares`` (n, 2) are the radii over their sum. Returns the largest normal force. ``grip`` scales the
    friction.
    """
    arrays = unpack(state, STATE)
    x = arrays[0]
    point, slopes, motion = np.zeros(POINT), np.zeros(SLOPES), np.zeros(MOTION)
    m, n, w, arm = point[0], point[1], point[2], point[3:]
    delta, soft, own = np.empty(3), np.empty(3), np.empty(5)
    f, none = np.empty(14), np.empty((14, 14))
    largest = 0.0
    for k in range(pairs.shape[0]):
        p, q = edges[pairs[k, 0]], edges[pairs[k, 1]]
        s, t, rho = closest(x[p[0]], x[p[1]], x[q[0]], x[q[1]], sizes[k, 1], delta, soft)
        gap, length = rho - sizes[k, 0], math.sqrt(dot(delta, delta))
        w[0], w[1], w[2], w[3] = 1.0 - s, s, t - 1.0, -t
        for a in range(3):
            m[a], n[a] = delta[a] / rho, delta[a] / length
            arm[0, a], arm[1, a] = -shares[k, 0] * delta[a], shares[k, 1] * delta[a]
        own[:] = law[k]
        own[FRICTION] *= grip
        for side in range(2):
            take_motion(side, pairs[k, side], arrays, motion)
        if with_jac:
            _pair_derivatives(
                x[p[0]], x[p[1]], x[q[0]], x[q[1]], soft, delta, rho, length, shares[k], point, slopes
            )
        N = contact_block(2, own, gap, cv, point, slopes, motion, f, J[k] if with_jac else none, with_jac)
        largest = max(largest, N)
        for side in range(2):
            for r in range(6):
                F[3 * edges[pairs[k, side], r // 3] + r % 3] += f[7 * side + r]
            F[twist0 + pairs[k, side]] += f[7 * side + 6]
    return largest


@kernel
def _pair_derivatives(x0, x1, y0, y1, soft, delta, rho, length, shares, point, slopes):
    """Derivatives of a pair's gap, vectors, weights and arms by the positions of its four nodes."""
    m, n, w = point[0], point[1], point[2]
    dgap, dm, dn, dw, darm = slopes[0], slopes[1:4], slopes[4:7], slopes[7:11], slopes[11:]
    for r in range(12):
        i, b = r // 3, r % 3
        c = r if r < 6 else r + 1  # the first edge's twist is between
        # how the two conditions of the closest points change while s and t stay
        first, second = w[i] * (x1[b] - x0[b]), -w[i] * (y1[b] - y0[b])
        if i < 2:
            first += delta[b] if i == 1 else -delta[b]
        else:
            second -= delta[b] if i == 3 else -delta[b]
        ds = -soft[0] * first - soft[1] * second
        dt = -soft[1] * first - soft[2] * second
        dw[0, c], dw[1, c], dw[2, c], dw[3, c] = -ds, ds, dt, -dt
        dgap[c] = w[i] * m[b]
        radial = 0.0
        for a in range(3):
            shift = (x1[a] - x0[a]) * ds - (y1[a] - y0[a]) * dt
            if a == b:
                shift += w[i]
            darm[a, c], darm[3 + a, c] = -shares[0] * shift, shares[1] * shift
            dn[a, c] = shift
            radial += n[a] * shift
        for a in range(3):
            dm[a, c] = (dn[a, c] - m[a] * dgap[c]) / rho
            dn[a, c] = (dn[a, c] - radial * n[a]) / length


@kernel
def pair_step(pairs, sizes, law, edges, x, dx):
    """Share of the displacement ``dx`` on which every gap stays open, by conservative advancement."""
    delta, soft, mean = np.empty(3), np.empty(3), np.empty(3)
    y, d = np.empty((4, 3)), np.empty((4, 3))
    share = 1.0
    for k in range(pairs.shape[0]):
        for r in range(4):
            node = edges[pairs[k, r // 2], r % 2]
            for a in range(3):
                y[r, a], d[r, a] = x[node, a], dx[node, a]
        for a in range(3):
            mean[a] = 0.25 * (d[0, a] + d[1, a] + d[2, a] + d[3, a])
        rate = 0.0
        for side in range(2):
            fastest = 0.0
            for r in (2 * side, 2 * side + 1):
                square = 0.0
                for a in range(3):
                    d[r, a] -= mean[a]
                    square += d[r, a] * d[r, a]
                fastest = max(fastest, square)
            rate += STEEPEST * math.sqrt(fastest)
        _, _, rho = closest(y[0], y[1], y[2], y[3], sizes[k, 1], delta, soft)
        gap = rho - sizes[k, 0]
        floor = CLOSEST * min(gap, law[k, REACH])
        if (gap - floor) >= rate * share:
            continue
        if not gap > 0.0:
            return 0.0
        gone = 0.0
        for _ in range(200):
            ahead = (gap - 0.9 * floor) / rate
            gone += ahead
            if gone >= share:
                break
            for r in range(4):
                for a in range(3):
                    y[r, a] += ahead * d[r, a]
            _, _, rho = closest(y[0], y[1], y[2], y[3], sizes[k, 1], delta, soft)
            gap = rho - sizes[k, 0]
            if gap < floor:
                break
        share = min(share, gone)
    return share
