"""Machines and drives of the blind benchmark, drawn at random."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

GRID = 1e-3  # [s]


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


@dataclass(frozen=True)
class Drive:
    """How the gripper moves: sums of sines that set in smoothly at t = 0, a tow, and what was before."""

    shift: np.ndarray  # (n, 3) amplitudes [m]
    turn: np.ndarray  # (n, 3) amplitudes [rad]
    frequency: np.ndarray  # (n,) [Hz]
    phase: np.ndarray  # (n, 2), of shifts and turns
    tow: np.ndarray = field(default_factory=lambda: np.zeros(3))  # [m/s]
    before: np.ndarray = field(
        default_factory=lambda: np.zeros(3)
    )  # height of a push before the recording [m]
    gain: float = 1.0
    lag: float = 0.0  # time constant of a gripper that runs behind [s]

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shift [m] and rotation vector [rad], shapes (T, 3)."""
        t = np.asarray(t, dtype=float)
        if self.lag == 0.0:
            return self._commanded(t)
        grid = np.arange(-1.0, float(t.max()) + 2.0 * GRID, GRID)
        asked = np.hstack(self._commanded(grid))
        # exact for a command that is linear between the grid's points
        keep = math.exp(-GRID / self.lag)
        rise = 1.0 - (1.0 - keep) * self.lag / GRID
        pushed = rise * asked[1:] + (1.0 - keep - rise) * asked[:-1]
        behind = np.vstack([asked[:1], lfilter([1.0], [1.0, -keep], pushed, axis=0)])
        found = CubicSpline(grid, behind)(np.maximum(t, -1.0))
        return found[:, :3], found[:, 3:]

    def _commanded(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        on = np.clip(t / 0.6, 0.0, 1.0)
        ramp = (on**3 * (10.0 - 15.0 * on + 6.0 * on**2))[:, None]
        angle = 2.0 * np.pi * t[:, None] * self.frequency
        shift = ramp * (np.sin(angle + self.phase[:, 0]) @ self.shift)
        turn = ramp * (np.sin(angle + self.phase[:, 1]) @ self.turn)
        # the integral of the ramp: a tow that sets in smoothly
        path = np.where(t > 0.6, t - 0.3, 0.6 * (2.5 * on**4 - 3.0 * on**5 + on**6))
        push = np.where((t > -0.9) & (t < -0.1), np.sin(np.pi * (t + 0.9) / 0.8) ** 4, 0.0)
        total = shift + path[:, None] * self.tow + push[:, None] * self.before
        return self.gain * total, self.gain * turn


def rotations(turn: np.ndarray) -> np.ndarray:
    """Rotation matrices of rotation vectors, shape (T, 3, 3)."""
    return Rotation.from_rotvec(turn).as_matrix()


def machine(family: str, rng: np.random.Generator) -> Machine:
    """Draw a machine."""
    length = rng.uniform(0.26, 0.34)
    radius = rng.uniform(0.0045, 0.0055)
    values = {"radius": radius, "young": rng.uniform(0.8e6, 1.3e6), "density": rng.uniform(1000.0, 1250.0)}
    viscosity = rng.uniform(0.2, 0.4)
    x, y, z = np.eye(3)
    zero = np.zeros(3)
    if family == "shaken":
        arms = (Arm(zero, x, y, length),)
    elif family == "spatial":
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


def drives(family: str, rng: np.random.Generator, count: int = 5) -> list[Drive]:
    """Draw drives of different regimes: slow and large, fast and small, turning, towed, mixed."""
    plane = family == "shaken"
    found = []
    for k in range(count):
        regime = k % 5
        n = 3
        shift, turn = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
        if plane:
            shift[:, 1] = 0.0
            turn[:, [0, 2]] = 0.0
        shift /= np.linalg.norm(shift)
        turn /= np.linalg.norm(turn)
        slow = rng.uniform(0.2, 0.45, n)
        fast = rng.uniform(0.7, 1.2, n)
        size, swing, frequency, pull = {
            0: (0.09, 0.15, slow, 0.0),
            1: (0.035, 0.15, fast, 0.0),
            2: (0.02, 0.9, rng.uniform(0.3, 0.8, n), 0.0),
            3: (0.03, 0.3, rng.uniform(0.3, 0.9, n), 0.07),
            4: (0.06, 0.5, rng.uniform(0.2, 1.0, n), 0.03),
        }[regime]
        tow, before = rng.normal(size=3), rng.normal(size=3)
        if plane:
            tow[1] = before[1] = 0.0
        drive = Drive(
            shift=shift * size * rng.uniform(0.8, 1.2),
            turn=turn * swing * rng.uniform(0.8, 1.2),
            frequency=frequency,
            phase=rng.uniform(0.0, 2.0 * np.pi, (n, 2)),
            tow=pull * tow / np.linalg.norm(tow),
            before=rng.uniform(0.003, 0.008) * before / np.linalg.norm(before),
        )
        found.append(drive)
    return found
