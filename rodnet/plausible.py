"""Sizes and materials that are more likely in other units than meant: told as a warning, never refused."""

from __future__ import annotations

import warnings

import numpy as np

from rodnet.errors import PlausibilityWarning
from rodnet.graph.rod_graph import RodGraph

THICK = 0.25  # radius of a rod [m]; one of 1 mm, given in mm, is 1
SOFT = 50.0  # Young's modulus [Pa]; the softest gels have some hundreds
LIGHT = 10.0  # density [kg/m^3]; water in g/cm^3 is 1


def doubts(graph: RodGraph) -> list[str]:
    """Return what looks like a mistake in the units of a robot, a sentence each.

    Parameters
    ----------
    graph : RodGraph
        The robot's rods.
    """
    found = []
    for rod in graph.rods.values():
        if rod.material is None:
            continue
        spec, r = graph.figure.specs[rod.name], float(np.median(graph.radius[rod.edges]))
        length, E, rho = rod.length / len(rod.edges), *(float(np.min(spec.property(k))) for k in ("E", "rho"))
        if r > THICK:
            found.append(
                f"the radius of '{rod.name}' is {r:.3g} m; if lengths are in millimetres, multiply by 1e-3"
            )
        elif length < r:
            found.append(
                f"the edges of '{rod.name}' are {length:.3g} m long and its radius is {r:.3g} m, so that an edge is no "
                "rod: check the units of both (m), or use fewer edges"
            )
        if E < SOFT:
            found.append(f"Young's modulus of '{rod.name}' is {E:.3g} Pa; if it is in MPa, multiply by 1e6")
        if rho < LIGHT:
            found.append(
                f"the density of '{rod.name}' is {rho:.3g} kg/m^3; if it is in g/cm^3, multiply by 1e3"
            )
    return found


def warn_of_units(graph: RodGraph, level: int = 3) -> None:
    """Warn of units that do not seem to be meant; of the first few rods, if it is many."""
    found = doubts(graph)
    if found:
        more = f" (and {len(found) - 2} more)" if len(found) > 2 else ""
        warnings.warn("; ".join(found[:2]) + more, PlausibilityWarning, stacklevel=level + 1)
