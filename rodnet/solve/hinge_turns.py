"""Whole turns of the frames that joints carry, which no force tells (docs, theory: springs and joints)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rodnet.compiled import kernel
from rodnet.packed import Packed, unpack

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State

FARTHEST = 0.9 * math.pi  # [rad] in one step: nearly half a turn could be one to the other side

# frames of all joints, and of each body of a hinge that turns: the first body's frame, its own, its spring or -1
HINGES = "frames:l1 first:l1 turning:l1 spring:l1 q:d1 v:d1 eps:d2 driven:d1 before:d1"


@kernel
def largest_turn(table, twist0, q_old, tau_old):
    """Largest change of a hinge's angle since the old state, without what motors do [rad]."""
    _, first, turning, spring, q, _, eps, _, _ = unpack(table, HINGES)
    return _largest(twist0, first, turning, spring, q, q_old, eps, tau_old)


@kernel
def _largest(twist0, first, turning, spring, q, q_old, eps, tau_old):
    largest = 0.0
    for k in range(first.shape[0]):
        largest = max(largest, abs(_turn(k, twist0, first, turning, spring, q, q_old, eps, tau_old)))
    return largest


@kernel
def count(table, a, twist0, q_old, tau_old, cv, ca):
    """Take whole turns that nothing implies out of twist angles, their rates and accelerations ``a``.

    Returns whether no hinge has turned too far for that.
    """
    frames, first, turning, spring, q, v, eps, driven, before = unpack(table, HINGES)
    if _largest(twist0, first, turning, spring, q, q_old, eps, tau_old) > FARTHEST:
        return False
    for k in range(frames.shape[0]):
        i = twist0 + frames[k]
        _shift(i, math.floor(0.5 - (q[i] - q_old[i]) / math.tau), q, v, a, cv, ca)
    for k in range(first.shape[0]):
        wanted = _turn(k, twist0, first, turning, spring, q, q_old, eps, tau_old)
        if spring[k] >= 0:
            wanted += driven[spring[k]] - before[spring[k]]
        i, j = twist0 + first[k], twist0 + turning[k]
        moved = (q[j] - q_old[j]) - (q[i] - q_old[i])
        _shift(j, math.floor((wanted - moved) / math.tau + 0.5), q, v, a, cv, ca)
    return True


@kernel
def _turn(k, twist0, first, turning, spring, q, q_old, eps, tau_old):
    if spring[k] >= 0:
        return eps[spring[k], 2] - tau_old[spring[k]]
    i, j = twist0 + first[k], twist0 + turning[k]
    turn = (q[j] - q_old[j]) - (q[i] - q_old[i])
    return turn - math.tau * math.floor(turn / math.tau + 0.5)


@kernel
def _shift(i, turns, q, v, a, cv, ca):
    if turns != 0.0:
        q[i] += math.tau * turns
        v[i] += cv * math.tau * turns
        a[i] += ca * math.tau * turns


class HingeTurns:
    """Puts the twist angles of joints' frames, which have no mass, on the turn that their motion implies.

    Parameters
    ----------
    model : Model
        The model.
    ev : Evaluation
        Where states are evaluated.
    """

    def __init__(self, model: Model, ev: Evaluation) -> None:
        self.any, self._twist0 = bool(model.joints), model.twist0
        whole = lambda parts: np.array([*parts], dtype=np.int64)  # noqa: E731
        hinges = [(j, k) for j in model.joints if j.joint.kind == "hinge" for k in range(1, len(j.edges))]
        springs = {int(j.edges[k]): model.first_law + n for n, (j, k) in enumerate(model.joint_laws)}
        turning = [int(j.edges[k]) for j, k in hinges]
        self._packed = Packed(
            HINGES,
            whole(e for j in model.joints for e in j.edges),
            whole(j.edges[0] for j, _ in hinges),
            whole(turning),
            whole(springs.get(e, -1) for e in turning),
            ev.q, ev.rates, ev.eps, model.driven, ev.driven_ref,
        )  # fmt: skip

    def largest(self, state: State) -> float:
        """Largest change of a hinge's angle since ``state``, without what motors do [rad]."""
        return largest_turn(self._packed.table, self._twist0, state.q, state.tau) if self.any else 0.0

    def count(self, state: State, a: np.ndarray, cv: float, ca: float) -> bool:
        """Take whole turns that nothing implies out of an evaluated step's angles, rates and accelerations.

        Parameters
        ----------
        state : State
            Where the step began.
        a : ndarray, shape (dof_count,)
            Accelerations.
        cv, ca : float
            Derivatives of rates and accelerations by positions [1/s], [1/s^2].

        Returns
        -------
        bool
            False if a hinge has turned so far that nobody could tell to which side.
        """
        if not self.any:
            return True
        return bool(count(self._packed.table, a, self._twist0, state.q, state.tau, cv, ca))
