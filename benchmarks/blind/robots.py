"""Machines of the blind benchmark, drawn at random."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Arm:
    """A straight rod, or one of constant natural curvature, as it is at rest [m, 1/m]."""

    root: np.ndarray
    direction: np.ndarray
    normal: np.ndarray
    length: float
    curvature: tuple[float, float] = (0.0, 0.0)
    parent: int | None = None
    at: float = 0.0  # where on the parent, over its length

    def shape(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) and frames (n, 3, 3), rows d1, d2, d3, at arc lengths; the frame at s = 0 is the arm's."""
        start = np.stack([self.normal, np.cross(self.direction, self.normal), self.direction])
        kappa = np.array([*self.curvature, 0.0])
        frames = np.swapaxes(rotations(np.outer(s, kappa)), 1, 2) @ start
        fine = np.linspace(min(s[0], 0.0), s[-1], 2001)
        tangent = (np.swapaxes(rotations(np.outer(fine, kappa)), 1, 2) @ start)[:, 2]
        path = np.vstack(
            [np.zeros(3), np.cumsum(0.5 * (tangent[1:] + tangent[:-1]) * np.diff(fine)[:, None], axis=0)]
        )
        at = lambda x: np.stack([np.interp(x, fine, path[:, k]) for k in range(3)], axis=-1)  # noqa: E731
        return self.root + at(s) - at(np.zeros(1)), frames


@dataclass(frozen=True)
class Machine:
    """Rods of one material in a viscous medium (SI units)."""

    family: str
    radius: float
    young: float
    density: float
    viscosity: float
    arms: tuple[Arm, ...]
    place_rod: int = 0  # on which rod local effects sit

    def drag(self) -> tuple[float, float]:
        """Drag along and across the rods per length [Pa s], by Gray and Hancock's formulas for the first rod."""
        log = math.log(2.0 * self.arms[0].length / self.radius)
        return 2.0 * math.pi * self.viscosity / (log - 0.5), 4.0 * math.pi * self.viscosity / (log + 0.5)


def rotations(turn: np.ndarray) -> np.ndarray:
    """Rotation matrices of rotation vectors, shape (T, 3, 3)."""
    return Rotation.from_rotvec(turn).as_matrix()


def turned(machine: Machine, *turns: Mapping[str, Any]) -> Machine:
    """The machine turned about its root by ``angle`` about ``axis``, as it is held otherwise than drawn."""
    for turn in turns:
        R = rotations(turn["angle"] * np.array([turn["axis"]]))[0]
        arms = tuple(
            replace(arm, root=R @ arm.root, direction=R @ arm.direction, normal=R @ arm.normal)
            for arm in machine.arms
        )
        machine = replace(machine, arms=arms)
    return machine


def machine(family: str, rng: np.random.Generator) -> Machine:
    """Draw a machine."""
    length = rng.uniform(0.26, 0.34)
    radius = rng.uniform(0.0045, 0.0055)
    values = {"radius": radius, "young": rng.uniform(0.8e6, 1.3e6), "density": rng.uniform(1000.0, 1250.0)}
    viscosity = rng.uniform(0.2, 0.4)
    x, y, z = np.eye(3)
    zero = np.zeros(3)
    if family in ("shaken", "tendon"):
        arms = (Arm(zero, x, y, length),)
    elif family in ("spatial", "spun"):
        bend = rng.uniform(2.0, 4.0) * rng.choice([-1, 1], 2)
        arms = (Arm(zero, x, y, length, (float(bend[0]), float(bend[1]))),)
    elif family == "branched":
        trunk = Arm(zero, x, y, length)
        at, lean = 0.5, rng.uniform(0.7, 1.1)
        off = np.array([math.cos(lean), 0.0, math.sin(lean)])
        two = np.array([math.cos(lean), math.sin(lean), 0.0])
        arms = (
            trunk,
            Arm(at * length * x, off, y, 0.5 * length, parent=0, at=at),
            Arm(at * length * x, two, z, 0.4 * length, parent=0, at=at),
        )
    else:
        raise ValueError(f"no family '{family}'")
    return Machine(family, **values, viscosity=viscosity, arms=arms)
