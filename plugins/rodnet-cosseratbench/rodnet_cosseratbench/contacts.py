"""Contact terms of a scenario: obstacles, rods with each other and with themselves."""

from __future__ import annotations

import numpy as np
from cosseratbench.scenario import Scenario

import rodnet as rn
from rodnet.graph.rod_graph import RodGraph


def contact_terms(scenario: Scenario, graph: RodGraph) -> list[rn.Term]:
    """Contact terms of a scenario."""
    return []
