"""Hypothesis strategies: random robots and random states, for property tests.

Import it as ``rodnet.testing.strategies``; it needs ``pip install hypothesis``. What decides the
kind of robot (rods, joints, loops) is drawn by hypothesis and shrinks; the numbers come from a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from hypothesis import strategies as st

from rodnet.robot import Robot
from rodnet.terms.base import Term
from rodnet.testing.figures import Sketch, random_sketch
from rodnet.testing.states import Probe


def generators() -> st.SearchStrategy[np.random.Generator]:
    """NumPy random generators, each from a seed of its own."""
    return st.integers(0, 2**32 - 1).map(np.random.default_rng)


@st.composite
def sketches(
    draw: Any,
    *,
    rods: tuple[int, int] = (1, 6),
    edges: int = 4,
    loops: int = 2,
    rings: bool = True,
    stiff: bool = True,
    hubs: bool = True,
) -> Sketch:
    """Random robots, not drawn yet: trees and loops, joints of 2 to 6 edges with hubs and without.

    Rods are curved and uneven, of different sections (circular, elliptic, hollow) and materials, some
    drawn towards their joint; some parts are stiff; a separate ring may lie in the same graph.

    Parameters
    ----------
    rods : (int, int)
        Smallest and largest number of rods, without those that close loops.
    edges : int
        Largest number of edges of a rod.
    loops : int
        Largest number of rods that close loops; 0 for trees.
    rings, stiff, hubs : bool
        Whether there may be rings (never with ``loops=0``), stiff parts, declared hubs.
    """
    flag = st.booleans()
    return random_sketch(
        np.random.default_rng([1, draw(st.integers(0, 2**32 - 1))]),  # unlike those of `generators`
        rods=draw(st.integers(*rods)),
        edges=draw(st.integers(1, edges)),
        degree=draw(st.integers(2, 6)),
        loops=draw(st.integers(0, loops)),
        ring=rings and loops > 0 and draw(flag),
        stiff=stiff and draw(flag),
        hubs=hubs and draw(flag),
        joints=draw(st.sampled_from(["star", "anywhere"])),
    )


@st.composite
def robots(draw: Any, terms: Callable[[], Sequence[Term]], **kinds: Any) -> Robot:
    """Random robots with the given terms; ``kinds`` as in `sketches`."""
    return Robot(draw(sketches(**kinds)).draw().graph, terms())


@st.composite
def probes(draw: Any, terms: Callable[[], Sequence[Term]], **kinds: Any) -> Probe:
    """Random robots in random states far from rest, as functions of their state.

    Springs turn by up to 150 degrees from their natural shape, edges are 0.3 to 3 times as long as
    theirs, and every edge has turned by up to 150 degrees from its last accepted frame.
    """
    return Probe(draw(robots(terms, **kinds)), draw(generators()))
