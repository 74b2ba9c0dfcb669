"""Events: zero crossings that a run takes note of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from rodnet.observer import Observer


@dataclass(frozen=True)
class Event:
    """A zero crossing to watch for.

    Parameters
    ----------
    function : callable
        ``function(state)`` of an `Observer`; the event happens where it changes sign.
    name : str
        Name in ``traj.events``.
    terminal : bool
        Whether the run stops there.
    direction : {-1, 0, 1}
        Only falling, any, or only rising crossings.
    """

    function: Callable[[Observer], float]
    name: str = "event"
    terminal: bool = False
    direction: int = 0


@dataclass
class Watch:
    """An event, its last value, and the times at which it happened [s]."""

    event: Event
    value: float
    times: list[float] = field(default_factory=list)

    def see(self, before: float, view: Observer) -> bool:
        """Take note of a crossing in the last step; True if the run must stop."""
        value = float(self.event.function(view))
        old, self.value = self.value, value
        crossed = (old < 0.0 <= value and self.event.direction >= 0) or (
            old > 0.0 >= value and self.event.direction <= 0
        )
        if crossed:
            self.times.append(before + (view.t - before) * old / (old - value))
        return crossed and self.event.terminal
