"""What can be read off a state: positions, velocities, speeds of rotation, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State


class Observer:
    """A read-only view of one state, for sensors, controllers, events and stop conditions.

    Attributes
    ----------
    t : float
        Time [s].
    x, v : ndarray, shape (N, 3)
        Node positions [m] and velocities [m/s].
    theta, w : ndarray, shape (E,)
        Twist angles [rad], full turns included, and their rates [rad/s].
    sensors : Mapping
        Readings of the robot's sensors at this state.
    """

    def __init__(self, model: Model, state: State) -> None:
        self._model, self.state, self.t = model, state, state.t
        n, e = model.graph.node_count, model.graph.edge_count
        k = model.twist0
        self.x, self.v = state.q[: 3 * n].reshape(-1, 3), state.v[: 3 * n].reshape(-1, 3)
        self.theta = state.q[k : k + e] + 2.0 * np.pi * state.turns[:e]
        self.w = state.v[k : k + e]
        for array in (self.x, self.v, self.theta, self.w):
            array.flags.writeable = False
        self.sensors: Mapping[str, Any] = {}

    def position(self, at: str) -> np.ndarray:
        """Position of a node [m], shape (3,)."""
        return self.x[self._model.graph.node(at)]

    def velocity(self, at: str) -> np.ndarray:
        """Velocity of a node [m/s], shape (3,)."""
        return self.v[self._model.graph.node(at)]

    def spin(self, on: str) -> float:
        """Rate of rotation of an edge about its own axis [rad/s]."""
        return float(self.w[self._model.graph.edge_indices(on)[0]])

    def rpm(self, on: str) -> float:
        """Rate of rotation of an edge about its own axis [rpm]."""
        return self.spin(on) * 60.0 / (2.0 * np.pi)

    def tangent(self, on: str) -> np.ndarray:
        """Unit tangent of an edge, shape (3,)."""
        return self.state.tangents[self._model.graph.edge_indices(on)[0]]
