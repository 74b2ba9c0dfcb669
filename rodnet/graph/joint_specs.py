"""Joints that turn: what the user says of one, checked, and what the graph keeps of it.

A joint has *bodies*, groups of edges that turn as one, and frames that the bodies carry (docs, theory:
springs and joints). Every edge meets the frame of its body through its own half edge.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.graph.joints import FLIP
from rodnet.kinematics.frames import any_normal, material_frames, transport, unit

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.graph.rod_spec import RodSpec

STIFFEST = 1e6  # of a joint's stiffness against the half edges there; Newton's method loses as many digits
TILT = np.radians(15.0)  # more of a hinge's axis from its bodies' mean is no pose of a hinge
KINDS = ("weld", "rigid", "hinge", "ball", "elastic")


@dataclass(frozen=True)
class JointSpec:
    """What the user said of one joint that is not a plain weld.

    Attributes
    ----------
    at : str
        The node, as it was named.
    kind : {"rigid", "hinge", "ball", "elastic"}
        See `StickFigure.joint`.
    of : tuple of (str, int)
        The edges (rod, number) that turn against the rest; empty for all, each by itself.
    stiffness : ndarray, shape (3,)
        About the columns of ``frame`` [N m/rad].
    frame : ndarray, shape (3, 3)
        Axes of the joint as drawn; the third is the axis of a hinge.
    angle : float
        Angle at which a hinge is at rest, against what is drawn [rad].
    given : dict
        The arguments that all this was made of.
    """

    at: str
    kind: str
    of: tuple[tuple[str, int], ...]
    stiffness: np.ndarray
    frame: np.ndarray
    angle: float = 0.0
    given: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Attachments:
    """Half edges that join edges to the frames of their bodies, arrays of shape (n, ...).

    Attributes
    ----------
    body, edge : ndarray, shape (n,)
        Body and edge.
    sign : ndarray, shape (n,)
        +1 where the edge leaves the node.
    Q1, Q2 : ndarray, shape (n, 3, 3)
        Rotations from the body's and the edge's frame to the one that they share at rest.
    seat : ndarray, shape (n, 3, 3)
        Rotation from the edge's frame to the body's, as drawn.
    compliance : ndarray, shape (n, 3)
        Of the half edge about its m1, m2, t [rad/(N m)].
    length : ndarray, shape (n,)
        Half the edge's length [m].
    """

    body: np.ndarray
    edge: np.ndarray
    sign: np.ndarray
    Q1: np.ndarray
    Q2: np.ndarray
    seat: np.ndarray
    compliance: np.ndarray
    length: np.ndarray


@dataclass(frozen=True)
class Joint:
    """A joint of a `RodGraph` whose bodies carry frames.

    Attributes
    ----------
    at, kind, node : str, str, int
        The node, as it was named and by number, and the kind of joint.
    bodies : tuple of ndarray of int
        Edges by body; the first body is the one that the others turn against.
    attachments : Attachments
        How the edges meet the frames of their bodies.
    frames : ndarray, shape (n, 3, 3)
        Initial frames of the bodies, alike as drawn; the third column is the axis of a hinge.
    stiffness : ndarray, shape (3,)
        About the columns of the frames [N m/rad].
    angle : float
        Rest angle of a hinge against what is drawn [rad].
    arm : float
        Length of the edges that stand for the frames [m]; it has no influence.
    """

    at: str
    kind: str
    node: int
    bodies: tuple[np.ndarray, ...]
    attachments: Attachments
    frames: np.ndarray
    stiffness: np.ndarray
    angle: float
    arm: float

    @property
    def sprung(self) -> bool:
        """Whether the joint has a stiffness of its own."""
        return len(self.bodies) > 1 and bool(np.any(self.stiffness > 0.0))

    @property
    def turns(self) -> np.ndarray:
        """Initial angle of each body of a hinge against the first one [rad], shape (n,); zeros as drawn."""
        d1, d2 = self.frames[0, :, :2].T
        return np.arctan2(self.frames[:, :, 0] @ d2, self.frames[:, :, 0] @ d1)

    def posed(self, frames: np.ndarray) -> Joint:
        """Return the joint where the edges' frames are others: that of each body goes with its first edge."""
        a = self.attachments
        first = [int(np.flatnonzero(a.body == k)[0]) for k in range(len(self.bodies))]
        mine = frames[a.edge[first]] @ a.seat[first]
        if self.kind == "hinge":
            axis = unit(mine[:, :, 2].sum(axis=0))
            tilt = float(np.arccos(np.clip(mine[:, :, 2] @ axis, -1.0, 1.0)).max())
            if not tilt <= TILT:
                raise GraphError(
                    f"the positions tilt the axis of the hinge at '{self.at}' by {2.0 * np.degrees(tilt):.3g} degrees "
                    "from body to body: turn what is beyond it about its axis alone"
                )
            mine = np.stack([transport(mine[:, :, c], mine[:, :, 2], axis) for c in range(3)], axis=-1)
        return replace(self, frames=mine)


def joint_spec(
    at: str, kind: str, of: tuple[tuple[str, int], ...], axis: Any, stiffness: Any, axes: Any, angle: float
) -> JointSpec:
    """Check the arguments of `StickFigure.joint` for a joint that is not a weld with a hub."""
    if kind not in KINDS:
        raise GraphError(f"joint at '{at}': kind must be one of {', '.join(KINDS)}, not {kind!r}")
    allowed = {"hinge": {"axis", "stiffness", "angle"}, "elastic": {"axis", "axes", "stiffness"}}
    given = {"axis": axis, "axes": axes, "stiffness": stiffness, "angle": angle or None}
    for name, value in given.items():
        if value is not None and name not in allowed.get(kind, ()):
            raise GraphError(f"joint at '{at}': a joint of kind '{kind}' has no {name}")
    if kind == "rigid" and of:
        raise GraphError(f"joint at '{at}': in a rigid joint nothing turns; leave out of=")
    frame = np.eye(3) if kind in ("rigid", "ball") else _frame(at, kind, axis, axes, stiffness)
    k = _stiffness(at, kind, stiffness)
    if axis is not None and np.shape(stiffness) == (3,):
        raise GraphError(
            f"joint at '{at}': three stiffnesses need the three axes that they are about, axes=, not axis="
        )
    if not (np.isfinite(angle) and abs(angle) < np.pi):
        raise GraphError(f"joint at '{at}': angle = {angle!r} must be less than half a turn, pi [rad]")
    if angle and not k.any():
        raise GraphError(f"joint at '{at}': a hinge has a rest angle only if it has a stiffness")
    return JointSpec(at, kind, of, k, frame, float(angle), {**given, "angle": float(angle)})


def _frame(at: str, kind: str, axis: Any, axes: Any, stiffness: Any) -> np.ndarray:
    """Axes of the joint as columns."""
    if axes is not None:
        rows = np.asarray(axes, dtype=float)
        if axis is not None or rows.shape != (3, 3) or not np.all(np.isfinite(rows)):
            raise GraphError(f"joint at '{at}': axes must be three finite vectors (3, 3), and axis left out")
        if np.abs(rows @ rows.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rows) < 0.0:
            raise GraphError(f"joint at '{at}': axes must be three orthogonal unit vectors, right-handed")
        return rows.T.copy()
    if axis is None:
        if kind == "hinge" or np.size(stiffness) == 2:
            raise GraphError(f"joint at '{at}': say about which axis, axis=(x, y, z)")
        return np.eye(3)
    vector = np.asarray(axis, dtype=float)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)) or not np.linalg.norm(vector) > 0.0:
        raise GraphError(
            f"joint at '{at}': axis = {axis!r} must be a finite vector (x, y, z) that is not zero"
        )
    t = unit(vector)
    d1 = any_normal(t)
    return np.stack([d1, np.cross(t, d1), t], axis=1)


def _stiffness(at: str, kind: str, stiffness: Any) -> np.ndarray:
    """Stiffness about the three axes [N m/rad]."""
    if stiffness is None:
        if kind == "elastic":
            raise GraphError(f"joint at '{at}': an elastic joint needs its stiffness [N m/rad]")
        return np.zeros(3)
    try:
        k = np.asarray(stiffness, dtype=float)
    except (TypeError, ValueError):
        k = np.array(np.nan)
    shapes = ((), (2,), (3,)) if kind == "elastic" else ((),)
    if k.shape not in shapes or not np.all(np.isfinite(k)) or np.any(k < 0.0):
        forms = "one number, (bending, twist) or three about axes=" if kind == "elastic" else "one number"
        raise GraphError(
            f"joint at '{at}': stiffness = {stiffness!r} must be {forms}, finite and not negative [N m/rad]"
        )
    if kind == "elastic" and not k.any():
        raise GraphError(f"joint at '{at}': an elastic joint without stiffness is a ball joint, kind='ball'")
    return np.array([k[0], k[0], k[1]]) if k.shape == (2,) else k * np.ones(3)


def bodies_of(spec: JointSpec, around: list[int], turning: list[int]) -> list[list[int]]:
    """Group the edges around a joint's node into bodies, the one that the others turn against first."""
    if spec.kind == "rigid":
        return [around]
    if len(around) < 2:
        raise GraphError(f"joint at '{spec.at}': only one edge ends there, so there is nothing to join")
    if turning:
        rest = [e for e in around if e not in turning]
        return [*([rest] if rest else []), *([e] for e in turning)]
    if spec.stiffness.any() and len(around) > 2:
        raise GraphError(
            f"joint at '{spec.at}': {len(around)} edges meet there; say which of them turn against the others, "
            "which stay welded together: of=['rod']"
        )
    return [[e] for e in around]


STIFF = 1e4  # of a rigid body's bearing in a joint: times the EI of the stiffest soft rod


def attach(
    spec: JointSpec,
    node: int,
    bodies: list[list[int]],
    edges: np.ndarray,
    length: np.ndarray,
    frames: np.ndarray,
    compliance: np.ndarray,
    half_natural: np.ndarray,
    rest: np.ndarray | None = None,
) -> Joint:
    """Join edges to the frames of their bodies.

    Parameters
    ----------
    spec, node, bodies : JointSpec, int, list of list of int
        The joint, where it is, and its edges by body.
    edges, length, frames, half_natural : ndarray
        Of all edges, as in `rodnet.graph.joints.make_springs`.
    compliance : ndarray, shape (E, 3)
        Of the half edges next to this node [rad/(N m)].
    rest : ndarray, optional
        Frames of all edges as they are without a load, if not as they are drawn.
    """
    edge = np.array([e for body in bodies for e in body], dtype=np.int64)
    if not np.all(compliance[edge] > 0.0):
        raise GraphError(
            f"joint at '{spec.at}': rigid bodies alone do not say how stiff its bearing is; add at least one soft rod"
        )
    soft = 1.0 / float(compliance[edge].max())
    if spec.stiffness.max() > STIFFEST * soft:
        raise GraphError(
            f"joint at '{spec.at}': its stiffness {spec.stiffness.max():.3g} N m/rad is more than {STIFFEST:.0e} times "
            f"that of the half edges there, {soft:.3g}: it is no other than a joint that does not turn, kind='rigid'"
        )
    body = np.repeat(np.arange(len(bodies)), [len(b) for b in bodies])
    sign = np.where(edges[edge, 0] == node, 1.0, -1.0)
    forward = (sign > 0)[:, None, None]
    Q2 = np.where(forward, np.eye(3), FLIP)
    half = half_natural[edge]
    half = np.where(forward, half, FLIP @ np.swapaxes(half, 1, 2) @ FLIP)
    # what the half edge carries at rest is the frame that is drawn at its end, turned by its natural shape
    Q1 = spec.frame.T @ (frames if rest is None else rest)[edge] @ Q2 @ half
    seat = np.swapaxes(frames[edge], 1, 2) @ spec.frame
    attachments = Attachments(body, edge, sign, Q1, Q2, seat, compliance[edge], 0.5 * length[edge])
    return Joint(
        spec.at,
        spec.kind,
        node,
        tuple(np.array(b, dtype=np.int64) for b in bodies),
        attachments,
        np.tile(spec.frame, (len(bodies), 1, 1)),
        spec.stiffness,
        spec.angle,
        float(length[edge].mean()),
    )


def bearings(compliance: np.ndarray, EI: np.ndarray, soft: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Half edges of rigid bodies next to joints: as compliant as those of stiff parts, `StickFigure.rigid`.

    Parameters
    ----------
    compliance : ndarray, shape (E, 3)
        Of the half edges [rad/(N m)], zero in rigid bodies.
    EI, length : ndarray, shape (E,)
        Bending stiffnesses [N m^2] and lengths [m].
    soft : ndarray of bool, shape (E,)
        Edges of soft rods.
    """
    if not np.any(soft):
        return compliance
    return np.where(compliance > 0.0, compliance, (0.5 * length / (STIFF * EI[soft].max()))[:, None])


def root_factor(specs: Iterable[RodSpec]) -> float:
    """How much stiffer than the rod its half edge at a rigid root is: as stiff as the stiff parts."""
    rigid = [spec.stiffening[1] for spec in specs if spec.kind == "rigid"]
    return max(rigid, default=1e4)


def root_factors(graph: RodGraph, edges: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """How much stiffer than their rods half edges at nodes are: those where a rod begins whose root is rigid."""
    factors = np.ones(len(edges))
    specs = {} if graph.figure is None else graph.figure.specs
    for name, spec in specs.items():
        if spec.kind == "rod" and spec.root == "rigid":
            rod = graph.rods[name]
            factors[(edges == rod.edges[0]) & (nodes == rod.nodes[0])] = root_factor(specs.values())
    return factors


def pivot(graph: RodGraph, node: int, spec: JointSpec) -> Joint:
    """Hinge between the surroundings, which are the first body, and the edges at a node, which stay welded."""
    tangents = unit(graph.x0[graph.edges[:, 1]] - graph.x0[graph.edges[:, 0]])
    frames = material_frames(tangents, graph.d1, np.zeros(graph.edge_count))
    around = np.flatnonzero((graph.edges == node).any(axis=1)).tolist()
    bodies = [[], around]
    roots = root_factors(graph, np.arange(graph.edge_count), np.full(graph.edge_count, node))
    compliance = bearings(graph.compliance, graph.EI1, ~graph.rigid, graph.rest_length) / roots[:, None]
    rest = _unbent(graph, node, frames)
    return attach(
        spec, node, bodies, graph.edges, graph.rest_length, frames, compliance, graph.half_natural, rest
    )


def _unbent(graph: RodGraph, node: int, frames: np.ndarray) -> np.ndarray:
    """Frames of the edges, that of the second at an inner node of a rod as it is without a load beside the first."""
    springs, rest = graph.springs, frames.copy()
    here = np.flatnonzero(springs.node == node)
    if len(here) == 1:
        first, second = (int(e[here[0]]) for e in (springs.edge1, springs.edge2))
        rest[second] = frames[first] @ springs.Q1[here[0]] @ springs.Q2[here[0]].T
    return rest
