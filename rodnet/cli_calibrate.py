"""The command ``rodnet calibrate``."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import rodnet
from rodnet.cli_options import AsJson, CasePath, Modes, Progress, Recordings, Workers

if TYPE_CHECKING:
    from rodnet.inference.fitted import Fitted
    from rodnet.inference.result import CalibrationResult
    from rodnet.inference.split import Split

NOT_CONVERGED, INTERRUPTED = 3, 130
SEARCH = "search.json"


def calibrate(
    case: CasePath,
    recordings: Recordings,
    hold_out: Annotated[
        list[str] | None,
        typer.Option(
            help="Not fitted but predicted: file names as patterns, or group=NAME; may be repeated. Without it "
            "and --confirm, recordings are split by group, 60/20/20."
        ),
    ] = None,
    confirm: Annotated[
        list[str] | None,
        typer.Option(help="Neither fitted nor predicted, but left for the end; patterns likewise."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for fitted.json and a page with figures.")
    ] = None,
    loss: Annotated[str, typer.Option(help="linear, or robust: soft_l1, huber, cauchy, arctan.")] = "linear",
    segments: Annotated[
        float | None, typer.Option(help="Simulate trials in segments of so many seconds.")
    ] = None,
    starts: Annotated[int, typer.Option(help="Searches from so many places.")] = 1,
    modes: Modes = 6,
    workers: Workers = None,
    progress: Progress = True,
    as_json: AsJson = False,
) -> None:
    """Find the parameters of a case with which its robot moves as recorded, and how well they are known.

    With --out, Ctrl-C or a crash loses nothing: the same command goes on where it ended. In Python,
    rodnet.calibrate returns the same.
    """
    import rodnet as rn
    from rodnet.inference.instruments import check_planes
    from rodnet.inference.split import read_split
    from rodnet.numbers import plain
    from rodnet.report.calibration import calibration_page
    from rodnet.storage import check_writable

    if out is not None:
        check_writable(out / SEARCH)
    loaded = rn.load_case(case)
    parts = read_split(recordings, hold_out or (), confirm or ())
    check_planes(loaded, [*parts.train, *parts.held_out, *parts.confirm])
    if progress:
        print(parts, file=sys.stderr, flush=True)
    found = rn.calibrate(
        loaded, parts.train, loss=loss, segments=segments, starts=starts, modes=modes, workers=workers,
        progress=progress,
        checkpoint=None if out is None else out / SEARCH,
    )  # fmt: skip
    if out is not None:  # whatever becomes of the predictions
        _record(found, parts).save(out)
    scores = found.predictions(parts.held_out, own=True)
    page = None
    if out is not None:
        page = calibration_page(found, scores, str(parts)).save(out / "calibration.html")
    if as_json:
        told = {**found.to_dict(), "held_out": {name: s.rms for name, s in scores.items()}}
        told |= {"out": None if out is None else str(out), "trained_on": [r.name for r in parts.train]}
        told |= {"confirm": [r.name for r in parts.confirm], "split": parts.how}
        print(json.dumps(plain(told), allow_nan=False), flush=True)
    else:
        print(parts)
        _show(found, scores)
        if page is not None:
            print(f"written: {page}")
    if found.interrupted:
        raise typer.Exit(INTERRUPTED)
    if not found.success:
        raise typer.Exit(NOT_CONVERGED)


def _record(found: CalibrationResult, parts: Split) -> Fitted:
    """What is written: the values, and which recordings they have seen and not seen, when, by what."""
    fitted = found.fitted()
    made: dict[str, Any] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "rodnet": rodnet.__version__,
    }
    made |= {"split": parts.how, "held_out": [r.name for r in parts.held_out]}
    made |= {"confirm": [r.name for r in parts.confirm]}
    return replace(fitted, notes={"made": made, **fitted.notes})


def _show(found, scores) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("parameter", "value", "95 % from", "to", "unit"):
        table.add_column(title, justify="left" if title in ("parameter", "unit") else "right")
    for path, one in found.parameters.items():
        table.add_row(path, f"{one.value:.5g}", f"{one.low:.4g}", f"{one.high:.4g}", one.unit)
    Console(highlight=False, soft_wrap=True).print(table)
    for sentence in found.identifiability.sentences:
        print(sentence)
    for name, rms in found.rms.items():
        print(
            f"left unexplained: {name} {rms:.4g} {found.units[name]} rms, {found.outliers} outliers left out"
        )
    for name, score in scores.items():
        units = dict(score.instruments)
        told = score.failure or ", ".join(f"{k} {v:.4g} {units[k]} rms" for k, v in score.rms.items())
        fitted = f" (its own {', '.join(found.case.per_trial)} fitted)" if score.own else ""
        print(f"held out{fitted}: {name}: {told}")
    print(found.message)
