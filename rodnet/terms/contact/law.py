"""Compiled law of contact: a barrier on the gap and regularised Coulomb friction (docs/theory/contact.md).

A contact acts on one edge or two, each with seven degrees of freedom: the positions of its ends and its
twist. The geometry of a gap comes in `GEOMETRY`, the motion of the edges in `MOTION`.
"""

import math

import numpy as np

from rodnet.compiled import kernel

# by how much of its diameter a rod may be thicker, so that closest points are unique
THICKER = 1e-3
# the gradient of a gap by one point is at most this
STEEPEST = 1.0 + 2.0 * THICKER
# a step may close so much of a gap, or of the reach
CLOSEST = 0.2
# columns of `contact.law_table`
STIFFNESS, REACH, FRICTION, SLIP, DAMPING = 0, 1, 2, 3, 4


@kernel
def barrier(gap, stiffness, reach):
    """Energy [J], normal force [N] and its derivative by the gap [N/m]; infinite without a gap."""
    if gap >= reach:
        return 0.0, 0.0, 0.0
    if not gap > 0.0:
        return np.inf, np.inf, np.inf
    u = gap / reach
    log, left = math.log(u), 1.0 - u
    energy = -left * left * log
    force = left * left / u - 2.0 * left * log
    slope = 2.0 * log - 4.0 * left / u - left * left / (u * u)
    return stiffness * reach * reach * energy, stiffness * reach * force, stiffness * slope


@kernel
def stored_energy(law, gaps):
    """Energy that barriers store [J]."""
    total = 0.0
    for k in range(gaps.shape[0]):
        total += barrier(gaps[k], law[k, STIFFNESS], law[k, REACH])[0]
    return total


@kernel
def new_geometry():
    """Work arrays for the geometry of a gap.

    Returns
    -------
    m, n : (3,)
        The gap's gradient by node i is w_i m; unit normal from the second body to the first.
    w : (4,)
        Weights of the nodes.
    arm : (2, 3)
        From the edges' axes to where they touch [m].
    dgap, dm, dn, dw, darm : (14,), (3, 14), (3, 14), (4, 14), (2, 3, 14)
        Derivatives by the degrees of freedom of both edges.
    """
    n = 14
    return (
        np.zeros(3), np.zeros(3), np.zeros(4), np.zeros((2, 3)),
        np.zeros(n), np.zeros((3, n)), np.zeros((3, n)), np.zeros((4, n)), np.zeros((2, 3, n)),
    )  # fmt: skip


@kernel
def new_motion():
    """Work arrays for the motion of two edges.

    Returns
    -------
    v : (4, 3)
        Velocities of the nodes [m/s].
    rate, omega, t, S, ts : (2, 3)
        Rate of the edge vector [m/s], angular velocity [rad/s], tangent, holonomy vector, source tangent.
    size : (2, 2)
        Length [m] and spin about the tangent [rad/s].
    """
    return (
        np.zeros((4, 3)), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)),
        np.zeros((2, 3)), np.zeros((2, 2)),
    )  # fmt: skip


@kernel
def cross(a, b, out):
    """Cross product, the result last."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def take_motion(side, e, state, motion):
    """Fill in the motion of edge ``e``; its spin is that of the twist angle and of the carried director."""
    _, v_all, _, w_all, edges, L, T, S_all, ts_all = state
    v, rate, omega, t, S, ts, size = motion
    for a in range(3):
        v[2 * side, a], v[2 * side + 1, a] = v_all[edges[e, 0], a], v_all[edges[e, 1], a]
        rate[side, a] = v[2 * side + 1, a] - v[2 * side, a]
        t[side, a], S[side, a], ts[side, a] = T[e, a], S_all[e, a], ts_all[e, a]
    size[side, 0] = L[e]
    size[side, 1] = w_all[e] - dot(S[side], rate[side]) / L[e]
    cross(t[side], rate[side], omega[side])
    for a in range(3):
        omega[side, a] = omega[side, a] / L[e] + size[side, 1] * t[side, a]


@kernel
def contact_block(sides, law, gap, cv, geometry, motion, f, J, with_jac):
    """Generalised forces ``f`` (14,) of a contact and their derivatives ``J`` (14, 14).

    By virtual work, a friction force at the end of an arm is a force on the axis, a couple of forces on
    the ends of the edge, and a torque on its twist. Returns the normal force [N].

    Parameters
    ----------
    sides : int
        Number of edges, 1 or 2.
    law : (5,)
        Stiffness [N/m], reach [m], coefficient of friction [1], slip speed [m/s], damping [s/m].
    gap, cv : float
        [m]; derivative of rates by positions [1/s].
    geometry, motion : tuple
        See `new_geometry` and `new_motion`.
    """
    m, n, w, arm, dgap, dm, dn, dw, darm = geometry
    v, rate, omega, t, S, ts, size = motion
    mu, slip = law[FRICTION], law[SLIP]
    V, h, P, work = np.zeros(3), np.empty(3), np.empty(3), np.empty(3)
    tau, couple = np.zeros((2, 3)), np.zeros((2, 3))
    for k in range(sides):
        cross(omega[k], arm[k], work)
        sign = 1.0 - 2.0 * k
        for a in range(3):
            V[a] += w[2 * k] * v[2 * k, a] + w[2 * k + 1] * v[2 * k + 1, a] + sign * work[a]
    _, N, dN = barrier(gap, law[STIFFNESS], law[REACH])
    damped = max(1.0 - law[DAMPING] * dot(m, V), 0.0)
    braking = law[DAMPING] * N if damped > 0.0 else 0.0
    N, dN = N * damped, dN * damped
    normal = dot(n, V)
    for a in range(3):
        h[a] = V[a] - normal * n[a]
    speed = math.sqrt(dot(h, h))
    if speed < slip:
        phi = mu * (2.0 - speed / slip) / slip
        bend = -mu / (slip * slip * speed) if speed > 0.0 else 0.0
    else:
        phi = mu / speed
        bend = -mu / (speed * speed * speed)
    vt = h.copy()
    for a in range(3):
        h[a] = -phi * vt[a]  # friction per normal force
        P[a] = m[a] + h[a]
    for k in range(sides):
        sign = 1.0 - 2.0 * k
        cross(arm[k], h, tau[k])
        for a in range(3):
            tau[k, a] *= sign * N
        axial = dot(tau[k], t[k])
        cross(tau[k], t[k], work)
        for a in range(3):
            couple[k, a] = (work[a] - axial * S[k, a]) / size[k, 0]
            f[7 * k + a] = w[2 * k] * N * P[a] - couple[k, a]
            f[7 * k + 3 + a] = w[2 * k + 1] * N * P[a] + couple[k, a]
        f[7 * k + 6] = axial
    if with_jac:
        for c in range(7 * sides):
            _column(
                c, sides, cv, N, dN, braking, phi, bend, normal, V, vt, h, P, tau, couple, geometry, motion, J
            )
    return N


@kernel
def _column(c, sides, cv, N, dN, braking, phi, bend, normal, V, vt, h, P, tau, couple, geometry, motion, J):
    """Derivative of the generalised forces of a contact by one degree of freedom."""
    m, n, w, arm, dgap, dm, dn, dw, darm = geometry
    v, rate, omega, t, S, ts, size = motion
    own, b = c // 7, c % 7
    L, spin = size[own]
    de, dt, dS, domega = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    work, more, dV, dP = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    dl = 0.0
    if b == 6:
        for a in range(3):
            domega[a] = cv * t[own, a]
    else:
        de[b % 3] = 1.0 if b >= 3 else -1.0
        dl = dot(t[own], de)
        for a in range(3):
            dt[a] = (de[a] - dl * t[own, a]) / L
        chi, along = 1.0 + dot(ts[own], t[own]), dot(ts[own], dt)
        cross(ts[own], dt, dS)
        for a in range(3):
            dS[a] = (dS[a] - S[own, a] * along) / chi
        cross(dt, rate[own], work)
        cross(t[own], de, more)
        turn = dot(S[own], rate[own]) / L
        dspin = -(dot(dS, rate[own]) + cv * dot(S[own], de)) / L + turn * dl / L
        for a in range(3):
            across = omega[own, a] - spin * t[own, a]
            domega[a] = (work[a] + cv * more[a] - across * dl) / L + dspin * t[own, a] + spin * dt[a]
        dV[b % 3] = cv * w[2 * own + b // 3]
    # the relative velocity at the contact
    for k in range(sides):
        sign = 1.0 - 2.0 * k
        cross(omega[k], darm[k, :, c], work)
        if k == own:
            cross(domega, arm[k], more)
        else:
            more[:] = 0.0
        for a in range(3):
            dV[a] += (
                dw[2 * k, c] * v[2 * k, a] + dw[2 * k + 1, c] * v[2 * k + 1, a] + sign * (work[a] + more[a])
            )
    # its tangential part, and the forces that go with it
    through = dot(n, dV) + dot(dn[:, c], V)
    for a in range(3):
        work[a] = dV[a] - through * n[a] - normal * dn[a, c]
    along = bend * dot(vt, work)
    change = dN * dgap[c] - braking * (dot(dm[:, c], V) + dot(m, dV))
    df = np.empty(3)
    for a in range(3):
        df[a] = change * h[a] - N * (phi * work[a] + along * vt[a])
        dP[a] = change * m[a] + N * dm[a, c] + df[a]
    for k in range(sides):
        sign = 1.0 - 2.0 * k
        cross(darm[k, :, c], h, work)
        cross(arm[k], df, more)
        dtau = np.empty(3)
        for a in range(3):
            dtau[a] = sign * (N * work[a] + more[a])
        axial, twist = dot(tau[k], t[k]), dot(dtau, t[k])
        cross(dtau, t[k], work)
        if k == own:
            twist += dot(tau[k], dt)
            cross(tau[k], dt, more)
        for a in range(3):
            d = work[a] - twist * S[k, a]
            if k == own:
                d += more[a] - axial * dS[a] - couple[k, a] * dl
            d /= size[k, 0]
            J[7 * k + a, c] = w[2 * k] * dP[a] + dw[2 * k, c] * N * P[a] - d
            J[7 * k + 3 + a, c] = w[2 * k + 1] * dP[a] + dw[2 * k + 1, c] * N * P[a] + d
        J[7 * k + 6, c] = twist
