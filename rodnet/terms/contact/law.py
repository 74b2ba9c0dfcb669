"""Compiled law of contact: a barrier on the gap and regularised Coulomb friction (docs/theory/contact.md).

A contact acts on up to four nodes with weights ``w``; its gap, the vector ``m`` that the gap's gradient
goes with (d gap / d x_i = w_i m), the unit normal ``n`` and the relative velocity ``V`` come from the
geometry, with their derivatives by the nodes' positions as rows of matrices.
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
def contact_block(count, law, gap, m, n, V, w, dgap, dm, dn, dV, dw, f, J, with_jac):
    """Forces ``f`` on the nodes of a contact and their derivatives ``J``; returns the normal force.

    Parameters
    ----------
    count : int
        Number of nodes.
    law : (4,)
        Stiffness [N/m], reach [m], coefficient of friction [1], slip speed [m/s].
    gap : float
        [m]
    m, n, V : (3,)
        See the module's note.
    w, dgap, dm, dn, dV, dw : (4,), (12,), (3, 12), (3, 12), (3, 12), (4, 12)
        Weights, and derivatives by the nodes' positions.
    """
    _, N, dN = barrier(gap, law[0], law[1])
    mu, slip = law[2], law[3]
    normal = n[0] * V[0] + n[1] * V[1] + n[2] * V[2]
    v0, v1, v2 = V[0] - normal * n[0], V[1] - normal * n[1], V[2] - normal * n[2]
    speed = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    if speed < slip:
        phi = (2.0 - speed / slip) / slip
        bend = -1.0 / (slip * slip * speed) if speed > 0.0 else 0.0
    else:
        phi = 1.0 / speed
        bend = -phi * phi * phi
    p0, p1, p2 = m[0] - mu * phi * v0, m[1] - mu * phi * v1, m[2] - mu * phi * v2  # per normal force
    for i in range(count):
        f[3 * i], f[3 * i + 1], f[3 * i + 2] = w[i] * N * p0, w[i] * N * p1, w[i] * N * p2
    if not with_jac:
        return N
    for c in range(3 * count):
        nd = n[0] * dV[0, c] + n[1] * dV[1, c] + n[2] * dV[2, c]
        nd += dn[0, c] * V[0] + dn[1, c] * V[1] + dn[2, c] * V[2]
        t0 = dV[0, c] - nd * n[0] - normal * dn[0, c]
        t1 = dV[1, c] - nd * n[1] - normal * dn[1, c]
        t2 = dV[2, c] - nd * n[2] - normal * dn[2, c]
        along = bend * (v0 * t0 + v1 * t1 + v2 * t2)
        g = dN * dgap[c]
        d0 = g * p0 + N * (dm[0, c] - mu * (phi * t0 + along * v0))
        d1 = g * p1 + N * (dm[1, c] - mu * (phi * t1 + along * v1))
        d2 = g * p2 + N * (dm[2, c] - mu * (phi * t2 + along * v2))
        for i in range(count):
            turn = N * dw[i, c]
            J[3 * i, c] = w[i] * d0 + turn * p0
            J[3 * i + 1, c] = w[i] * d1 + turn * p1
            J[3 * i + 2, c] = w[i] * d2 + turn * p2
    return N
