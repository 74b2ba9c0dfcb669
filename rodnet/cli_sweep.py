"""The command ``rodnet sweep``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rodnet.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

    from rodnet.trajectory import Trajectory

FAILED = 3


def sweep(
    robot: Annotated[
        str,
        typer.Argument(help="An installed robot: flagellated, or one of a plug-in; or a file, robot.toml."),
    ],
    settings: Annotated[
        list[str],
        typer.Option(
            "--set",
            help="Values of an argument of the robot or a parameter by path: rpm=25:300:12 (from, to, how many), "
            "n_tails=2,3,4, or one. Repeatable: every combination is run.",
            metavar="NAME=VALUES",
        ),
    ],
    duration: Annotated[float, typer.Option(help="Seconds to simulate.")] = 60.0,
    dt: Annotated[float, typer.Option(help="Time step in seconds.")] = 0.01,
    stepper: Annotated[str, typer.Option(help="Time stepper.", metavar="euler|alpha|sdirk2")] = "euler",
    out: Annotated[
        Path | None, typer.Option(help="NetCDF file of the results (default: runs/ROBOT-sweep.nc).")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes (default: the cores at hand).")] = None,
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
    from rodnet import sweep as run_sweep
    from rodnet.runs import contents, label, plain

    grid: dict[str, Any] = {}
    for text in settings:
        name, equals, values = text.partition("=")
        if not (name.strip() and equals and values.strip()):
            raise ParameterError(f"--set {text!r} is not of the form NAME=VALUES, e.g. rpm=25:300:12")
        if name.strip() in grid:
            raise ParameterError(f"--set {name.strip()} is given twice")
        grid[name.strip()] = parse_values(text, values.strip())
    installed = Installed(robot, dt, stepper, contents=tuple(contents(robot).values()))
    installed.spec(**{name: values[0] for name, values in grid.items()}).build()  # says what is wrong
    out = out or Path("runs") / f"{label(robot)}-sweep.nc"
    try:
        found = run_sweep(
            installed,
            grid,
            Measured(robot),
            duration=duration,
            dt=dt,
            options={"stepper": stepper},
            out=out,
            workers=workers,
            retry=retry,
            progress=progress,
        )
    except KeyboardInterrupt:
        print(f"interrupted; what was computed is in {out}, the same command goes on", file=sys.stderr)
        raise typer.Exit(130) from None
    errors = [e for e in found["error"].values.ravel() if e]
    if as_json:
        rows = found.to_dataframe().reset_index().to_dict("records")
        print(json.dumps(plain({"file": str(out), "failed": len(errors), "results": rows}), allow_nan=False))
    else:
        print_table(found)
        print(f"written: {out}")
    if errors:
        print(f"{len(errors)} of {found['error'].size} failed, first: {errors[0]}", file=sys.stderr)
        raise typer.Exit(FAILED)


def parse_values(text: str, values: str) -> list[Any]:
    """Values of ``from:to:count``, ``a,b,c`` or one value."""
    import numpy as np

    parts = values.split(":")
    if len(parts) == 3:
        try:
            low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
        except ValueError:
            raise ParameterError(
                f"--set {text!r}: a range is FROM:TO:COUNT in numbers, e.g. rpm=25:300:12"
            ) from None
        if count < 1:
            raise ParameterError(f"--set {text!r}: the count of a range must be positive")
        return np.linspace(low, high, count).tolist()
    return [_value(v) for v in values.split(",") if v.strip()]


def _value(word: str) -> Any:
    try:
        return json.loads(word)
    except json.JSONDecodeError:
        return word.strip()


@dataclass(frozen=True)
class Installed:
    """Builds an installed robot with arguments and parameters by path."""

    robot: str
    dt: float
    stepper: str
    fixed: dict[str, Any] = field(default_factory=dict)
    contents: tuple[str, ...] = ()  # of a file: another one is another sweep

    def spec(self, **settings: Any) -> Any:
        """Return the specification of a run with these settings."""
        from rodnet.runs import RunSpec

        return RunSpec(self.robot, {**self.fixed, **settings}, dt=self.dt, stepper=self.stepper)

    def __call__(self, **settings: Any) -> Any:
        return self.spec(**settings).build()


@dataclass(frozen=True)
class Measured:
    """Measures what an installed robot says of itself, as far as it is numbers."""

    robot: str

    def __call__(self, trajectory: Trajectory) -> dict[str, float]:
        from rodnet.runs import measure, robot_factory

        found = measure(robot_factory(self.robot), trajectory)
        return {name: value for name, value in found.items() if isinstance(value, bool | int | float)}


def print_table(found: xr.Dataset) -> None:
    """Print the results as a table."""
    from rich.console import Console
    from rich.table import Table

    frame = found.to_dataframe().reset_index()
    table = Table(box=None, pad_edge=False)
    shown = [c for c in frame.columns if c not in ("seconds", "converged", "turns")]
    shown = [c for c in shown if c != "error" or frame[c].any()]
    for name in shown:
        table.add_column(str(name), justify="left" if name == "error" else "right")
    for _, row in frame.iterrows():
        table.add_row(*(f"{v:.5g}" if isinstance(v, float) else str(v) for v in row[shown]))
    Console().print(table)
