"""Progress bars (rich), only where asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def meter(show: bool, label: str = "simulating", done: float = 0.0) -> Iterator[Callable[[float], None]]:
    """Give a function that takes the fraction done, and show it with the time left on standard error.

    ``done`` was there before: the estimate is made from the rest alone.
    """
    if not show:
        yield lambda fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=1.0)
        bar.update(task, completed=done)
        yield lambda fraction: bar.update(task, completed=fraction)
