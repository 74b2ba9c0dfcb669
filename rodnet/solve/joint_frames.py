"""The frames that joints carry, as ghost edges of a model, and the springs that hold and turn them.

A body of a joint is an edge without mass from the joint's node to a ghost node. The bodies of a hinge share
the ghost node, hence the direction, the axis, and differ in their twist only; those of an elastic joint
have a ghost node each (docs, theory: springs and joints).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.joints import Springs
from rodnet.kinematics.frames import about_z

if TYPE_CHECKING:
    from rodnet.graph.joint_specs import Joint
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.solve.model import Model


class JointFrames(NamedTuple):
    """One joint in a model.

    Attributes
    ----------
    joint : Joint
        The joint of the graph.
    edges : ndarray of int
        Ghost edge of each body.
    nodes : ndarray of int
        Ghost node of each body, the same for all bodies of a hinge.
    axial : float
        Axial stiffness of the ghost edges [N]: they carry no force, so any will keep their length.
    """

    joint: Joint
    edges: np.ndarray
    nodes: np.ndarray
    axial: float


class GhostParts(NamedTuple):
    """What joints add to a model: positions, edges, frames and twist angles of ghosts, and springs."""

    frames: list[JointFrames]
    x: np.ndarray
    edges: np.ndarray
    directions: np.ndarray
    theta: np.ndarray
    springs: list[Springs]
    laws: list[tuple[JointFrames, int]]  # of the joints' own springs, which come last: joint and turning body


def joint_ghosts(graph: RodGraph, pivots: list[Joint], ghosts: int, walls: list[int]) -> GhostParts:
    """Lay out the ghosts of a graph's joints and of hinges that are held.

    Parameters
    ----------
    graph : RodGraph
        With its joints.
    pivots : list of Joint
        Hinges whose first body is held by a constraint.
    ghosts, walls : int, list of int
        Number of the ghost nodes and edges of walls, which come first, and the walls' nodes.
    """
    frames: list[JointFrames] = []
    x, edges, directions, theta, held, own = [], [], [], [np.zeros(0)], [], []
    laws: list[tuple[JointFrames, int]] = []
    node, edge = graph.node_count + ghosts, graph.edge_count + ghosts
    for wall in walls:
        if wall in graph.balls:
            raise GraphError(_clamped("ball", graph.balls[wall]))
    taken = set(graph.balls)
    for joint in (*graph.joints, *pivots):
        if joint.node in taken:
            raise GraphError(
                f"there are two joints at '{joint.at}', one of them of a constraint; draw a short stiff edge between "
                "two nodes, fig.rigid(...), and give each its own"
            )
        taken.add(joint.node)
        if joint.node in walls:
            raise GraphError(_clamped(joint.kind, joint.at))
        count = len(joint.bodies)
        shared = joint.kind == "hinge"
        mine = JointFrames(
            joint,
            np.arange(edge, edge + count),
            np.full(count, node) if shared else np.arange(node, node + count),
            float(np.max(1.0 / joint.attachments.compliance)) / joint.arm,
        )
        ghosts = 1 if shared else count
        x += [graph.x0[joint.node] + joint.arm * frame[:, 2] for frame in joint.frames[:ghosts]]
        edges += [(joint.node, int(n)) for n in mine.nodes]
        # the bodies of a hinge share a director, against which each has turned
        directions += [joint.frames[0]] * count if shared else list(joint.frames)
        theta.append(joint.turns if shared else np.zeros(count))
        held.append(_holding(mine))
        if joint.sprung:
            own.append(_turning(mine))
            laws += [(mine, k) for k in range(1, count)]
        frames.append(mine)
        node, edge = node + ghosts, edge + count
    return GhostParts(
        frames,
        np.array(x).reshape(-1, 3),
        np.array(edges, dtype=np.int64).reshape(-1, 2),
        np.array(directions).reshape(-1, 3, 3),
        np.concatenate(theta),
        held + own,
        laws,
    )


def _clamped(kind: str, at: str) -> str:
    return (
        f"the {kind} joint at '{at}' is clamped: a wall would take its place. Clamp an edge ('rod:0-1') that ends "
        "there, or hold the position alone with rodnet.Hinge"
    )


def _holding(mine: JointFrames) -> Springs:
    """Springs of the half edges that join edges to the frames of their bodies."""
    a, node = mine.joint.attachments, mine.joint.node
    n = len(a.edge)
    rigid = np.zeros((n, 3))
    return Springs(
        mine.edges[a.body], a.edge, np.full(n, node), -np.ones(n), a.sign, a.Q1, a.Q2, rigid, a.compliance,
        np.ones(n), a.length,
    )  # fmt: skip


def _turning(mine: JointFrames) -> Springs:
    """Springs between the first body's frame and each of the others'."""
    joint, n = mine.joint, len(mine.edges) - 1
    Q1 = np.tile(np.eye(3), (n, 1, 1))
    Q2 = np.tile(about_z(np.array(-joint.angle)), (n, 1, 1))
    # half of the compliance to either side: what a motor asks, and the law of the joint does not
    k = np.where(joint.stiffness > 0.0, joint.stiffness, joint.stiffness.max())
    half = np.tile(0.5 / k, (n, 1))
    return Springs(
        np.full(n, mine.edges[0]), mine.edges[1:], np.full(n, joint.node), -np.ones(n), np.ones(n),
        Q1, Q2, half, half.copy(), np.ones(n), np.full(n, joint.arm),
    )  # fmt: skip


def find_motor(
    laws: list[tuple[JointFrames, int]], first: int, node: int, pair: Any
) -> tuple[int, float] | None:
    """Spring of a hinge that a motor drives, and +1 if its second body is the rotor, else -1.

    Parameters
    ----------
    laws : list
        The joints' own springs.
    first : int
        Number of the first of them among the model's springs.
    node : int
        Where the motor is, -1 if it says between which edges.
    pair : (int, int) or None
        Stator and rotor edge.
    """
    for k, (frames, body) in enumerate(laws):
        joint = frames.joint
        if joint.kind != "hinge":
            continue
        if pair is None and joint.node == node:
            return first + k, 1.0
        if pair is not None:
            bodies = joint.bodies[0], joint.bodies[body]
            for sign, (stator, rotor) in ((1.0, pair), (-1.0, pair[::-1])):
                if stator in bodies[0] and rotor in bodies[1]:
                    return first + k, sign
    return None


def initial_twists(model: Model) -> np.ndarray:
    """Initial twists of a model's springs up to whole turns [rad]; those of hinges count them."""
    tau = np.zeros(model.spring_count)
    for s, (frames, body) in enumerate(model.joint_laws, start=model.first_law):
        if frames.joint.kind == "hinge":
            tau[s] = frames.joint.turns[body] - frames.joint.angle - model.driven[s]
    return tau


def hinge_angles(model: Model, at: str, q: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Angles of the bodies of a hinge against its first one [rad], over leading axes of ``q`` and ``turns``."""
    node = model.graph.node(at)
    found = [frames for frames in model.joints if frames.joint.node == node]
    if not found or found[0].joint.kind != "hinge":
        kind = f"the joint at '{at}' is {found[0].joint.kind}" if found else f"there is no joint at '{at}'"
        raise GraphError(f"{kind}: only a hinge has an angle; declare one with fig.joint(..., kind='hinge')")
    edges = found[0].edges
    theta = q[..., model.twist0 + edges] + 2.0 * np.pi * turns[..., edges]
    angles = theta[..., 1:] - theta[..., :1]
    return angles[..., 0] if angles.shape[-1] == 1 else angles
