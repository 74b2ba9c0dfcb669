"""Names of degrees of freedom for people: which node, edge, wall, joint or body it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rodnet.solve.joint_frames import JointFrames
    from rodnet.solve.model import Ghost, Model


def dof_name(model: Model, dof: int) -> str:
    """Name of a degree of freedom, by rod."""
    graph = model.graph
    if dof >= model.turn0:
        k, axis = divmod(dof - model.turn0, 3)
        return f"the rotation about {'xyz'[axis]} of the body '{graph.bodies[k].name}'"
    if dof < model.twist0:
        node = dof // 3
        if node < graph.node_count:
            return f"{'xyz'[dof % 3]} of {graph.node_name(node)}"
        for body, *hidden in zip(graph.bodies, model.mass_nodes, model.centre_nodes, strict=True):
            if node in np.append(*hidden):
                return f"the mass of the body '{body.name}'"
        return _ghost_name(model, lambda g: g.node == node, lambda j: node in j.nodes)
    edge = dof - model.twist0
    if edge < graph.edge_count:
        return f"the twist of {graph.edge_name(edge)}"
    return _ghost_name(model, lambda g: g.edge == edge, lambda j: edge in j.edges)


def _ghost_name(
    model: Model, of_wall: Callable[[Ghost], bool], of_joint: Callable[[JointFrames], bool]
) -> str:
    for ghost in filter(of_wall, model.ghosts):
        return f"the wall at {model.graph.node_name(ghost.root)}"
    found = next(filter(of_joint, model.joints)).joint
    return f"the {found.kind} joint at {found.at}"
