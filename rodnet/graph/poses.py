"""Another initial position of a graph: how its edges' directors and its joints go along.

Positions do not tell how edges turn about themselves. Within a piece that no joint divides, directors are
carried along by parallel transport, edge by edge. What turns at a joint first goes with the piece that it
turns against, as one rigid body: about the axis of a hinge, otherwise by the smallest rotation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rodnet.kinematics.frames import material_frames, transport, unit

if TYPE_CHECKING:
    from rodnet.graph.joint_specs import Joint
    from rodnet.graph.rod_graph import RodGraph

ALONG = (
    0.05  # sine of the angle between a hinge's axis and an edge below which the edge does not show its turn
)


def carried_directors(graph: RodGraph, x0: np.ndarray) -> np.ndarray:
    """First directors of a graph's edges in another position, shape (E, 3)."""
    i, j = graph.edges.T
    old, new = unit(graph.x0[j] - graph.x0[i]), unit(x0[j] - x0[i])
    drawn, piece = material_frames(old, graph.d1, np.zeros(len(old))), _pieces(graph)
    d1 = _carried(graph.d1, old, new)
    done = np.zeros(graph.edge_count, dtype=bool)
    for root in range(piece.max() + 1):
        if done[piece == root].any():
            continue
        done |= piece == root
        pending = [root]
        while pending:
            here = pending.pop(0)
            for joint, stator, rotor in _around(graph, piece, here):
                if done[rotor]:
                    continue
                mine, t = piece == piece[rotor], new[stator : stator + 1]
                turned = material_frames(t, d1[stator : stator + 1], np.zeros(1))[0] @ drawn[stator].T
                R = _turn(joint, turned, old[rotor], new[rotor], *_farthest(graph, x0, joint, mine))
                d1[mine] = _carried(graph.d1[mine] @ R.T, old[mine] @ R.T, new[mine])
                done |= mine
                pending.append(int(piece[rotor]))
    return d1


def _pieces(graph: RodGraph) -> np.ndarray:
    """Number of the piece that each edge belongs to: what springs, bodies of joints and rigid bodies join."""
    pairs = [(graph.springs.edge1, graph.springs.edge2)]
    groups = [body for joint in graph.joints for body in joint.bodies] + [body.edges for body in graph.bodies]
    pairs += [(group[:-1], group[1:]) for group in groups]
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    links = coo_matrix((np.ones(len(first)), (first, second)), shape=(graph.edge_count,) * 2)
    return connected_components(links, directed=False)[1]


def _around(graph: RodGraph, piece: np.ndarray, here: int) -> list[tuple[Joint, int, int]]:
    """Joints of a piece with others: the joint, an edge of the piece there, and one of another piece."""
    found = []
    for joint in graph.joints:
        edges = [int(body[0]) for body in joint.bodies]
        found += [(joint, a, b) for a in edges for b in edges if piece[a] == here != piece[b]]
    return found


def _turn(
    joint: Joint, turned: np.ndarray, old: np.ndarray, new: np.ndarray, arm: np.ndarray, arm_new: np.ndarray
) -> np.ndarray:
    """Rotation (3, 3) of a piece that turns at a joint, from the rotation of the piece that it turns against.

    What shows it are its edge at the joint, with a hinge's axis, or if they are parallel, the arm to a node.
    """
    axis = joint.frames[0][:, 2]
    if joint.kind == "hinge" and min(_sine(axis, old), _sine(turned @ axis, new)) > ALONG:
        return _basis(new, turned @ axis) @ _basis(old, axis).T
    if joint.kind == "hinge" and min(_sine(axis, arm), _sine(turned @ axis, arm_new)) > ALONG:
        return _basis(turned @ axis, arm_new) @ _basis(axis, arm).T
    return _carried(turned.T, np.tile(turned @ old, (3, 1)), np.tile(new, (3, 1))).T


def _farthest(
    graph: RodGraph, x0: np.ndarray, joint: Joint, mine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions from a joint to the node of a piece that is farthest from the joint's axis, before and after."""
    nodes = np.setdiff1d(graph.edges[mine], joint.node)
    arms = graph.x0[nodes] - graph.x0[joint.node]
    k = int(np.argmax(np.linalg.norm(np.cross(arms, joint.frames[0][:, 2]), axis=1)))
    return unit(arms[k]), unit(x0[nodes[k]] - x0[joint.node])


def _sine(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(a, b)))


def _basis(t: np.ndarray, a: np.ndarray) -> np.ndarray:
    n = unit(np.cross(t, a))
    return np.stack([t, n, np.cross(t, n)], axis=1)


def _carried(d: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Transport of vectors from old to new tangents, (n, 3) each; half a turn is one about the vector itself."""
    back = np.sum(old * new, axis=1) < -1.0 + 1e-12
    return np.where(back[:, None], d, transport(d, old, new))
