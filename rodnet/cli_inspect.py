"""The command ``rodnet inspect``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer


def inspect(
    data: Annotated[
        list[str], typer.Argument(help="Recordings (.npz, .csv, .nc, .c3d), folders, or patterns in quotes.")
    ],
    units: Annotated[str | None, typer.Option(help="Unit of the positions: m, cm, mm, um.")] = None,
    out: Annotated[Path | None, typer.Option(help="Page to write (HTML), with figures.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, as the last line of standard output.")
    ] = False,
) -> None:
    """Say what is in recordings: channels, rate, gaps, noise, rest, constancy of edges.

    In Python, rodnet.inspect returns the same.
    """
    import numpy as np

    import rodnet as rn
    from rodnet.numbers import plain
    from rodnet.report.page import shown

    found = rn.inspect(rn.read_recordings(data, units))
    page = found.save(out) if out is not None else None
    if as_json:
        print(json.dumps(plain(found.to_dict()), allow_nan=False), flush=True)
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    columns = {
        "name": "name", "frames": "frames", "rate_hz": "Hz", "lost": "lost", "suspect": "suspect",
        "longest_gap_s": "gap (s)", "starts_at_rest": "rests", "start_speed": "start (m/s)",
        "breathing_mm": "breathing (mm)",
    }  # fmt: skip
    for title in columns.values():
        table.add_column(title, justify="left" if title == "name" else "right")
    for file in found.files:
        table.add_row(*(shown(file[key]) for key in columns))
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 1000)
    console.print(table)
    first = found.recordings[0]
    print(repr(first))
    if found.noise is not None:
        model = found.noise.model
        white, slow = 1e3 * np.median(model.white), 1e3 * np.median(model.slow)
        print(f"noise of a coordinate: white {white:.3f} mm; slow {slow:.2f} mm over {model.time:.2g} s; "
              f"common {1e3 * model.common:.2f} mm; effective frames {found.noise.effective:.0f}")  # fmt: skip
        for note in found.noise.notes:
            print(f"note: {note}")
    for remark in found.remarks:
        print(f"look: {remark}")
    if page is not None:
        print(f"written: {page}")
