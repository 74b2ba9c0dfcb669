"""Friction of a tendon at its eyelets: Coulomb's limits (capstan), and a bristle that never gives more than it took.

What is remembered of an eyelet is a force f [N], the drop of tension there, and the stiffness k [N/m] of its
pre-sliding. Along a slip ds towards the drive Dahl's law df = k ds - k abs(ds) f / C bends f towards the limit C of the
direction. It holds the energy f^2 / 2k. Since k stays, or rises with the largest limit so far, and f is cut to
the limits, what that energy loses without slip is lost: the work of friction is positive up to what is stored.
"""

from __future__ import annotations

import math

import numpy as np

from rodnet.compiled import kernel


@kernel
def drop(tension, turn, mu, old, stiffness, slip, reach, out):
    """Drop of tension f and stiffness k at one eyelet with their derivatives, in ``out`` (10,).

    These are f, its derivatives by tension, turn, slip, and what it and the stiffness were; k, and its derivatives by
    tension, turn, and what it was.

    Parameters
    ----------
    tension, turn, mu : float
        Tension before the eyelet [N], angle by which the tendon turns [rad], coefficient of friction [1].
    old, stiffness : float
        Drop [N] and stiffness [N/m] at the last accepted state.
    slip, reach : float
        Slip since then towards the drive and pre-sliding scale [m].
    out : ndarray, shape (10,)
        Filled.
    """
    loss, gain = -math.expm1(-mu * turn), math.expm1(mu * turn)
    ahead, back = tension * loss, tension * gain
    # derivatives of the two limits by the tension and by the turn
    ahead_turn, back_turn = mu * (tension - ahead), mu * (tension + back)
    start, start_T, start_turn, start_old = old, 0.0, 0.0, 1.0
    if old > ahead:
        start, start_T, start_turn, start_old = ahead, loss, ahead_turn, 0.0
    elif old < -back:
        start, start_T, start_turn, start_old = -back, -gain, -back_turn, 0.0
    k, k_T, k_turn, k_old = stiffness, 0.0, 0.0, 1.0
    if ahead > reach * stiffness:
        k, k_T, k_turn, k_old = ahead / reach, loss / reach, ahead_turn / reach, 0.0
    out[6], out[7], out[8], out[9] = k, k_T, k_turn, k_old
    if slip >= 0.0:
        n, limit, limit_T, limit_turn = 1.0, ahead, loss, ahead_turn
    else:
        n, limit, limit_T, limit_turn = -1.0, back, gain, back_turn
    way = abs(slip)
    if way == 0.0:
        out[0], out[1], out[2], out[3], out[4], out[5] = start, start_T, start_turn, k, start_old, 0.0
        return
    if limit <= 1e-14 * k * way:  # far beyond the scale: it slides
        out[0], out[1], out[2], out[3], out[4], out[5] = n * limit, n * limit_T, n * limit_turn, 0.0, 0.0, 0.0
        return
    x = k * way / limit
    left = math.exp(-x)
    end = n * limit
    out[0] = end + (start - end) * left
    bent = -(start - end) * left  # by x
    x_T, x_turn = x * (k_T / k - limit_T / limit), x * (k_turn / k - limit_turn / limit)
    out[1] = n * limit_T * (1.0 - left) + start_T * left + bent * x_T
    out[2] = n * limit_turn * (1.0 - left) + start_turn * left + bent * x_turn
    out[3] = bent * n * k / limit
    out[4] = start_old * left
    out[5] = k_old * bent * way / limit


@kernel
def chain(base, turns, mu, old, stiffness, slips, reach, tension, force, new, jac, by):
    """Tensions (n,) of all segments from that at the drive; fills forces, stiffnesses and, with ``jac``, ``by``.

    ``by`` (n, 2 n) are the derivatives of the tensions by the n lengths, the n - 1 turns and the base.
    """
    n = tension.shape[0]
    out = np.empty(10)
    tension[0] = base
    if jac:
        by[:] = 0.0
        by[0, 2 * n - 1] = 1.0
    for j in range(n - 1):
        drop(tension[j], turns[j], mu, old[j], stiffness[j], slips[j], reach, out)
        force[j], new[j] = out[0], out[6]
        tension[j + 1] = tension[j] - out[0]
        if jac:
            for c in range(2 * n):
                by[j + 1, c] = (1.0 - out[1]) * by[j, c]
            by[j + 1, n + j] -= out[2]
            for c in range(j + 1, n):  # what the way beyond an eyelet gets longer slides back through it
                by[j + 1, c] += out[3]


@kernel
def chain_changes(
    tension,
    turns,
    mu,
    old,
    stiffness,
    slips,
    reach,
    d_turns,
    d_old,
    d_stiffness,
    d_slips,
    d_tension,
    d_force,
    d_new,
):
    """Changes of tensions, forces and stiffnesses that `chain` gives, for many columns; those at the drive are given.

    ``d_turns``, ``d_old``, ``d_stiffness`` and ``d_slips`` (n - 1, k) are the changes of what it starts from. The first
    row of ``d_tension`` (n, k) is that of the tension at the drive; the others, ``d_force`` and ``d_new`` (n - 1, k)
    are filled.
    """
    out = np.empty(10)
    for j in range(tension.shape[0] - 1):
        drop(tension[j], turns[j], mu, old[j], stiffness[j], slips[j], reach, out)
        for c in range(d_tension.shape[1]):
            d_force[j, c] = (
                out[1] * d_tension[j, c]
                + out[2] * d_turns[j, c]
                + out[3] * d_slips[j, c]
                + out[4] * d_old[j, c]
                + out[5] * d_stiffness[j, c]
            )
            d_new[j, c] = out[7] * d_tension[j, c] + out[8] * d_turns[j, c] + out[9] * d_stiffness[j, c]
            d_tension[j + 1, c] = d_tension[j, c] - d_force[j, c]


@kernel
def drawn_tension(longer, natural, axial, turns, mu, old, stiffness, slips, reach, tension, force, new, by):
    """Tension at the drive [N] of a tendon that is longer than its natural lengths by ``longer`` > 0 [m].

    The segments' own stretches sum_k natural_k T_k / EA make up for it. The sum grows with the tension at the
    drive; its root lies between those of full friction either way.
    """
    n = tension.shape[0]
    total = least = most = 0.0
    share_low, share_high = 1.0, 1.0
    for k in range(n):
        if k > 0:
            share_low *= math.exp(-mu * turns[k - 1])
            share_high *= math.exp(mu * turns[k - 1])
        total += natural[k]
        least += natural[k] * share_low
        most += natural[k] * share_high
    wanted = longer * axial
    low, high = wanted / most, wanted / least
    base = min(max(wanted / total, low), high)
    for _ in range(100):
        chain(base, turns, mu, old, stiffness, slips, reach, tension, force, new, True, by)
        sum_, slope = -wanted, 0.0
        for k in range(n):
            sum_ += natural[k] * tension[k]
            slope += natural[k] * by[k, 2 * n - 1]
        if sum_ > 0.0:
            high = base
        else:
            low = base
        step = sum_ / slope if slope > 0.0 else math.inf
        if abs(step) <= 1e-15 * base or high - low <= 2e-16 * high:
            break
        base = base - step if low < base - step < high else 0.5 * (low + high)
    return base
