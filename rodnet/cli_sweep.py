"""The command ``rodnet sweep``."""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rodnet.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

    from rodnet.trajectory import Trajectory

FAILED, INTERRUPTED = 3, 130
# options that `rodnet run` has as well
Adaptive = Annotated[
    float | None,
    typer.Option(
        help="Choose the time steps by this tolerance, e.g. 0.01: about the relative error of velocities. --dt is "
        "then the first step. Best with --stepper sdirk2.",
        metavar="TOLERANCE",
    ),
]
SaveEvery = Annotated[
    int | None,
    typer.Option(help="Keep every so many-th time step, and the last (5; with --adaptive every one)."),
]


def kept(save_every: int | None, adaptive: float | None) -> int:
    """Every how many steps a state is kept: steps that are chosen are long, so all of them count."""
    return save_every if save_every is not None else 5 if adaptive is None else 1


def sweep(
    robot: Annotated[
        str,
        typer.Argument(help="An installed robot: flagellated, or one of a plug-in; or a file, robot.toml."),
    ],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Values of an argument of the robot or a parameter by path: rpm=25:300:12 (from, to, how many), "
            "n_tails=2,3,4, or one. Repeatable: every combination is run.",
            metavar="NAME=VALUES",
        ),
    ] = None,
    samples: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with a column per parameter and a robot per row, in place of combinations."
        ),
    ] = None,
    duration: Annotated[float, typer.Option(help="Seconds to simulate.")] = 60.0,
    dt: Annotated[float, typer.Option(help="Time step in seconds.")] = 0.01,
    stepper: Annotated[str, typer.Option(help="Time stepper.", metavar="euler|alpha|sdirk2")] = "euler",
    adaptive: Adaptive = None,
    out: Annotated[
        Path | None, typer.Option(help="NetCDF file of the results (default: runs/ROBOT-sweep.nc).")
    ] = None,
    save: Annotated[Path | None, typer.Option(help="Directory to keep the trajectories in.")] = None,
    save_every: SaveEvery = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes (default: the cores at hand); 0 computes in this one.")
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Run again what failed before.")] = False,
    progress: Annotated[bool, typer.Option(help="Show progress on standard error.")] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, as the last line of standard output.")
    ] = False,
) -> None:
    """Simulate a robot for every combination of parameters and measure each.

    Results come one by one into a journal beside --out: killed and called again, the same command
    computes only what is missing.
    """
    from rodnet.sweeps.processes import get_ready

    if workers != 0:
        get_ready()  # before all else: it takes as long as what is imported here meanwhile
    from rodnet import registry
    from rodnet import sweep as run_sweep
    from rodnet.runs import is_file, label

    values = parse_all(settings or [])
    out = out or Path("runs") / f"{label(robot)}-sweep.nc"
    found = run_sweep(
        robot,
        values if samples is None else None,
        Measured(robot, None if is_file(robot) else getattr(registry.robot(robot), "metrics", None)),
        samples=None if samples is None else read_samples(samples, values),
        duration=duration,
        dt=dt,
        options={"stepper": stepper} | ({} if adaptive is None else {"adaptive": adaptive}),
        save_every=kept(save_every, adaptive),
        out=out,
        save=save,
        workers=workers,
        retry=retry,
        progress=progress,
        units={
            "speed_mm_s": "mm/s",
            "displacement_mm": "mm",
            "path_mm": "mm",
            "head_rpm": "rpm",
            "tail_rpm": "rpm",
        },
    )
    interrupted = found.attrs["status"] == "interrupted"
    failed = int((found["state"] == "failed").sum())
    missing = int((found["state"] == "missing").sum())
    if as_json:
        from rodnet.numbers import plain

        rows = found.drop_dims([d for d in found.dims if d not in found["state"].dims])
        told = {"file": str(out), "status": found.attrs["status"], "failed": failed, "missing": missing}
        records = (
            rows.to_dataframe().reset_index().to_dict("records") if rows["state"].dims else [one_row(rows)]
        )
        print(json.dumps(plain({**told, "results": records}), allow_nan=False))
    else:
        print_table(found)
        print(f"written: {out}")
        if "note" in found:
            notes = [note for note in found["note"].values.ravel() if note]
            print(f"notes on {len(notes)} of {found['note'].size}, first: {notes[0]}", file=sys.stderr)
    if failed:
        first = next(e for e in found["error"].values.ravel() if e)
        print(f"{failed} of {found['error'].size} failed, first: {first}", file=sys.stderr)
    if interrupted:
        print(f"interrupted, {missing} are missing; the same command goes on", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    if failed:
        raise typer.Exit(FAILED)


def parse_all(settings: Iterable[str]) -> dict[str, Any]:
    """Return the values of all ``--set`` options: a list of what is swept, a single value of what is not."""
    values: dict[str, Any] = {}
    for text in settings:
        name, equals, words = (part.strip() for part in text.partition("="))
        if not (name and equals and words):
            raise ParameterError(f"--set {text!r} is not of the form NAME=VALUES, e.g. rpm=25:300:12")
        if name in values:
            raise ParameterError(f"--set {name} is given twice")
        values[name] = parse_values(text, words)
    return values


def read_samples(file: Path, fixed: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a CSV file, each with what is the same for all."""
    several = [name for name, value in fixed.items() if isinstance(value, list)]
    if several:
        raise ParameterError(
            f"--set {several[0]} has several values; with --samples it takes one, or is a column"
        )
    try:
        with file.open(newline="", encoding="utf-8-sig") as lines:
            rows = list(csv.DictReader(lines, skipinitialspace=True, restval="", strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ParameterError(f"cannot read the samples '{file}': {error}") from None
    for number, row in enumerate(rows, 2):
        if None in row or "" in row.values():
            raise ParameterError(f"line {number} of '{file}' has not one value per column")
        if twice := set(row) & set(fixed):
            raise ParameterError(f"{min(twice)} is a column of '{file}' and given by --set")
    return [{name.strip(): _value(word) for name, word in row.items()} | dict(fixed) for row in rows]


def parse_values(text: str, words: str) -> Any:
    """Values of ``from:to:count`` or ``a,b,c`` as a list, or one value."""
    import numpy as np

    parts = words.split(":")
    numbers = [isinstance(_value(part), int | float) for part in parts]
    if len(parts) == 3 or (len(parts) > 1 and all(numbers)):
        try:
            low, high, count = (kind(part) for kind, part in zip((float, float, int), parts, strict=True))
        except ValueError:
            raise ParameterError(
                f"--set {text!r}: a range is FROM:TO:COUNT in numbers, e.g. rpm=25:300:12"
            ) from None
        if count < 1 or not (np.isfinite(low) and np.isfinite(high)):
            raise ParameterError(f"--set {text!r}: a range is finite, its count positive")
        values = np.linspace(low, high, count)
        whole = all(isinstance(_value(p), int) for p in parts) and bool(np.all(values == np.round(values)))
        return [int(v) for v in values] if whole else values.tolist()
    if "," not in words:
        return _value(words)
    if not all(word.strip() for word in words.split(",")):
        raise ParameterError(f"--set {text!r} has an empty value between its commas")
    return [_value(word) for word in words.split(",")]


def _value(word: str) -> Any:
    try:
        return json.loads(word)
    except json.JSONDecodeError:
        try:
            return float(word)  # .5, nan, inf: for the sweep to judge
        except ValueError:
            return word.strip()


@dataclass(frozen=True)
class Measured:
    """Measures what an installed robot says of itself, as far as it is numbers, and a note on them.

    Its own metrics are part of it: results of others are not taken up.
    """

    robot: str
    metrics: Any = None

    def __call__(self, trajectory: Trajectory) -> dict[str, Any]:
        """Return numbers by name."""
        from rodnet import registry
        from rodnet.runs import FileRobot, is_file, measure

        robot = FileRobot if is_file(self.robot) else registry.robot(self.robot)
        found = measure(robot, trajectory)
        found["converged"] = math.nan if found["converged"] is None else found["converged"]
        return {k: v for k, v in found.items() if k == "note" or isinstance(v, bool | int | float)}


def one_row(found: xr.Dataset) -> dict[str, Any]:
    """Return the values of a sweep without dimensions."""
    return {str(name): variable.values.item() for name, variable in found.variables.items()}


def print_table(found: xr.Dataset) -> None:
    """Print the results as a table."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    flat = found.drop_dims([d for d in found.dims if d not in found["state"].dims])
    rows = flat.to_dataframe().reset_index().to_dict("records") if flat.dims else [one_row(flat)]
    hidden = {"sample", "seconds", "drift", "turns", "state", "error_time", "note", "trajectory"}
    if all(row.get("converged") != row.get("converged") for row in rows):  # nobody says
        hidden.add("converged")
    names = [n for n in rows[0] if n not in hidden and (n != "error" or any(row[n] for row in rows))]
    table = Table(box=None, pad_edge=False)
    for name in names:
        unit = found[name].attrs.get("units", "1")
        heading = name.removesuffix("_mm_s") + (f" [{unit}]" if unit != "1" else "")
        table.add_column(escape(heading), justify="left" if name == "error" else "right", overflow="fold")
    for row in rows:
        if "error" in names:
            row["error"] = row["error"].partition(":")[0]  # its class: whole sentences make no table
        if "converged" in names:
            row["converged"] = {1: "yes", 0: "no"}.get(row["converged"], "")
        table.add_row(
            *(f"{v:.5g}" if isinstance(v, float) else escape(str(v)) for v in (row[n] for n in names))
        )
    # a file or a pipe has no width to fit
    Console(highlight=False, width=None if sys.stdout.isatty() else 1000).print(table)
