"""How times are taken and compared.

Contenders take turns, A B C, C B A, A B C, so that a drift of the machine's speed meets them all alike,
and ratios are formed within a round. Times are of the processor, which other processes disturb
least; that the clock on the wall agrees (`disturbance`) is stated with every result.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

Work = Callable[[], Any]
Spread = dict[str, float]


class Clock:
    """Processor and wall time of everything that was measured through it."""

    def __init__(self) -> None:
        self.processor = self.wall = 0.0

    def time(self, work: Work) -> float:
        """Processor time of a call [s]."""
        wall, start = time.perf_counter(), time.process_time()
        work()
        elapsed = time.process_time() - start
        self.processor += elapsed
        self.wall += time.perf_counter() - wall
        return elapsed

    @property
    def disturbance(self) -> float:
        """Wall time over processor time: 1 on a quiet machine."""
        return self.wall / self.processor if self.processor else 1.0


@dataclass
class Rounds:
    """What a contender did: times [s], and what its work returned, one of each per round."""

    seconds: list[float] = field(default_factory=list)
    returned: list[Any] = field(default_factory=list)

    def per(self, units: float | Callable[[Any], float]) -> list[float]:
        """Time per unit of work in each round [s], the units fixed or a function of what the work returned."""
        count = units if callable(units) else lambda _: units
        return [t / count(value) for t, value in zip(self.seconds, self.returned, strict=True)]


def interleave(contenders: Mapping[str, Callable[[], Work]], repeats: int, clock: Clock) -> dict[str, Rounds]:
    """Let contenders take turns.

    Parameters
    ----------
    contenders : mapping of str to callable
        Each prepares a fresh start, which is not timed, and returns the work, which is.
    repeats : int
        Number of rounds, after one that does not count (it compiles, and warms caches).
    """
    rounds = {name: Rounds() for name in contenders}
    for prepare in contenders.values():
        prepare()()
    names = list(contenders)
    for k in range(repeats):
        for name in names if k % 2 == 0 else names[::-1]:
            work = contenders[name]()
            returned: list[Any] = []
            rounds[name].seconds.append(clock.time(lambda: returned.append(work())))  # noqa: B023
            rounds[name].returned += returned
    return rounds


def best_loop(work: Work, clock: Clock, at_least: float = 5e-3, rounds: int = 5) -> float:
    """Time of one short call [s]: the median over rounds of as many calls as take long enough."""
    work()
    count, elapsed = 1, clock.time(work)
    while elapsed < at_least:
        count = max(2 * count, int(1.2 * count * at_least / max(elapsed, 1e-7)))
        elapsed = clock.time(lambda: _repeat(work, count))  # noqa: B023
    samples = [clock.time(lambda: _repeat(work, count)) / count for _ in range(rounds)]
    return statistics.median(samples)


def _repeat(work: Work, count: int) -> None:
    for _ in range(count):
        work()


def spread(values: list[float], scale: float = 1.0) -> Spread:
    """Median, least and largest, each times ``scale``."""
    return {
        "median": scale * statistics.median(values),
        "min": scale * min(values),
        "max": scale * max(values),
    }


def ratio(over: list[float], under: list[float]) -> Spread:
    """Spread of the ratios, formed round by round."""
    return spread([a / b for a, b in zip(over, under, strict=True)])
