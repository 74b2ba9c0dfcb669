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
def spin_drag(coefficient, spun, edges, ts, T, L, S, v, w, cv, dofs, F, slots, data, with_jac):
    """Torque -c spin about each edge; ``dofs`` (n, 7) are those of its start, its end and its twist.

    The spin is that of the twist angle and of the transported director, w - S.(de/dt)/l; by virtual
    work the torque is as much on the twist and a couple T S / l of forces on the ends.
    """
    ds = np.empty(3)
    dt = np.empty(3)
    for k in range(spun.shape[0]):
        e, c = spun[k], coefficient[k]
        i, j = edges[e, 0], edges[e, 1]
        il = 1.0 / L[e]
        turn = 0.0
        chi = 1.0
        for a in range(3):
            turn += S[e, a] * (v[j, a] - v[i, a]) * il
            chi += ts[e, a] * T[e, a]
        torque = -c * (w[e] - turn)
        for a in range(3):
            F[dofs[k, a]] += torque * S[e, a] * il
            F[dofs[k, 3 + a]] -= torque * S[e, a] * il
        F[dofs[k, 6]] += torque
        if not with_jac:
            continue
        for a in range(3):  # by the edge vector's component a
            for b in range(3):
                dt[b] = -T[e, b] * T[e, a] * il
            dt[a] += il
            along = ts[e, 0] * dt[0] + ts[e, 1] * dt[1] + ts[e, 2] * dt[2]
            ds[0] = (ts[e, 1] * dt[2] - ts[e, 2] * dt[1] - S[e, 0] * along) / chi
            ds[1] = (ts[e, 2] * dt[0] - ts[e, 0] * dt[2] - S[e, 1] * along) / chi
            ds[2] = (ts[e, 0] * dt[1] - ts[e, 1] * dt[0] - S[e, 2] * along) / chi
            dturn = cv * S[e, a] * il - turn * T[e, a] * il
            for b in range(3):
                dturn += ds[b] * (v[j, b] - v[i, b]) * il
            dtorque = c * dturn
            for b in range(3):
                couple = (dtorque * S[e, b] + torque * (ds[b] - S[e, b] * T[e, a] * il)) * il
                data[slots[k, b, 3 + a]] -= couple
                data[slots[k, b, a]] += couple
                data[slots[k, 3 + b, 3 + a]] += couple
                data[slots[k, 3 + b, a]] -= couple
            data[slots[k, 6, 3 + a]] -= dtorque
            data[slots[k, 6, a]] += dtorque
            data[slots[k, a, 6]] += c * cv * S[e, a] * il
            data[slots[k, 3 + a, 6]] -= c * cv * S[e, a] * il
        data[slots[k, 6, 6]] += c * cv


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
