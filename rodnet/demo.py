"""The demonstration: the paper's robots with two and three tails, beside what the paper prints of them."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rodnet
from rodnet.runs import RunSpec, Say, check_directory, execute

RPM = 100.0
# caption of the paper's figure of snapshots; of the efficiency it shows only a curve
PAPER = {
    2: {"head_rpm": 95.47, "tail_rpm": 4.53, "speed_mm_s": 0.22},
    3: {"head_rpm": 97.49, "tail_rpm": 2.51, "speed_mm_s": 0.13},
}
COLUMNS = {  # heading, format of ours and of the paper's
    "head_rpm": ("head [rpm]", ".3f", ".2f"),
    "tail_rpm": ("tails [rpm]", ".3f", ".2f"),
    "speed_mm_s": ("forward speed [mm/s]", ".4f", ".2f"),
    "efficiency": ("efficiency", ".4f", ""),
}


def run_demo(
    out: str | Path, *, duration: float = 60.0, show: bool = True, say: Say = lambda _: None
) -> dict[str, Any]:
    """Simulate the robots at 100 rpm and write their results to ``out/2_tails`` and ``out/3_tails``.

    Parameters
    ----------
    out : path
        Directory; each robot gets ``run.nc``, ``run.rrd``, ``shapes.png``, ``position.png`` and
        ``summary.json`` in a directory of its own.
    duration : float
        Time to simulate [s].
    show : bool
        Print the comparison with the paper.
    say : callable
        Takes remarks on what is being done.

    Returns
    -------
    dict
        ``status``, ``seconds`` [s], and by number of tails the summary of the run and the paper's numbers.
    """
    begun = time.perf_counter()
    folders = {tails: Path(out) / f"{tails}_tails" for tails in PAPER}
    for folder in folders.values():
        check_directory(folder)
    found: dict[int, dict[str, Any]] = {}
    status = "finished"
    for tails, folder in folders.items():
        say(f"{tails} tails at {RPM:g} rpm, {duration:g} s")
        spec = RunSpec("flagellated", {"n_tails": tails, "rpm": RPM}, duration)
        outcome = execute(spec, folder, say=say)
        if outcome.error is not None:
            raise outcome.error
        found[tails] = outcome.summary
        status = outcome.trajectory.status
        if status == "interrupted":
            break
        position = folder / "position.png"
        rodnet.viz.plot_position(outcome.trajectory, position)
        outcome.summary["files"]["position"] = str(position)
    seconds = time.perf_counter() - begun
    if show and status == "finished":
        print_comparison(found, folders)
        print(f"\n{seconds:.0f} s in all. What next:")
        print(f"  {_command()} view {folders[2] / 'run.rrd'}    # see it move")
        print(f"  {_command()} run flagellated --tails 5 --rpm 150    # another robot")
        print(f"  {_command()} terms    # what can act on a robot")
    robots = {str(n): {"rodnet": summary, "paper": PAPER[n]} for n, summary in found.items()}
    return {"status": status, "seconds": seconds, "robots": robots}


def print_comparison(found: Mapping[int, Mapping[str, Any]], folders: Mapping[int, Path]) -> None:
    """Print a table, the paper's numbers under ours, and where the files are."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"Flagellated robot at {RPM:g} rpm", title_justify="left")
    table.add_column("tails")
    table.add_column("")
    for heading, _, _ in COLUMNS.values():
        table.add_column(heading, justify="right")
    table.add_column("steady")
    for tails, summary in found.items():
        ours = [
            format(v, style) if (v := summary[key]) == v else "-" for key, (_, style, _) in COLUMNS.items()
        ]
        paper = [
            format(PAPER[tails][key], style) if key in PAPER[tails] else "n/a"
            for key, (_, _, style) in COLUMNS.items()
        ]
        table.add_row(str(tails), "simulated", *ours, "yes" if summary["converged"] else "no")
        table.add_row("", "paper", *paper, "", style="dim", end_section=True)
    console = Console(highlight=False)
    console.print(table)
    console.print("The paper shows the efficiency only as a figure.", style="dim")
    for note in {s["note"] for s in found.values() if s.get("note")}:
        console.print(note, style="yellow")
    speeds = ", ".join(f"{s['realtime_factor']:.0f}" for s in found.values())
    print(f"Steps ran {speeds} times faster than real time (compilation and writing not counted).")
    for folder in folders.values():
        print(f"{folder}/: run.nc (trajectory), run.rrd (rerun), shapes.png, position.png, summary.json")


def _command() -> str:
    """How to call the command line from where the user is."""
    called = Path(sys.argv[0])
    return "rodnet" if shutil.which("rodnet") or called.name != "rodnet" else str(called)
