"""How long a search for further effects goes on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

MINUTES = 15.0  # of a whole diagnosis
CLOSING = 0.25  # of these, for what comes after the search


@dataclass(frozen=True)
class Patience:
    """The time that a diagnosis may take. What is begun is finished; what would take longer is not begun.

    A time step or a mesh is refined where what then is to come can be done, too.

    Attributes
    ----------
    spent : callable
        How long it has taken so far [s], earlier runs that it goes on from included.
    minutes : float
        How long it may take [min].
    rest : callable
        How long what is to come takes at least, at the present pace [s].
    """

    spent: Callable[[], float] = lambda: 0.0
    minutes: float = math.inf
    rest: Callable[[], float] = lambda: 0.0

    def allows(self, seconds: float = 0.0) -> bool:
        """Whether what takes so long [s] may still be begun."""
        return self.spent() + seconds <= 60.0 * (1.0 - CLOSING) * self.minutes


ENDLESS = Patience()
