"""The command ``rodnet evaluate``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rodnet.cli_options import AsJson, CasePath, Progress, Recordings, Workers
from rodnet.errors import ParameterError

if TYPE_CHECKING:
    from rodnet.inference.fitted import Fitted
    from rodnet.recordings.recording import Recording

FAILED = 3
PAGE = "evaluation.html"


def evaluate(
    case: CasePath,
    recordings: Recordings,
    model: Annotated[
        Path | None, typer.Option(help="Directory with fitted.json (default: the case's own values).")
    ] = None,
    train: Annotated[
        list[str] | None,
        typer.Option(
            help="Recordings to fit the case's simpler models to (default: those that the model has)."
        ),
    ] = None,
    unseen: Annotated[
        bool, typer.Option("--unseen", help="Only recordings that the model was not fitted to.")
    ] = False,
    converge: Annotated[
        bool, typer.Option("--converge", help="Say what half the time step changes, and what it damps.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Directory for a page with figures.")] = None,
    workers: Workers = None,
    progress: Progress = True,
    as_json: AsJson = False,
) -> None:
    """Predict recordings from their first two frames and what was prescribed, and score the predictions.

    Beside the model stand predictions without one: the last pose held, the prescribed motion interpolated,
    and what the case has of its own. In Python, rodnet.evaluate returns the same.
    """
    import rodnet as rn
    from rodnet.numbers import plain
    from rodnet.report.evaluation import evaluation_page
    from rodnet.storage import check_writable

    if out is not None:
        check_writable(out / PAGE)
    fitted = None if model is None else rn.Fitted.load(model)
    learned: Any = train or _existing(fitted)
    given: Any = recordings
    if unseen:
        given = _unseen(rn.read_recordings(given), fitted)
    found = rn.evaluate(
        case, given, fitted, train=learned, converge=converge, workers=workers, progress=progress
    )
    page = None
    if out is not None:
        page = evaluation_page(found, "" if fitted is None else _told(fitted)).save(out / PAGE)
    if as_json:
        told = {"model": None if model is None else str(model), **found.to_dict()}
        told["page"] = None if page is None else str(page)
        print(json.dumps(plain(told), allow_nan=False), flush=True)
    else:
        show(found)
        if page is not None:
            print(f"written: {page}")
    failed = [f for f in found.files if f["failure"]]
    for file in failed:
        print(f"{file['name']}: {file['failure']}", file=sys.stderr)
    if failed:
        raise typer.Exit(FAILED)


def _existing(fitted: Any) -> list[str] | None:
    """Files that a model was fitted to, if it keeps no simpler models and they are all still there."""
    files = [] if fitted is None or fitted.baselines else list(fitted.recordings)
    return files if files and all(Path(f).is_file() for f in files) else None


def _unseen(recordings: list[Recording], fitted: Fitted | None) -> list[Recording]:
    """Recordings that a model was not fitted to, told by their contents, or by their names."""
    if fitted is None:
        raise ParameterError("--unseen needs the model whose recordings it leaves out: give --model")
    known = fitted.notes.get("digests")
    if isinstance(known, dict):
        left = [rec for rec in recordings if rec.digest not in known.values()]
    else:
        names = {Path(file).stem for file in fitted.recordings}
        left = [rec for rec in recordings if rec.name not in names]
    if not left:
        raise ParameterError("--unseen leaves nothing: the model was fitted to all of these recordings")
    return left


def _told(fitted: Fitted) -> str:
    values = ", ".join(f"{path} = {p.value:.4g} {p.unit}" for path, p in fitted.parameters.items())
    names = ", ".join(Path(file).stem for file in fitted.recordings)
    return f"Model: {values}" + (f"; fitted to {names}." if names else ".")


def show(found: Any) -> None:
    """Print a table of files, totals and baselines."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for title in (found.metric_name, "mm, 5 s", "mm, 1 s"):
        table.add_column(title, justify="right")

    def row(label: str, values: Any, style: str | None = None) -> None:
        table.add_row(
            label, _number(values["metric"], 5), _number(values["mean_mm_5s"], 4), _number(values["mean_mm_1s"], 4),
            style=style,
        )  # fmt: skip

    for file in found.files:
        row(f"{file['kind']}/{file['name']}", file)
    for kind in [None] if len(found.kinds) == 1 else [*found.kinds, None]:
        total = found.total(kind)
        table.add_section()
        row(f"mean of {total['recordings']}" + (f" {kind}" if kind else ""), total, "bold")
        for name, values in total["baselines"].items():
            row(f"  {name}", values, "dim")
    Console(highlight=False, soft_wrap=True).print(table)
    _show_convergence(found)


def _show_convergence(found: Any) -> None:
    """Print what the time step does, and to which modes."""
    from rich.console import Console
    from rich.table import Table

    from rodnet.report.evaluation import convergence_in_words

    total = found.total().get("convergence")
    if total is None:
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for title in ("dt/2: mm rms", "max", "mode, Hz", "of energy", "fitted loss", "numerical"):
        table.add_column(title, justify="right")
    for file in found.files:
        one = file.get("convergence")
        if one is None:
            continue
        label, change = file["name"], [_number(one["rms_mm"], 2), _number(one["max_mm"], 2)]
        for m in one["modes"] or [None]:
            row = ["-"] * 4 if m is None else [
                f"{m['frequency']:.3g}", f"{m['share']:.1%}", f"{m['fitted']:.2%}", f"{m['numerical']:.4%}"
            ]  # fmt: skip
            table.add_row(label, *change, *row)
            label, change = "", ["", ""]
        if one["told"]:
            table.add_row(f"  {one['told']}")
    Console(highlight=False, soft_wrap=True).print(table)
    print(convergence_in_words(total) + "; losses are of the amplitude, in a period")


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}g}"
