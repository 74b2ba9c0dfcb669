"""Searching the minimum of a calibration: several starts, failed simulations, outliers, interruptions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from rodnet.errors import ConvergenceError, DerivativeError
from rodnet.inference.checkpoint import Checkpoint
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.losses import cost
from rodnet.inference.memory import memory_of
from rodnet.inference.problem import Problem, reject
from rodnet.inference.result import Optimum
from rodnet.inference.valley import LONG, along

INSIDE = 1e-6  # distance of a start from bounds, of a coordinate
SPREAD = 0.7  # of other starts, of a coordinate
ROUNDS = 4  # of leaving out outliers
FLAT = 1e-8  # least relative change of the sum of squares, or of coordinates, at which a fit ends
COARSE = 1e-5  # that at which it first asks how much a change matters
CLOSE = 0.02  # of a standard deviation: nearer to the minimum nobody needs to be
BEHIND = 0.1  # of what a search is behind its goal, that the derivatives must promise
LATELY = 4  # evaluations, whose gain must go on to reach a goal
RUNS = 2  # of trials without derivatives, or with, for an evaluation
EDGE = 1e-3  # of a coordinate: what is nearer to a bound than that, and pushed towards it, may go no farther
PATIENCE, LITTLE = 12, 1.0  # evaluations that must gain what so many standard deviations do, or it creeps
CREEP = 0.5  # of a standard deviation, that some steps along a valley must gain
# better places in a row that gain less than what ends a search: it is over; worse ones count half where rough is enough
STILL = 3
CORNERS, BESIDE = 4, 1e-3  # times that a search begins elsewhere, of a coordinate, for want of a derivative
SHORTER = 0.25  # of a step that led to a worse place: the next one
RANK = 1e-9  # of directions that move residuals by themselves
CLEANED = "without outliers"

Tell = Callable[[str], None]


class _StopError(Exception):
    """Somebody wants the search to end."""


class _CreepError(Exception):
    """What the search still gains is less than what the result is uncertain by."""


class _ThereError(Exception):
    """The derivatives promise nothing more that matters."""


def search(
    problem: Problem, loss: str, starts: int, seed: int, evaluations: int, tell: Tell,
    checkpoint: Checkpoint | None = None, rough: bool = False,
) -> Optimum:  # fmt: skip
    """Search from several places, and return the best minimum.

    The same call goes on with what is in the checkpoint and has not converged, unless ``rough`` is all that is asked.
    """
    rng, count = np.random.default_rng(seed), len(problem.quantities)
    found: list[Optimum] = []
    for k in range(starts):
        z = np.zeros(count) if k == 0 else SPREAD * rng.standard_normal(count)
        stage = f"start {k + 1}"
        keep = None
        if checkpoint is not None:
            z = np.array(checkpoint.places.get(stage, z))
            if stage in checkpoint.done:
                found.append(Optimum(z, **checkpoint.done[stage]))
                continue
            keep = lambda z, stage=stage: checkpoint.better(stage, z)  # noqa: E731
        one = minimise(problem, z, loss, evaluations, tell, keep=keep)
        if one is None:
            continue
        found.append(one)
        tell(f"{stage} of {starts}: {one.message}")
        if one.interrupted:
            break
        if checkpoint is not None and (one.success or rough):
            checkpoint.ended(stage, one.z, one.cost, one.success, one.message)
    if not found:
        raise ConvergenceError(f"no start can be simulated: {problem.failures[-1]}")
    best = min(found, key=lambda one: one.cost)
    if found[-1].interrupted and not best.interrupted:
        best = Optimum(best.z, best.cost, False, found[-1].message, True)
    return best


def minimise(
    problem: Problem, z: np.ndarray, loss: str, evaluations: int, tell: Tell, fixed: Sequence[int] = (),
    keep: Callable[[np.ndarray], None] | None = None, flat: float = FLAT, goal: float | None = None,
    scale: Any = 1.0,
) -> Optimum | None:  # fmt: skip
    """Minimise from one place; None if it cannot be simulated there.

    ``fixed`` coordinates stay. ``keep`` is called with every place that is better than all before it. It
    ends where the sum of squares changes by less than what `CLOSE` standard deviations from the minimum make,
    in so many independent samples as there are, or by less than ``flat`` of itself; where the derivatives promise
    no more than that, it is not tried, nor is a shorter step after one that led to a worse place; and where it creeps,
    as it may where small changes of parameters make a motion take another way. With a ``goal``, the cost of a rival,
    it ends also where they promise a small part of what it is behind that, or where gains as of late would not bring it
    there in the evaluations that are left. Steps are limited in coordinates, or with ``scale="jac"`` by what they do,
    where coordinates are of unlike effect.
    """
    low, high = (np.array(b) for b in zip(*(q.bounds for q in problem.quantities), strict=True))
    z = np.clip(
        z, np.where(np.isfinite(low), low + INSIDE, low), np.where(np.isfinite(high), high - INSIDE, high)
    )
    move = np.setdiff1d(np.arange(len(z)), fixed)
    z, begin = _begin(problem, z, move, (low, high))
    if begin is None:
        return None
    size, best, course, slow, there = len(begin[0]), (np.inf, z), [], 0.0, begin

    def full(y: np.ndarray) -> np.ndarray:
        out = z.copy()
        out[move] = y
        return out

    def residual(y: np.ndarray) -> np.ndarray:
        nonlocal best, slow, there
        place = full(y)
        try:
            joint = problem.joint(place)
        except DerivativeError:  # on a corner of a law
            joint = None
        if joint is None:
            tell("a trial cannot be simulated there: shorter step")
            if problem.interrupted:
                raise _StopError
            return np.full(size, np.inf)  # the optimiser takes a shorter step
        tell(f"evaluation {problem.evaluations}: residual {np.sqrt(np.mean(joint[0] ** 2)):.4g} sd")
        now = cost(joint[0], loss)
        if best[0] - now < flat * now:
            slow += 1.0 if now < best[0] else 0.5 if flat >= COARSE else 0.0
        else:
            slow = 0.0
        if now < best[0]:
            best, there = (now, place), (joint[0], joint[1])
            problem.hold()
            if keep is not None:
                keep(place)
        if problem.interrupted:
            raise _StopError
        course.append(best[0])
        gain = course[-PATIENCE - 1] - best[0] if len(course) > PATIENCE else np.inf
        if gain < 0.01 * best[0] and gain < LITTLE**2 * _matters(problem, place, size) * best[0]:
            raise _CreepError
        if slow >= STILL:
            raise _CreepError
        if goal is not None and len(course) > LATELY:
            lately = (course[-LATELY - 1] - best[0]) / LATELY
            if best[0] - goal > lately * (evaluations - len(course)):
                raise _CreepError
        if flat >= COARSE and loss == "linear" and now > best[0]:
            r, J = there
            if _falls(r, J, SHORTER * (place - best[1])) < flat * best[0]:
                raise _CreepError
        return joint[0]

    def jacobian(y: np.ndarray) -> np.ndarray:
        nonlocal best
        joint = problem.joint(full(y))
        assert joint is not None
        r, J = joint[0], joint[1][:, move]
        if loss == "linear" and np.isfinite(J).all():
            now = 0.5 * float(r @ r)
            least = max(flat, CLOSE**2 * _matters(problem, full(y), size)) * now
            if goal is not None:
                least = max(least, BEHIND * (now - goal))
            if _promised(r, J, y - low[move], high[move] - y) < least:
                best = now, full(y)
                raise _ThereError
        return J

    if not len(move):
        return Optimum(z, cost(begin[0], loss), True, "nothing is free")

    def descend(y: np.ndarray, ends: float, most: int) -> Any:
        # the optimiser's first step is as long as what it begins with, over the roots of the ways to the bounds that it
        # is pushed to: elsewhere than at one, it would creep or jump
        begin = np.sqrt(_ways(problem, full(y), move, y - low[move], high[move] - y) / len(y))
        aside = begin - y

        def back(u: np.ndarray) -> np.ndarray:
            return y if np.array_equal(u, begin) else u - aside

        found = least_squares(
            lambda u: residual(back(u)), begin, lambda u: jacobian(back(u)), (low[move] + aside, high[move] + aside),
            method="trf", loss=loss, x_scale=scale, ftol=ends, xtol=FLAT, gtol=None, max_nfev=most,
        )  # fmt: skip
        found.x = back(found.x)
        return found

    try:
        found = descend(z[move], max(flat, COARSE), evaluations)
        needed = CLOSE**2 * _matters(problem, full(found.x), size)
        if found.success and flat < COARSE and needed < COARSE and evaluations > found.nfev:
            finer = descend(found.x, max(flat, needed), evaluations - found.nfev)
            finer.nfev += found.nfev
            found = finer
    except _StopError:
        told = f"interrupted after {problem.evaluations} evaluations: these are the best values so far"
        return Optimum(best[1], best[0], False, told, True)
    except _ThereError:
        return Optimum(best[1], best[0], True, f"converged in {problem.evaluations} evaluations")
    except _CreepError:
        told = f"ended after {problem.evaluations} evaluations: the last ones gained less than is uncertain"
        return Optimum(best[1], best[0], True, told)
    return Optimum(full(found.x), float(found.cost), bool(found.success), _message(found, evaluations))


def follow(
    problem: Problem, z: np.ndarray, evaluations: int, tell: Tell, fixed: Sequence[int] = (), flat: float = FLAT,
    goal: float | None = None,
) -> Optimum | None:  # fmt: skip
    """Minimise squares from one place, quickly where noise is all that is left, along curved valleys, too.

    As `minimise`, whose steps are straight, but trials are run without derivatives to find where a step should end. It
    ends, too, where some steps in a row gain less than what `CREEP` standard deviations from the minimum make, or with
    a ``goal`` at a pace that would not bring it there in all its evaluations.
    """
    low, high = (np.array(b) for b in zip(*(q.bounds for q in problem.quantities), strict=True))
    low, high = (
        np.where(np.isfinite(low), low + INSIDE, low),
        np.where(np.isfinite(high), high - INSIDE, high),
    )
    z = np.clip(z, low, high)
    z, begin = _begin(problem, z, np.setdiff1d(np.arange(len(z)), fixed), (low, high))
    if begin is None:
        return None
    low[list(fixed)] = high[list(fixed)] = z[list(fixed)]
    first, best = problem.evaluations, (np.inf, z)

    def joint(place: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        nonlocal best
        try:
            found = None if problem.interrupted else problem.joint(place)
        except DerivativeError:  # on a corner of a law
            return None
        if found is not None and not np.isfinite(found[1]).all():
            return None
        if found is not None:
            tell(f"evaluation {problem.evaluations}: residual {np.sqrt(np.mean(found[0] ** 2)):.4g} sd")
            now = cost(found[0], "linear")
            if now < best[0]:
                problem.hold()
                best = now, place
        return found

    def residual(place: np.ndarray) -> np.ndarray | None:
        fits = None if problem.interrupted else problem.fits(place, slopes=False)
        return (
            None if fits is None else np.concatenate([*(f.residual for f in fits), problem.priors(place)[0]])
        )

    def least(place: np.ndarray, size: float) -> tuple[float, float, float]:
        matters = _matters(problem, place, len(begin[0])) * size
        idle, behind = max(flat * size, CLOSE**2 * matters), 0.0 if goal is None else size - 2.0 * goal
        return max(idle, BEHIND * behind), idle, max(CREEP**2 * matters, LONG * behind / evaluations)

    _, done = along(joint, residual, z, (low, high), least, RUNS * evaluations)
    count = problem.evaluations - first
    if problem.interrupted:
        told = f"interrupted after {count} evaluations: these are the best values so far"
        return Optimum(best[1], best[0], False, told, True)
    return Optimum(
        best[1], best[0], done, f"{'converged' if done else 'not converged'} in {count} evaluations"
    )


def _begin(
    problem: Problem, z: np.ndarray, move: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, Any]:  # fmt: skip
    """Where a search begins, with residuals and derivatives: beside the place itself where a law has a corner there."""
    rng, place = np.random.default_rng(0), z
    for _ in range(CORNERS if len(move) else 0):
        try:
            return place, problem.joint(place)
        except DerivativeError:
            place = z.copy()
            place[move] += BESIDE * rng.standard_normal(len(move))
            place = np.clip(place, *bounds)
    return place, problem.joint(place)


def _ways(
    problem: Problem, z: np.ndarray, move: np.ndarray, below: np.ndarray, above: np.ndarray
) -> np.ndarray:  # fmt: skip
    """What scales coordinates (Coleman and Li 1996): their ways to the bounds that they are pushed to, else one."""
    try:
        joint = problem.joint(z)
    except DerivativeError:
        joint = None
    pull = np.zeros(len(move)) if joint is None else joint[1][:, move].T @ joint[0]
    ways = np.where(pull > 0.0, below, np.where(pull < 0.0, above, 1.0))
    return np.where(np.isfinite(ways), ways, 1.0)


def _falls(r: np.ndarray, J: np.ndarray, step: np.ndarray) -> float:
    """By how much half the sum of squares would fall by a step if residuals were linear."""
    return 0.5 * float(r @ r - np.sum((r + J @ step) ** 2))


def _promised(r: np.ndarray, J: np.ndarray, below: np.ndarray, above: np.ndarray) -> float:
    """By how much half the sum of squares would fall if residuals were linear, with what room there is to bounds."""
    pull = J.T @ r
    stuck = ((pull > 0.0) & (below < EDGE)) | ((pull < 0.0) & (above < EDGE))
    sizes = np.linalg.norm(J[:, ~stuck], axis=0)
    Q, R = np.linalg.qr(J[:, ~stuck] / np.where(sizes > 0.0, sizes, 1.0))
    Q = Q[:, np.abs(np.diag(R)) > RANK]
    return 0.5 * float(np.sum((Q.T @ r) ** 2)) + EDGE * float(np.abs(pull[stuck]).sum())


def _matters(problem: Problem, z: np.ndarray, size: int) -> float:
    """Share of the sum of squares that one standard deviation from the minimum makes: one over independent samples."""
    fits = problem.at(z)
    return memory_of([w for f in fits for w in f.whitened])[0] / max(size, 1) if fits else 0.0


def _message(found: Any, evaluations: int) -> str:
    if found.success:
        return f"converged in {found.nfev} evaluations"
    return (
        f"not converged in {evaluations} evaluations; allow more (evaluations=), or begin elsewhere (start=)"
    )


def without_outliers(
    problem: Problem, trials: Sequence[Comparison], best: Optimum, threshold: float, loss: str, evaluations: int,
    tell: Tell, checkpoint: Checkpoint | None = None,
) -> Optimum:  # fmt: skip
    """Leave out what stands out of the noise, and fit again, until nothing changes."""
    keep = None
    if checkpoint is not None:
        if CLEANED in checkpoint.places:
            place = np.array(checkpoint.places[CLEANED])
            if problem.at(place) is not None:
                best = Optimum(place, best.cost, best.success, best.message)
        keep = lambda z: checkpoint.better(CLEANED, z)  # noqa: E731
    for _ in range(ROUNDS):
        if best.interrupted:
            break
        fits: list[Fit] | None = problem.at(best.z)
        assert fits is not None
        masks = [reject(t, f, threshold) for t, f in zip(trials, fits, strict=True)]
        same = all(np.array_equal(a, b) for new, old in zip(masks, problem.rejected, strict=True)
                   for a, b in zip(new, old, strict=True))  # fmt: skip
        if same:
            break
        problem.rejected = masks
        problem.forget()
        tell(f"{sum(int(m.sum()) for trial in masks for m in trial)} outliers left out")
        again = minimise(problem, best.z, loss, evaluations, tell, keep=keep)
        if again is None:
            break
        best = again
    return best
