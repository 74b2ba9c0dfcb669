"""What the instruments make of the truth: noise, lost markers, an inexact record of the drive."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.robots import Machine


@dataclass(frozen=True)
class Instrument:
    """A camera and an encoder (SI units).

    ``sigma`` is the standard deviation of a coordinate of a marker, ``slow`` the share of its variance that
    varies slowly, with correlation time ``time``; ``lost`` the share of samples without a value.
    """

    sigma: float
    slow: float = 0.0
    time: float = 0.4
    lost: float = 0.03
    grip: float = 5e-5  # [m]
    turn: float = 2e-4  # [rad]

    def see(self, markers: np.ndarray, frame: float, rng: np.random.Generator) -> np.ndarray:
        """Markers as recorded, shape (T, M, 3), NaN where they were lost."""
        shape = markers.shape
        white = rng.standard_normal(shape)
        keep = np.exp(-frame / self.time)
        slow = np.empty(shape)
        slow[0] = rng.standard_normal(shape[1:])
        for k in range(1, shape[0]):
            slow[k] = keep * slow[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(shape[1:])
        seen = markers + self.sigma * (np.sqrt(1.0 - self.slow) * white + np.sqrt(self.slow) * slow)
        lost = rng.random(shape[:2]) < 0.5 * self.lost
        for _ in range(max(1, round(0.5 * self.lost * shape[0] * shape[1] / 10))):
            first, m = rng.integers(1, shape[0] - 10), rng.integers(shape[1])
            lost[first : first + 10, m] = True
        lost[0] = False
        seen[lost] = np.nan
        return seen


def write_recording(
    path: Path, machine: Machine, t: np.ndarray, markers: np.ndarray, places: list[tuple[int, float]],
    drive: dict[str, np.ndarray], instrument: Instrument, guess: dict[str, float],
) -> None:  # fmt: skip
    """Write a trial: markers, the record of the drive, and the data sheet of the machine."""
    order = {place: m for m, place in enumerate(places)}
    edges = [(order[a], order[b]) for a, b in pairwise(places) if a[0] == b[0]]
    sheet: dict[str, Any] = {
        "radius": machine.radius, "density": machine.density, "grip_noise": instrument.grip,
        "turn_noise": instrument.turn, **guess,
    }  # fmt: skip
    for k, arm in enumerate(machine.arms):
        sheet[f"drawn{k}"] = arm.shape(np.linspace(0.0, arm.length, 61))[0]
        if arm.parent is not None:
            sheet[f"joined{k}"] = np.array([arm.parent, arm.at])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path, t=t, markers=markers.astype(np.float32), edges=np.array(edges),
        names=np.array([f"arm{k}@{100 * s:.4g}%" for k, s in places]),
        **{name: value.astype(np.float32) for name, value in drive.items()}, **sheet,
    )  # fmt: skip
