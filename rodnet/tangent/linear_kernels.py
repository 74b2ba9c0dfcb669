"""Compiled changes of the residual with coefficients that it is linear in, for all columns at a time."""

from __future__ import annotations

import numpy as np

from rodnet.compiled import kernel
from rodnet.kinematics.kernels import STATE
from rodnet.packed import unpack
from rodnet.terms.drag.kernels import SITES, site_tangent


@kernel
def diagonal_changes(change, which, factor, out):
    """Add ``change``, shape (dof_count, n), times ``factor``, shape (dof_count,), to the columns ``which``."""
    for i in range(change.shape[0]):
        f = factor[i]
        if f != 0.0:
            for m in range(which.size):
                out[i, which[m]] += f * change[i, m]


@kernel
def spin_changes(change, which, state, twist0, out):
    """Minus the torque of `rodnet.terms.drag.kernels.spin_drag`, whose coefficients (edge_count, n) change."""
    _, v, _, w, edges, L, _, S, _ = unpack(state, STATE)
    for e in range(change.shape[0]):
        some = False
        for m in range(which.size):
            some = some or change[e, m] != 0.0
        if not some:
            continue
        i, j = edges[e, 0], edges[e, 1]
        spin = w[e]
        for a in range(3):
            spin -= S[e, a] * (v[j, a] - v[i, a]) / L[e]
        for m in range(which.size):
            torque, c = change[e, m] * spin, which[m]
            out[twist0 + e, c] += torque
            for a in range(3):
                out[3 * i + a, c] += torque * S[e, a] / L[e]
                out[3 * j + a, c] -= torque * S[e, a] / L[e]


@kernel
def wall_changes(node, weight, walls, which, x, out):
    """Minus the force of `rodnet.ElasticWall`: rows of ``walls`` are normal, position, layer and stiffness."""
    for s in range(node.size):
        n = 3 * node[s]
        for m in range(which.size):
            depth = walls[m, 3]
            for i in range(3):
                depth -= walls[m, i] * x[node[s], i]
            if depth > 0.0:
                into = min(depth, walls[m, 4])
                force = weight[s] * walls[m, 5] * (depth - into + 0.5 * into * into / walls[m, 4])
                for i in range(3):
                    out[n + i, which[m]] -= force * walls[m, i]


@kernel
def line_changes(sites, change, which, state, out):
    """Minus the force of `rodnet.terms.drag.kernels.resistive_force`, whose resistances (n, 2, columns) change."""
    _, node, edgeA, edgeB, cA, cB, _, _, _ = unpack(sites, SITES)
    _, v, _, _, _, _, T, _, _ = unpack(state, STATE)
    t = np.empty(3)
    for s in range(node.size):
        n = node[s]
        site_tangent(s, edgeA, edgeB, cA, cB, T, t)
        vt = v[n, 0] * t[0] + v[n, 1] * t[1] + v[n, 2] * t[2]
        for m in range(which.size):
            across, along = change[s, 1, m], (change[s, 0, m] - change[s, 1, m]) * vt
            if across != 0.0 or along != 0.0:
                for i in range(3):
                    out[3 * n + i, which[m]] += across * v[n, i] + along * t[i]


@kernel
def scaled_changes(sites, factors, which, state, out):
    """Minus the force of `rodnet.terms.drag.kernels.scaled_resistance`, for factors (n, columns)."""
    eta, node, edgeA, edgeB, cA, cB, weight = sites
    _, v, _, _, _, _, T, _, _ = unpack(state, STATE)
    t = np.empty(3)
    for s in range(node.size):
        n = node[s]
        site_tangent(s, edgeA, edgeB, cA, cB, T, t)
        vt = v[n, 0] * t[0] + v[n, 1] * t[1] + v[n, 2] * t[2]
        across = weight[s] * eta[s, 1]
        along = weight[s] * (eta[s, 0] - eta[s, 1]) * vt
        for m in range(which.size):
            for i in range(3):
                out[3 * n + i, which[m]] += factors[s, m] * (across * v[n, i] + along * t[i])
