"""The cases: each module has a ``TITLE`` and ``measure(options) -> Result``.

A result is plain data: what it holds goes into the JSON file as it is, and tables, the page in the
documentation and the figures are all made from that file.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import asdict, dataclass, field
from typing import Any

from benchmarks.timing import Clock

# in the order in which they are run and shown
NAMES = (
    "cantilever", "accuracy", "swimmer", "iteration", "laws", "sensitivities", "scaling", "grid", "startup", "sweep",
    "diagnosis", "drafted",
)  # fmt: skip


@dataclass
class Options:
    """How much to measure.

    Attributes
    ----------
    quick : bool
        Small sizes and few repeats: to see that everything works.
    rivals : tuple of str
        Rivals to run, by module name in `benchmarks.rivals`.
    clock : Clock
        Where times are taken.
    """

    quick: bool = False
    rivals: tuple[str, ...] = ("pyelastica", "dismech", "mujoco_cable")
    clock: Clock = field(default_factory=Clock)

    @property
    def repeats(self) -> int:
        """Rounds of `benchmarks.timing.interleave`."""
        return 3 if self.quick else 7


@dataclass
class Table:
    """Rows under columns; a cell is a text, a number, None, or a spread (median, min, max)."""

    title: str
    columns: list[str]
    rows: list[list[Any]] = field(default_factory=list)


@dataclass
class Demand:
    """What was asked for, and what was measured; ``least`` says that larger is better."""

    what: str
    limit: float
    value: float | None
    unit: str = ""
    least: bool = False

    @property
    def met(self) -> bool:
        """Whether the measured value is good enough."""
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.least else self.value <= self.limit


@dataclass
class Result:
    """Everything that a case has measured."""

    title: str
    text: str
    tables: list[Table] = field(default_factory=list)
    demands: list[Demand] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """The result as JSON knows it."""
        out = asdict(self)
        for entry, demand in zip(out["demands"], self.demands, strict=True):
            entry["met"] = demand.met
        return out


def measure(name: str, options: Options) -> Result:
    """Run one case by name."""
    return importlib.import_module(f"benchmarks.cases.{name}").measure(options)
