"""Forces as arrows: those of every term on the nodes, and those of contacts where they act."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.terms.contact.points import contact_points
from rodnet.viz.rerun_log import FORCE, SERIES, Log, si

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

COLORS = {"drag": FORCE, "contact": SERIES[3], "load": SERIES[6]}  # by kind of term, which are shown
OPEN = ("drag", "contact")  # kinds that the view opens with
LONGEST = 1.0 / 3.0  # of the robot's size: the longest arrows


@dataclass
class Forces:
    """Forces of one term at the frames that are shown.

    Attributes
    ----------
    name, kind : str
        The term's.
    x, f : ndarray, shape (T, n, 3)
        Where they act [m], and forces [N]; NaN for no force.
    """

    name: str
    kind: str
    x: np.ndarray
    f: np.ndarray


def forces_of(traj: Trajectory, frames: np.ndarray) -> list[Forces]:
    """Forces of drag, contact and loads at the chosen frames; none without the robot."""
    if traj.robot is None:
        return []
    replay = traj._replay
    shown = [b for b in replay.model.bound if b.term.kind in COLORS]
    rows: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in shown]
    for _, _, ev in replay.states(frames.tolist() if shown else []):
        x = ev.x[: traj.x.shape[1]].copy()
        for found, b in zip(rows, shown, strict=True):
            points = contact_points(b, ev)
            found.append(points or (x, b.forces(ev)[: x.size].reshape(-1, 3)))
    return [Forces(b.term.name, b.term.kind, *_table(found)) for b, found in zip(shown, rows, strict=True)]


def _table(rows: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Points and forces of all frames, filled up with NaN to shape (T, n, 3)."""
    count = max(len(x) for x, _ in rows)
    x, f = np.full((2, len(rows), count, 3), np.nan)
    for k, (points, forces) in enumerate(rows):
        x[k, : len(points)], f[k, : len(forces)] = points, forces
    return x, f


def arrow_scale(forces: list[Forces], size: float) -> float | None:
    """Length of arrow per force [m/N], one for all, that makes the largest of drag and contact a third of ``size``.

    But for those in a twentieth of the frames: spikes. Without drag and contact the loads count; None if there is no
    force at all.
    """
    for kinds in (OPEN, tuple(COLORS)):
        chosen = [np.linalg.norm(s.f, axis=2) for s in forces if s.kind in kinds and s.f.shape[1]]
        if chosen:
            # a start from rest may begin with a spike: the run as a whole sets the scale
            largest = max(
                float(np.quantile(np.nan_to_num(f).max(axis=1), 0.95)) or float(np.nan_to_num(f).max())
                for f in chosen
            )
            if largest > 0.0 and math.isfinite(largest):
                return LONGEST * size / largest
    return None


def log_forces(
    log: Log, forces: list[Forces], columns: list[Any], root: str, size: float, scale: float
) -> list[str]:
    """Arrows of every term that acts at all, ``forces/NAME``; return the entities that are hidden at first."""
    hidden = []
    for s in forces:
        if not np.nan_to_num(s.f).any():
            continue
        entity = f"{root}/forces/{s.name}"
        log.arrows(entity, columns, s.x, scale * s.f, COLORS[s.kind], size / 350)
        if s.kind not in OPEN:
            hidden.append(entity)
    return hidden


def scale_text(scale: float, size: float) -> str:
    """What an arrow of a round length stands for, e.g. ``10 mm of arrow = 0.19 mN``."""
    unit = 10.0 ** math.floor(math.log10(LONGEST * size))
    return f"{si(unit, 'm')} of arrow = {si(unit / scale, 'N')}"
