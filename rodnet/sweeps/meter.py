"""How far a sweep is, and how long it will still take."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

EVERY = 10.0  # seconds between lines where no bar can be drawn


@dataclass(frozen=True)
class SweepProgress:
    """How far a sweep is.

    Attributes
    ----------
    total, done, failed : int
        All points; those that are done, earlier runs and failures included; failures.
    computed : int
        Points done since this call began.
    elapsed, left : float
        Time since this call began, and an estimate of the time left [s]; NaN before the first point.
    """

    total: int
    done: int
    failed: int
    computed: int
    elapsed: float
    left: float

    def __str__(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        left = (
            f", about {duration(self.left)} left" if self.left == self.left and self.done < self.total else ""
        )
        return f"{self.done} of {self.total} robots{failed}, {duration(self.elapsed)}{left}"


class Meter:
    """Counts points and tells.

    Parameters
    ----------
    total, done, failed : int
        As in `SweepProgress`, at the beginning.
    show : bool or callable
        Whether to show a bar on standard error; or what takes a `SweepProgress` after every point.
    """

    def __init__(
        self, total: int, done: int, failed: int, show: bool | Callable[[SweepProgress], None]
    ) -> None:
        self.total, self.done, self.failed, self.computed = total, done, failed, 0
        self._begun = self._told = time.perf_counter()
        self._call = show if callable(show) else None
        self._bar: Any = None
        self._lines = False
        if show is True and total > done:
            self._lines = not sys.stderr.isatty()
            if not self._lines:
                from rich.console import Console
                from rich.progress import BarColumn, Progress, TextColumn

                self._bar = Progress(
                    BarColumn(), TextColumn("{task.description}"), console=Console(stderr=True)
                )
                self._task = self._bar.add_task(str(self.progress()), total=total, completed=done)
                self._bar.start()

    def __enter__(self) -> Meter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def progress(self) -> SweepProgress:
        """Return how far it is."""
        elapsed = time.perf_counter() - self._begun
        # points take their time one beside the other: what counts is how many end per second
        left = elapsed / self.computed * (self.total - self.done) if self.computed else float("nan")
        return SweepProgress(self.total, self.done, self.failed, self.computed, elapsed, left)

    def count(self, failed: bool) -> None:
        """Count a point."""
        self.done += 1
        self.computed += 1
        self.failed += failed
        if self._call is not None:
            self._call(self.progress())
        self.tick()

    def tick(self) -> None:
        """Show the time."""
        if self._bar is not None:
            self._bar.update(self._task, description=str(self.progress()), completed=self.done)
        elif self._lines and (time.perf_counter() - self._told > EVERY or self.done == self.total):
            self._told = time.perf_counter()
            print(self.progress(), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()


def duration(seconds: float) -> str:
    """Return a duration for people: 12 s, 3 min 20 s, 2 h 05 min."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds) // 60
    return (
        f"{minutes} min {round(seconds) % 60:02d} s"
        if minutes < 60
        else f"{minutes // 60} h {minutes % 60:02d} min"
    )
