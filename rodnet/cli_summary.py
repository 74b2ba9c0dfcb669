"""What ``rodnet run`` prints of a run: a table of what was measured, and where the files are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# entries of a summary that the table leaves out
KEYS = {
    "status", "t_end", "duration", "dt", "stepper", "adaptive", "steps", "resumed_from", "stepping_s", "warmup_s",
    "substeps", "factorizations", "fallbacks", "spec", "versions", "files", "note", "converged", "turns",
}  # fmt: skip


def print_summary(summary: Mapping[str, Any]) -> None:
    """Print the measured values as a table, and where the files are."""
    from rich.console import Console
    from rich.table import Table

    mine = summary["spec"]["robot"]
    speed = (
        "mean speed of the centre of mass"
        if "displacement_mm" in summary
        else f"speed, as {mine} measures it"
    )
    rows = {
        "speed_mm_s": ("forward speed of the head" if mine == "flagellated" else speed, "mm/s", ".5f"),
        "displacement_mm": ("displacement of the centre of mass", "mm", ".5f"),
        "path_mm": ("its way, there and back", "mm", ".5f"),
        "bending_strain": ("largest bending strain", "1", ".2e"),
        "work_mJ": ("work put in", "mJ", ".4g"),
        "dissipated_mJ": ("taken by drag, friction and contact", "mJ", ".4g"),
        "stored_mJ": ("change of elastic and kinetic energy", "mJ", ".4g"),
        "energy_gap": ("missing in this balance", "1", ".1e"),
        "head_rpm": ("head", "rpm", ".3f"),
        "tail_rpm": ("tails", "rpm", ".3f"),
        "efficiency": ("efficiency", "1", ".5f"),
        "drift": ("drift of the speed", "1", ".1e"),
        "newton_iterations_per_step": ("Newton iterations per step", "1", ".3f"),
        "realtime_factor": ("times faster than real time", "1", ".1f"),
    }
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column(justify="right")
    table.add_column(style="dim")
    for key, (label, unit, style) in rows.items():
        value = summary.get(key)
        if value is not None and value == value:
            table.add_row(label, format(value, style), "" if unit == "1" else unit)
    # what the metrics of a plug-in's robot add
    known = {*rows, *KEYS}
    for key, value in summary.items():
        if key not in known and isinstance(value, int | float | str):
            table.add_row(key, str(value), "")
    steady = {True: "yes", False: "no", None: "not measured"}[summary.get("converged")]
    table.add_row("steady state", steady, "")
    console = Console()
    console.print(table)
    if summary.get("note"):
        console.print(summary["note"], style="yellow", highlight=False)
    files = summary["files"]
    print(f"written: {', '.join(files.values())}\nlook at it: rodnet view {files['rerun']}")
