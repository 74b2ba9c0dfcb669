"""`diagnose`: from recordings and a case to what the model leaves out."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.diagnosis.bank.instruments import possible
from rodnet.diagnosis.candidate import Candidate, as_family, free_parameter
from rodnet.diagnosis.candidate import candidates as installed
from rodnet.diagnosis.expected import expect
from rodnet.diagnosis.heldout import openings
from rodnet.diagnosis.patience import MINUTES, Patience
from rodnet.diagnosis.pipeline import Pipeline
from rodnet.diagnosis.result import Diagnosis
from rodnet.diagnosis.stage_files import Stages, identity, named
from rodnet.diagnosis.told import located
from rodnet.diagnosis.workbench import Workbench
from rodnet.errors import ParameterError
from rodnet.inference.case import Case, load_case
from rodnet.inference.instruments import check_planes
from rodnet.inference.problem import cores
from rodnet.recordings.files import as_recordings
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.storage import check_writable


def diagnose(
    case: Case | str | Path,
    recordings: Sequence[Recording] | str | Path,
    *,
    hold_out: Sequence[Recording] | str | Path = (),
    confirm: Sequence[Recording] | str | Path = (),
    candidates: Sequence[str] | Sequence[Candidate] | None = None,
    noise: Any = None,
    priors: Mapping[str, Any] | None = None,
    start: Mapping[str, float] | None = None,
    modes: int = 6,
    ledger: str | Path | bool | None = True,
    resume: str | Path | None = None,
    bootstrap: int = 0,
    minutes: float = MINUTES,
    executor: Executor | None = None,
    workers: int | None = None,
    seed: int = 0,
    progress: bool | Callable[[str], None] = False,
) -> Diagnosis:
    """Find what a case's model leaves out, name it, fit it, and show what it does on held-out trials.

    The stages are those of the docs (theory: diagnosis): calibrate; measure the numerical error; score all
    candidates; refit the best; accept by cross-validation over trials; go on until nothing gains; test the
    remainder; open the held-out trials.

    Parameters
    ----------
    case : Case or path
        How a recording is simulated, or the file that says so.
    recordings : sequence of Recording, or paths
        Training trials, or files, folders and patterns that they are read from.
    hold_out : sequence of Recording, or paths
        Trials that the model as it is and the repaired one are shown on, when all is decided.
    confirm : sequence of Recording, or paths
        Trials that are opened once, at the very end; errors before and after are then those of them.
    candidates : sequence of str or Candidate, or one of them, optional
        Ids of families or candidates, or candidates; by default all that are installed and the case's own.
    noise, priors, start, modes
        As for `rodnet.calibrate`: without ``noise`` the case's own counts.
    ledger : path or bool
        File to which every opening of held-out trials is appended: by default beside the file of the case, where it
        has one (``CASE.ledger.jsonl``); False for none.
    resume : path, optional
        Directory in which the results of finished stages are kept. After Ctrl-C or a crash the same call goes on
        from there; if the case, the recordings, the options or rodnet have changed it starts anew.
    bootstrap : int
        Number of recordings that the repaired model might have given, which are diagnosed like the real ones. By
        default there are none, and what other trials might have given is told to first order alone.
    minutes : float
        How long it may take: no effect after the first is looked for that would take longer, no explanation is
        refitted whose runs alone would, and the result says so.
    executor, workers
        As for `rodnet.calibrate`.
    seed : int
        Of the placebos and of the bootstrap.
    progress : bool or callable
        Tell on standard error how it goes on, or call with a text.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ParameterError, CaseError, RecordingError, OutputError
        For bad input, and a ledger that cannot be written.
    ConvergenceError
        If a trial cannot be simulated as the case has it.
    """
    from rodnet.sweeps.driver import start as start_workers

    case = case if isinstance(case, Case) else load_case(case)
    trials, held, kept = map(as_recordings, (recordings, hold_out, confirm))
    if not trials:
        raise ParameterError("diagnose needs at least one recording")
    if executor is not None and workers is not None:
        raise ParameterError("an executor has its own workers; give either executor or workers")
    if isinstance(bootstrap, bool | str) or bootstrap < 0 or int(bootstrap) != bootstrap:
        raise ParameterError(f"bootstrap = {bootstrap!r} must be a number of replicas, or 0")
    if isinstance(modes, bool | str) or modes < 0 or int(modes) != modes:
        raise ParameterError(f"modes = {modes!r} must be a number of modes of initial states, or 0")
    if not minutes > 0.0:
        raise ParameterError(f"minutes = {minutes!r} must be the time that a diagnosis may take, more than 0")
    began, tell = time.monotonic(), _teller(progress)
    noise = case.noise if noise is None else noise
    parts = _apart({"training": trials, "held out": held, "to confirm": kept})
    trials, ledger_file = parts["training"], _ledger(case, ledger)
    case.menu(trials[0])  # which must be one, before anything is computed
    if ledger_file is not None and (parts["held out"] or parts["to confirm"]):
        check_writable(ledger_file)
        openings(ledger_file, [*parts["held out"], *parts["to confirm"]])  # which must be readable, too
    check_planes(case, [rec for recs in parts.values() for rec in recs])
    tell(", ".join(f"{len(recs)} trials {name}" for name, recs in parts.items()))
    inner = lambda text: tell(f"  {text}")  # noqa: E731
    with ExitStack() as stack:
        if executor is None:
            workers = cores() if workers is None else workers
            executor = start_workers(workers, len(trials))
            stack.callback(executor.shutdown, cancel_futures=True)
        bench = Workbench.of(
            case, trials, executor, noise, priors=dict(priors or {}), start=dict(start or {}), modes=modes, tell=inner
        )  # fmt: skip
        for word, given in (("priors", bench.priors), ("start", bench.start)):
            if unknown := [path for path in given if not bench.has(path)]:
                raise ParameterError(
                    f"{word}: there is no {', '.join(unknown)} in this case; it has {', '.join(bench.names())}"
                )
        every = [case.part(rec) for recs in parts.values() for rec in recs]
        bank, mark = bank_of(case, bench.simplest, candidates, every), ""
        if resume is not None:
            options = [
                noise,
                dict(bench.priors),
                dict(bench.start),
                modes,
                seed,
                float(minutes),
            ]
            mark = identity(case, parts, bank, options)
        known = named(case, parts, bank, executor=executor, tell=tell, inner=inner)
        stages = Stages(None if resume is None else Path(resume), mark, known, tell)
        told = expect(bench, bank, len(parts["held out"]), tell, workers or 1, int(bootstrap))
        patience = Patience(
            lambda: time.monotonic() - began + stages.seconds, float(minutes), lambda: told.left()[0]
        )
        run = Pipeline(
            bench,
            bank,
            parts,
            noise,
            ledger_file,
            seed,
            stages,
            told,
            patience,
        )
        found = run.diagnose(int(bootstrap))
        told("locating the missing force over body and time")
        found = located(run.bench, found, stages, run.anew)
    return replace(found, seconds=time.monotonic() - began + stages.seconds)


def _ledger(case: Case, given: str | Path | bool | None) -> Path | None:
    """Where openings are noted."""
    if given is None or isinstance(given, bool):
        return case.path.with_suffix(".ledger.jsonl") if given and case.path is not None else None
    return Path(given)


def _apart(parts: dict[str, list[Recording]]) -> dict[str, list[Recording]]:
    """The same, no two of one name: two folders may have files of the same names.

    Raises
    ------
    ParameterError
        If one is a copy of another.
    """
    seen: list[tuple[str, Recording]] = []
    for part, recs in parts.items():
        for rec in recs:
            for other, one in seen:
                if not _same(one, rec):
                    continue
                if other != part:
                    raise ParameterError(
                        f"'{rec.name}' is {part} and has the same data as '{one.name}' ({other}): what is held "
                        "out must not have been seen; take one of them away"
                    )
                raise ParameterError(
                    f"'{rec.name}' has the same data as '{one.name}' (both {part}): a copy is no further evidence; "
                    "take one of them away"
                )
            seen.append((part, rec))
    given, taken = {rec.name for recs in parts.values() for rec in recs}, set()
    found: dict[str, list[Recording]] = {}
    for part, recs in parts.items():
        found[part] = []
        for rec in recs:
            name, count = rec.name, 1
            while name in taken or (count > 1 and name in given):
                count += 1
                name = f"{rec.name} ({count})"
            taken.add(name)
            if count > 1:
                rec = rec.replace(name=name, group=name if rec.group == rec.name else rec.group)
            found[part].append(rec)
    return found


def _same(one: Recording, other: Recording) -> bool:
    """Whether two recordings have the same times and samples."""
    if one.channels.keys() != other.channels.keys():
        return False
    pairs = [
        (one.t, other.t),
        (one.markers, other.markers),
        *((v, other.channels[k]) for k, v in one.channels.items()),
    ]
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def bank_of(case: Case, rec: Recording, wanted: Any, others: Sequence[Recording] = ()) -> list[Candidate]:
    """Return what is tried, of a part of a recording; ``others`` are those of other trials."""
    robot = case.robot(rec)
    instruments = case.observations(rec, robot)
    wanted = [wanted] if isinstance(wanted, str | Candidate) else wanted
    if wanted is not None and any(isinstance(c, Candidate) for c in wanted):
        return list(wanted)
    found = installed(robot, instruments, wanted)
    for k, own in enumerate(case.candidates):
        found += as_family(getattr(own, "id", f"case-{k}"), own)(robot, instruments)
    if wanted is not None and not found:
        raise ParameterError(
            f"none of the candidates {', '.join(map(str, wanted))} applies to this robot, so there is nothing to try"
        )
    found = possible(found, lambda one: case.observations(one, case.robot(one)), [rec, *others])
    return [one for one in found if _of_one_value(one, [robot, *map(case.robot, others)])]


def _of_one_value(candidate: Candidate, robots: Sequence[Robot]) -> bool:
    """Whether what a candidate frees is the same in all robots: else one value for all would change some of them."""
    build = candidate.build
    if not (isinstance(build, partial) and build.func is free_parameter):
        return True
    values = [robot.parameters[build.keywords["path"]].value for robot in robots]
    return all(value == values[0] for value in values)


def _teller(progress: bool | Callable[[str], None]) -> Callable[[str], None]:
    if callable(progress):
        return progress
    if not progress:
        return lambda text: None
    began = time.monotonic()
    return lambda text: print(f"[{time.monotonic() - began:5.0f} s] {text}", file=sys.stderr, flush=True)
