"""Compiled loops over the sites of drag laws.

A site is a node with the tangent ``cA T[edgeA] + cB T[edgeB]``; its stencil is the node and the
end nodes of those edges. ``data`` receives minus the derivative of the force.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def _scatter(s, f, dv, dt, cv, edgeA, edgeB, cA, cB, T, L, dofs, F, slots, data, with_jac):
    for i in range(3):
        F[dofs[s, i]] += f[i]
    if not with_jac:
        return
    for i in range(3):
        for j in range(3):
            data[slots[s, i, j]] -= cv * dv[i, j]
    for side in range(2):
        e = edgeA[s] if side == 0 else edgeB[s]
        if e < 0:
            continue
        w = (cA[s] if side == 0 else cB[s]) / L[e]
        a = 3 + 6 * side
        for i in range(3):
            p = dt[i, 0] * T[e, 0] + dt[i, 1] * T[e, 1] + dt[i, 2] * T[e, 2]
            for j in range(3):
                h = w * (dt[i, j] - p * T[e, j])
                data[slots[s, i, a + j]] += h
                data[slots[s, i, a + 3 + j]] -= h


@njit(cache=True)
def resistive_force(
    eta_t, eta_n, node, edgeA, edgeB, cA, cB, weight, v, T, L, cv, dofs, F, slots, data, with_jac
):
    """Anisotropic linear drag -eta_n v_n - eta_t v_t per unit length; returns the largest force."""
    f = np.empty(3)
    dv = np.empty((3, 3))
    dt = np.empty((3, 3))
    t = np.empty(3)
    fmax = 0.0
    for s in range(node.shape[0]):
        n = node[s]
        for i in range(3):
            t[i] = cA[s] * T[edgeA[s], i]
            if edgeB[s] >= 0:
                t[i] += cB[s] * T[edgeB[s], i]
        vt = v[n, 0] * t[0] + v[n, 1] * t[1] + v[n, 2] * t[2]
        en = -weight[s] * eta_n[s]
        ea = -weight[s] * (eta_t[s] - eta_n[s])
        for i in range(3):
            f[i] = en * v[n, i] + ea * vt * t[i]
            fmax = max(fmax, abs(f[i]))
            for j in range(3):
                dv[i, j] = ea * t[i] * t[j]
                dt[i, j] = ea * t[i] * v[n, j]
            dv[i, i] += en
            dt[i, i] += ea * vt
        _scatter(s, f, dv, dt, cv, edgeA, edgeB, cA, cB, T, L, dofs, F, slots, data, with_jac)
    return fmax


@njit(cache=True)
def scatter_line(f, dv, dt, cv, edgeA, edgeB, cA, cB, T, L, dofs, F, slots, data, with_jac):
    """Scatter forces (n, 3) and derivatives (n, 3, 3) by velocity (and position) and tangent."""
    fmax = 0.0
    for s in range(f.shape[0]):
        for i in range(3):
            fmax = max(fmax, abs(f[s, i]))
        _scatter(s, f[s], dv[s], dt[s], cv, edgeA, edgeB, cA, cB, T, L, dofs, F, slots, data, with_jac)
    return fmax


@njit(cache=True)
def axial_torque(coefficient, edges, w, cv, twist0, diagonal, F, data, with_jac):
    """Torque -c dtheta/dt on the twist of each edge."""
    for k in range(edges.shape[0]):
        dof = twist0 + edges[k]
        F[dof] -= coefficient[k] * w[edges[k]]
        if with_jac:
            data[diagonal[dof]] += cv * coefficient[k]


def site_loop(law):
    """Compile a loop over sites around a user's per-site twin ``law(v, x, t, radius, time, p, f, dv, dt)``."""

    @njit
    def loop(
        time, p, node, edgeA, edgeB, cA, cB, weight, radius, x, v, T, L, cv, dofs, F, slots, data, with_jac
    ):
        f = np.empty(3)
        dv = np.empty((3, 3))
        dt = np.empty((3, 3))
        t = np.empty(3)
        fmax = 0.0
        for s in range(node.shape[0]):
            for i in range(3):
                t[i] = cA[s] * T[edgeA[s], i]
                if edgeB[s] >= 0:
                    t[i] += cB[s] * T[edgeB[s], i]
            f[:] = 0.0
            dv[:] = 0.0
            dt[:] = 0.0
            law(v[node[s]], x[node[s]], t, radius[s], time, p[s], f, dv, dt)
            for i in range(3):
                f[i] *= weight[s]
                fmax = max(fmax, math.fabs(f[i]))
                for j in range(3):
                    dv[i, j] *= weight[s]
                    dt[i, j] *= weight[s]
            _scatter(s, f, dv, dt, cv, edgeA, edgeB, cA, cB, T, L, dofs, F, slots, data, with_jac)
        return fmax

    return loop
