"""Arguments and options that the commands about recordings share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

CasePath = Annotated[Path, typer.Argument(help="The case, a Python file.")]
Recordings = Annotated[
    list[str], typer.Option(help="Recordings, folders, or patterns in quotes; one or more.")
]
Modes = Annotated[int, typer.Option(help="Modes of initial positions and velocities, in each trial.")]
Workers = Annotated[
    int | None, typer.Option(help="Processes (default: the cores at hand); 0 computes in this one.")
]
Progress = Annotated[bool, typer.Option(help="Show progress on standard error.")]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, as the last line of standard output.")
]


class ManyValues(TyperCommand):
    """A command whose options that may be repeated take several values at once, as shells expand patterns."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat such an option before each of its values; the case, a Python file, is none of them."""
        repeated = {name for p in self.params if getattr(p, "multiple", False) for name in p.opts}
        spread: list[str] = []
        option, count = None, 0
        for value in args:
            if value.startswith("-"):
                option, count = (value if value in repeated else None), 0
            elif option is not None:
                if value.endswith(".py"):
                    option = None
                elif count:
                    spread.append(option)
                count += 1
            spread.append(value)
        return super().parse_args(ctx, spread)
