"""Multiple shooting: a trial in segments, each simulated from a state of its own near what was measured."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from rodnet.errors import ConvergenceError, ParameterError, SingularMatrixError
from rodnet.inference.modes import soft_modes
from rodnet.inference.quantities import GRAVITY, OFFSET, SPEED, Quantity
from rodnet.inference.shots import why
from rodnet.kinematics.frames import unit
from rodnet.parameters import is_number
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.solve.model import Model
from rodnet.solve.steppers import State
from rodnet.tangent.state import StateTangent, combined, moved, zero
from rodnet.terms.constraints import Constraint

if TYPE_CHECKING:
    from rodnet.inference.case import Case
    from rodnet.inference.comparison import Comparison

LOOSE = 5.0  # priors of the states of segments, against those of initial states
TIGHT = 0.1  # jumps between segments, likewise
STEPS = 8  # of Gauss-Newton towards what was measured
SHORTER = 0.3  # what is left of a step that leads nowhere
DONE = 1e-2  # of a step against the prior
FEWEST = 3  # frames
RIGID = 6  # motions of what nothing holds
SHIFT = 1e-6  # of differences of states, of an amplitude's scale
KINDS = ("position", "velocity")


@dataclass(frozen=True)
class Segment:
    """A part of a trial after its first.

    Attributes
    ----------
    number : int
        From 1.
    first : int
        Its first frame.
    state : State
        That it begins near.
    shapes : ndarray, shape (modes, dof_count)
        Displacements, and velocities, of unit amplitude.
    read : ndarray, shape (modes, dof_count)
        Their amplitudes in a displacement.
    scales : tuple of float
        Amplitudes worth considering [m], [m/s].
    tree : ndarray, shape (n, 2)
        Nodes and, before each, the one that it is reached from, outward from what is held.
    """

    number: int
    first: int
    state: State
    shapes: np.ndarray
    read: np.ndarray
    scales: tuple[float, float]
    tree: np.ndarray

    def paths(self) -> dict[str, tuple[int, int]]:
        """Paths of its amplitudes, with 0 for positions or 1 for velocities, and the number of the mode."""
        return {
            f"segment{self.number}.{kind}[{j}]": (which, j)
            for which, kind in enumerate(KINDS)
            for j in range(len(self.shapes))
        }

    def begin(self, model: Model, values: Mapping[str, float]) -> State:
        """State at some values of its amplitudes."""
        return self._moved(model, self._amplitudes(values))

    def tangents(self, model: Model, values: Mapping[str, float]) -> dict[str, StateTangent]:
        """Derivative of that state by each amplitude."""
        base, at = self.begin(model, values), self._amplitudes(values)
        found = {}
        for path, (which, j) in self.paths().items():
            step, near = SHIFT * self.scales[which], []
            for sign in (1.0, -1.0):
                other = at.copy()
                other[which, j] += sign * step
                near.append((sign / (2.0 * step), self._moved(model, other)))
            found[path] = combined(model, base, near)
        return found

    def _amplitudes(self, values: Mapping[str, float]) -> np.ndarray:
        at = np.zeros((2, len(self.shapes)))
        for path, place in self.paths().items():
            at[place] = values.get(path, 0.0)
        return at

    def _moved(self, model: Model, amplitudes: np.ndarray) -> State:
        if not amplitudes.any():
            return self.state
        change = zero(model, self.state, 1)
        change.q[:, 0], change.v[:, 0] = amplitudes @ self.shapes
        self._keep_lengths(change.q[:, 0], change.v[:, 0])
        return moved(model, self.state, change, 0, 1.0)

    def _keep_lengths(self, dq: np.ndarray, dv: np.ndarray) -> None:
        """Turn edges instead of stretching them: what is stiff would ring after a displacement along a line."""
        size = 3 * (int(self.tree[:, :2].max()) + 1)
        x, v = (a[:size].reshape(-1, 3) for a in (self.state.q, self.state.v))
        dx, dw = (a[:size].reshape(-1, 3) for a in (dq, dv))
        for parent, child in self.tree:
            arm, rate = x[child] - x[parent], v[child] - v[parent]
            length = float(np.linalg.norm(arm))
            t = unit((arm + dx[child] - dx[parent])[None])[0]
            dx[child] = dx[parent] + length * t - arm
            new = rate + dw[child] - dw[parent]
            dw[child] = dw[parent] + new - (t @ new) * t + (arm @ rate / length) * t - rate

    def jump(
        self, start: State, before: State, slopes: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """By how much it begins beside where the segment before ended, shape (2 modes,), and its derivative.

        In units of what is tolerated. ``slopes`` are derivatives of position and velocity of ``start`` less
        those of ``before``, shapes (dof_count, k).
        """
        q, v = start.q - before.q, start.v - before.v
        rows = [self.read @ d / (TIGHT * s) for d, s in zip((q, v), self.scales, strict=True)]
        if slopes is None:
            return np.concatenate(rows), np.zeros((2 * len(self.shapes), 0))
        change = [self.read @ d / (TIGHT * s) for d, s in zip(slopes, self.scales, strict=True)]
        return np.concatenate(rows), np.concatenate(change)


def first_frames(rec: Recording, segments: Any) -> list[int]:
    """First frames of the segments of a trial but the first; ``segments`` is a number of them, or seconds.

    Raises
    ------
    ParameterError
        If they would hold fewer than three frames.
    """
    whole = isinstance(segments, int) and not isinstance(segments, bool)
    if not (is_number(segments) and segments > 0) or isinstance(segments, bool):
        raise ParameterError(
            f"segments = {segments!r} must be a number of segments (an integer), or seconds (2.0)"
        )
    count = int(segments) if whole else max(round(rec.duration / segments), 1)
    frames = np.linspace(0, len(rec.t), count + 1).astype(int)
    if np.diff(frames).min() < FEWEST:
        raise ParameterError(
            f"segments = {segments!r} leaves segments of fewer than {FEWEST} of the {len(rec.t)} frames of "
            f"'{rec.name}'"
        )
    return frames[1:-1].tolist()


def check_segments(case: Case, recordings: Sequence[Recording], segments: Any) -> None:
    """Raise where trials cannot be divided, before anything is simulated.

    Raises
    ------
    ParameterError
        If segments are too short, or a robot has rigid bodies: changes of a segment's beginning keep the lengths of
        edges, and would not keep the shapes of bodies.
    """
    for rec in recordings:
        part = case.part(rec)
        first_frames(part, segments)
        names = [body.name for body in case.robot(part).graph.bodies]
        if names:
            raise ParameterError(
                f"segments are of rods alone, and the robot of '{rec.name}' has the rigid body '{names[0]}': leave out "
                "segments= and fit shorter pieces instead (rec.cut(start, end)), or draw the body of short stiff rods"
            )


def make_segments(
    trial: Comparison, values: Mapping[str, float], frames: Sequence[int], modes: int
) -> list[Segment]:
    """Find where segments begin: where the one before ends, and from there towards what was measured.

    Parameters
    ----------
    trial : Comparison
        The trial.
    values : mapping
        Parameters, and the initial state.
    frames : sequence of int
        Their first frames.
    modes : int
        Number of modes of positions and velocities, beside the rigid motions of what nothing holds.
    """
    robot, _ = trial.robot_at(values)
    held = any(isinstance(term, Constraint) for term in robot.terms)
    size = float(robot.graph.size)
    scales = (LOOSE * OFFSET * size, LOOSE * SPEED * float(np.sqrt(GRAVITY * size)))
    tree = _tree(robot, trial.model_at(values))
    trial = copy.copy(trial)
    found: list[Segment] = []
    trial.segments = ()
    for number, first in enumerate(frames, start=1):
        state = trial.end_of(values, number - 1, first)
        if state is None:
            raise ConvergenceError(
                f"trial '{trial.rec.name}': segment {number - 1} cannot be simulated to its end; begin elsewhere "
                "(start=), or take shorter segments"
            )
        count = modes + (0 if held else RIGID)
        shapes = soft_modes(robot, count, state)
        segment = Segment(number, first, state, shapes, _reader(robot, shapes), scales, tree)
        trial.segments = (*found, segment)
        found.append(replace(segment, state=_towards(trial, segment, values)))
        trial.segments = tuple(found)
    return found


def _tree(robot: Robot, model: Model) -> np.ndarray:
    """Edges from node to node, outward from the nodes that are held, or from the first."""
    graph = robot.graph
    held = np.unique(model.held[model.held < 3 * graph.node_count] // 3).tolist()
    reached, queue, found = set(held or [0]), list(held or [0]), []
    beside: dict[int, list[int]] = {}
    for i, j in graph.edges.tolist():
        beside.setdefault(i, []).append(j)
        beside.setdefault(j, []).append(i)
    while queue:
        here = queue.pop(0)
        for there in beside.get(here, ()):
            if there not in reached:
                reached.add(there)
                queue.append(there)
                found.append((here, there))
    return np.array(found, dtype=int).reshape(-1, 2)


def _reader(robot: Robot, shapes: np.ndarray) -> np.ndarray:
    """Least-squares amplitudes of shapes, from the displacements of nodes."""
    nodes = 3 * robot.graph.node_count
    out = np.zeros_like(shapes)
    out[:, :nodes] = np.linalg.pinv(shapes[:, :nodes].T)
    return out


def _towards(trial: Comparison, segment: Segment, values: Mapping[str, float]) -> State:
    """State near that of a segment from which its frames are predicted best, the parameters being as they are."""
    paths = segment.paths()
    scales = {path: segment.scales[which] for path, (which, _) in paths.items()}
    size = np.array(list(scales.values()))
    best, kept, u = np.inf, np.zeros(len(size)), np.zeros(len(size))
    step = u
    for _ in range(STEPS):
        total = np.inf
        try:
            at = dict(zip(paths, u * size, strict=True))
            r, J = trial.shot_residual({**values, **at}, segment.number, scales)
            total = float(r @ r + u @ u)
        except (ConvergenceError, SingularMatrixError) as error:
            why(error)
        if total < best:
            best, kept = total, u
            A = np.vstack([J * size, np.eye(len(u))])
            step = -np.linalg.lstsq(A, np.concatenate([r, u]), rcond=None)[0]
        else:
            step = SHORTER * step
        if np.abs(step).max() < DONE:
            break
        u = kept + step
    return segment.begin(trial.model_at(values), dict(zip(paths, kept * size, strict=True)))


def segment_quantities(trial: Comparison, number: int) -> list[Quantity]:
    """Amplitudes of the states that the segments of a trial begin with."""
    return [
        Quantity(path, ("m", "m/s")[which], 0.0, -np.inf, np.inf, segment.scales[which], False,
                 norm(0.0, segment.scales[which]), number)
        for segment in trial.segments
        for path, (which, _) in segment.paths().items()
    ]  # fmt: skip
