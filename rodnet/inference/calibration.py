"""`calibrate`: parameters of a robot from recordings of its motion, with their uncertainty."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import CaseError, ConvergenceError, DerivativeError, ParameterError
from rodnet.inference.case import Case, load_case
from rodnet.inference.checkpoint import Checkpoint, identity
from rodnet.inference.comparison import Comparison
from rodnet.inference.instruments import check_planes, make_trials
from rodnet.inference.losses import LOSSES
from rodnet.inference.packing import pack_case, pack_trial
from rodnet.inference.problem import Problem, cores, none_rejected
from rodnet.inference.quantities import TWISTED, Quantity, expand, make_quantity
from rodnet.inference.result import CalibrationResult
from rodnet.inference.search import search, without_outliers
from rodnet.inference.segments import check_segments, first_frames
from rodnet.inference.shooting import SHORT, settle, shoot
from rodnet.interrupts import deferred_interrupt
from rodnet.names import meant
from rodnet.recordings.files import as_recordings
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

WITHOUT = 1e-6  # change of all residuals below which a quantity has no influence


def calibrate(
    case: Case | Robot | str | Path,
    recordings: Recording | Sequence[Recording] | str | Path,
    *,
    free: Sequence[str] | None = None,
    observe: Any = None,
    per_trial: Sequence[str] | None = None,
    tied: Mapping[str, Callable[[Mapping[str, float]], float]] | None = None,
    options: Mapping[str, Any] | None = None,
    priors: Mapping[str, Any] | None = None,
    start: Mapping[str, float] | None = None,
    noise: Any = None,
    modes: int = 6,
    segments: float | int | None = None,
    continuity: bool = True,
    loss: str = "linear",
    outliers: float | None = 5.0,
    starts: int = 1,
    seed: int = 0,
    misfit: bool | str = "auto",
    executor: Executor | None = None,
    workers: int | None = None,
    evaluations: int = 100,
    checkpoint: str | Path | None = None,
    progress: bool | Callable[[str], None] = False,
) -> CalibrationResult:
    """Find the parameters with which a robot moves as it was recorded to, and how well they are known.

    Least squares on prewhitened residuals with the exact derivatives of the simulated motion (docs, theory:
    calibration).

    Parameters
    ----------
    case : Case, Robot or path
        How a recording is simulated, or the file that says so; a robot is the same in all trials.
    recordings : Recording, sequence of Recording, or paths
        The trials, or files, folders and patterns that they are read from.
    free : sequence of str, optional
        Paths of parameters, the same in all trials: of the robot (``"drag.viscosity"``, a glob ``"tail*.E"``
        is one number), of an observation (``"markers.scale"``). By default the case's.
    observe : Observation, sequence of Observation, or callable, optional
        Instruments of a robot, or ``observe(rec, robot)``; a case has its own.
    per_trial : sequence of str, optional
        Paths with a value in each trial: ``"initial.position"`` and ``"initial.velocity"`` (amplitudes of soft
        modes), ``"initial.offset"``, ``"initial.time"`` (when motion begins), or any of the above.
    tied : mapping, optional
        Parameters that follow: path -> function of {path: value}.
    options : mapping, optional
        Of `Simulation`, over those of the case: dt, stepper, velocity.
    priors : mapping, optional
        By path (of all modes: ``"initial.position"``): a standard deviation about the start, a pair (value,
        standard deviation), or a frozen distribution of `scipy.stats`.
    start : mapping, optional
        Values to begin with; by default those of the robot.
    noise : NoiseModel, float, mapping or callable, optional
        Of the instruments, by name if there are several; a number is a standard deviation of independent
        errors, in the instrument's unit; a function of the recording returns any of these. By default that of
        the case, of the recording, or an estimate from all of them.
    modes : int
        Number of modes of initial positions and velocities.
    segments : float or int, optional
        Simulate every trial in segments of so many seconds (a float), or in so many (an integer), each from a
        state of its own: where a whole trial cannot be predicted because small errors grow or stay.
    continuity : bool
        Whether jumps between segments are held small (docs, theory: calibration), or are free.
    loss : {"linear", "soft_l1", "huber", "cauchy", "arctan"}
        Robust losses count large residuals less.
    outliers : float, optional
        Samples whose prewhitened residual is so many times the usual one are left out, and the fit repeated.
    starts : int
        Number of searches; all but the first begin at random places nearby.
    seed : int
        Of these.
    misfit : bool or "auto"
        Whether intervals are widened by what the model leaves unexplained beyond the noise, correlation in
        time included; "auto" does so where it is significant.
    executor : concurrent.futures.Executor, optional
        Where trials are simulated; left running. By default ``workers`` processes of this machine.
    workers : int, optional
        Number of processes, by default one per core; 0 computes in this process.
    evaluations : int
        Largest number of evaluations of a search.
    checkpoint : path, optional
        File of the best places found so far. After Ctrl-C or a crash the same call goes on from there; that of
        another calibration is replaced.
    progress : bool or callable
        Tell on standard error how the search goes on, or call with a text.

    Returns
    -------
    CalibrationResult
        After Ctrl-C that of the best place so far, with ``interrupted`` set (a second Ctrl-C raises).

    Raises
    ------
    ParameterError, CaseError, RecordingError
        For bad input: unknown paths, nothing free, nothing observed, no influence.
    ConvergenceError
        If a trial cannot be simulated at the start.
    """
    from rodnet.sweeps.driver import start as start_workers

    case = as_case(case, observe, free, per_trial, tied, options)
    trials = as_recordings(recordings)
    _check(trials, loss, starts, outliers, evaluations, modes)
    names = names_of(trials)
    check_planes(case, trials)
    if segments is not None:
        check_segments(case, trials, segments)
    built = make_trials(case, trials, case.noise if noise is None else noise, modes)
    quantities = make_quantities(case, built, priors or {}, start or {}, modes)
    blob = pack_case(case)
    packed = [pack_trial(blob, t.rec, t.noise, modes) for t in built]
    fixed = {p: float(v) for p, v in (start or {}).items() if p not in {q.path for q in quantities}}
    with ExitStack() as stack:
        if executor is None:
            executor = start_workers(
                cores() if workers is None and len(packed) > 1 else workers or 0, len(packed)
            )
            stack.callback(executor.shutdown, cancel_futures=True)
        elif workers is not None:
            raise ParameterError("an executor has its own workers; give either executor or workers")
        problem = Problem(quantities, packed, names, dict(case.tied), executor, none_rejected(built), fixed)
        problem.continuous = continuity and segments is None
        tell, kept = _teller(progress), None
        if segments is not None:
            firsts = [first_frames(t.rec, segments) for t in built]
            shoot(problem, built, blob, np.zeros(len(quantities)), firsts, modes, tell)
        if checkpoint is not None:
            chosen = (loss, starts, seed, modes, outliers, segments, continuity)
            kept = Checkpoint(checkpoint, identity(case, built, problem.quantities, fixed, chosen))
        _check_influence(problem, tell)
        with deferred_interrupt() as problem.interrupt:
            first = evaluations if segments is None else SHORT
            best = search(problem, loss, starts, seed, first, tell, kept, segments is not None)
            if segments is not None:
                best = settle(
                    problem, built, blob, best, firsts, modes, continuity, loss, evaluations, tell, kept
                )
            if outliers is not None:
                best = without_outliers(problem, built, best, outliers, loss, evaluations, tell, kept)
        joint = problem.joint(best.z)
        fits = problem.at(best.z)
    assert joint is not None and fits is not None
    found = CalibrationResult.of(case, built, problem, best, joint, fits, misfit, loss)
    found.priors, found.start = dict(priors or {}), dict(start or {})
    found.noise = case.noise if noise is None else noise
    return found


def as_case(
    case: Case | Robot | str | Path, observe: Any, free: Any, per_trial: Any, tied: Any, options: Any
) -> Case:
    """Return a case of a robot, a case or its file, with what is given over it."""
    if isinstance(case, str | Path):
        case = load_case(case)
    if isinstance(case, Robot):
        if observe is None:
            raise ParameterError("nothing is observed: give observe=[rodnet.Markers(robot, ...)]")
        robot = case
        case = Case(lambda rec: robot, _observing(observe), name="robot")
    elif not isinstance(case, Case):
        raise ParameterError(f"calibrate needs a Case or a Robot, got {type(case).__name__}")
    elif observe is not None:
        case = replace(case, observe=_observing(observe))
    for name, given in (("free", free), ("per_trial", per_trial)):
        if isinstance(given, str):
            raise ParameterError(f"{name} is a list of paths: {name}=[{given!r}]")
    if free is not None:
        case = replace(case, free=tuple(free))
    if per_trial is not None:
        case = replace(case, per_trial=tuple(per_trial))
    if tied is not None:
        case = replace(case, tied=dict(tied))
    if options is not None:
        before, over = case.options, dict(options)
        case = replace(
            case, options=lambda rec, robot: {**({} if before is None else before(rec, robot)), **over}
        )
    if not case.free and not case.per_trial:
        raise ParameterError("nothing is free: give free=['drag.viscosity', ...], paths of robot.parameters")
    return case


def _observing(observe: Any) -> Callable[[Recording, Robot], Any]:
    if callable(observe):
        return observe
    instruments = [observe] if isinstance(observe, Observation) else list(observe)
    return lambda rec, robot: instruments


def _check(
    trials: Sequence[Any], loss: str, starts: int, outliers: float | None, evaluations: int, modes: int
) -> None:
    if not trials:
        raise ParameterError("calibrate needs at least one recording")
    for one in trials:
        if not isinstance(one, Recording):
            raise ParameterError(
                f"calibrate needs recordings, got {type(one).__name__}; see rodnet.read_recordings"
            )
    if loss not in LOSSES:
        raise ParameterError(f"loss = {loss!r} must be one of {', '.join(LOSSES)}")
    if isinstance(starts, bool) or starts < 1 or int(starts) != starts:
        raise ParameterError(f"starts = {starts!r} must be a positive integer")
    for name, number in (("evaluations", evaluations), ("modes", modes)):
        if isinstance(number, bool) or number < 1 or int(number) != number:
            raise ParameterError(f"{name} = {number!r} must be a positive integer")
    if outliers is not None and not outliers > 2.0:
        raise ParameterError(f"outliers = {outliers!r} must be more than 2 standard deviations, or None")


def names_of(trials: Sequence[Recording]) -> list[str]:
    """Names of the trials, made different."""
    names: list[str] = []
    for rec in trials:
        name, k = rec.name, 2
        while name in names:
            name, k = f"{rec.name}#{k}", k + 1
        names.append(name)
    return names


# -- quantities -------------------------------------------------------------------------------------
def make_quantities(
    case: Case,
    trials: Sequence[Comparison],
    priors: Mapping[str, Any],
    start: Mapping[str, float],
    modes: int,
) -> list[Quantity]:
    """All unknowns: common ones first, then those of each trial."""
    first = trials[0]
    found: list[Quantity] = []

    def add(path: str, trial: Comparison, number: int | None) -> None:
        for single in expand(path, modes):
            prior = priors.get(single, priors.get(path))
            frame = 1.0 / trial.rec.rate
            one = make_quantity(single, trial.robot, trial.instruments, frame, prior, start.get(single))
            if single.startswith("initial.") and single != "initial.time":
                trial.motion(single)  # whether there is such a mode
            found.append(replace(one, trial=number))

    for path in case.free:
        if path.startswith("initial."):
            raise ParameterError(f"'{path}' is of each trial by itself: put it in per_trial, not in free")
        add(path, first, None)
    for number, trial in enumerate(trials):
        for path in case.per_trial:
            add(path, trial, number)
            if path == "initial.position" and modes and trial.twist is not None:
                add(TWISTED, trial, number)  # who does not know the one does not know the other
    paths = [q.path for q in found if q.trial in (None, 0)]
    twice = [p for p in paths if paths.count(p) > 1 or p in case.tied]
    if twice:
        raise ParameterError(f"'{twice[0]}' is given twice, in free, per_trial or tied")
    for what, given in (("priors", priors), ("start", start)):
        known = {*paths, *case.free, *case.per_trial}
        for path in given:
            if path not in known and (what == "priors" or path not in first.robot.parameters):
                raise ParameterError(
                    f"{what}: {path!r} is not free; {meant(path, known)}free are {', '.join(paths)}"
                )
    for path in case.tied:
        try:
            make_quantity(path, first.robot, first.instruments, 1.0, None, None)
        except ParameterError as error:
            raise CaseError(f"tied: {error}") from None
    return found


def _check_influence(problem: Problem, tell: Callable[[str], None]) -> None:
    """Raise if nothing that was recorded depends on a quantity, or a trial cannot be simulated."""
    tell(f"{len(problem.quantities)} unknowns, {len(problem.packed)} trials")
    try:
        fits = problem.at(np.zeros(len(problem.quantities)))
    except DerivativeError:  # at the corner of a law, from which a search steps aside
        return
    if fits is None:
        raise ConvergenceError(f"the fit cannot begin: {problem.failures[0]}; begin elsewhere (start=)")
    J = np.concatenate([f.jacobian for f in fits if f.jacobian is not None])
    norms = np.sqrt((J**2).sum(axis=0))
    idle = [q.path for q, n in zip(problem.quantities, norms, strict=True) if n < WITHOUT and q.trial is None]
    if idle:
        raise ParameterError(
            f"nothing that was recorded depends on {', '.join(idle)}: take {'it' if len(idle) == 1 else 'them'} out "
            "of free, or observe something that does"
        )
    if len(J) < sum(q.prior is None for q in problem.quantities):
        raise ParameterError(
            f"{len(J)} recorded numbers cannot tell {len(problem.quantities)} unknowns; give priors"
        )


def _teller(progress: bool | Callable[[str], None]) -> Callable[[str], None]:
    if callable(progress):
        return progress
    if not progress:
        return lambda text: None
    return lambda text: print(f"calibrating: {text}", file=sys.stderr, flush=True)
