"""Other codes, one adapter each, behind one small interface; what is not installed says so.

An adapter module has ``LABEL``, ``PACKAGE`` (its name on PyPI), ``SIZES`` (numbers of edges of the
cantilever that it is timed at) and ``Cantilever(edges, ...)``, a `Falling` rod. All of them clamp
whole edges: the first of ``edges`` edges is held and straddles the wall, so that the free length
begins in its middle and all codes approximate the same rod to second order.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Protocol

import numpy as np

# why none of them runs the paper's robot
REASONS_SWIMMER = {
    "PyElastica": "no motor at a joint of several stiff rods and no such drag; explicit steps would have to "
    "resolve the stiff parts",
    "dismech-newton": "unbranched chains only",
    "MuJoCo cable": "no drag along a cable",
}


class Falling(Protocol):
    """A falling cantilever in some code.

    Attributes
    ----------
    dt : float
        Time step [s]; for explicit codes close to the largest stable one.
    """

    dt: float

    def advance(self, duration: float) -> int:
        """Run on for so long; return the number of steps."""
        ...

    def tip(self) -> np.ndarray:
        """Position of the free end [m], shape (3,)."""
        ...


def first_edge(edges: int, length: float) -> tuple[float, float]:
    """Where the held first edge starts, and the length of all edges together [m]."""
    size = length / (edges - 0.5)
    return -0.5 * size, edges * size


def load(names: tuple[str, ...]) -> tuple[list[ModuleType], dict[str, str]]:
    """Adapters that can be used, and for the others why not."""
    found, missing = [], {}
    for name in names:
        adapter = importlib.import_module(f"benchmarks.rivals.{name}")
        try:
            adapter.check()
        except Exception as error:  # a rival's import can fail in any way
            missing[adapter.LABEL] = (
                "not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be imported: {error}"
            )
        else:
            found.append(adapter)
    return found, missing
