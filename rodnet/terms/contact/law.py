"""Compiled law of contact: a barrier on the gap and regularised Coulomb friction (docs/theory/contact.md).

A contact acts on one edge or two, each with seven degrees of freedom: the positions of its ends and its
twist. Its geometry comes in ``point`` (`POINT`) with the derivatives by these in ``slopes`` (`SLOPES`), the
motion of the edges in ``motion`` (`MOTION`).
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
# m, n, the weights of the nodes, and the arms of both edges: the gap's gradient by node i is w_i m; n is the unit
# normal from the second body to the first; arms lead from the axes to where the surfaces touch [m]
POINT = (5, 4)
# rows: gap; m and n (3 each); 4 weights; arms (3 each)
SLOPES = (17, 14)
# of each edge the velocities of its ends, their difference, angular velocity, tangent, holonomy vector, source
# tangent, and (length, spin about the tangent)
MOTION = (2, 8, 3)
START, END, RATE, OMEGA, TANGENT, HOLONOMY, SOURCE, SIZE = 0, 1, 2, 3, 4, 5, 6, 7


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
    _, v, _, w, edges, L, T, S, ts = state
    m = motion[side]
    for a in range(3):
        m[START, a], m[END, a] = v[edges[e, 0], a], v[edges[e, 1], a]
        m[RATE, a] = m[END, a] - m[START, a]
        m[TANGENT, a], m[HOLONOMY, a], m[SOURCE, a] = T[e, a], S[e, a], ts[e, a]
    m[SIZE, 0] = L[e]
    m[SIZE, 1] = w[e] - dot(m[HOLONOMY], m[RATE]) / L[e]
    cross(m[TANGENT], m[RATE], m[OMEGA])
    for a in range(3):
        m[OMEGA, a] = m[OMEGA, a] / L[e] + m[SIZE, 1] * m[TANGENT, a]


@kernel
def contact_block(sides, law, gap, cv, point, slopes, motion, f, J, with_jac):
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
    point, slopes, motion : ndarray
        See the module's note.
    """
    m, n, w, arm = point[0, :3], point[1, :3], point[2], point[3:, :3]
    mu, slip = law[FRICTION], law[SLIP]
    V, h, P, work = np.zeros(3), np.empty(3), np.empty(3), np.empty(3)
    tau, couple = np.zeros((2, 3)), np.zeros((2, 3))
    for k in range(sides):
        cross(motion[k, OMEGA], arm[k], work)
        sign = 1.0 - 2.0 * k
        for a in range(3):
            V[a] += w[2 * k] * motion[k, START, a] + w[2 * k + 1] * motion[k, END, a] + sign * work[a]
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
        axial = dot(tau[k], motion[k, TANGENT])
        cross(tau[k], motion[k, TANGENT], work)
        for a in range(3):
            couple[k, a] = (work[a] - axial * motion[k, HOLONOMY, a]) / motion[k, SIZE, 0]
            f[7 * k + a] = w[2 * k] * N * P[a] - couple[k, a]
            f[7 * k + 3 + a] = w[2 * k + 1] * N * P[a] + couple[k, a]
        f[7 * k + 6] = axial
    if with_jac:
        for c in range(7 * sides):
            _column(
                c,
                sides,
                cv,
                N,
                dN,
                braking,
                phi,
                bend,
                normal,
                V,
                vt,
                h,
                P,
                tau,
                couple,
                point,
                slopes,
                motion,
                J,
            )
    return N


@kernel
def _column(
    c, sides, cv, N, dN, braking, phi, bend, normal, V, vt, h, P, tau, couple, point, slopes, motion, J
):
    """Derivative of the generalised forces of a contact by one degree of freedom."""
    m, n, w, arm = point[0, :3], point[1, :3], point[2], point[3:, :3]
    dgap, dm, dn, dw = slopes[0, c], slopes[1:4, c], slopes[4:7, c], slopes[7:11, c]
    own, b = c // 7, c % 7
    rate, omega, t, S = motion[own, RATE], motion[own, OMEGA], motion[own, TANGENT], motion[own, HOLONOMY]
    L, spin = motion[own, SIZE, 0], motion[own, SIZE, 1]
    de, dt, dS, domega = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    work, more, dV, dP = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    dl = 0.0
    if b == 6:
        for a in range(3):
            domega[a] = cv * t[a]
    else:
        de[b % 3] = 1.0 if b >= 3 else -1.0
        dl = dot(t, de)
        for a in range(3):
            dt[a] = (de[a] - dl * t[a]) / L
        ts = motion[own, SOURCE]
        chi, along = 1.0 + dot(ts, t), dot(ts, dt)
        cross(ts, dt, dS)
        for a in range(3):
            dS[a] = (dS[a] - S[a] * along) / chi
        cross(dt, rate, work)
        cross(t, de, more)
        dspin = (dot(S, rate) * dl / L - dot(dS, rate) - cv * dot(S, de)) / L
        for a in range(3):
            across = omega[a] - spin * t[a]
            domega[a] = (work[a] + cv * more[a] - across * dl) / L + dspin * t[a] + spin * dt[a]
        dV[b % 3] = cv * w[2 * own + b // 3]
    # the relative velocity at the contact
    for k in range(sides):
        sign = 1.0 - 2.0 * k
        cross(motion[k, OMEGA], slopes[11 + 3 * k : 14 + 3 * k, c], work)
        more[:] = 0.0
        if k == own:
            cross(domega, arm[k], more)
        for a in range(3):
            dV[a] += dw[2 * k] * motion[k, START, a] + dw[2 * k + 1] * motion[k, END, a]
            dV[a] += sign * (work[a] + more[a])
    # its tangential part, and the forces that go with it
    through = dot(n, dV) + dot(dn, V)
    for a in range(3):
        work[a] = dV[a] - through * n[a] - normal * dn[a]
    along = bend * dot(vt, work)
    change = dN * dgap - braking * (dot(dm, V) + dot(m, dV))
    df, dtau = np.empty(3), np.empty(3)
    for a in range(3):
        df[a] = change * h[a] - N * (phi * work[a] + along * vt[a])
        dP[a] = change * m[a] + N * dm[a] + df[a]
    for k in range(sides):
        sign = 1.0 - 2.0 * k
        cross(slopes[11 + 3 * k : 14 + 3 * k, c], h, work)
        cross(arm[k], df, more)
        for a in range(3):
            dtau[a] = sign * (N * work[a] + more[a])
        twist = dot(dtau, motion[k, TANGENT])
        cross(dtau, motion[k, TANGENT], work)
        if k == own:
            axial = dot(tau[k], t)
            twist += dot(tau[k], dt)
            cross(tau[k], dt, more)
            for a in range(3):
                work[a] += more[a] - axial * dS[a] - couple[k, a] * dl
        for a in range(3):
            d = (work[a] - twist * motion[k, HOLONOMY, a]) / motion[k, SIZE, 0]
            J[7 * k + a, c] = w[2 * k] * dP[a] + dw[2 * k] * N * P[a] - d
            J[7 * k + 3 + a, c] = w[2 * k + 1] * dP[a] + dw[2 * k + 1] * N * P[a] + d
        J[7 * k + 6, c] = twist
