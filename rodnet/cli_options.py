"""Arguments and options that the commands about recordings share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

CasePath = Annotated[Path, typer.Argument(help="The case, a Python file.")]
Recordings = Annotated[
    list[str], typer.Option(help="Recordings, folders, or patterns in quotes; more may follow.")
]
More = Annotated[list[str] | None, typer.Argument(metavar="[PATH]...", help="More recordings.")]
Modes = Annotated[int, typer.Option(help="Modes of initial positions and velocities.")]
Workers = Annotated[
    int | None, typer.Option(help="Processes (default: the cores at hand); 0 computes in this one.")
]
Progress = Annotated[bool, typer.Option(help="Show progress on standard error.")]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, as the last line of standard output.")
]
