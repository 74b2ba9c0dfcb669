"""The truth by PyElastica: Cosserat rods with shear and rotary inertia, explicit in time, a fine mesh.

Rods in a viscous medium; the root of the first is held by a gripper that moves; others are joined to it. What
is missing in the model that is to be diagnosed comes in here, in Elastica's own terms: as a forcing, as another
stiffness or mass of elements, as another motion of the gripper. Steps of place and time are sharp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import elastica as ea
import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.blind.drives import Drive
from benchmarks.blind.forces import (
    Contact,
    Effects,
    Hardening,
    Magnet,
    Medium,
    Memory,
    Puddle,
    Spacing,
    Swirl,
    Tether,
    inside,
)
from benchmarks.blind.robots import Machine, rotations, turned

STEP = 0.8  # of the stability limit
SPUN = 0.5  # of the time in which an axial drag stops a spin: the longest step


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


def stable_step(machine: Machine, h: float) -> float:
    """Time step that sound and the shear mode of an element allow [s]."""
    speed = math.sqrt(machine.young / machine.density)
    slowest = 1.0 / math.hypot(speed / h, speed / math.sqrt(3.0) / machine.radius)
    return STEP * slowest


def converged(
    machine: Machine,
    drive: Drive,
    effects: Effects,
    t: np.ndarray,
    markers: Sequence[tuple[int, float]],
    *,
    elements: int = 30,
) -> np.ndarray:
    """Return the markers' positions as `simulate`; those of joined rods from two meshes.

    Elastica joins nodes and elements that lie half an element apart, so that the error is of first order in the mesh
    width, and extrapolation takes most of it away. Of a single rod it is of second order, and would double.
    """
    found = simulate(machine, drive, effects, t, markers, elements=elements)
    if len(machine.arms) == 1:
        return found
    return 2.0 * found - simulate(machine, drive, effects, t, markers, elements=elements // 2)


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
    machine = turned(machine, *(effects[id] for id in ("root-direction", "grasp-twist") if id in effects))
    beside = np.asarray(effects.get("grasp-offset", {}).get("shift", np.zeros(3)))
    h = machine.arms[0].length / elements
    frame = float(t[1] - t[0])
    # the springs of a joint are stiffer than an element
    lightest = 1.0 - 0.5 * abs(effects.get("mass-gradient", {}).get("slope", 0.0))
    slower = (1.0 if len(machine.arms) == 1 else 1.8) / math.sqrt(lightest)
    longest = stable_step(machine, h) / slower
    if spun := effects.get("axial-drag", {}).get("viscosity", 0.0):
        # the explicit step bears no drag on the spin that stops it within a step: 4 pi mu r^2 over rho pi r^4 / 2
        longest = min(longest, SPUN * machine.density * machine.radius**2 / (8.0 * spun))
    parts = math.ceil(frame / longest)
    dt = frame / parts
    rods, arcs = [], []
    for k, arm in enumerate(machine.arms):
        joints = [other.at for other in machine.arms if other.parent == k]
        nodes = _mesh(arm, joints, h, held=1.0 if effects.get("root-compliance", {}).get("length") else 0.5)
        count = len(nodes) - 1
        points, frames = arm.shape(nodes)[0].T + beside[:, None], arm.shape(0.5 * (nodes[1:] + nodes[:-1]))[1]
        frames = _on_edges(points, frames)
        rod = ea.CosseratRod.straight_rod(
            count, points[:, 0].copy(), arm.direction, arm.normal, float(np.ptp(nodes)),
            machine.radius, machine.density, youngs_modulus=machine.young, shear_modulus=machine.young / 3.0,
            position=points.copy(), directors=np.ascontiguousarray(np.moveaxis(frames, 0, 2)),
        )  # fmt: skip
        _material(rod, machine, arm, effects, nodes, own=k == machine.place_rod)
        system.append(rod)
        rods.append(rod)
        arcs.append(nodes)
    for k, (arm, rod) in enumerate(zip(machine.arms, rods, strict=True)):
        if arm.parent is not None:
            _join(system, machine, rods[arm.parent], rod, arcs[arm.parent], arm)
        near = None
        if (jam := effects.get("jam-spacing")) and jam["gain"]:
            near = Spacing(machine, rods, arcs, k, jam)
        _surround(system, machine, arm, effects, rod, arcs[k], k == machine.place_rod, dt, near)
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
    away = effects.get("marker-offset", {}).get("offset")
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
                at = place * machine.arms[k].length
                seen[frame_number, m] = shapes[k](at)
                if away is not None:
                    seen[frame_number, m] += away @ _across(rods[k], arcs[k], at)
        for step in range(parts):
            now = np.float64(begin + ((frame_number + before) * parts + step) * dt)
            stepper.step(system, now, dt)
    return seen


def _across(rod: Any, nodes: np.ndarray, at: float) -> np.ndarray:
    """The two directors across a rod at an arc length, shape (2, 3)."""
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    found = np.array(
        [[np.interp(at, middle, rod.director_collection[d, j]) for j in range(3)] for d in range(2)]
    )
    return found / np.linalg.norm(found, axis=1, keepdims=True)


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
    middle = 0.5 * (nodes[1:] + nodes[:-1]) / arm.length
    cells = middle[:-1], middle[1:]
    rod.rest_kappa[:2] = np.asarray(arm.curvature)[:, None]
    if bent := effects.get("natural-curvature"):
        rod.rest_kappa[:2] += np.asarray(bent["kappa"])[:, None]
    if twisted := effects.get("natural-twist"):
        rod.rest_kappa[2] += twisted["twist"]
    scale = np.ones(len(joint))
    if own and (spot := effects.get("stiffness-defect")):
        soft = inside(*cells, spot)
        scale /= 1.0 - soft + soft / (1.0 - spot["loss"])  # compliances add
    if own and (kink := effects.get("kink")):
        rod.rest_kappa[:2] += np.outer(kink["kappa"], inside(*cells, kink))
    if slope := effects.get("stiffness-gradient", {}).get("slope"):
        scale *= 1.0 + slope * (joint - 0.5)
    give = effects.get("root-compliance", {}).get("length", 0.0)
    if arm.parent is None and give:
        # a hinge at the gripper's edge, and the half element beyond it; that alone is twisted
        beyond = 0.5 * (nodes[2] - nodes[1])
        scale[0] = (nodes[1] - nodes[0]) / (beyond + give)
        rod.bend_matrix[2, 2, 0] *= (nodes[1] - nodes[0]) / beyond
    rod.bend_matrix[0, 0] *= scale
    rod.bend_matrix[1, 1] *= scale
    if flat := effects.get("flat"):
        rod.bend_matrix[0, 0] *= 1.0 + flat["excess"]
    if slope := effects.get("mass-gradient", {}).get("slope"):
        rod.mass *= 1.0 + slope * (nodes / arm.length - 0.5)
    if own and (lump := effects.get("local-mass")):
        k, shares = _between(nodes / arm.length, lump["place"])
        rod.mass[k : k + 2] += lump["mass"] * shares


def _between(nodes: np.ndarray, place: float) -> tuple[int, np.ndarray]:
    """The first of two nodes beside a place, and the shares of both, their first moment that of the place."""
    at = float(np.interp(place, nodes, np.arange(len(nodes))))
    k = min(int(at), len(nodes) - 2)
    return k, np.array([k + 1 - at, at - k])


def _surround(
    system: Any,
    machine: Machine,
    arm: Any,
    effects: Effects,
    rod: Any,
    nodes: np.ndarray,
    own: bool,
    dt: float,
    near: Spacing | None,
) -> None:
    """What acts on a rod from outside."""
    weight = np.zeros(len(nodes))
    weight[1:] += 0.5 * np.diff(nodes)
    weight[:-1] += 0.5 * np.diff(nodes)
    system.add_forcing_to(rod).using(Medium, machine, effects, nodes / arm.length, weight, own, near)
    if pull := effects.get("gravity"):
        system.add_forcing_to(rod).using(ea.GravityForces, acc_gravity=np.array([0.0, 0.0, -pull["g"]]))
    for thread in filter(None, (effects.get("tether"), effects.get("rope")) if own else ()):
        between = _between(nodes / arm.length, thread["place"])
        anchor = arm.root + thread["place"] * arm.length * arm.direction + np.asarray(thread["to"])
        system.add_forcing_to(rod).using(
            Tether, *between, anchor, thread["stiffness"], thread.get("length", 0.0)
        )
    if pole := effects.get("magnet"):
        system.add_forcing_to(rod).using(Magnet, weight, pole["at"], pole["force"])
    if elastic := effects.get("memory"):
        system.add_forcing_to(rod).using(Memory, weight, elastic["modulus"], elastic["time"], dt)
    if plane := effects.get("obstacle"):
        system.add_forcing_to(rod).using(Contact, weight, plane["height"], plane["stiffness"])
    if vortex := effects.get("swirl"):
        system.add_forcing_to(rod).using(Swirl, weight, machine.drag()[1], vortex["at"], vortex["rate"])
    if patch := effects.get("puddle"):
        eta = machine.drag()[1]
        system.add_forcing_to(rod).using(Puddle, weight, eta, patch["at"], patch["radius"], patch["gain"])
    if hard := effects.get("nonlinear-elasticity"):
        stiffness = machine.young * 0.25 * math.pi * machine.radius**4
        system.add_forcing_to(rod).using(Hardening, stiffness, hard["hardening"], rod.rest_kappa.copy())


def _mesh(arm: Any, joints: list[float], h: float, held: float) -> np.ndarray:
    """Nodes along a rod [m]: one at each joint, and so much of the first element of a held rod in the gripper."""
    cuts = sorted({0.0, *joints, 1.0})
    nodes: list[np.ndarray] = []
    for a, b in pairwise(cuts):
        n = max(4, round((b - a) * arm.length / h))
        if a == 0.0 and arm.parent is None:
            # so that the clamp sits at s = 0 on any mesh
            spacing = (b - a) * arm.length / (n + 1.0 - held)
            nodes.append(spacing * (np.arange(n + 1) - held))
        else:
            nodes.append(arm.length * (a + (b - a) * np.arange(n) / n))
    return np.concatenate([*nodes, [arm.length]])


def _join(system: Any, machine: Machine, parent: Any, rod: Any, nodes: np.ndarray, arm: Any) -> None:
    """Weld a rod's start to a node of another: to the mean of the two elements there.

    The spring of the joint gives as much as the half of the rod's first element, which is rigid, would.
    """
    node = int(np.argmin(np.abs(nodes - arm.at * machine.arms[arm.parent].length)))
    spacing = float(rod.rest_lengths[0])
    stretching = machine.young * math.pi * machine.radius**2
    turning = 2.0 * machine.young * 0.25 * math.pi * machine.radius**4 / spacing
    for element in (node - 1, node):
        rotation = parent.director_collection[:, :, element] @ rod.director_collection[:, :, 0].T
        joint = ea.FixedJoint(0.0, 0.0, 0.5 * turning, 0.0, rotation)
        system.connect(parent, rod, node, 0).using(_Weld, joint, element, 0.25 * stretching / spacing)


class _Weld(ea.FreeJoint):
    """A spring between nodes, and one that turns the elements beside them."""

    def __init__(self, turning: Any, element: int, k: float) -> None:
        super().__init__(k, 0.0)
        self.turning, self.element = turning, element

    def apply_torques(
        self, system_one: Any, index_one: Any, system_two: Any, index_two: Any, time: Any = 0.0
    ) -> None:
        self.turning.apply_torques(system_one, self.element, system_two, 0)
