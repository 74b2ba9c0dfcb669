"""What is simulated, as rodnet robots; the rivals build the same by their own means."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import rodnet as rn

# the cantilever: a soft rod, clamped at one end, horizontal at the start, that falls
LENGTH, RADIUS, YOUNG, DENSITY, GRAVITY = 1.0, 5e-3, 1e7, 1000.0, 9.81
SHEAR = YOUNG / 3.0  # nu = 1/2


def cantilever(edges: int, young: float = YOUNG) -> rn.Robot:
    """Horizontal rod ``rod`` along x, clamped at x = 0, under gravity."""
    fig = rn.StickFigure()
    material = rn.Material(E=young, nu=0.5, rho=DENSITY)
    fig.rod("rod", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=material, radius=RADIUS)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(g=GRAVITY), rn.Clamp(at="rod.start")]
    return rn.Robot(fig.build(), terms)


def tip(sim: rn.Simulation) -> np.ndarray:
    """Position of the free end [m], shape (3,)."""
    node = sim.model.graph.node_count - 1
    return sim.state.q[3 * node : 3 * node + 3].copy()


def chain(nodes: int) -> rn.Robot:
    """One rod of 1 cm edges, clamped at its start, under gravity and drag."""
    fig = rn.StickFigure()
    points = [(0, 0, 0), (0.01 * (nodes - 1), 0, 0)]
    fig.rod("rod0", points, edges=nodes - 1, material=_rubber(), radius=2e-3)
    return _in_grains(fig)


def tree(nodes: int, branch: int = 33) -> rn.Robot:
    """A branching tree of 1 cm edges: each rod of ``branch`` edges ends in two more, to about so many nodes."""
    rng = np.random.default_rng(1)
    fig = rn.StickFigure()
    ends: list[np.ndarray] = []
    directions: list[np.ndarray] = []
    for k in range(max(1, round((nodes - 1) / branch))):
        parent = (k - 1) // 2
        start: Any = f"rod{parent}.end" if k else (0.0, 0.0, 0.0)
        direction = directions[parent] + 0.7 * rng.standard_normal(3) if k else np.array([1.0, 0.0, 0.0])
        directions.append(direction / np.linalg.norm(direction))
        ends.append((ends[parent] if k else 0.0) + 0.01 * branch * directions[k])
        fig.rod(f"rod{k}", [start, tuple(ends[k])], edges=branch, material=_rubber(), radius=2e-3)
    return _in_grains(fig)


def _rubber() -> rn.Material:
    return rn.Material(E=1e7, nu=0.5, rho=1000.0)


def _in_grains(fig: rn.StickFigure) -> rn.Robot:
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), drag, rn.Gravity(), rn.Clamp(at="rod0.start")]
    return rn.Robot(fig.build(), terms)


def grid(side: int, spacing: float = 0.02) -> rn.Robot:
    """A horizontal net of ``side`` x ``side`` welded nodes, its border held, that sags under its weight."""
    fig = rn.StickFigure()
    material = rn.Material(E=1e7, nu=0.5, rho=1000.0)
    for i in range(side):
        points = [(spacing * i, spacing * j, 0.0) for j in range(side)]
        fig.rod(f"x{i}", points, material=material, radius=1e-3)
    for j in range(side):
        points = [f"x{i}:{j}" for i in range(side)]
        fig.rod(f"y{j}", points, material=material, radius=1e-3)
    border = [f"x{i}:{j}" for i in range(side) for j in range(side) if {i, j} & {0, side - 1}]
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Hinge(at=border)]
    return rn.Robot(fig.build(), terms)


def swimmer(tails: int, drag: rn.Term | None = None) -> rn.Robot:
    """The paper's robot at 100 rpm, with another drag law on its tails if one is given."""
    robot = rn.robots.flagellated(n_tails=tails, rpm=100.0)
    if drag is None:
        return robot
    terms = [drag if term.name == "drag" else term for term in robot.terms]
    return rn.Robot(robot.graph, terms, robot.sensors)


def tail_drag(viscosity: float = 6.828, length: float = 0.111, radius: float = 3.2e-3) -> tuple[float, float]:
    """Coefficients of the paper's drag along and across a tail [Pa s] (Gray and Hancock 1955)."""
    log = math.log(2.0 * length / radius)
    return 2.0 * math.pi * viscosity / (log - 0.5), 4.0 * math.pi * viscosity / (log + 0.5)
