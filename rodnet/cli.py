"""The command line: run, import, inspect, calibrate, evaluate, diagnose ... Heavy imports wait for a command."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from rodnet import cli_calibrate, cli_diagnose, cli_evaluate, cli_import, cli_inspect, cli_sweep
from rodnet.cli_options import ManyValues
from rodnet.cli_summary import print_summary
from rodnet.cli_sweep import Adaptive, SaveEvery
from rodnet.errors import ConvergenceError, OutputError, ParameterError, RodnetError, UnknownNameError

if TYPE_CHECKING:
    from rodnet.registry import Record

BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 2, 3, 130
ABOUT = """Simulate robots made of thin rods, calibrate them, and find what a model leaves out.

A robot is a graph of elastic rods, joints and stiff parts; elastic laws, drag, loads, motors and \
constraints are terms with named parameters. Results are NetCDF files, rerun recordings and figures."""
EXAMPLES = """[bold]Examples[/bold]

  rodnet demo                                   [dim]the paper's robots[/dim]

  rodnet run flagellated --tails 3 --rpm 150    [dim]into runs/flagellated[/dim]

  rodnet run flagellated --tails 3 --rpm 150 --duration 300 --resume

  rodnet run flagellated --set drag.viscosity=10 --set L3=0.12 --out long

  rodnet run robot.toml --duration 5 --dt 1e-3  [dim]what robot.save("robot.toml") wrote[/dim]

  rodnet sweep flagellated --set n_tails=2,3 --set rpm=50:300:6   [dim]every combination, on all cores[/dim]

  rodnet view demo/2_tails/run.rrd              [dim]open the rerun viewer[/dim]

  rodnet import robot.stl --units mm            [dim]a mesh as rods, and how well[/dim]

  rodnet calibrate dlo.py --recordings "day1/*.npz" --out fit   [dim]parameters with intervals[/dim]
  rodnet diagnose dlo.py --recordings "day1/*.npz" --out found   [dim]what the model leaves out[/dim]

  rodnet inspect "day1/*.npz" --out day1.html   [dim]what is in recordings[/dim]

  rodnet evaluate case.py --recordings "day2/*.npz" --model fit   [dim]predict, and score[/dim]

  rodnet terms                                  [dim]the physics installed[/dim]

[bold]Exit codes[/bold]

  0 fine; 2 bad input; 3 a time step or a search did not converge, or a robot of a sweep or a recording failed;
  130 interrupted

  What was computed before 3 or 130 is on disk. With --json the last line of standard output is one JSON object."""

app = typer.Typer(
    help=ABOUT,
    epilog=EXAMPLES,
    rich_markup_mode="rich",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, as the last line of standard output.")
]


def main() -> None:
    """Entry point: run a command; errors made on purpose become one message and an exit code."""
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
    try:
        app(prog_name="rodnet")
    except RodnetError as error:
        fail(error, "--json" in sys.argv)
    finally:
        gc.freeze()  # libraries by the thousand objects, not to be searched for rubbish when the process ends


def fail(error: RodnetError, as_json: bool) -> NoReturn:
    """Print an error and leave with its exit code."""
    code = NOT_CONVERGED if isinstance(error, ConvergenceError) else BAD_INPUT
    tell(f"error: {error}")
    if as_json:
        emit({"error": type(error).__name__, "message": str(error), "exit_code": code})
    raise SystemExit(code)


def emit(values: Mapping[str, Any]) -> None:
    """Print one line of JSON."""
    from rodnet.numbers import plain

    print(json.dumps(plain(values), allow_nan=False), flush=True)


def tell(text: str) -> None:
    """Print a remark on standard error."""
    print(text, file=sys.stderr, flush=True)


def _version(wanted: bool) -> None:
    if wanted:
        import rodnet

        print(f"rodnet {rodnet.__version__}")
        raise typer.Exit()


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options before the command."""


# -- run --------------------------------------------------------------------------------------
@app.command(
    epilog="Robots of your own: plug-ins that announce them as entry points in the group rodnet.robots."
)
def run(
    robot: Annotated[
        str,
        typer.Argument(help="An installed robot: flagellated, or one of a plug-in; or a file, robot.toml."),
    ],
    tails: Annotated[int | None, typer.Option(help="Number of tails (2 for flagellated).")] = None,
    rpm: Annotated[
        float | None, typer.Option(help="Speed of the motor in rpm (100 for flagellated).")
    ] = None,
    duration: Annotated[float, typer.Option(help="Seconds to simulate, counted from the beginning.")] = 60.0,
    dt: Annotated[float, typer.Option(help="Time step in seconds.")] = 0.01,
    edges: Annotated[int | None, typer.Option(help="Edges per tail (27 for flagellated).")] = None,
    root: Annotated[
        str | None,
        typer.Option(help="Root of the tails: rigid, as in the paper, or clamped.", metavar="rigid|clamped"),
    ] = None,
    stepper: Annotated[
        str,
        typer.Option(
            help="Time stepper; the second-order ones for what swings.", metavar="euler|alpha|sdirk2"
        ),
    ] = "euler",
    adaptive: Adaptive = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="An argument of the robot, L3=0.12, or a parameter by path, drag.viscosity=10. Repeatable.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Directory of the results; earlier ones are replaced (default: runs/ROBOT)."),
    ] = None,
    save_every: SaveEvery = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Continue an interrupted run in --out, or a finished one to a later time."
        ),
    ] = False,
    progress: Annotated[bool, typer.Option(help="Show progress on standard error.")] = True,
    as_json: Json = False,
) -> None:
    """Simulate a robot and measure how it moves.

    Writes run.nc (the trajectory), run.rrd (for the rerun viewer), shapes.png and summary.json.
    """
    from rodnet.runs import RunSpec, execute, label

    named = {"n_tails": tails, "rpm": rpm, "edges": edges, "root": root}
    given = {name: value for name, value in named.items() if value is not None}
    for name, value in parse_settings(settings or []).items():
        if name in given:
            raise ParameterError(f"{name} is given twice, as an option and by --set")
        given[name] = value
    save_every = cli_sweep.kept(save_every, adaptive)
    spec = RunSpec(robot, given, duration, dt, stepper, save_every, adaptive)
    out = out or Path("runs") / label(robot)
    outcome = execute(spec, out, resume=resume, progress=progress, say=tell if progress else lambda _: None)
    summary = outcome.summary
    if outcome.error is None:
        if not as_json:
            print_summary(summary)
    else:
        tell(f"error: {outcome.error}")
    if outcome.trajectory.status == "interrupted":
        tell(f"interrupted at t = {summary['t_end']:g} s; --resume continues from there")
    if as_json:
        emit(summary)
    if outcome.error is not None:
        raise typer.Exit(NOT_CONVERGED)
    if outcome.trajectory.status == "interrupted":
        raise typer.Exit(INTERRUPTED)


def parse_settings(texts: Iterable[str]) -> dict[str, Any]:
    """Parse ``NAME=VALUE`` pairs; a value is a number, true or false, a JSON list, or else a word."""
    found: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals and value.strip()):
            raise ParameterError(f"--set {text!r} is not of the form NAME=VALUE, e.g. drag.viscosity=10")
        if name.strip() in found:
            raise ParameterError(f"--set {name.strip()} is given twice")
        try:
            found[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            try:
                found[name.strip()] = float(value)  # .5, nan, inf: for the robot to judge
            except ValueError:
                found[name.strip()] = value.strip()
    return found


app.command(name="sweep")(cli_sweep.sweep)
app.command(name="import")(cli_import.import_)
app.command(name="inspect")(cli_inspect.inspect)
app.command(name="calibrate", cls=ManyValues)(cli_calibrate.calibrate)
app.command(name="diagnose", cls=ManyValues)(cli_diagnose.diagnose)
app.command(name="evaluate", cls=ManyValues)(cli_evaluate.evaluate)


# -- demo, view -------------------------------------------------------------------------------
@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Directory of the results.")] = Path("demo"),
    duration: Annotated[float, typer.Option(help="Seconds to simulate.")] = 60.0,
    as_json: Json = False,
) -> None:
    """Simulate the paper's robots and compare with its numbers.

    Those with two and three tails at 100 rpm; writes a trajectory, a rerun recording and figures of each.
    """
    from rodnet.demo import run_demo

    result = run_demo(out, duration=duration, show=not as_json, say=tell)
    if as_json:
        emit(result)
    if result["status"] == "interrupted":
        raise typer.Exit(INTERRUPTED)


@app.command()
def view(
    file: Annotated[Path, typer.Argument(help="A rerun recording, e.g. runs/flagellated/run.rrd.")],
    web: Annotated[
        bool,
        typer.Option(
            "--web", help="Serve the viewer to a browser on this machine, at http://127.0.0.1:9090."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Open a rerun recording in the viewer."""
    if not file.is_file():
        raise OutputError(f"there is no file '{file}'; rodnet run and rodnet demo write .rrd files")
    with file.open("rb") as handle:
        if handle.read(3) != b"RRF":
            raise OutputError(f"'{file}' is not a rerun recording (.rrd)")
    if (
        not web
        and sys.platform.startswith("linux")
        and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    ):
        raise OutputError(
            f"there is no display here to open a window on. rodnet view --web {file} serves the viewer to a "
            "browser, or copy the file to a machine with a display"
        )
    command = [
        sys.executable,
        "-m",
        "rerun",
        str(file),
        *(["--web-viewer", "--bind", "127.0.0.1"] if web else []),
    ]
    try:
        code = subprocess.run(command).returncode
    except KeyboardInterrupt:  # how one leaves a viewer that was started from a terminal
        code = 0
    if as_json:
        emit({"file": str(file), "viewer_exit_code": code})
    raise typer.Exit(1 if code else 0)


# -- terms ------------------------------------------------------------------------------------
@app.command()
def terms(
    words: Annotated[
        list[str] | None, typer.Argument(help="Only what has all of these in its id or first line.")
    ] = None,
    candidates: Annotated[
        bool,
        typer.Option("--candidates", help="List what a diagnosis can add: what vanishes at a null value."),
    ] = False,
    as_json: Json = False,
) -> None:
    """List the physics that is installed, plug-ins included.

    Every energy, drag law, load, actuator and constraint, with parameters, units and where it comes from.
    """
    from rodnet import registry
    from rodnet.graph.rod_spec import UNITS

    records = registry.candidates() if candidates else registry.terms()
    asked = [word.lower() for word in words or []]
    records = {k: r for k, r in records.items() if all(w in f"{k} {r.summary}".lower() for w in asked)}
    if not records:
        said = f"no {'candidate' if candidates else 'term'} has {' and '.join(words or [])} in its id or first line"
        raise UnknownNameError(f"{said}; rodnet terms{' --candidates' if candidates else ''} lists all")
    if as_json:
        rods = [{"name": k, "unit": unit, "bounds": bounds} for k, (unit, bounds) in UNITS.items()]
        emit({"terms": [r.to_dict() for r in records.values()], "rod_parameters": rods})
        return
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    for kind in (*registry.KINDS, "candidate"):
        chosen = [r for r in records.values() if r.kind == kind]
        if chosen:
            console.print(f"[bold]{kind}[/bold]")
        for record in chosen:
            print_record(console, record)
    units = ", ".join(f"{k} \\[{unit}]" for k, (unit, _) in UNITS.items())
    console.print(
        "A term's parameters go by its name, drag.viscosity; at their null values it does nothing. Equations "
        "and sources are in the docs, theory."
    )
    console.print(
        f"Energies act with the stiffness of the rods, whose parameters are {units}, as in tail0.E."
    )
    console.print('A class: rn.term("resistive-force"). Terms of your own: rodnet.DragModel and its like.')


def print_record(console: Any, record: Record) -> None:
    """Print one term with its parameters."""
    from rich.markup import escape

    if record.kind == "candidate":
        name = record.object.group
    else:
        name = f"{record.object.__module__.split('.')[0]}.{record.object.__name__}"
    console.print(f"  [cyan]{record.id}[/cyan]  {name}  [dim]{escape(record.distribution)}[/dim]")
    console.print(f"      {escape(record.summary)}")
    taken = f"; takes {', '.join(record.arguments)}" if record.arguments else ""
    console.print(f"      [dim]named {escape(record.name + taken)}[/dim]")
    for p in record.parameters:
        low, high = ("" if abs(b) == float("inf") else f"{b:g}" for b in p.bounds)
        bounds = f", {low} .. {high}" if low or high else ""
        null = f", null {p.null:g}" if p.null is not None else ""
        default = (
            "not set" if p.value is None else f"{p.value:g}" if isinstance(p.value, float) else str(p.value)
        )
        console.print(
            f"      - {p.name} {escape(f'[{p.unit}]')} {escape(p.doc)} [dim]({default}{bounds}{null})[/dim]"
        )
    if record.source:
        console.print(f"      [dim]from: {escape(record.source)}[/dim]")
