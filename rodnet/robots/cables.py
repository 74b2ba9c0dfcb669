"""Cables as a recording shows them: rods through its markers, held and moved where it says so."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.graph.material import Material
from rodnet.graph.stick_figure import StickFigure
from rodnet.recordings.recording import Recording
from rodnet.terms.constraints import Constraint, PrescribedMotion
from rodnet.terms.grasp import Grasp
from rodnet.terms.motion import smooth_motion

SINGLE = ("carried", "hinged")
WHITE = 3e-5  # white part of the markers' noise [m]; the splines of what is held are smoothed to it


class Cables:
    """A cable, or a tree of them, drawn through the markers of a recording.

    The recording's ``edges`` say which markers a cable joins: a chain of pairs for each cable, one that
    branches off beginning with the marker where it does. The cables begin where and as fast as the first
    two frames have it; of the later frames only the ``prescribed`` markers are looked at.
    Rods are named ``cable``, ``branch1``, ``branch2``...; every marker is at a node.

    Parameters
    ----------
    rec : Recording
        With ``edges``.
    edges_per_metre : float
        Fineness of the mesh [1/m].

    Attributes
    ----------
    chains : list of list of int
        Markers along each cable.
    points : list of str
        Node of each marker, ``"cable:7"``.
    velocity : ndarray, shape (N, 3)
        Velocities of the nodes at the first frame [m/s].
    pairs : list of (int, int)
        Neighbouring markers that are both prescribed: what grippers hold.

    Raises
    ------
    RecordingError
        If markers belong to no cable, or a cable begins nowhere.
    """

    def __init__(self, rec: Recording, edges_per_metre: float = 25.0) -> None:
        from scipy.interpolate import CubicSpline

        self.rec, self.edges_per_metre = rec, float(edges_per_metre)
        self.chains = chains(rec)
        position, speed = rec.first_frames()
        held = set(rec.prescribed.tolist())
        self.pairs = [(int(i), int(j)) for i, j in rec.edges if {i, j} <= held]
        self._lines: dict[str, list[Any]] = {}
        place: dict[int, str] = {}
        velocity = []
        for k, chain in enumerate(self.chains):
            name = f"branch{k}" if k else "cable"
            s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position[chain], axis=0), axis=1))])
            # what a gripper holds is one edge
            counts = [
                1 if pair in self.pairs else max(int(np.ceil(length * edges_per_metre)), 1)
                for pair, length in zip(pairwise(chain), np.diff(s), strict=True)
            ]
            parts = [
                np.linspace(a, b, n, endpoint=False) for (a, b), n in zip(pairwise(s), counts, strict=True)
            ]
            stations = np.append(np.concatenate(parts), s[-1])
            line = list(CubicSpline(s, position[chain])(stations))
            speeds = CubicSpline(s, speed[chain])(stations)
            if chain[0] in place:
                line[0], speeds = place[chain[0]], speeds[1:]
            velocity.append(speeds)
            self._lines[name] = line
            for marker, n in zip(chain, np.cumsum([0, *counts]), strict=True):
                place.setdefault(marker, f"{name}:{n}")
        self.points = [place[m] for m in range(len(rec.names))]
        self.velocity = np.vstack(velocity)

    def figure(self, material: Material, radius: float) -> StickFigure:
        """Draw straight rods of one material and radius [m] in the shape of the first frame."""
        figure = StickFigure()
        for name, line in self._lines.items():
            figure.rod(name, line, material=material, radius=radius, natural="straight")
        return figure

    def held(self, twist: str = "no-spin", single: str = "carried", noise: float = WHITE) -> list[Constraint]:
        """What is prescribed: of a pair of markers one position and the direction, of a single one its position.

        A gripper holds a rod's direction too, and of a single marker nobody knows how it turns: it is carried
        along without turning, the rod on both sides beginning in the direction that it has at the first frame.

        Parameters
        ----------
        twist : {"no-spin", "free"}
            Whether grippers keep the rod from turning about its axis; see `Grasp`.
        single : {"carried", "hinged"}
            Whether what holds a single marker keeps the rod from turning there, or is a string or a pin.
        noise : float
            Standard deviation to which the measured motion is smoothed [m].

        Raises
        ------
        ParameterError
            For another word.
        """
        if single not in SINGLE:
            raise ParameterError(f"Cables.held: single = {single!r} must be one of {', '.join(SINGLE)}")
        x, t = self.rec.trusted, self.rec.t - self.rec.t[0]
        constraints: list[Constraint] = []
        for i, j in self.pairs:
            rod, n = self.points[i].split(":")
            constraints.append(
                Grasp(
                    at=f"{rod}:{n}-{int(n) + 1}",
                    position=smooth_motion(t, x[:, i], noise),
                    tangent=smooth_motion(t, x[:, j] - x[:, i], noise),
                    twist=twist,
                    duration=float(t[-1]),
                    name=f"grasp{i}",
                )
            )
        for i in self._single:
            position = _from_start(smooth_motion(t, x[:, i], noise))
            turned = _not_turned if single == "carried" else None
            constraints.append(
                PrescribedMotion(at=self.points[i], position=position, orientation=turned, name=f"held{i}")
            )
        return constraints

    @cached_property
    def _single(self) -> list[int]:
        paired = {m for pair in self.pairs for m in pair}
        return [int(i) for i in self.rec.prescribed if int(i) not in paired]


def _from_start(path: Callable[[float], np.ndarray]) -> Callable[[float], np.ndarray]:
    """A path as displacement from where it begins."""
    start = path(0.0)
    return lambda t: path(t) - start


def _not_turned(t: float) -> np.ndarray:
    return np.eye(3)


def chains(rec: Recording) -> list[list[int]]:
    """Markers along each cable of a recording: a new one begins where its list of edges jumps.

    Raises
    ------
    RecordingError
        If markers belong to no cable, or a cable begins at none of the markers before it.
    """
    found: list[list[int]] = []
    for i, j in rec.edges.tolist():
        if found and found[-1][-1] == i:
            found[-1].append(j)
        elif found and not any(i in chain for chain in found):
            raise rec.error(f"the edge ({i}, {j}) begins at a marker of no edge before it")
        else:
            found.append([i, j])
    missing = sorted(set(range(len(rec.names))) - {m for chain in found for m in chain})
    if missing:
        names = ", ".join(rec.names[m] for m in missing)
        raise rec.error(f"'edges' leave out marker {names}; cables run through every marker")
    return found
