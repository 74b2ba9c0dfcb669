"""Sizes of a robot from which changes worth considering are derived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rodnet.parameters import Parameter
from rodnet.robot import Robot

PART = 0.05  # a change worth considering, of what a robot has


@dataclass(frozen=True)
class Measures:
    """A robot in a few numbers.

    Attributes
    ----------
    length : float
        Of its longest soft rod [m].
    size : float
        Diagonal of its initial shape [m].
    radius : float
        Mean radius of its soft rods [m].
    bending : float
        Mean bending stiffness of these [N m^2].
    mass : float
        In all [kg].
    time : float
        That it is watched for [s].
    """

    length: float
    size: float
    radius: float
    bending: float
    mass: float
    time: float

    @classmethod
    def of(cls, robot: Robot, duration: float) -> Measures:
        """Measure a robot that is watched for some time [s]."""
        graph = robot.graph
        soft = np.isfinite(graph.EI1) & ~graph.rigid
        if not soft.any():
            soft = np.ones(graph.edge_count, dtype=bool)
        weight = graph.rest_length[soft]
        mean = lambda a: float(np.sum(a[soft] * weight) / weight.sum())  # noqa: E731
        length = max(rod.length for rod in graph.rods.values() if soft[rod.edges].any())
        mass = float(graph.node_mass.sum()) + sum(body.mass for body in graph.bodies)
        bending = 0.5 * (graph.EI1 + graph.EI2)
        return cls(length, float(graph.size), mean(graph.radius), mean(bending), mass, float(duration))

    @property
    def speed(self) -> float:
        """Slowest motion that matters: its length in the time that it is watched for [m/s]."""
        return self.length / self.time

    @property
    def moment(self) -> float:
        """Moment that bends the longest rod by one radian [N m]."""
        return self.bending / self.length

    @property
    def force(self) -> float:
        """Force that bends the longest rod by about one radian [N]."""
        return self.bending / self.length**2

    def scale(self, parameter: Parameter) -> float:
        """Change of a parameter that is worth considering, from its unit and bounds."""
        value = float(np.max(np.abs(parameter.value))) if parameter.value is not None else 0.0
        low, high = parameter.bounds
        by_unit = {
            "1": 0.1,
            "rad": 0.1,
            "m": 0.01 * self.length,
            "s": 0.01 * self.time,
            "1/s": 1.0 / self.time,
            "Hz": 1.0 / self.time,
            "1/m": PART / self.length,
            "rad/m": PART / self.length,
            "1/m^2": PART / self.length**2,
            "N": PART * self.force,
            "N/m": PART * self.force / self.length,
            "N m": PART * self.moment,
            "m/s": PART * self.speed,
            "m/s^2": PART * self.force / self.mass if self.mass else 1.0,
            "Pa": PART * self.force / (self.length * self.radius),
            "Pa s": PART * self.force / (self.length * self.speed),
            "N s^2/m^3": PART * self.force / (self.length * self.speed**2),
            "kg": PART * self.mass,
            "kg/m^3": 100.0,
        }
        if value:
            return 0.1 * value
        if by_unit.get(parameter.unit):
            return by_unit[parameter.unit]
        return PART * (high - low) if np.isfinite(high - low) else 1.0
