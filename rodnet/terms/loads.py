"""Loads: gravity, point forces and torques, and local laws of one's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import _STEP

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


@dataclass(frozen=True)
class NodeSites:
    """What a load law sees: arrays over its nodes, one row each.

    Attributes
    ----------
    x, v : ndarray, shape (n, 3)
        Position [m] and velocity [m/s].
    mass, volume : ndarray, shape (n,)
        Lumped mass [kg], and lumped volume of material [m^3].
    t, dt : float
        Time and time step [s].
    """

    x: np.ndarray
    v: np.ndarray
    mass: np.ndarray
    volume: np.ndarray
    t: float
    dt: float


def node_volumes(graph: RodGraph) -> np.ndarray:
    """Lumped volume of the material at each node [m^3], shape (N,); of stiff parts, that of their radius."""
    area = np.pi * graph.radius**2
    for rod in graph.rods.values():
        if rod.material is not None:
            soft = rod.material if isinstance(rod.material, tuple) else [rod.material]
            area[rod.edges] = graph.EA[rod.edges] / [m.E for m in soft]
    for body in graph.bodies:
        if body.volume is not None:  # it displaces that, at its own masses
            area[body.edges] = 0.0
    volume = np.zeros(graph.node_count)
    np.add.at(volume, graph.edges, 0.5 * (area * graph.rest_length)[:, None])
    return volume


class LoadModel(Term):
    """A load law: ``force(self, site, p)`` returns the force on each node [N], shape (n, 3)."""

    kind = "load"
    default_name = "load"
    dead: ClassVar[bool] = False  # a dead load depends on neither position nor velocity
    steady: bool = False  # nor on time
    # it acts on nodes that were drawn, and on none that a finer mesh has between
    concentrated: ClassVar[bool] = False
    weighs: ClassVar[bool] = (
        False  # it acts on all mass: also on that of rigid bodies, if all their nodes are named
    )

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force on each node [N], shape (n, 3)."""
        raise TermError(f"{type(self).__name__} must implement force(self, site, p)")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the nodes that ``on`` names."""
        return _BoundLoad(self, model)


class _BoundLoad(BoundTerm):
    def __init__(self, term: LoadModel, model: Model) -> None:
        super().__init__(term)
        self.law = term
        named = model.graph.drawn_nodes if term.concentrated else model.graph.nodes
        self.nodes = model.nodes_with_masses(term.on) if term.weighs else named(term.on)
        self.p = term.values(len(self.nodes))
        self.dofs = 3 * self.nodes[:, None] + np.arange(3)
        self.mass = model.node_mass[self.nodes]
        volumes = np.zeros(model.node_count)
        volumes[: model.graph.node_count] = node_volumes(model.graph)
        for body, masses in zip(model.graph.bodies, model.mass_nodes, strict=True):
            volumes[masses] = body.displaced()
        self.volume = volumes[self.nodes]
        if not term.dead:
            self.stencils = [self.dofs]
        self._dead: tuple[float, np.ndarray, float] | None = None  # time, generalised forces, largest force

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        if not self.law.steady:
            self._dead = None  # evaluated once per step

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.law.dead:
            dead = self._dead
            if dead is None or (dead[0] != ev.t and not self.law.steady):
                self._dead = dead = ev.t, *self._evaluated(ev)
            F += dead[1]
            return dead[2]
        site = self._sites(ev)
        f = np.asarray(self.law.force(site, self.p), dtype=float)
        F[self.dofs] += f
        if jac:
            for key, factor in (("x", 1.0), ("v", ev.cv)):
                value = getattr(site, key)
                for k in range(3):
                    step = np.zeros(3)
                    step[k] = _STEP * max(float(np.abs(value).max(initial=0.0)), 1e-6)
                    up, down = (
                        self.law.force(replace(site, **{key: value + s * step}), self.p) for s in (1.0, -1.0)
                    )
                    np.subtract.at(
                        data, self.slots[0][:, :, k], factor * (np.asarray(up) - down) / (2.0 * step[k])
                    )
        return float(np.abs(f).max(initial=0.0))

    def _sites(self, ev: Evaluation) -> NodeSites:
        return NodeSites(ev.x[self.nodes], ev.v[self.nodes], self.mass, self.volume, ev.t, ev.dt)

    def _evaluated(self, ev: Evaluation) -> tuple[np.ndarray, float]:
        """Generalised forces of a dead load at the evaluation's time, and the largest force [N]."""
        site = self._sites(ev)
        f = np.asarray(self.law.force(site, self.p), dtype=float)
        F = np.zeros(ev.model.dof_count)
        F[self.dofs] = f
        return F, float(np.abs(f).max(initial=0.0))


class Gravity(LoadModel):
    """Weight less buoyancy, f = (m - fluid_density V) g; z is up.

    V is the volume of material: hollow rods are flooded, stiff parts are as thick as their radius says, and
    rigid bodies displace their ``volume`` about its centre, if they have one (`StickFigure.body`).

    Parameters
    ----------
    g : float or Parameter
        Acceleration of gravity [m/s^2].
    fluid_density : float or Parameter
        Density of a fluid at rest around the rods [kg/m^3]; by default there is none.
    direction : (3,)
        Direction in which things fall.
    """

    default_name = "gravity"
    source = "uniform field; Archimedes"
    dead = steady = weighs = True
    once = True
    g = Parameter(9.81, unit="m/s^2", null=0.0, doc="acceleration of gravity")
    fluid_density = Parameter(
        0.0, unit="kg/m^3", bounds=(0, None), null=0.0, kind="shape", doc="density of the fluid around"
    )

    def __init__(self, on: Any = "*", *, direction: Any = (0.0, 0.0, -1.0), **options: Any) -> None:
        super().__init__(on, **options)
        vector = np.asarray(direction, dtype=float)
        if vector.shape != (3,) or not np.linalg.norm(vector) > 0:
            raise TermError(f"Gravity: direction = {direction!r} must be a vector (3,) that is not zero")
        self.direction = vector / np.linalg.norm(vector)

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Weight of each node [N], shape (n, 3)."""
        heavy = site.mass - np.ravel(p.fluid_density) * site.volume
        return np.ravel(p.g)[:, None] * heavy[:, None] * self.direction


def _vector(owner: str, value: Any, unit: str) -> Callable[[float], np.ndarray]:
    if callable(value):
        probe = np.asarray(value(0.0), dtype=float)
    else:
        probe = np.array(value, dtype=float)
    if probe.shape != (3,) or not np.all(np.isfinite(probe)):
        raise TermError(
            f"{owner} must be a finite vector (3,) [{unit}] or a function of time that returns one"
        )
    return _Driven(value) if callable(value) else _Constant(probe)


@dataclass(frozen=True)
class _Constant:
    """A vector that does not change, as a function of time: a class, so that robots can be pickled."""

    value: np.ndarray

    def __call__(self, t: float) -> np.ndarray:
        return self.value


@dataclass(frozen=True)
class _Driven:
    """A function of time whose values are arrays."""

    function: Callable[[float], Any]

    def __call__(self, t: float) -> np.ndarray:
        return np.asarray(self.function(t), dtype=float)


class PointForce(LoadModel):
    """A force on each of the nodes that ``at`` names; on a finer mesh (`Robot.refined`) on the same ones.

    Parameters
    ----------
    at : str or sequence of str
        The nodes.
    force : (3,) or callable
        Force [N], constant or a function of time.
    """

    default_name = "force"
    source = "dead load"
    dead = concentrated = True
    scale = Parameter(1.0, unit="1", null=0.0, doc="factor on the force")
    example: ClassVar[dict[str, Any]] = {"force": (0.0, 0.0, 1.0)}

    def __init__(self, *, at: Any, force: Any, name: str | None = None, **parameters: Any) -> None:
        super().__init__(at, name=name, **parameters)
        self.vector, self.steady = _vector("PointForce: force", force, "N"), not callable(force)

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force on each node [N], shape (n, 3)."""
        return np.broadcast_to(p.scale * self.vector(site.t), site.x.shape)


class PointTorque(Term):
    """A torque on each of the edges that ``on`` names, fixed in space or carried by the edge.

    On a finer mesh (`Robot.refined`) the parts of an edge share its torque.

    Parameters
    ----------
    on : str or sequence of str
        The edges, e.g. ``"rod:0-1"`` or ``"rod.end"``.
    torque : (3,) or callable
        Torque [N m], constant or a function of time, in space, or with ``follower=True`` in the
        edge's material frame (m1, m2, t). A dead torque on an edge that tilts is not conservative.
    """

    kind = "load"
    default_name = "torque"
    source = "virtual work of the edge's rotation"
    scale = Parameter(1.0, unit="1", null=0.0, doc="factor on the torque")
    example: ClassVar[dict[str, Any]] = {"torque": (0.0, 0.0, 1e-3)}

    def __init__(
        self, *, on: Any, torque: Any, follower: bool = False, name: str | None = None, **parameters: Any
    ) -> None:
        super().__init__(on, name=name, **parameters)
        self.vector, self.follower = _vector("PointTorque: torque", torque, "N m"), follower

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges that ``on`` names."""
        return _BoundTorque(self, model)


class _BoundTorque(BoundTerm):
    def __init__(self, term: PointTorque, model: Model) -> None:
        super().__init__(term)
        self.law = term
        self.index = model.graph.edge_indices(term.on)
        self.share = 1.0 / model.graph.parts(self.index)[:, None]
        ends = model.edges[self.index]
        axes = np.arange(3)
        self.dofs = np.concatenate(
            [3 * ends[:, :1] + axes, 3 * ends[:, 1:] + axes, model.twist0 + self.index[:, None]], axis=1
        )
        self.stencils = [self.dofs]

    def _force(
        self, e: np.ndarray, theta: np.ndarray, source: tuple[np.ndarray, np.ndarray], t: float
    ) -> np.ndarray:
        from rodnet.kinematics.frames import material_frames, transport

        length = np.linalg.norm(e, axis=1, keepdims=True)
        tangent = e / length
        torque = self.share * self.law.scale.value * self.law.vector(t)
        if self.law.follower:
            frame = material_frames(tangent, transport(source[1], source[0], tangent), theta)
            torque = np.einsum("nij,nj->ni", frame, torque)
        holonomy = np.cross(source[0], tangent) / (1.0 + np.sum(source[0] * tangent, axis=1, keepdims=True))
        axial = np.sum(torque * tangent, axis=1, keepdims=True)
        couple = (np.cross(torque, tangent) - axial * holonomy) / length
        return np.concatenate([-couple, couple, axial], axis=1)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        e = ev.x[ev.model.edges[self.index, 1]] - ev.x[ev.model.edges[self.index, 0]]
        theta, source = ev.theta[self.index], (ev.ts[self.index], ev.d1s[self.index])
        f = self._force(e, theta, source, ev.t)
        np.add.at(F, self.dofs, f)
        if jac:
            h = 1e-6
            for k in range(3):
                step = h * ev.L[self.index][:, None] * np.eye(3)[k]
                slope = self._force(e + step, theta, source, ev.t) - self._force(
                    e - step, theta, source, ev.t
                )
                slope /= 2.0 * h * ev.L[self.index][:, None]
                np.subtract.at(data, self.slots[0][:, :, 3 + k], slope)
                np.add.at(data, self.slots[0][:, :, k], slope)
            slope = (self._force(e, theta + h, source, ev.t) - self._force(e, theta - h, source, ev.t)) / (
                2.0 * h
            )
            np.subtract.at(data, self.slots[0][:, :, 6], slope)
        return float(np.abs(f[:, :6]).max(initial=0.0))
