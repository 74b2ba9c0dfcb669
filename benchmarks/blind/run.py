"""Diagnose the cases of a set, each in a process of its own; done cases are left as they are, others go on where
they were stopped.
"""

from __future__ import annotations

import json
import re
import shutil
import signal
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.blind.generate import ELEMENTS, generate, planned, setting, wild, write_trials
from benchmarks.blind.instruments import Instrument
from benchmarks.blind.plan import ALIKE, HELD_OUT, TRIALS, Spec, generator

LIMIT = 7200.0  # CPU seconds for a case
MINUTES = 60.0  # that a diagnosis may take, on one core
BEGUN = 3  # times that a diagnosis is begun and never ends, that has failed: it takes its process with it
# times as long for each trial where some were recorded afterwards, for they are often harder to simulate: a finer mesh
AMPLE = 2.0
REPEATS = 4  # times that a recommended trial is run, at most, if so many are asked for


class OutOfTime(BaseException):
    """A case has taken more than its time; nothing between here and there may catch it as an error of its own."""


def diagnose(
    data: Path,
    out: Path,
    candidates: Sequence[str] | None = None,
    limit: float = LIMIT,
    more: Path | None = None,
) -> dict[str, Any]:
    """Diagnose one case as its user would, and write ``diagnosis.json``; what fails is written down instead.

    Parameters
    ----------
    data, out
        Folders of the case and of what is found.
    candidates
        Ids to try; by default all that are installed.
    limit
        CPU time [s] for the trials of a case; one that takes longer has failed.
    more
        Folder of trials that were recorded afterwards, to learn from; `AMPLE` time is taken then.
    """
    import rodnet as rn

    done = out / "diagnosis.json"
    if done.exists():
        return dict(json.loads(done.read_text()))
    out.mkdir(parents=True, exist_ok=True)
    before, spent = _begin(out / "begun")
    began, used = time.monotonic(), time.process_time() - spent
    files = sorted(more.glob("trial_*.npz")) if more else []
    times = AMPLE * (TRIALS + len(files)) / TRIALS if files else 1.0
    limit *= times
    found: dict[str, Any]
    try:
        if before >= BEGUN:
            raise RuntimeError(f"it was begun {before} times and did not end")
        with _within(max(limit - spent, 1.0)):
            recordings = rn.read_recordings([str(p) for p in sorted(data.glob("trial_*.npz"))])
            extra = rn.read_recordings([str(p) for p in files])
            found = rn.diagnose(
                rn.load_case(data / "CASE.py"), [*recordings[:-HELD_OUT], *extra], hold_out=recordings[-HELD_OUT:],
                candidates=candidates, ledger=out / "ledger.jsonl", resume=out / "stages", workers=0,
                minutes=times * MINUTES, progress=_log(out / "log.txt"),
            ).to_dict()  # fmt: skip
    except OutOfTime:
        found = {"verdict": "failed", "error": f"more than {limit:g} s of CPU time"}
    except Exception as error:  # a diagnosis that fails is a result, and the others go on
        found = _failed(error)
    except (KeyboardInterrupt, SystemExit):  # it goes on where it was stopped
        _mark(out / "begun", before, time.process_time() - used)
        raise
    found["wall_seconds"] = time.monotonic() - began
    found["cpu_seconds"] = time.process_time() - used
    part = out / "diagnosis.part"
    part.write_text(json.dumps(found))
    part.replace(done)
    (out / "begun").unlink()
    shutil.rmtree(out / "stages", ignore_errors=True)
    return found


def _failed(error: Exception) -> dict[str, Any]:
    return {
        "verdict": "failed",
        "error": f"{type(error).__name__}: {error}",
        "trace": traceback.format_exc(),
    }


def _begin(mark: Path) -> tuple[int, float]:
    """How often a diagnosis was begun before and did not say that it was stopped, and CPU seconds; it is once more."""
    known = json.loads(mark.read_text()) if mark.exists() else 0
    before, spent = known if isinstance(known, list) else (known, 0.0)
    _mark(mark, before + 1, spent)
    return before, spent


def _mark(mark: Path, times: int, spent: float) -> None:
    mark.write_text(json.dumps([times, spent]))


def through(
    seed: str, specs: Sequence[Spec], root: Path, steps: Sequence[str], candidates: Sequence[str] | None = None,
    limit: float = LIMIT, elements: int = ELEMENTS,
) -> None:  # fmt: skip
    """Generate some cases, diagnose them, and do what that recommends, one after the other; what fails stops no other.

    Raises
    ------
    RuntimeError
        If some could not be made, once all others are done.
    """
    failed = []
    for spec in specs:
        try:
            if "generate" in steps:
                generate(seed, spec, root, elements)
            if "run" in steps and (root / "truth" / f"{spec.name}.json").exists():
                diagnose(root / "data" / spec.name, root / "runs" / spec.name, candidates, limit)
            if "next" in steps and (root / "runs" / spec.name / "diagnosis.json").exists():
                follow(seed, spec, root, candidates, limit, elements)
        except Exception as error:
            failed.append(f"{spec.name}: {type(error).__name__}: {error}")
    if failed:
        raise RuntimeError("; ".join(failed))


def follow(
    seed: str, spec: Spec, root: Path, candidates: Sequence[str] | None = None, limit: float = LIMIT,
    elements: int = ELEMENTS,
) -> dict[str, Any] | None:  # fmt: skip
    """Run what a diagnosis recommends, by the same truth, and diagnose again; None if it asks for nothing.

    Each trial as many times as it says, the noise drawn anew for each.
    """
    found = json.loads((root / "runs" / spec.name / "diagnosis.json").read_text())
    chosen = recommended(found)
    folder, out = root / "data" / spec.name / "next", root / "runs" / spec.name / "next"
    asked, mark = json.dumps(chosen), folder / "chosen.json"
    if not (mark.exists() and mark.read_text() == asked):  # or what it asked for before
        shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(out, ignore_errors=True)
    if spec.kind not in ("effect", ALIKE) or not chosen:
        return None
    truth = json.loads((root / "truth" / f"{spec.name}.json").read_text())
    if not mark.exists():
        camera, count = Instrument(truth["sigma_m"], slow=spec.slow), TRIALS
        rng = generator(seed, "next", spec.name)
        for kind, number, times in chosen:
            there = setting(seed, spec)
            drive = planned(seed, spec)[number] if kind == "plan" else there.drives[number]
            there = replace(there, drives=[drive])
            try:
                clean = there.simulate(truth["truth"], elements)
                if wild(clean, there.machine):
                    raise ArithmeticError(f"{kind}_{number} makes a motion that is none")
            except ArithmeticError as error:  # FloatingPointError, too: it tells nothing of the class
                out.mkdir(parents=True, exist_ok=True)
                (out / "diagnosis.json").write_text(json.dumps(_failed(error)))
                break
            for _ in range(times):
                write_trials(folder, there, camera, truth["guess"], clean, truth["kept"], rng, first=count)
                count += 1
        folder.mkdir(parents=True, exist_ok=True)
        mark.write_text(asked)
    return diagnose(root / "data" / spec.name, out, candidates, limit, folder)


def open_class(found: Mapping[str, Any]) -> bool:
    """Whether a diagnosis leaves open which of several explanations it is."""
    terms = found.get("terms") or []
    return found.get("verdict") == "class" or any(len(term.get("class") or []) > 1 for term in terms)


def recommended(found: Mapping[str, Any]) -> list[tuple[str, int, int]]:
    """The trials that are recommended, ``("plan", K, times)`` or ``("trial", K, times)`` to be repeated."""
    chosen: dict[tuple[str, int], int] = {}
    if not open_class(found):
        return []
    for proposal in found.get("next_experiment") or []:
        if not proposal.get("needed"):  # it says that no trial of the menu would tell
            continue
        for trial, needed in [(proposal["trial"], proposal["needed"]), *(proposal.get("further") or [])]:
            if named := re.search(r"(plan|trial)_(\d+)", str(trial)):
                which = named[1], int(named[2])
                chosen[which] = max(chosen.get(which, 0), min(int(needed), REPEATS))
    return [(*which, times) for which, times in chosen.items()]


@contextmanager
def _within(limit: float) -> Iterator[None]:
    """Stop after so much CPU time; where the system can't, there is no limit."""
    if not hasattr(signal, "SIGPROF"):
        yield
        return

    def stop(*_: Any) -> None:
        raise OutOfTime

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _log(path: Path) -> Any:
    began = time.monotonic()

    def tell(text: str) -> None:
        with path.open("a") as file:
            file.write(f"{time.monotonic() - began:8.1f} s  {text}\n")

    return tell
