"""Forces on PyElastica's rods: the viscous medium, and what may be missing in a model of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import elastica as ea
import numpy as np
from numba import njit

from benchmarks.blind.robots import Machine

NEXT = 1.5  # spacings along the rods, within which another rod is no neighbour
Effects = Mapping[str, Mapping[str, Any]]


def inside(first: np.ndarray, last: np.ndarray, region: Mapping[str, Any]) -> np.ndarray:
    """Share of each cell that lies within a region with sharp ends."""
    low, high = region["place"] - region["width"], region["place"] + region["width"]
    return np.clip(np.minimum(last, high) - np.maximum(first, low), 0.0, None) / (last - first)


@njit(cache=True)
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
        factor = gain[i] * max(1.0 + depth * x[2, i], 0.0)
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


class Medium(ea.NoForces):
    """The viscous medium around a rod."""

    def __init__(
        self, machine: Machine, effects: Effects, s: np.ndarray, weight: np.ndarray, own: bool,
        near: Spacing | None = None,
    ) -> None:  # fmt: skip
        get, self.near = effects.get, near
        self.eta_t, self.eta_n = machine.drag()
        self.eta_t *= 1.0 + get("anisotropy", {}).get("along", 0.0)
        self.weight, self.gain = weight, np.ones(len(s))
        if own and (region := get("drag-region")):
            ends = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
            self.gain += region["gain"] * inside(ends[:-1], ends[1:], region)
        self.flow = np.array(get("flow", {}).get("u", np.zeros(3)), dtype=float)
        current = get("shear-flow", {})
        self.shear, self.pulse = current.get("rate", 0.0), np.array([current.get("pulse", 0.0), 0.7])
        law = get("power-law", {})
        self.power = np.array([law.get("exponent", 1.0), law.get("speed", 0.05)])
        dry = get("yield", {})
        self.threshold, self.creep = dry.get("force", 0.0), dry.get("creep", 2e-4)
        self.depth = get("depth", {}).get("gradient", 0.0)
        plane = get("wall", {})
        self.wall = np.array([plane.get("reach", 0.0), plane.get("height", 1.0)])
        jam = get("jam-onset", {})
        self.jam, self.onset = jam.get("gain", 0.0), jam.get("onset", math.inf)
        self.axial = 4.0 * np.pi * get("axial-drag", {}).get("viscosity", 0.0) * machine.radius**2

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        jammed = 1.0 + (self.jam if time >= self.onset else 0.0)
        gain = self.gain if self.near is None else self.gain * self.near.factor()
        _drag(
            system.position_collection, system.velocity_collection, system.external_forces, self.weight, gain,
            self.eta_t * jammed, self.eta_n * jammed, self.flow, self.shear, self.pulse, self.power,
            self.threshold, self.creep, self.depth, self.wall, float(time),
        )  # fmt: skip

    def apply_torques(self, system: Any, time: Any = 0.0) -> None:
        if self.axial:
            system.external_torques[2] -= self.axial * system.lengths * system.omega_collection[2]


class Spacing:
    """A medium that jams between rods: where another rod is nearer than a spacing, drag is larger at once.

    Pairs next to each other along the rods, by way of a joint, are always near and don't count.
    """

    EVERY = 40  # half steps between two looks at the distances

    def __init__(
        self, machine: Machine, rods: list[Any], arcs: list[np.ndarray], own: int, jam: Mapping[str, Any]
    ) -> None:
        self.rods, self.own, self.gain, self.spacing = rods, own, jam["gain"], jam["spacing"]
        self.count, self.jammed = 0, np.ones(len(arcs[own]))
        # a joint cuts the first rod in two; all rods are measured from there
        joint = next((arm.at * machine.arms[0].length for arm in machine.arms if arm.parent is not None), 0.0)
        to_joint = [np.abs(s - joint) if k == 0 else s for k, s in enumerate(arcs)]
        self.pairs = [
            (k, to_joint[own][:, None] + to_joint[k] > NEXT * self.spacing)
            for k in range(len(rods))
            if k != own
        ]

    def factor(self) -> np.ndarray:
        """Drag over that without neighbours, for each node."""
        if self.count % self.EVERY == 0:
            x = self.rods[self.own].position_collection
            near = np.zeros(x.shape[1], dtype=bool)
            for k, counts in self.pairs:
                other = self.rods[k].position_collection
                away = np.sum((x[:, :, None] - other[:, None, :]) ** 2, axis=0)
                near |= ((away < self.spacing**2) & counts).any(axis=1)
            self.jammed = 1.0 + self.gain * near
        self.count += 1
        return self.jammed


class Contact(ea.NoForces):
    """A wall above that pushes back, without friction."""

    def __init__(self, weight: np.ndarray, height: float, stiffness: float) -> None:
        self.weight, self.height, self.stiffness = weight, height, stiffness

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        deep = np.maximum(system.position_collection[2] - self.height, 0.0)
        system.external_forces[2] -= self.stiffness * self.weight * deep


class Tether(ea.NoForces):
    """A thread that pulls a place between a node and the next to a point, from a length on."""

    def __init__(
        self, node: int, shares: np.ndarray, anchor: np.ndarray, stiffness: float, length: float = 0.0
    ) -> None:
        self.nodes, self.shares, self.anchor = slice(node, node + 2), shares, anchor
        self.stiffness, self.length = stiffness, length

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        pull = self.anchor - system.position_collection[:, self.nodes] @ self.shares
        taut = max(1.0 - self.length / max(float(np.linalg.norm(pull)), 1e-12), 0.0)
        system.external_forces[:, self.nodes] += self.stiffness * taut * np.outer(pull, self.shares)


class Magnet(ea.NoForces):
    """A force per length towards a point, weaker with the square of the distance."""

    def __init__(self, weight: np.ndarray, at: np.ndarray, force: float) -> None:
        self.weight, self.at, self.force = weight, np.asarray(at), force

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        away = self.at[:, None] - system.position_collection
        near = np.sum(away**2, axis=0) + 1e-3
        system.external_forces += self.force * 1e-2 * self.weight * away / near**1.5


class Memory(ea.NoForces):
    """A medium that is elastic for a while: a Maxwell element on every node."""

    def __init__(self, weight: np.ndarray, modulus: float, time: float, dt: float) -> None:
        self.weight, self.modulus, self.keep, self.dt = weight, modulus, math.exp(-dt / time), dt
        self.stretch = np.zeros((3, len(weight)))

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        self.stretch = self.keep * self.stretch + self.dt * system.velocity_collection
        system.external_forces -= self.modulus * self.weight * self.stretch


class Swirl(ea.NoForces):
    """A vortex of the medium about an axis across the plane of motion."""

    def __init__(self, weight: np.ndarray, eta: float, at: np.ndarray, rate: float) -> None:
        self.weight, self.eta, self.at, self.rate = weight, eta, np.asarray(at), rate

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        x, _, z = system.position_collection - self.at[:, None]
        turning = self.eta * self.rate * self.weight * np.exp(-(x**2 + z**2) / 0.01)
        system.external_forces[0] += turning * z
        system.external_forces[2] -= turning * x


class Puddle(ea.NoForces):
    """A round patch of the medium that holds back more, with a sharp edge; as much along the rods as across."""

    def __init__(self, weight: np.ndarray, eta: float, at: np.ndarray, radius: float, gain: float) -> None:
        self.weight, self.eta, self.at, self.radius = weight, gain * eta, np.asarray(at), radius

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        away = system.position_collection - self.at[:, None]
        within = away[0] ** 2 + away[2] ** 2 < self.radius**2
        system.external_forces -= self.eta * self.weight * within * system.velocity_collection


class Hardening(ea.NoForces):
    """Bending that stiffens with the square of curvature: an additional couple between elements.

    The frames of the elements are turned against each other: seen from theirs, half of the turn is beside the couple.
    """

    def __init__(self, stiffness: float, hardening: float, rest: np.ndarray) -> None:
        self.stiffness, self.hardening, self.rest = stiffness, hardening, rest

    def apply_torques(self, system: Any, time: Any = 0.0) -> None:
        strain = (system.kappa - self.rest)[:2]
        couple = np.zeros_like(system.kappa)
        couple[:2] = self.stiffness * self.hardening * np.sum(strain**2, axis=0) * strain
        turned = 0.5 * system.rest_voronoi_lengths * np.cross(system.kappa, couple, axis=0)
        system.external_torques[:, :-1] += couple + turned
        system.external_torques[:, 1:] += turned - couple
