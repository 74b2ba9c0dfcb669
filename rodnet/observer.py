"""What can be read off a state: positions, velocities, speeds of rotation, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
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
        Readings of the robot's sensors at this state, each taken when it is first asked for.
    """

    def __init__(
        self, model: Model, state: State, sensors: Mapping[str, Callable[[Any], Any]] | None = None
    ) -> None:
        self._model, self.state, self.t = model, state, state.t
        self._sensors: Mapping[str, Callable[[Any], Any]] = {} if sensors is None else sensors
        self._taken: dict[str, Any] = {}  # no reference to itself, or states would pile up

    @property
    def sensors(self) -> Mapping[str, Any]:
        return _Readings(self._sensors, self, self._taken)

    @cached_property
    def x(self) -> np.ndarray:
        return _read_only(self.state.q[: 3 * self._model.graph.node_count].reshape(-1, 3))

    @cached_property
    def v(self) -> np.ndarray:
        return _read_only(self.state.v[: 3 * self._model.graph.node_count].reshape(-1, 3))

    @cached_property
    def theta(self) -> np.ndarray:
        k, e = self._model.twist0, self._model.graph.edge_count
        return _read_only(self.state.q[k : k + e] + 2.0 * np.pi * self.state.turns[:e])

    @cached_property
    def w(self) -> np.ndarray:
        k, e = self._model.twist0, self._model.graph.edge_count
        return _read_only(self.state.v[k : k + e])

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

    def joint_angle(self, at: str) -> Any:
        """Angle of a hinge [rad], whole turns included; see `Trajectory.joint_angle`."""
        from rodnet.solve.joint_frames import hinge_angles

        return hinge_angles(self._model, at, self.state.q, self.state.turns)


class _Readings(Mapping[str, Any]):
    """Sensor readings of one state, taken at the first request and kept."""

    def __init__(
        self, sensors: Mapping[str, Callable[[Any], Any]], view: Observer, taken: dict[str, Any]
    ) -> None:
        self._sensors, self._view, self._taken = sensors, view, taken

    def __getitem__(self, name: str) -> Any:
        if name not in self._taken:
            self._taken[name] = self._sensors[name](self._view)
        return self._taken[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sensors)

    def __len__(self) -> int:
        return len(self._sensors)

    def __repr__(self) -> str:
        return repr(dict(self))


def _read_only(array: np.ndarray) -> np.ndarray:
    array = array.view()
    array.flags.writeable = False
    return array
