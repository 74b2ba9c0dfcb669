"""How the machines of the blind benchmark are driven: in a gripper, by a motor, by a tendon."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

GRID = 1e-3  # [s]
SHAKEN = 0, 1  # regimes of little turn
LARGER = 2.0  # times as large as the trials before are those to choose from


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

    def reading(
        self, t: np.ndarray, rng: np.random.Generator, grip: float, turn: float
    ) -> dict[str, np.ndarray]:
        """What is recorded of it: shift [m] and orientation (quaternions x, y, z, w), with noise [m], [rad]."""
        shift, angle = self.motion(t)
        turned = Rotation.from_rotvec(angle) * Rotation.from_rotvec(turn * rng.standard_normal(angle.shape))
        return {
            "grip": shift + grip * rng.standard_normal(shift.shape),
            "turn": turned.as_quat(canonical=True),
        }

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


@dataclass(frozen=True)
class Spin:
    """A motor at the root that is told a speed [rpm], from rest at t = 0."""

    rpm: float

    def reading(
        self, t: np.ndarray, rng: np.random.Generator, grip: float, turn: float
    ) -> dict[str, np.ndarray]:
        """What is recorded of it: the command."""
        return {"rpm": np.array(self.rpm)}


@dataclass(frozen=True)
class Pull:
    """A tendon that is pulled and let go again and again, from nothing at t = 0."""

    tension: float  # [N]
    frequency: float  # [Hz]

    def share(self, t: float) -> float:
        """Part of the tension."""
        return math.sin(math.pi * self.frequency * t) ** 2

    def reading(
        self, t: np.ndarray, rng: np.random.Generator, grip: float, turn: float
    ) -> dict[str, np.ndarray]:
        """What is recorded of it: the command."""
        return {"tension": np.array(self.tension), "frequency": np.array(self.frequency)}


AnyDrive = Drive | Spin | Pull


def drives(family: str, rng: np.random.Generator, count: int = 5) -> list[AnyDrive]:
    """Draw drives of different regimes; in a gripper: slow and large, fast and small, turning, towed, mixed."""
    if family == "spun":
        speeds = np.linspace(3.0, 12.0, count) * rng.uniform(0.85, 1.15, count)
        return [Spin(float(rng.choice([-1.0, 1.0]) * v)) for v in rng.permutation(speeds)]
    if family == "tendon":
        tensions = np.linspace(0.25, 0.9, count) * rng.uniform(0.9, 1.1, count)
        return [Pull(float(v), float(rng.uniform(0.3, 0.9))) for v in rng.permutation(tensions)]
    return [_held(family, rng, k % 5) for k in range(count)]


def alike(family: str, rng: np.random.Generator, count: int = 5) -> list[AnyDrive]:
    """Draw drives of one regime, which differ by chance alone: of a laboratory that only shakes, slowly or fast."""
    if family in ("spun", "tendon"):
        one = drives(family, rng, 1)[0]
        return [one] * count
    regime = int(rng.choice(SHAKEN))
    return [_held(family, rng, regime) for _ in range(count)]


def menu(family: str, rng: np.random.Generator, count: int = 6) -> list[AnyDrive]:
    """Draw drives to choose the next trial from: like those before, larger; and slow ones that turn far.

    What a turn tells: a weight keeps its direction while the rod turns under it, a drag turns along.
    """
    if family == "spun":
        speeds = np.linspace(2.0, 16.0, count) * rng.uniform(0.9, 1.1, count)
        return [Spin(float(rng.choice([-1.0, 1.0]) * v)) for v in speeds]
    if family == "tendon":
        tensions = np.linspace(0.2, 1.2, count) * rng.uniform(0.9, 1.1, count)
        return [Pull(float(v), float(rng.uniform(0.2, 1.2))) for v in tensions]
    return [_held(family, rng, k % 6, LARGER) for k in range(count)]


def _held(family: str, rng: np.random.Generator, regime: int, times: float = 1.0) -> Drive:
    plane = family == "shaken"
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
        5: (0.03, 1.0, rng.uniform(0.1, 0.3, n), 0.0),
    }[regime]
    tow, before = rng.normal(size=3), rng.normal(size=3)
    if plane:
        tow[1] = before[1] = 0.0
    return Drive(
        shift=shift * times * size * rng.uniform(0.8, 1.2),
        turn=turn * times * swing * rng.uniform(0.8, 1.2),
        frequency=frequency,
        phase=rng.uniform(0.0, 2.0 * np.pi, (n, 2)),
        tow=times * pull * tow / np.linalg.norm(tow),
        before=rng.uniform(0.003, 0.008) * before / np.linalg.norm(before),
    )
