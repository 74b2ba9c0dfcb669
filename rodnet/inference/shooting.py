"""Where the segments of all trials begin, at first and after a search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rodnet.errors import ConvergenceError
from rodnet.inference.checkpoint import Checkpoint
from rodnet.inference.comparison import Comparison
from rodnet.inference.identifiability import invert
from rodnet.inference.packing import pack_trial, segment_trial
from rodnet.inference.problem import Problem
from rodnet.inference.result import Optimum
from rodnet.inference.search import minimise
from rodnet.inference.segments import segment_quantities

ROUNDS = 12  # of finding states anew
SHORT = 6  # evaluations of a search as long as jumps are free
NEAR = 0.03  # change of a coordinate below which they no longer are
STILL = 0.1  # of a standard deviation: everything has settled


def shoot(
    problem: Problem, trials: Sequence[Comparison], blob: bytes, z: np.ndarray, firsts: Sequence[Sequence[int]],
    modes: int, tell: Callable[[str], None],
) -> None:  # fmt: skip
    """Divide all trials at these frames, the states being found with the values at ``z``.

    Raises
    ------
    ConvergenceError
        If a segment cannot be simulated.
    """
    tell("finding where segments begin")
    jobs = [
        problem.executor.submit(segment_trial, packed, _without_segments(problem, z, k), frames, modes)
        for k, (packed, frames) in enumerate(zip(problem.packed, firsts, strict=True))
    ]
    for job, trial in zip(jobs, trials, strict=True):
        found = job.result()
        if isinstance(found, str):
            raise ConvergenceError(found)
        trial.segments = tuple(found)
    problem.packed = [pack_trial(blob, t.rec, t.noise, t.mode_count, t.segments) for t in trials]
    own = [q for q in problem.quantities if not q.path.startswith("segment")]
    problem.quantities = own + [q for k, t in enumerate(trials) for q in segment_quantities(t, k)]
    problem.forget()


def _without_segments(problem: Problem, z: np.ndarray, trial: int) -> dict[str, float]:
    return {p: v for p, v in problem.values(z, trial).items() if not p.startswith("segment")}


def settle(
    problem: Problem, trials: Sequence[Comparison], blob: bytes, best: Optimum, firsts: Sequence[Sequence[int]],
    modes: int, continuity: bool, loss: str, evaluations: int, tell: Callable[[str], None],
    checkpoint: Checkpoint | None = None,
) -> Optimum:  # fmt: skip
    """Find the states anew with what was found, and search again, until nothing changes.

    What a state has beside its modes follows from the parameters that it was found with. As long as these are
    far off jumps are free, and searches short. Where segments begin follows from the place before a round, so
    that a checkpoint of the places after all rounds is enough to go on from.
    """
    done = {} if checkpoint is None else checkpoint.done
    last = next((f"round {k}" for k in range(ROUNDS, 0, -1) if f"round {k}" in done), None)
    onwards = last is not None and f"round {int(last.split()[1]) + 1}" in checkpoint.places  # type: ignore[union-attr]
    if (
        last is not None and not onwards and not done[last]["success"]
    ):  # the same call, with more evaluations, goes on
        del done[last]
    for k in range(ROUNDS):
        if best.interrupted:
            break
        stage, later = f"round {k + 1}", f"round {k + 2}" in done
        place = {(q.trial, q.path): z for q, z in zip(problem.quantities, best.z, strict=True)}
        if not later:
            shoot(problem, trials, blob, best.z, firsts, modes, tell)
        z = np.array([
            0.0 if q.path.startswith("segment") else place[q.trial, q.path] for q in problem.quantities
        ])  # fmt: skip
        if checkpoint is not None and stage in done:
            again = Optimum(np.array(checkpoint.places[stage]), **done[stage])
        else:
            again = _once_more(problem, z, stage, loss, evaluations if problem.continuous == continuity else SHORT,
                               tell, checkpoint)  # fmt: skip
        shared = np.array([q.trial is None for q in problem.quantities])
        moved = np.abs(again.z - z)[shared]
        best = replace(again, message=f"{again.message}, in segments")
        if problem.continuous != continuity:
            problem.continuous = bool(moved.max(initial=0.0) < NEAR)
            continue
        if later:
            continue
        joint = problem.joint(best.z)
        assert joint is not None
        sd = np.sqrt(np.diag(invert(joint[1].T @ joint[1])))[shared]
        if (moved <= STILL * sd).all():
            break
    else:
        best = replace(best, success=False, message=f"{best.message}, which have not settled")
    problem.continuous = continuity
    return best


def _once_more(
    problem: Problem, z: np.ndarray, stage: str, loss: str, evaluations: int, tell: Callable[[str], None],
    checkpoint: Checkpoint | None,
) -> Optimum:  # fmt: skip
    """Search from one place, or from where this stage was interrupted."""
    keep = None
    if checkpoint is not None:
        z = np.array(checkpoint.places.get(stage, z))
        keep = lambda z: checkpoint.better(stage, z)  # noqa: E731
    found = minimise(problem, z, loss, evaluations, tell, keep=keep)
    if found is None:
        raise ConvergenceError(f"segments cannot be simulated again: {problem.failures[-1]}")
    if checkpoint is not None and not found.interrupted:
        checkpoint.ended(stage, found.z, found.cost, found.success, found.message)
    return found
