"""The command ``rodnet evaluate``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from rodnet.cli_options import AsJson, CasePath, More, Progress, Recordings, Workers

FAILED = 3


def evaluate(
    case: CasePath,
    recordings: Recordings,
    more: More = None,
    model: Annotated[
        Path | None, typer.Option(help="Directory with fitted.json (default: the case's own values).")
    ] = None,
    train: Annotated[
        list[str] | None,
        typer.Option(help="Recordings to fit the case's simpler models to (default: those of the model)."),
    ] = None,
    workers: Workers = None,
    progress: Progress = True,
    as_json: AsJson = False,
) -> None:
    """Predict recordings from their first two frames and what was prescribed, and score the predictions.

    Beside the model stand predictions without one: the last pose held, the prescribed motion interpolated,
    and what the case has of its own. In Python, rodnet.evaluate returns the same.
    """
    import rodnet as rn
    from rodnet.runs import plain

    fitted = None if model is None else rn.Fitted.load(model)
    learned: Any = train or _existing(fitted)
    found = rn.evaluate(
        case, [*recordings, *(more or [])], fitted, train=learned, workers=workers, progress=progress
    )
    if as_json:
        told = {"model": None if model is None else str(model), **found.to_dict()}
        print(json.dumps(plain(told), allow_nan=False), flush=True)
    else:
        show(found)
    failed = [f for f in found.files if f["failure"]]
    for file in failed:
        print(f"{file['name']}: {file['failure']}", file=sys.stderr)
    if failed:
        raise typer.Exit(FAILED)


def _existing(fitted: Any) -> list[str] | None:
    """Files that a model was fitted to, if they are all still there."""
    files = [] if fitted is None else list(fitted.recordings)
    return files if files and all(Path(f).is_file() for f in files) else None


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


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}g}"
