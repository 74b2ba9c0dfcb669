"""The command ``rodnet diagnose``."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from rodnet.cli_options import AsJson, CasePath, Modes, Progress, Recordings, Workers
from rodnet.diagnosis.patience import MINUTES

FEW = 8  # trials, below which none is left alone to confirm


def diagnose(
    case: CasePath,
    recordings: Recordings,
    hold_out: Annotated[
        list[str] | None,
        typer.Option(
            help="Opened after the search, once per accepted model, when they can take an effect back: file names as "
            "patterns, or group=NAME; may be repeated. Without it and --confirm a fifth of the recordings; of eight or "
            "more another fifth confirms."
        ),
    ] = None,
    confirm: Annotated[
        list[str] | None,
        typer.Option(help="Opened once, at the very end, for the figures that count; as --hold-out."),
    ] = None,
    candidates: Annotated[
        list[str] | None,
        typer.Option(
            help="Ids of explanations to try (rodnet terms --candidates), by spaces or commas; all by default."
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            help="Directory that rodnet calibrate wrote: the search begins there (default: the case's values)."
        ),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            help="Standard deviation of a marker's coordinate in metres; of several instruments NAME=VALUE, may be "
            "repeated. By default that of the case, else of the recordings, else an estimate."
        ),
    ] = None,
    modes: Modes = 6,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Directory for diagnosis.json, report.html and the repaired robot; with the same one, "
            "what was interrupted goes on."
        ),
    ] = None,
    bootstrap: Annotated[
        int, typer.Option(help="Number of replicas for the bootstrap of the whole pipeline; none by default.")
    ] = 0,
    minutes: Annotated[
        float,
        typer.Option(
            help="Time it may take: no effect after the first is looked for that would take longer."
        ),
    ] = MINUTES,
    workers: Workers = None,
    progress: Progress = True,
    as_json: AsJson = False,
) -> None:
    """Find what a model leaves out: locate it, name it, fit it, and show what that does on trials not seen.

    In Python, rodnet.diagnose returns the same.
    """
    import rodnet as rn
    from rodnet.inference.split import read_split
    from rodnet.report.sentences import summary
    from rodnet.storage import check_writable

    if out is not None:
        check_writable(out / "diagnosis.json")
    sigma = _noise(noise or [])
    loaded = rn.load_case(case)
    start = None if model is None else rn.Fitted.load(model).values
    ids = [id for some in candidates or [] for id in some.replace(",", " ").split()]
    parts = read_split(recordings, hold_out or [], confirm or [])
    if (
        not (hold_out or confirm) and len(parts.train) + len(parts.held_out) + len(parts.confirm) < FEW
    ):  # none to spare
        how = "one held out, for there are few" if parts.held_out else "too few to hold one out"
        parts = replace(parts, train=[*parts.train, *parts.confirm], confirm=[], how=how)
    if not as_json:
        print(parts)
    try:
        found = rn.diagnose(
            loaded, parts.train, hold_out=parts.held_out, confirm=parts.confirm, candidates=ids or None,
            noise=sigma, start=start, modes=modes, resume=out,
            bootstrap=bootstrap, minutes=minutes, workers=workers, progress=progress,
        )  # fmt: skip
    except KeyboardInterrupt:
        kept = "" if out is None else "; the same command goes on after the last stage that was finished"
        print(f"interrupted{kept}", file=sys.stderr)
        raise typer.Exit(130) from None
    written = []
    if out is not None:
        written = found.write(out)
    if as_json:
        print(json.dumps(found.to_dict(), allow_nan=False), flush=True)
        return
    print(summary(found))
    for path in written:
        print(f"written: {path}")


def _noise(given: list[str]) -> float | dict[str, float] | None:
    """What ``--noise`` says: a number, or one for each name."""
    from rodnet.errors import ParameterError

    found: dict[str, float] = {}
    for text in given:
        name, _, value = text.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = 0.0
        if not 0.0 < found[name] < float("inf"):
            raise ParameterError(
                f"--noise {text}: {value!r} must be a positive number; write --noise 1e-3 or NAME=1e-3"
            )
    if "" in found and len(given) > 1:
        raise ParameterError(f"--noise {' '.join(given)}: of several, each needs its name, NAME=VALUE")
    return found.get("", found or None)
