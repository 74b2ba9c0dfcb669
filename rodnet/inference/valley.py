"""Least squares in narrow curved valleys: Gauss-Newton steps, brought back to the floor before they count."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

# the first damping, over the mean square of the residuals, and its factors after a better place and after none
DAMPED, LESS, MORE = 10.0, 0.3, 6.0
BACK = 6  # corrections of a step with the derivatives where it began
CLOSER = 0.5  # of what a place is above its step's promise, that a correction may leave
FLOOR = 0.3  # of the promise: as near to it the floor is
FAILED = 8  # steps in a row that lead to no better place
SLOW = 3  # steps in a row that gain what does not matter
LONG = 6  # steps that must gain more than what is uncertain, or it creeps
GOOD, POOR = 0.5, 0.1  # shares of its promise that a step keeps, for less damping and for more
RANK = 1e-9  # of the largest, of directions that move residuals by themselves

Bounds = tuple[np.ndarray, np.ndarray]
Joint = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray] | None]
Residual = Callable[[np.ndarray], np.ndarray | None]
Run = Callable[[np.ndarray, bool], tuple[np.ndarray, np.ndarray | None] | None]
Least = Callable[[np.ndarray, float], tuple[float, float, float]]


def along(
    joint: Joint, residual: Residual, z: np.ndarray, within: Bounds, least: Least, runs: int
) -> tuple[np.ndarray, bool]:  # fmt: skip
    """Lower a sum of squares until its derivatives promise no more that matters.

    Where a product of two values is known and each of them is not, a straight step along the floor of the valley leaves
    it though the floor does not rise for long. The step's end is corrected with the derivatives of its beginning until
    residuals are about what it promised (Transtrum and Sethna 2012 do so to second order). Steps are damped as
    Levenberg (1944) does, within bounds. After a step that needed no correction the next one's end is run with
    derivatives at once: most likely they are needed there, and to take them along costs less than another run.

    Parameters
    ----------
    joint, residual : callable
        Residual (n,) and its derivatives (n, k), and the residual alone, by coordinates; None where there is none.
    z : ndarray, shape (k,)
        Coordinates to begin at.
    within : tuple of ndarray, shapes (k,)
        Their bounds.
    least : callable
        What does not matter of a sum of squares, by coordinates and that sum: to be promised, to have been gained by a
        step, and by some steps in a row.
    runs : int
        Of either, at most, but that the corrections of a step that has begun come to their end.

    Returns
    -------
    z : ndarray, shape (k,)
        The best place.
    done : bool
        Whether it ended before its runs did: nothing more is promised, or gained for a while, or there is no better
        place.
    """
    count, damping, failed, slow, here = 1, DAMPED, 0, 0, joint(z)
    course: list[float] = []
    straight = True  # whether the last step needed no correction: the next takes derivatives along

    def run(place: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray | None] | None:
        nonlocal count
        count += 1
        if slopes:
            return joint(place)
        alone = residual(place)
        return None if alone is None else (alone, None)

    while here is not None:
        r, J = here
        now = float(r @ r)
        idle, little, uncertain = least(z, now)
        course.append(now)
        creeps = len(course) > LONG and course[-LONG - 1] - now < uncertain
        if creeps or slow == SLOW or now - float(np.sum((r + J @ damped(J, r, 0.0, z, within)) ** 2)) <= idle:
            return z, True
        end = there = None
        while there is None and failed < FAILED and count < runs:
            end, share = _end(run, straight, z, r, J, damping * now / len(r), within)
            straight = end is not None and end.corrections == 0
            if end is not None and end.slopes is not None:
                there = end.residual, end.slopes
            elif end is not None:
                there, count = joint(end.place), count + 1
            if there is not None and not float(there[0] @ there[0]) < now:
                there = None
            if there is None:
                damping, failed = damping * MORE, failed + 1
        if end is None or there is None:
            return z, count < runs
        slow = slow + 1 if now - float(there[0] @ there[0]) < little else 0
        z, here, failed = end.place, there, 0
        damping *= LESS if share > GOOD else 1.0 if share > POOR else MORE
    return z, True


class _End(NamedTuple):
    """Where a step ends, after so many corrections, with the residual there and, if they are known, derivatives."""

    place: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray | None
    corrections: int


def _end(
    run: Run, slopes: bool, z: np.ndarray, r: np.ndarray, J: np.ndarray, damping: float, within: Bounds
) -> tuple[_End | None, float]:  # fmt: skip
    """Where a damped step from a place leads on the floor of the valley, None if that is no better, and its success.

    That is the share of what it promised to take off the sum of squares. With ``slopes``, derivatives are asked for
    where it leads at first.
    """
    step = damped(J, r, damping, z, within)
    goal, place, before = r + J @ step, np.clip(z + step, *within), np.inf
    promised = float(r @ r - goal @ goal)
    found, lowest = None, float(r @ r)
    for corrections in range(BACK + 1):
        here = run(place, slopes and not corrections)
        if here is None:
            break
        now = here[0]
        size = float(now @ now)
        if size < lowest:
            found, lowest = _End(place, *here, corrections), size
        above = size - float(goal @ goal)
        if above < FLOOR * promised or above > CLOSER * before:
            break
        before = above
        place = np.clip(place + damped(J, now - goal, damping, place, within), *within)
    return found, (float(r @ r) - lowest) / max(promised, 1e-300)


def damped(J: np.ndarray, r: np.ndarray, damping: float, z: np.ndarray, within: Bounds) -> np.ndarray:
    """What lowers the sum of squares most to first order, plus damping times its own square, within the bounds.

    ``J`` (n, k) are derivatives of the residual ``r`` (n,) at the coordinates ``z`` (k,).
    """
    step = np.zeros(len(z))
    free = np.flatnonzero(within[1] > within[0])
    if not len(free):
        return step
    R = np.asarray(np.linalg.qr(np.column_stack([J[:, free], r]), mode="r"))
    least = RANK * float(np.linalg.norm(R[:, :-1]))
    rows = np.sqrt(max(damping, least**2)) * np.eye(len(free))
    A, b = np.vstack([R[:, :-1], rows]), np.concatenate([-R[:, -1], np.zeros(len(free))])
    room = np.minimum(within[0] - z, 0.0)[free], np.maximum(within[1] - z, 0.0)[free]
    found = lsq_linear(A, b, room, method="bvls", max_iter=100 * len(free))
    if not found.cost <= 0.5 * float(b @ b):  # it ended before it was better than no step
        found = lsq_linear(A, b, room)
    step[free] = found.x
    return step
