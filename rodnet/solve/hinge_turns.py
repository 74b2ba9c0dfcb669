"""Whole turns of the frames that joints carry, which no force tells (docs, theory: springs and joints)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State

FARTHEST = 0.9 * np.pi  # [rad] in one step: nearly half a turn could be one to the other side


class HingeTurns:
    """Puts the twist angles of joints' frames, which have no mass, on the turn that their motion implies.

    Parameters
    ----------
    model : Model
        The model.

    Attributes
    ----------
    any : bool
        Whether there are frames at all.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.any = bool(model.joints)
        none = [np.zeros(0, dtype=np.int64)]
        self._frames = np.concatenate([*none, *(j.edges for j in model.joints)])
        self._near, self._far = model.edges[self._frames].T
        hinges = [j for j in model.joints if j.joint.kind == "hinge"]
        self._first = np.concatenate([*none, *(np.repeat(j.edges[:1], len(j.edges) - 1) for j in hinges)])
        self._turning = np.concatenate([*none, *(j.edges[1:] for j in hinges)])
        springs = {int(j.edges[k]): model.first_law + n for n, (j, k) in enumerate(model.joint_laws)}
        # without a spring of its own: -1
        self._spring = np.array([springs.get(int(e), -1) for e in self._turning], dtype=np.int64)
        self._sprung = self._spring >= 0
        self._driven = model.driven.copy()

    def carry(self, guess: np.ndarray, q: np.ndarray) -> None:
        """Let the frames in a ``guess`` follow their nodes as they were in ``q``: without mass they have no swing."""
        if not self.any:
            return
        k = self.model.twist0
        x, x_old = guess[:k].reshape(-1, 3), q[:k].reshape(-1, 3)
        x[self._far] = x[self._near] + (x_old[self._far] - x_old[self._near])
        guess[k + self._frames] = q[k + self._frames]

    def begin(self) -> None:
        """Note where motors are before a step."""
        if self.any:
            self._driven[:] = self.model.driven

    def change(self, ev: Evaluation, state: State) -> np.ndarray:
        """Change of hinges' angles since ``state`` without what motors do [rad], shape (n,)."""
        k = self.model.twist0
        theta, old = ev.theta, state.q[k : k + len(ev.theta)]
        change = (theta - old)[self._turning] - (theta - old)[self._first]
        change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
        s = self._spring[self._sprung]
        change[self._sprung] = ev.eps[s, 2] - state.tau[s]
        return change

    def count(self, ev: Evaluation, state: State, cv: float, ca: float, a: np.ndarray) -> bool:
        """Take whole turns that nothing implies out of an evaluated step's angles, rates and accelerations.

        Parameters
        ----------
        ev : Evaluation
            At the end of a step or of a stage.
        state : State
            Where the step began.
        cv, ca : float
            Derivatives of rates and accelerations by positions [1/s], [1/s^2].
        a : ndarray, shape (dof_count,)
            Accelerations.

        Returns
        -------
        bool
            False if a hinge has turned so far that nobody could tell to which side.
        """
        if not self.any:
            return True
        whole, k = 2.0 * np.pi, self.model.twist0
        theta, old = ev.theta, state.q[k : k + len(ev.theta)]
        change = self.change(ev, state)
        turns = np.zeros(len(theta))
        turns[self._frames] = -np.round((theta - old)[self._frames] / whole)
        moved = theta + whole * turns - old
        wanted = change.copy()
        s = self._spring[self._sprung]
        wanted[self._sprung] += (self.model.driven - self._driven)[s]
        turns[self._turning] += np.round((wanted - (moved[self._turning] - moved[self._first])) / whole)
        if turns.any():
            theta += whole * turns
            ev.w += cv * whole * turns
            a[k : k + len(theta)] += ca * whole * turns
        return not len(change) or float(np.abs(change).max()) < FARTHEST
