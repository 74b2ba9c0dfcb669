"""Robots of every kind: a linkage of hinges, a ring, a tree of branches on branches, a tapered whip.

``python examples/every_kind.py`` measures each against what is known on paper. With ``--out FOLDER`` it also
writes each as a file that ``rodnet run FOLDER/tree.toml`` simulates, and draws it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import rodnet as rn

RUBBER = rn.Material(E=1.2e6, nu=0.5, rho=1100.0)
STEEL = rn.Material(E=2e11, nu=0.3, rho=7800.0)
WOOD = rn.Material(E=8e9, nu=0.3, rho=700.0)


def elastic() -> list[rn.Term]:
    """The physics of every rod."""
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


# -- a linkage --------------------------------------------------------------------------------
CRANK, COUPLER, ROCKER, GROUND = 0.04, 0.1, 0.08, 0.09


def linkage() -> rn.Robot:
    """A four-bar linkage: a servo turns the crank all round, the rocker swings to and fro."""
    crank = np.array([-CRANK, 0.0, 0.0])  # drawn pointing away from the rocker
    reach = GROUND + CRANK
    along = (reach**2 + COUPLER**2 - ROCKER**2) / (2 * reach)
    knee = crank + np.array([along, 0.0, np.sqrt(COUPLER**2 - along**2)])
    bar: dict[str, Any] = {"material": STEEL, "radius": 1.5e-3, "edges": 4}
    fig = rn.StickFigure()
    fig.rod("ground", [(0, 0, 0), (GROUND, 0, 0)], **bar)
    fig.rod("crank", ["ground.start", crank], **bar)
    fig.rod("coupler", ["crank.end", knee], **bar)
    fig.rod("rocker", ["coupler.end", "ground.end"], **bar)
    fig.joint("ground.start", kind="hinge", axis=(0, -1, 0), of="crank", stiffness=50.0)
    for node in ("crank.end", "coupler.end", "rocker.end"):
        fig.joint(node, kind="hinge", axis=(0, -1, 0))
    motor = rn.Motor(at="ground.start", rpm=60.0)
    return rn.Robot(fig.build(), [*elastic(), motor, rn.Clamp(at="ground"), rn.Gravity()])


def swing_of_the_rocker() -> dict[str, float]:
    """Angle between the rocker's ends of travel [deg], where crank and coupler are in line."""
    traj = rn.Simulation(linkage(), 5e-3).run(1.0)
    arm = traj.at("rocker.start") - traj.at("rocker.end")
    angle = np.degrees(np.arctan2(arm[:, 2], arm[:, 0]))

    def limit(reach: float) -> float:
        return np.degrees(np.arccos((GROUND**2 + ROCKER**2 - reach**2) / (2 * GROUND * ROCKER)))

    return {"found": float(np.ptp(angle)), "theory": limit(COUPLER + CRANK) - limit(COUPLER - CRANK)}


# -- a ring -----------------------------------------------------------------------------------
RADIUS, THICK = 0.05, 1.5e-3


def ring(edges: int = 64, load: float = 1e-4) -> rn.Robot:
    """A rubber ring, naturally round, pulled apart (pushed together, it would turn round first)."""
    angle = 2.0 * np.pi * np.arange(edges) / edges
    circle = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    fig = rn.StickFigure()
    fig.rod("ring", circle, closed=True, material=RUBBER, radius=THICK)
    pull = [
        rn.PointForce(at="ring:0", force=(load, 0, 0), name="right"),
        rn.PointForce(at=f"ring:{edges // 2}", force=(-load, 0, 0), name="left"),
    ]
    return rn.Robot(fig.build(), [*elastic(), *pull])


def pull_of_the_ring(load: float = 1e-4) -> dict[str, float]:
    """What the loaded points move apart [mm]: (pi/4 - 2/pi) P R^3 / EI for small loads."""
    traj = rn.equilibrium(ring(load=load))
    width = (traj.at("ring:0") - traj.at("ring:32"))[-1, 0]
    EI = RUBBER.E * np.pi / 4.0 * THICK**4
    theory = (np.pi / 4.0 - 2.0 / np.pi) * load * RADIUS**3 / EI
    return {"found": 1e3 * (width - 2.0 * RADIUS), "theory": 1e3 * theory}


# -- a tree -----------------------------------------------------------------------------------
def tree(levels: int = 4) -> rn.Robot:
    """Branches on branches, each tapered; forks are as stiff as living wood lets them be."""
    fig = rn.StickFigure()
    rng = np.random.default_rng(7)

    def grow(
        name: str, start: Any, base: np.ndarray, way: np.ndarray, length: float, r: float, level: int
    ) -> None:
        tip = base + length * way
        fig.rod(name, [start, tip], edges=6, material=WOOD, radius=rn.Taper(r, 0.6 * r))
        if level == 0:
            return
        side = np.cross(way, rng.normal(size=3))
        side /= np.linalg.norm(side)
        for k, turn in enumerate((0.45, -0.55)):
            outward = np.cos(turn) * way + np.sin(turn) * side
            grow(f"{name}{k}", f"{name}.end", tip, outward, 0.7 * length, 0.5 * r, level - 1)

    up = np.array([0.0, 0.0, 1.0])
    grow("t", (0.0, 0.0, 0.0), np.zeros(3), up, 1.0, 0.02, levels - 1)
    for name in list(fig.specs):
        twigs = [f"{name}{k}" for k in "01" if f"{name}{k}" in fig.specs]
        if twigs:
            stiffness = 5e7 * fig.specs[twigs[0]].sections[0].radius ** 3
            fig.joint(f"{name}.end", kind="elastic", of=twigs, stiffness=stiffness)
    wind = rn.PointForce(at="t*.end", force=(0.05, 0.0, 0.0), name="wind")
    return rn.Robot(fig.build(), [*elastic(), rn.Gravity(), wind, rn.Clamp(at="t.start", name="soil")])


def weight_of_the_tree() -> dict[str, float]:
    """What the soil carries [N]: the weight of cones, whatever the wind does."""
    traj = rn.equilibrium(tree())
    cones = [(0.7**k, 0.02 * 0.5**k, 2**k) for k in range(4)]  # length, radius, number
    volume = sum(n * np.pi / 3.0 * l * r**2 * (1.0 + 0.6 + 0.36) for l, r, n in cones)
    return {"found": float(traj.reactions["soil"].force[-1, 2]), "theory": 9.81 * WOOD.rho * volume}


# -- a whip -----------------------------------------------------------------------------------
LENGTH, ROOT, TIP = 0.3, 4e-3, 1e-3


def whip(edges: int = 60, load: float = 2e-5) -> rn.Robot:
    """A cone of rubber, clamped at its thick end, loaded at its tip."""
    fig = rn.StickFigure()
    fig.rod("whip", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=RUBBER, radius=rn.Taper(ROOT, TIP))
    force = rn.PointForce(at="whip.end", force=(0, 0, -load))
    return rn.Robot(fig.build(), [*elastic(), force, rn.Clamp(at="whip.start")])


def sag_of_the_whip(load: float = 2e-5) -> dict[str, float]:
    """Deflection of the tip [mm]: 4 P L^3 / (3 pi E R^3 r)."""
    found = -rn.equilibrium(whip(load=load)).at("whip.end")[-1, 2]
    theory = 4.0 * load * LENGTH**3 / (3.0 * np.pi * RUBBER.E * ROOT**3 * TIP)
    return {"found": 1e3 * float(found), "theory": 1e3 * theory}


KINDS: dict[str, tuple[Callable[[], rn.Robot], Callable[[], dict[str, float]], str]] = {
    "linkage": (linkage, swing_of_the_rocker, "swing of the rocker [deg]"),
    "ring": (ring, pull_of_the_ring, "pull of the ring [mm]"),
    "tree": (tree, weight_of_the_tree, "weight of the tree [N]"),
    "whip": (whip, sag_of_the_whip, "sag of the whip [mm]"),
}


def main(arguments: list[str] | None = None) -> dict[str, dict[str, float]]:
    """Measure every robot; return what is printed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="folder for a file and a picture of each")
    out = parser.parse_args(arguments).out
    results = {}
    for name, (build, measure, label) in KINDS.items():
        results[name] = found = measure()
        print(f"{label:28} {found['found']:10.4f}   on paper {found['theory']:10.4f}")
        if out is not None:
            robot = build()
            robot.save(out / f"{name}.toml")
            rn.viz.plot_shapes(rn.Simulation(robot, 0.01).run(0.3), out / f"{name}.png")
    return results


if __name__ == "__main__":
    main()
