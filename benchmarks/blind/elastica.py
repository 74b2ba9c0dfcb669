"""The truth by PyElastica: Cosserat rods with shear and rotary inertia, explicit in time, a fine mesh.

Rods in a viscous medium; the root of the first is held by a gripper that moves; others are joined to it. What
is missing in the model that is to be diagnosed comes in here, in Elastica's own terms: as a forcing, as another
stiffness or mass of elements, as another motion of the gripper. Steps of place and time are sharp.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import elastica as ea
import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from benchmarks.blind.robots import Drive, Machine, rotations

STEP = 0.8  # of the stability limit
Effects = Mapping[str, Mapping[str, Any]]


class _System(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Connections):
    """What the machines need."""


class _Grip(ea.ConstraintBase):
    """The first element follows the gripper."""

    def __init__(self, *fixed: Any, table: Any, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.table = table

    def constrain_values(self, system: Any, time: Any) -> None:
        x, Q, _, _ = self.table.at(time)
        system.position_collection[:, :2] = x
        system.director_collection[:, :, 0] = Q

    def constrain_rates(self, system: Any, time: Any) -> None:
        _, _, v, omega = self.table.at(time)
        system.velocity_collection[:, :2] = v
        system.omega_collection[:, 0] = omega


class _Table:
    """The gripper's motion on the stepper's own times."""

    def __init__(
        self, drive: Drive, rest: np.ndarray, Q: np.ndarray, root: np.ndarray, start: float, dt: float, n: int
    ) -> None:
        t = start + 0.5 * dt * np.arange(2 * n + 2)
        shift, turn = drive.motion(t)
        R = rotations(turn)
        # rates by differences much finer than the motion
        d = 0.5 * dt
        self.x = (root + shift)[:, :, None] + R @ (rest - root[:, None])
        self.v = np.gradient(self.x, d, axis=0)
        self.Q = Q @ np.swapaxes(R, 1, 2)
        spin = np.gradient(R, d, axis=0) @ np.swapaxes(R, 1, 2)
        lab = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        self.omega = np.einsum("nij,nj->ni", self.Q, lab)
        self.start, self.d = start, d

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        k = round((time - self.start) / self.d)
        return self.x[k], self.Q[k], self.v[k], self.omega[k]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _drag(
    x, v, f, weight, gain, eta_t, eta_n, flow, shear, pulse, power, threshold, creep, depth, wall, time
):
    """Anisotropic drag on nodes, and what may be missing of it."""
    n = x.shape[1]
    for i in range(n):
        a, b = max(i - 1, 0), min(i + 1, n - 1)
        tx, ty, tz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
        norm = math.sqrt(tx * tx + ty * ty + tz * tz)
        tx, ty, tz = tx / norm, ty / norm, tz / norm
        stir = 1.0 + pulse[0] * math.sin(2.0 * math.pi * pulse[1] * time)
        ux = v[0, i] - flow[0] - shear * stir * x[2, i]
        uy = v[1, i] - flow[1]
        uz = v[2, i] - flow[2] + 0.5 * shear * (stir - 1.0) * x[0, i]
        speed = math.sqrt(ux * ux + uy * uy + uz * uz)
        factor = gain[i] * (1.0 + depth * x[2, i])
        if wall[0] > 0.0:
            gap = max(wall[1] - x[2, i], 1e-3)
            factor *= 1.0 + wall[0] / gap
        if power[0] != 1.0:
            factor *= max(speed / power[1], 1e-3) ** (power[0] - 1.0)
        along = ux * tx + uy * ty + uz * tz
        across = -eta_n * factor
        more = -(eta_t - eta_n) * factor * along
        dry = -threshold / max(speed, creep) if threshold > 0.0 else 0.0
        w = weight[i]
        f[0, i] += w * ((across + dry) * ux + more * tx)
        f[1, i] += w * ((across + dry) * uy + more * ty)
        f[2, i] += w * ((across + dry) * uz + more * tz)


class _Medium(ea.NoForces):
    """The viscous medium around a rod."""

    def __init__(
        self, machine: Machine, effects: Effects, s: np.ndarray, weight: np.ndarray, own: bool
    ) -> None:
        get = effects.get
        self.eta_t, self.eta_n = machine.drag()
        self.eta_t *= 1.0 + get("anisotropy", {}).get("along", 0.0)
        self.weight, self.gain = weight, np.ones(len(s))
        if own and (region := get("drag-region")):
            self.gain += region["gain"] * (np.abs(s - region["place"]) <= region["width"])
        self.flow = np.array(get("flow", {}).get("u", np.zeros(3)), dtype=float)
        current = get("shear-flow", {})
        self.shear, self.pulse = current.get("rate", 0.0), np.array([current.get("pulse", 0.0), 0.7])
        law = get("power-law", {})
        self.power = np.array([law.get("exponent", 1.0), law.get("speed", 0.05)])
        dry = get("yield", {})
        self.threshold, self.creep = dry.get("force", 0.0), dry.get("creep", 2e-4)
        self.depth = get("depth", {}).get("gradient", 0.0)
        near = get("wall", {})
        self.wall = np.array([near.get("reach", 0.0), near.get("height", 1.0)])
        jam = get("jam-onset", {})
        self.jam, self.onset = jam.get("gain", 0.0), jam.get("onset", math.inf)
        self.axial = 4.0 * np.pi * get("axial-drag", {}).get("viscosity", 0.0) * machine.radius**2

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        jammed = 1.0 + (self.jam if time >= self.onset else 0.0)
        _drag(
            system.position_collection, system.velocity_collection, system.external_forces, self.weight, self.gain,
            self.eta_t * jammed, self.eta_n * jammed, self.flow, self.shear, self.pulse, self.power,
            self.threshold, self.creep, self.depth, self.wall, float(time),
        )  # fmt: skip

    def apply_torques(self, system: Any, time: Any = 0.0) -> None:
        if self.axial:
            system.external_torques[2] -= self.axial * system.lengths * system.omega_collection[2]


class _Tether(ea.NoForces):
    """A thread that pulls a node to a point."""

    def __init__(self, node: int, anchor: np.ndarray, stiffness: float) -> None:
        self.node, self.anchor, self.stiffness = node, anchor, stiffness

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        pull = self.anchor - system.position_collection[:, self.node]
        system.external_forces[:, self.node] += self.stiffness * pull


class _Magnet(ea.NoForces):
    """A force per length towards a point, weaker with the square of the distance."""

    def __init__(self, weight: np.ndarray, at: np.ndarray, force: float) -> None:
        self.weight, self.at, self.force = weight, np.asarray(at), force

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        away = self.at[:, None] - system.position_collection
        near = np.sum(away**2, axis=0) + 1e-3
        system.external_forces += self.force * 1e-2 * self.weight * away / near**1.5


class _Memory(ea.NoForces):
    """A medium that is elastic for a while: a Maxwell element on every node."""

    def __init__(self, weight: np.ndarray, modulus: float, time: float, dt: float) -> None:
        self.weight, self.modulus, self.keep, self.dt = weight, modulus, math.exp(-dt / time), dt
        self.stretch = np.zeros((3, len(weight)))

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        self.stretch = self.keep * self.stretch + self.dt * system.velocity_collection
        system.external_forces -= self.modulus * self.weight * self.stretch


class _Swirl(ea.NoForces):
    """A vortex of the medium about an axis across the plane of motion."""

    def __init__(self, weight: np.ndarray, eta: float, at: np.ndarray, rate: float) -> None:
        self.weight, self.eta, self.at, self.rate = weight, eta, np.asarray(at), rate

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        x, _, z = system.position_collection - self.at[:, None]
        turning = self.eta * self.rate * self.weight * np.exp(-(x**2 + z**2) / 0.01)
        system.external_forces[0] += turning * z
        system.external_forces[2] -= turning * x


class _Hardening(ea.NoForces):
    """Bending that stiffens with the square of curvature: an additional couple between elements."""

    def __init__(self, stiffness: float, hardening: float, rest: np.ndarray) -> None:
        self.stiffness, self.hardening, self.rest = stiffness, hardening, rest

    def apply_torques(self, system: Any, time: Any = 0.0) -> None:
        strain = (system.kappa - self.rest)[:2]
        couple = self.stiffness * self.hardening * np.sum(strain**2, axis=0) * strain
        system.external_torques[:2, :-1] += couple
        system.external_torques[:2, 1:] -= couple


def stable_step(machine: Machine, h: float) -> float:
    """Time step that sound and the shear mode of an element allow [s]."""
    speed = math.sqrt(machine.young / machine.density)
    slowest = 1.0 / math.hypot(speed / h, speed / math.sqrt(3.0) / machine.radius)
    return STEP * slowest


def simulate(
    machine: Machine, drive: Drive, effects: Effects, t: np.ndarray, markers: Sequence[tuple[int, float]],
    *, elements: int = 30, start: float = -1.0,
) -> np.ndarray:  # fmt: skip
    """Return the markers' true positions at the frames [m], shape (T, M, 3).

    Parameters
    ----------
    machine, drive
        The rods, and how the gripper moves.
    effects : mapping
        What is missing in the model: parameters of each effect by its id.
    t : ndarray, shape (T,)
        Frames at equal steps [s].
    markers : sequence of (int, float)
        Rod and place of each marker, over the rod's length.
    elements : int
        Elements of the first rod.
    start : float
        When the rods are at rest [s]; the gripper moves from then on.
    """
    system = _System()
    h = machine.arms[0].length / elements
    frame = float(t[1] - t[0])
    # the springs of a joint are stiffer than an element
    parts = math.ceil((1.0 if len(machine.arms) == 1 else 1.8) * frame / stable_step(machine, h))
    dt = frame / parts
    rods, arcs = [], []
    for k, arm in enumerate(machine.arms):
        n = max(6, round(arm.length / h))
        # the first element straddles the gripper's edge, so that the clamp sits at s = 0 on any mesh
        straddles = arm.parent is None
        spacing = arm.length / (n + 0.5 if straddles else n)
        count, back = (n + 1, 0.5 * spacing) if straddles else (n, 0.0)
        nodes = spacing * np.arange(count + 1) - back
        points, frames = arm.shape(nodes)[0].T, arm.shape(nodes[:-1] + 0.5 * spacing)[1]
        frames = _on_edges(points, frames)
        rod = ea.CosseratRod.straight_rod(
            count, points[:, 0].copy(), arm.direction, arm.normal, count * spacing,
            machine.radius, machine.density, youngs_modulus=machine.young, shear_modulus=machine.young / 3.0,
            position=points.copy(), directors=np.ascontiguousarray(np.moveaxis(frames, 0, 2)),
        )  # fmt: skip
        _material(rod, machine, arm, effects, nodes, own=k == machine.place_rod)
        system.append(rod)
        rods.append(rod)
        arcs.append(nodes)
    for k, (arm, rod) in enumerate(zip(machine.arms, rods, strict=True)):
        if arm.parent is not None:
            _join(system, machine, rods[arm.parent], rod, arcs[arm.parent], arm, h)
        _surround(system, machine, arm, effects, rod, arcs[k], k == machine.place_rod, dt)
    before = math.ceil((t[0] - start) / frame - 1e-9)
    begin = float(t[0]) - before * frame
    count = (before + len(t)) * parts
    first = rods[0]
    table = _Table(
        drive, first.position_collection[:, :2].copy(), first.director_collection[:, :, 0].copy(),
        machine.arms[0].root, begin, dt, count,
    )  # fmt: skip
    system.constrain(first).using(
        _Grip, table=table, constrained_position_idx=(0, 1), constrained_director_idx=(0,)
    )
    system.finalize()
    stepper, now = ea.PositionVerlet(), np.float64(begin)
    seen = np.empty((len(t), len(markers), 3))
    for frame_number in range(-before, len(t)):
        if frame_number >= 0:
            if not all(np.abs(rod.position_collection).max() < 10.0 for rod in rods):
                raise FloatingPointError(
                    f"the rods of {machine.family} fly apart at t = {now:.3g} s, {effects}"
                )
            shapes = [CubicSpline(s, rod.position_collection.T) for s, rod in zip(arcs, rods, strict=True)]
            for m, (k, place) in enumerate(markers):
                seen[frame_number, m] = shapes[k](place * machine.arms[k].length)
        for step in range(parts):
            now = np.float64(begin + ((frame_number + before) * parts + step) * dt)
            stepper.step(system, now, dt)
    return seen


def _on_edges(points: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Frames whose third director is the edge, the others as near to the given ones as can be."""
    edge = np.diff(points, axis=1).T
    d3 = edge / np.linalg.norm(edge, axis=1, keepdims=True)
    d1 = frames[:, 0] - np.sum(frames[:, 0] * d3, axis=1, keepdims=True) * d3
    d1 /= np.linalg.norm(d1, axis=1, keepdims=True)
    return np.stack([d1, np.cross(d3, d1), d3], axis=1)


def _material(rod: Any, machine: Machine, arm: Any, effects: Effects, nodes: np.ndarray, own: bool) -> None:
    """Rest curvature, and what may be missing of stiffness and mass."""
    joint = nodes[1:-1] / arm.length  # where bending strains live
    rod.rest_kappa[:2] = np.asarray(arm.curvature)[:, None]
    if bent := effects.get("natural-curvature"):
        rod.rest_kappa[:2] += np.asarray(bent["kappa"])[:, None]
    scale = np.ones(len(joint))
    if own and (spot := effects.get("stiffness-defect")):
        scale[np.abs(joint - spot["place"]) <= spot["width"]] *= 1.0 - spot["loss"]
    if own and (kink := effects.get("kink")):
        inside = np.abs(joint - kink["place"]) <= kink["width"]
        rod.rest_kappa[:2] += np.outer(kink["kappa"], inside)
    if slope := effects.get("stiffness-gradient", {}).get("slope"):
        scale *= 1.0 + slope * (joint - 0.5)
    if arm.parent is None and (give := effects.get("root-compliance")):
        scale[0] = (nodes[1] - nodes[0]) / (nodes[1] - nodes[0] + give["length"])
    rod.bend_matrix[0, 0] *= scale
    rod.bend_matrix[1, 1] *= scale
    if slope := effects.get("mass-gradient", {}).get("slope"):
        rod.mass *= 1.0 + slope * (nodes / arm.length - 0.5)
    if own and (lump := effects.get("local-mass")):
        rod.mass[np.argmin(np.abs(nodes / arm.length - lump["place"]))] += lump["mass"]


def _surround(
    system: Any,
    machine: Machine,
    arm: Any,
    effects: Effects,
    rod: Any,
    nodes: np.ndarray,
    own: bool,
    dt: float,
) -> None:
    """What acts on a rod from outside."""
    spacing = nodes[1] - nodes[0]
    weight = np.full(len(nodes), spacing)
    weight[[0, -1]] = 0.5 * spacing
    system.add_forcing_to(rod).using(_Medium, machine, effects, nodes / arm.length, weight, own)
    if pull := effects.get("gravity"):
        system.add_forcing_to(rod).using(ea.GravityForces, acc_gravity=np.array([0.0, 0.0, -pull["g"]]))
    if own and (thread := effects.get("tether")):
        node = int(np.argmin(np.abs(nodes / arm.length - thread["place"])))
        anchor = arm.root + thread["place"] * arm.length * arm.direction + np.asarray(thread["to"])
        system.add_forcing_to(rod).using(_Tether, node, anchor, thread["stiffness"])
    if pole := effects.get("magnet"):
        system.add_forcing_to(rod).using(_Magnet, weight, pole["at"], pole["force"])
    if elastic := effects.get("memory"):
        system.add_forcing_to(rod).using(_Memory, weight, elastic["modulus"], elastic["time"], dt)
    if vortex := effects.get("swirl"):
        system.add_forcing_to(rod).using(_Swirl, weight, machine.drag()[1], vortex["at"], vortex["rate"])
    if hard := effects.get("nonlinear-elasticity"):
        stiffness = machine.young * 0.25 * math.pi * machine.radius**4
        system.add_forcing_to(rod).using(_Hardening, stiffness, hard["hardening"], rod.rest_kappa.copy())


def _join(
    system: Any, machine: Machine, parent: Any, rod: Any, nodes: np.ndarray, arm: Any, h: float
) -> None:
    """Weld a rod's start to a node of another."""
    node = int(np.argmin(np.abs(nodes - arm.at * machine.arms[arm.parent].length)))
    element = min(node, parent.n_elems - 1)
    area = math.pi * machine.radius**2
    rotation = parent.director_collection[:, :, element] @ rod.director_collection[:, :, 0].T
    system.connect(first_rod=parent, second_rod=rod, first_connect_idx=node, second_connect_idx=0).using(
        ea.FixedJoint, k=0.5 * machine.young * area / h, nu=0.0,
        kt=5.0 * machine.young * 0.25 * math.pi * machine.radius**4 / h, nut=0.0, rest_rotation_matrix=rotation,
    )  # fmt: skip
