"""Compiled loops over the sites of drag laws.

A site is a node with the tangent ``cA T[edgeA] + cB T[edgeB]``; its stencil is the node and the
end nodes of those edges. ``data`` receives minus the derivative of the force.
"""

import math

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.kinematics.kernels import STATE
from rodnet.packed import unpack

# the arrays of a law's sites; ``coefficients`` has a row for each site
SITES = "coefficients:d2 node:i1 edgeA:i1 edgeB:i1 cA:d1 cB:d1 weight:d1 radius:d1 slots:i3"


@inlined
def site_tangent(s, edgeA, edgeB, cA, cB, T, t):
    """Fill the tangent (3,) of a site."""
    for i in range(3):
        t[i] = cA[s] * T[edgeA[s], i]
        if edgeB[s] >= 0:
            t[i] += cB[s] * T[edgeB[s], i]


@inlined
def _scatter(s, f, dv, dt, cv, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac):
    for i in range(3):
        F[3 * node[s] + i] += f[i]
    if not with_jac:
        return
    for i in range(3):
        for j in range(3):
            data[slots[s, i, 0] + j] -= cv * dv[i, j]
    for side in range(2):
        e = edgeA[s] if side == 0 else edgeB[s]
        if e < 0:
            continue
        w = (cA[s] if side == 0 else cB[s]) / L[e]
        a = 1 + 2 * side
        for i in range(3):
            p = dt[i, 0] * T[e, 0] + dt[i, 1] * T[e, 1] + dt[i, 2] * T[e, 2]
            for j in range(3):
                h = w * (dt[i, j] - p * T[e, j])
                data[slots[s, i, a] + j] += h
                data[slots[s, i, a + 1] + j] -= h


@kernel
def see_sites(node, edgeA, edgeB, cA, cB, state):
    """Velocities, positions and tangents at sites, shape (n, 3) each."""
    x, v, _, _, _, _, T, _, _ = unpack(state, STATE)
    seen = np.empty((3, node.shape[0], 3))
    for s in range(node.shape[0]):
        for i in range(3):
            seen[0, s, i] = v[node[s], i]
            seen[1, s, i] = x[node[s], i]
        site_tangent(s, edgeA, edgeB, cA, cB, T, seen[2, s])
    return seen


@kernel
def resistive_force(sites, state, cv, F, data, with_jac):
    """Anisotropic linear drag -eta_n v_n - eta_t v_t per unit length; returns the largest force.

    The coefficients of a site are (eta_t, eta_n).
    """
    eta, node, edgeA, edgeB, cA, cB, weight, _, slots = unpack(sites, SITES)
    _, v, _, _, _, L, T, _, _ = unpack(state, STATE)
    f = np.empty(3)
    dv = np.empty((3, 3))
    dt = np.empty((3, 3))
    t = np.empty(3)
    fmax = 0.0
    for s in range(node.shape[0]):
        n = node[s]
        site_tangent(s, edgeA, edgeB, cA, cB, T, t)
        vt = v[n, 0] * t[0] + v[n, 1] * t[1] + v[n, 2] * t[2]
        en = -weight[s] * eta[s, 1]
        ea = -weight[s] * (eta[s, 0] - eta[s, 1])
        for i in range(3):
            f[i] = en * v[n, i] + ea * vt * t[i]
            fmax = max(fmax, abs(f[i]))
            for j in range(3):
                dv[i, j] = ea * t[i] * t[j]
                dt[i, j] = ea * t[i] * v[n, j]
            dv[i, i] += en
            dt[i, i] += ea * vt
        _scatter(s, f, dv, dt, cv, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac)
    return fmax


@kernel
def scaled_resistance(sites, factor, by_v, by_x, state, cv, F, data, with_jac):
    """`resistive_force` times a factor (n,) of each site, whose slopes by velocity and place are (n, 3), or empty.

    Returns the largest force.
    """
    eta, node, edgeA, edgeB, cA, cB, weight, _, slots = unpack(sites, SITES)
    _, v, _, _, _, L, T, _, _ = unpack(state, STATE)
    f = np.empty(3)
    dv = np.empty((3, 3))
    dt = np.empty((3, 3))
    t = np.empty(3)
    fmax = 0.0
    for s in range(node.shape[0]):
        n = node[s]
        site_tangent(s, edgeA, edgeB, cA, cB, T, t)
        vt = v[n, 0] * t[0] + v[n, 1] * t[1] + v[n, 2] * t[2]
        en = -weight[s] * eta[s, 1]
        ea = -weight[s] * (eta[s, 0] - eta[s, 1])
        g = factor[s]
        for i in range(3):
            whole = en * v[n, i] + ea * vt * t[i]
            f[i] = g * whole
            fmax = max(fmax, abs(f[i]))
            if with_jac:  # ``_scatter`` multiplies what is by velocity with the rate of change of velocities
                for j in range(3):
                    dv[i, j] = cv * g * ea * t[i] * t[j]
                    dt[i, j] = g * ea * t[i] * v[n, j]
                    if by_v.shape[0]:
                        dv[i, j] += cv * whole * by_v[s, j]
                    if by_x.shape[0]:
                        dv[i, j] += whole * by_x[s, j]
                dv[i, i] += cv * g * en
                dt[i, i] += g * ea * vt
        _scatter(s, f, dv, dt, 1.0, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac)
    return fmax


@kernel
def site_resistance(eta, v, t, f, dv, dt, slopes):
    """Anisotropic linear drag per unit length at sites (n, 3), its derivatives by velocity and tangent (n, 3, 3)."""
    for s in range(eta.shape[0]):
        along = v[s, 0] * t[s, 0] + v[s, 1] * t[s, 1] + v[s, 2] * t[s, 2]
        less = eta[s, 0] - eta[s, 1]
        for i in range(3):
            f[s, i] = -eta[s, 1] * v[s, i] - less * along * t[s, i]
            if slopes:
                for j in range(3):
                    dv[s, i, j] = -less * t[s, i] * t[s, j]
                    dt[s, i, j] = -less * t[s, i] * v[s, j]
                dv[s, i, i] -= eta[s, 1]
                dt[s, i, i] -= less * along


@kernel
def scatter_line(f, dv, dt, cv, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac):
    """Scatter forces (n, 3) and derivatives (n, 3, 3) by velocity (and position) and tangent."""
    fmax = 0.0
    for s in range(f.shape[0]):
        for i in range(3):
            fmax = max(fmax, abs(f[s, i]))
        _scatter(s, f[s], dv[s], dt[s], cv, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac)
    return fmax


# the arrays of `spin_drag`: edges, their drag [N m s], and their degrees of freedom
SPUN = "coefficient:d1 spun:l1 dofs:i2 slots:i3"


@kernel
def spin_drag(spun_edges, state, cv, F, data, with_jac):
    """Torque -c spin about each edge; ``dofs`` (n, 7) are those of its start, its end and its twist.

    The spin is that of the twist angle and of the transported director, w - S.(de/dt)/l; by virtual
    work the torque is as much on the twist and a couple T S / l of forces on the ends.
    """
    coefficient, spun, dofs, slots = unpack(spun_edges, SPUN)
    _, v, _, w, edges, L, T, S, ts = unpack(state, STATE)
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


# the arrays of `sphere_drag`: the node's drag [N s/m] and its degrees of freedom
NODE = "coefficient:d1 dofs:i1 slots:i3"


@kernel
def sphere_drag(sphere, spun_edges, state, rates, cv, F, data, with_jac):
    """Force -c v on a node and torque on an edge (`spin_drag`); returns the largest force."""
    coefficient, dofs, slots = unpack(sphere, NODE)
    largest = 0.0
    for i in range(3):
        f = coefficient[0] * rates[dofs[i]]
        F[dofs[i]] -= f
        largest = max(largest, abs(f))
        if with_jac:
            data[slots[i, 0, 0]] += cv * coefficient[0]
    spin_drag(spun_edges, state, cv, F, data, with_jac)
    return largest


@kernel
def _resistance_load(R, local, q, rates, ts, d1, out):
    """Generalised forces on (x_i, x_j, theta) of an edge with the 6 x 6 resistance R in its frame."""
    e, rate, t, d, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    for a in range(3):
        e[a] = q[3 + a] - q[a]
        rate[a] = rates[3 + a] - rates[a]
    length = math.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2)
    for a in range(3):
        t[a] = e[a] / length
    chi = 1.0 + ts[0] * t[0] + ts[1] * t[1] + ts[2] * t[2]
    b = (ts[1] * t[2] - ts[2] * t[1], ts[2] * t[0] - ts[0] * t[2], ts[0] * t[1] - ts[1] * t[0])
    bd = (b[0] * d1[0] + b[1] * d1[1] + b[2] * d1[2]) / chi
    d[0] = (chi - 1.0) * d1[0] + b[1] * d1[2] - b[2] * d1[1] + b[0] * bd
    d[1] = (chi - 1.0) * d1[1] + b[2] * d1[0] - b[0] * d1[2] + b[1] * bd
    d[2] = (chi - 1.0) * d1[2] + b[0] * d1[1] - b[1] * d1[0] + b[2] * bd
    w = (t[1] * d[2] - t[2] * d[1], t[2] * d[0] - t[0] * d[2], t[0] * d[1] - t[1] * d[0])
    c, s = math.cos(q[6]), math.sin(q[6])
    for a in range(3):
        m[0, a], m[1, a], m[2, a] = c * d[a] + s * w[a], c * w[a] - s * d[a], t[a]
    # the frame's spin about the edge is that of theta and that of the transported director
    axial = rates[6] - (b[0] * rate[0] + b[1] * rate[1] + b[2] * rate[2]) / (chi * length)
    spin = (
        (t[1] * rate[2] - t[2] * rate[1]) / length + axial * t[0],
        (t[2] * rate[0] - t[0] * rate[2]) / length + axial * t[1],
        (t[0] * rate[1] - t[1] * rate[0]) / length + axial * t[2],
    )
    twist, load = np.zeros(6), np.zeros(6)
    for k in range(3):
        for a in range(3):
            twist[k] += m[k, a] * rates[3 * local + a]
            twist[3 + k] += m[k, a] * spin[a]
    for k in range(6):
        for a in range(6):
            load[k] -= R[k, a] * twist[a]
    g = np.zeros(3)
    for k in range(3):
        for a in range(3):
            g[a] += m[k, a] * load[3 + k]
    # virtual rotation t x de/l + (dtheta - s.de/l) t with s = b / chi
    about = g[0] * t[0] + g[1] * t[1] + g[2] * t[2]
    out[3] = (g[1] * t[2] - g[2] * t[1] - about * b[0] / chi) / length
    out[4] = (g[2] * t[0] - g[0] * t[2] - about * b[1] / chi) / length
    out[5] = (g[0] * t[1] - g[1] * t[0] - about * b[2] / chi) / length
    for a in range(3):
        out[a] = -out[3 + a]
    out[6] = about
    for k in range(3):
        for a in range(3):
            out[3 * local + a] += m[k, a] * load[k]


@kernel
def resistance(R, local, q, rates, ts, d1, cv, steps, dofs, F, slots, data, with_jac):
    """Add the load of a 6 x 6 resistance; derivatives by central differences. Returns the largest force."""
    out, up, down, moved = np.empty(7), np.empty(7), np.empty(7), np.empty(7)
    _resistance_load(R, local, q, rates, ts, d1, out)
    largest = 0.0
    for a in range(7):
        F[dofs[a]] += out[a]
        if a < 6:
            largest = max(largest, abs(out[a]))
    if not with_jac:
        return largest
    for k in range(7):
        h = steps[0] if k < 6 else steps[1]
        for rated in range(2):
            source = rates if rated else q
            factor = cv if rated else 1.0
            h = steps[2] if rated else h
            moved[:] = source
            moved[k] = source[k] + h
            _resistance_load(R, local, q if rated else moved, moved if rated else rates, ts, d1, up)
            moved[k] = source[k] - h
            _resistance_load(R, local, q if rated else moved, moved if rated else rates, ts, d1, down)
            for a in range(7):
                data[slots[a, k]] -= factor * (up[a] - down[a]) / (2.0 * h)
    return largest
