"""What to look at before physics is blamed: bad markers, and drives that do not do what they are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.diagnosis.outliers import left_out
from rodnet.inference.packing import unpack_trial
from rodnet.recordings.inspection import Inspection, inspect
from rodnet.recordings.observation import Markers
from rodnet.robot import Robot
from rodnet.solve.model import Model

if TYPE_CHECKING:
    from rodnet.diagnosis.workbench import Fitted, Workbench

ASTRAY = 3.0  # times its noise that a driven marker may be off, rms
SHARE = 0.5  # of what it is off by that a lag, a gain or a shift must explain to be told
NAMES = ("lag", "gain", "shift")
EPSILON = 1e-12


@dataclass(frozen=True)
class Driven:
    """A marker on a part that is held or moved as commanded: where it was seen, beside where it should be.

    Attributes
    ----------
    marker : str
        Its name.
    rms : float
        Distance of both, over all trials [m].
    noise : float
        What the noise makes of it [m]; NaN where that is unknown.
    travel : float
        Rms distance of the command from its mean [m].
    lag, gain, shift : float
        What explains the distance best, each by itself: seconds that the marker comes later, what its motion is over
        the command's, and metres that it sits elsewhere.
    share : dict
        Share of the squared distance that each of them explains.
    """

    marker: str
    rms: float
    noise: float
    travel: float
    lag: float
    gain: float
    shift: float
    share: dict[str, float]

    @property
    def astray(self) -> bool:
        """Whether it is farther from its command than noise explains."""
        return self.rms > ASTRAY * self.noise

    @property
    def words(self) -> str:
        """What is seen, for people."""
        best = max(NAMES, key=lambda name: self.share[name])
        why = {
            "lag": f"as if it came {1e3 * abs(self.lag):.3g} ms {'late' if self.lag > 0.0 else 'early'}",
            "gain": f"as if it moved by {self.gain:.3g} of the command",
            "shift": f"as if it sat {1e3 * self.shift:.3g} mm elsewhere",
        }[best]
        explained = f", {why}" if self.share[best] > SHARE else ""
        return (
            f"marker {self.marker} is driven, and {1e3 * self.rms:.3g} mm from where its drive should have it "
            f"({self.rms / self.noise:.2g} times its noise){explained}"
        )


@dataclass(frozen=True)
class Preflight:
    """Checks of the training trials before a model is blamed.

    Attributes
    ----------
    markers : list of str
        What `rodnet.inspect` asks to look at: slipping or swapped markers, spoilt starts, frames that are missing.
    lost, suspect : dict
        Shares of samples that are missing, and that are flagged and left out, by trial.
    driven : list of Driven
        Markers on parts that are held or moved as commanded.
    outliers : dict
        Number of samples that stand out of those before and after, and are left out, by trial.
    """

    markers: list[str]
    lost: dict[str, float]
    suspect: dict[str, float]
    driven: list[Driven]
    outliers: dict[str, int] = field(default_factory=dict)

    @property
    def remarks(self) -> list[str]:
        """What needs attention."""
        standing = [
            f"{name}: {count} sample{'s' * (count != 1)} beside what came before and after, left out"
            for name, count in self.outliers.items()
            if count
        ]
        return [*self.markers, *standing, *(one.words for one in self.driven if one.astray)]

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        driven = [{**vars(one), "astray": one.astray} for one in self.driven]
        return {"remarks": self.remarks, "lost": self.lost, "suspect": self.suspect,
                "outliers": self.outliers, "driven": driven}  # fmt: skip


def preflight(bench: Workbench, fitted: Fitted) -> Preflight:
    """Look at the training trials, and at what is driven in them, beside the calibrated model as it is.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        The model as it is, calibrated.

    Returns
    -------
    Preflight
        Remarks in words, shares of samples lost and suspect, and of driven markers the distance from their drives [m].
    """
    seen = inspect([bench.case.part(rec) for rec in bench.recordings])
    untold = (
        bench.case.noise is None
    )  # else sigma is what a model is off by, and the noise what the recordings tell
    noise = _given(bench) if untold else _told(seen)
    known = {rec.name: file for rec, file in zip(bench.recordings, seen.files, strict=True)}
    return Preflight(
        [remark for remark in seen.remarks if not (untold and remark == seen.unknown)],
        {name: file["lost"] for name, file in known.items()},
        {name: file["suspect"] for name, file in known.items()},
        _driven(bench, fitted, noise),
        left_out(bench),
    )


def _given(bench: Workbench) -> dict[str, float]:
    """Standard deviation of a coordinate of each marker, as the diagnosis has it [m]."""
    found: dict[str, float] = {}
    for rec, noise in zip(bench.recordings, bench.noise, strict=True):
        part = bench.case.part(rec)
        for one in bench.case.observations(part, bench.case.robot(part)):
            if isinstance(one, Markers):
                names = [part.names[part.marker(m)] for m in one.markers]
                found |= dict(zip(names, map(float, noise[one.name].total(len(names))), strict=True))
    return found


def _told(seen: Inspection) -> dict[str, float]:
    """The same, as the recordings tell it; nothing if they do not."""
    if seen.noise is None:
        return {}
    names = seen.recordings[0].names
    return dict(zip(names, map(float, seen.noise.model.total(len(names))), strict=True))


def _driven(bench: Workbench, fitted: Fitted, noise: dict[str, float]) -> list[Driven]:
    """Every marker on a part that cannot move but as commanded, over all trials."""
    measured: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    axes: dict[str, int] = {}
    problem = bench.problem(fitted.candidates, fitted.values, fitted.own)
    for packed, fit in zip(problem.packed, fitted.fits, strict=True):
        trial = unpack_trial(packed)
        for number, one in enumerate(trial.instruments):
            if not isinstance(one, Markers) or len(trial.rec.t) < 2:
                continue
            where, there = (fit.samples(number, v[number]) for v in (fit.measured, fit.predicted))
            for m in np.flatnonzero(held(trial.robot, one)):
                name = trial.rec.names[trial.rec.marker(one.markers[m])]
                count = where.shape[2]
                if axes.setdefault(name, count) == count:  # a view of other axes is left out
                    measured.setdefault(name, []).append((trial.rec.t, where[:, m], there[:, m]))
    return [
        _compare(name, runs, noise.get(name, float("nan")), axes[name]) for name, runs in measured.items()
    ]


def held(robot: Robot, markers: Markers) -> np.ndarray:
    """Which markers sit on nodes that move as commanded and not otherwise, shape (M,) of bool."""
    model = Model(robot)
    movable = np.asarray(model.movable[: 3 * robot.graph.node_count].reshape(-1, 3).any(axis=1))
    i, j = robot.graph.edges[markers.edge].T
    first, second = markers.along < 1.0 - EPSILON, markers.along > EPSILON
    return np.logical_not((movable[i] & first) | (movable[j] & second))


def _compare(
    name: str, runs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], noise: float, axes: int
) -> Driven:
    """How far a marker is from its command, and which of lag, gain and shift explains most of it."""
    off, rate, way = [], [], []
    for t, seen, command in runs:
        good = np.isfinite(seen).all(axis=1)
        off.append((seen - command)[good])
        rate.append(-np.gradient(command, t, axis=0)[good])
        way.append((command - command[0])[good])
    d, v, w = (np.concatenate(parts) for parts in (off, rate, way))
    power = max(float((d**2).sum()), EPSILON**2)
    lag, late = _fit(v, d)
    more, further = _fit(w, d)
    mean = d.mean(axis=0) if len(d) else np.zeros(axes)
    share = {"lag": late / power, "gain": further / power, "shift": float(len(d) * mean @ mean) / power}
    rms = float(np.sqrt(power / max(len(d), 1)))
    travel = float(np.sqrt(np.mean(np.sum((w - w.mean(axis=0)) ** 2, axis=1)))) if len(w) else 0.0
    return Driven(
        name, rms, float(np.sqrt(axes)) * noise, travel, lag, 1.0 + more, float(np.linalg.norm(mean)), share
    )


def _fit(column: np.ndarray, off: np.ndarray) -> tuple[float, float]:
    """Coefficient of a column in what is off, and the power that it takes away."""
    norm = float((column**2).sum())
    if norm <= EPSILON**2:
        return 0.0, 0.0
    c = float((column * off).sum()) / norm
    return c, c * c * norm
