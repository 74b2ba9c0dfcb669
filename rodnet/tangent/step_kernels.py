"""Compiled parts of the tangent of a step; columns are innermost in all blocks (docs, theory: sensitivities)."""

from __future__ import annotations

import math

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.kinematics.kernels import QUADRATIC, spring_forces, spring_strains
from rodnet.kinematics.turn_kernels import turn_about
from rodnet.packed import unpack
from rodnet.tangent.wide_kernels import U, across, add, at, load, store, times, wide

# what an evaluation holds: edges, new tangents, lengths, holonomy vectors, source tangents, rates, forces
EDGES = "edges:l2 L:d1 T:d2 S:d2 ts:d2 v:d2 F:d1"
# the matrix over the free degrees of freedom by rows: entries' places in the stored values, and their columns
# among all; ``full`` numbers the free degrees of freedom among all, ``position`` in the order of elimination
# ``entry`` and ``factor`` are scratch
ROWS = "start:l1 place:l1 column:l1 full:l1 position:l1 mass:d1 entry:l1 factor:d1"
# parts of D below this share of J [s] are what its making leaves of the derivative by positions (`fast.FAST`)
ROUND_OFF = 1e-15


@inlined
def _by_edge(a, t, inverse, out):
    """Derivative by the edge vector of a . t, the edge's tangent: (a - (a.t) t) / l."""
    along = a[0] * t[0] + a[1] * t[1] + a[2] * t[2]
    for i in range(3):
        out[i] = (a[i] - along * t[i]) * inverse


@wide
def begin(blocks, weights, q, held, columns, cv, ca, v0, a0, dv, da, out, clear):
    """Changes of rates and accelerations at a fixed new position; with ``clear``, that of the residual is zero yet.

    Parameters
    ----------
    blocks : tuple of ndarray
        What the stepper's offsets depend on; all blocks are flat, with rows dof_count.
    weights : ndarray, shape (2, len(blocks))
        How v0 and a0 are summed from them.
    q : ndarray
        Changes of the old degrees of freedom.
    held : ndarray of int
        Degrees of freedom whose changes come from elsewhere; here they are zero.
    columns : int
        Number of columns, a multiple of eight.
    cv, ca : float
        Derivatives of the rates and accelerations by the position.
    v0, a0, dv, da, out : ndarray
        Where it goes.
    """
    nothing = (0.0,) * 8
    for panel in range(q.size // 8):
        o = U(8 * panel)
        v, a, d = nothing, nothing, load(q, o)
        for k in range(len(blocks)):
            b = load(blocks[k], o)
            v, a = add(v, weights[0, k], b), add(a, weights[1, k], b)
        store(v0, o, v)
        store(a0, o, a)
        store(dv, o, add(v, -cv, d))
        store(da, o, add(a, -ca, d))
        if clear:
            store(out, o, nothing)
    for i in held:
        for c in range(i * columns, (i + 1) * columns):
            dv[c] = da[c] = 0.0


@wide
def turn_sources(table, twist0, columns, x_old, dq, spin, sources, out):
    """Effect of changed source frames on angles and rates of twist, and on the residual; blocks are flat.

    Parameters
    ----------
    table : int
        The `Packed` arrays of an evaluation (`EDGES`).
    twist0, columns : int
        First twist angle among the degrees of freedom; number of columns, a multiple of eight.
    x_old : ndarray, shape (3 n,)
        Positions before the step.
    dq, spin : ndarray, rows dof_count and edge_count
        Changes of the old degrees of freedom and of the old directors.
    sources : ndarray, rows dof_count + edge_count
        Changes of the rates, to which is added; behind them, set, the angles that the transported
        directors turn by.
    out : ndarray, rows dof_count
        Changes of the residual, to which is added.
    """
    edges, L, T, S, ts, v, F = unpack(table, EDGES)
    h = np.empty((3, 3))
    a, b, g, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    stride, behind = U(columns), F.size
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        length = 0.0
        chi = 1.0
        spun = 0.0
        for m in range(3):
            length += (x_old[3 * j + m] - x_old[3 * i + m]) ** 2
            chi += ts[e, m] * T[e, m]
            w[m] = v[j, m] - v[i, m]
            spun += S[e, m] * w[m]
        inverse = 1.0 / math.sqrt(length)
        _by_edge(S[e], ts[e], inverse, g)
        scale = 1.0 / (L[e] * chi)
        t = T[e]
        b[0] = -scale * (t[1] * w[2] - t[2] * w[1] - spun * t[0])
        b[1] = -scale * (t[2] * w[0] - t[0] * w[2] - spun * t[1])
        b[2] = -scale * (t[0] * w[1] - t[1] * w[0] - spun * t[2])
        _by_edge(b, ts[e], inverse, w)
        # rows of the derivative of S by the source tangent, (dts x t - S (dts . t)) / chi
        moment = F[twist0 + e] * scale
        for m in range(3):
            for n in range(3):
                a[n] = -moment * S[e, m] * t[n]
            n1, n2 = (m + 1) % 3, (m + 2) % 3
            a[n1] += moment * t[n2]
            a[n2] -= moment * t[n1]
            _by_edge(a, ts[e], inverse, h[m])
        for panel in range(columns // 8):
            c = U(8 * panel)
            first, last = at(3 * i, stride, c), at(3 * j, stride, c)
            d0 = across(dq, last, first)
            d1 = across(dq, last + stride, first + stride)
            d2 = across(dq, last + stride + stride, first + stride + stride)
            turned = add(add(add(load(spin, at(e, stride, c)), -g[0], d0), -g[1], d1), -g[2], d2)
            o = at(twist0 + e, stride, c)
            rate = add(add(add(load(sources, o), w[0], d0), w[1], d1), w[2], d2)
            store(sources, at(behind + e, stride, c), turned)
            store(sources, o, rate)
            if moment != 0.0:
                for m in range(3):
                    f = add(add(times(h[m, 0], d0), h[m, 1], d1), h[m, 2], d2)
                    o = at(3 * j + m, stride, c)
                    store(out, o, add(load(out, o), 1.0, f))
                    o = at(3 * i + m, stride, c)
                    store(out, o, add(load(out, o), -1.0, f))


@wide
def right_sides(rows, twist0, columns, J, D, cv, ca, sources, da, out, y):
    """Right-hand sides of all columns, in the order of elimination: minus the change of the residual.

    Parameters
    ----------
    rows : int
        The `Packed` matrix (`ROWS`).
    twist0, columns : int
        As for `turn_sources`.
    J, D : ndarray
        Values of the Jacobian, and of minus the derivative of the forces by the rates.
    cv, ca : float
        Derivatives of the rates and accelerations by the position.
    sources, da, out : ndarray
        Changes of rates and frames, of accelerations, and of the rest of the residual; flat blocks.
    y : ndarray, rows free
        Where they go.
    """
    start, place, column, full, position, mass, entry, factor = unpack(rows, ROWS)
    stride, behind = U(columns), mass.size - twist0
    for r in range(full.shape[0]):
        i = full[r]
        m = mass[i]
        count = 0
        for k in range(start[r], start[r + 1]):
            j, p = column[U(k)], U(place[U(k)])
            d = D[p]
            if d != 0.0 and abs(d) > ROUND_OFF * abs(J[p]):
                entry[count], factor[count] = j, -d
                count += 1
            if j >= twist0:
                stiff = J[p] - cv * d
                if i == j:
                    stiff -= ca * m
                if stiff != 0.0:
                    entry[count], factor[count] = j + behind, -stiff
                    count += 1
        for panel in range(columns // 8):
            c = U(8 * panel)
            o = at(i, stride, c)
            a = add(times(-1.0, load(out, o)), -m, load(da, o))
            for k in range(count):
                a = add(a, factor[U(k)], load(sources, at(entry[U(k)], stride, c)))
            store(y, at(position[r], stride, c), a)


@wide
def advance(table, rows, twist0, columns, y, cv, ca, dq_old, dv0, da0, sources, dq, dv, da, spin):
    """Changes of the new degrees of freedom, rates, accelerations and directors; blocks are flat.

    Those of what is held must be in ``dq``, ``dv`` and ``da`` already.
    """
    edges, L, T, S, _, _, F = unpack(table, EDGES)
    _, _, _, full, position, _, _, _ = unpack(rows, ROWS)
    stride, behind = U(columns), F.size
    for r in range(full.shape[0]):
        for panel in range(columns // 8):
            c = U(8 * panel)
            o = at(full[r], stride, c)
            new = load(y, at(position[r], stride, c))
            d = add(new, -1.0, load(dq_old, o))
            rate = add(load(dv0, o), cv, d)
            acceleration = add(load(da0, o), ca, d)
            store(dq, o, new)
            store(dv, o, rate)
            store(da, o, acceleration)
    g = np.empty(3)
    for e in range(edges.shape[0]):
        _by_edge(S[e], T[e], 1.0 / L[e], g)
        for panel in range(columns // 8):
            c = U(8 * panel)
            first, last = at(3 * edges[e, 0], stride, c), at(3 * edges[e, 1], stride, c)
            a = load(sources, at(behind + e, stride, c))
            a = add(a, -g[0], across(dq, last, first))
            a = add(a, -g[1], across(dq, last + stride, first + stride))
            a = add(a, -g[2], across(dq, last + stride + stride, first + stride + stride))
            store(spin, at(e, stride, c), a)


@kernel
def motor_change(quadratic, parts, angle, h, s, second, K, places, change, out):
    """Add the change of the residual with the natural angle of one spring's motor, times ``change``, shape (k,).

    ``places`` are the spring's degrees of freedom, ``h`` the step of central differences of its force alone.
    """
    (
        _, theta, _, L, T, M1, M2, S, _, _, e1, e2, Q1, Q2, _, _, _, _, eps0, _, _,
        s1, s2, _, _, _, slots, _, ts, _, tau_ref, theta_ref, driven, driven_ref, spin,
    ) = unpack(quadratic, QUADRATIC)  # fmt: skip
    some = False
    for c in range(change.size):
        some = some or change[c] != 0.0
    if not some:
        return
    column = np.zeros(11)
    eps, sigma, scrap = np.empty((1, 3)), np.empty((1, 3)), np.zeros(1)
    one, two = Q1[s : s + 1].copy(), Q2[s : s + 1].copy()
    dofs = np.empty((1, 11), dtype=np.int32)
    for i in range(11):
        dofs[0, i] = i
    for sign in (1.0, -1.0):
        turn_about(parts, angle + sign * h, 0, two if second else one)
        a, b = e1[s : s + 1], e2[s : s + 1]
        spring_strains(
            a, b, one, two, T, M1, M2, tau_ref[s : s + 1], theta, theta_ref, driven[s : s + 1],
            driven_ref[s : s + 1], spin[s : s + 1], eps,
        )  # fmt: skip
        for i in range(3):
            sigma[0, i] = 0.0
            for j in range(3):
                sigma[0, i] -= sign / (2.0 * h) * K[s, i, j] * (eps[0, j] - eps0[s, j])
        spring_forces(
            a, b, one, two, s1[s : s + 1], s2[s : s + 1], dofs, L, T, M1, M2, S, ts, eps, sigma, K[s : s + 1],
            column, slots[s : s + 1], scrap, False,
        )  # fmt: skip
    for i in range(11):
        for c in range(change.size):
            out[places[i], c] += column[i] * change[c]


@kernel
def spread(rows, columns, out):
    """Add rows, shape (n, dof_count), to the given columns of ``out``, shape (dof_count, k)."""
    for n in range(columns.size):
        c = columns[n]
        for i in range(out.shape[0]):
            out[i, c] += rows[n, i]
