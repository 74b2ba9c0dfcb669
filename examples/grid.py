"""A net of welded rods under its own weight: a graph full of loops, held at its corners or along its rim.

``python examples/grid.py`` hangs a net of 60 by 60 rods and prints how deep it sags, what holds it, and
what it took to find that out; with ``--out net.png`` it draws the net.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import rodnet as rn

PITCH, RADIUS = 0.02, 1e-3  # of the rods [m]
NYLON = rn.Material(E=2e9, nu=0.4, rho=1150.0)


def draw(rods: int, edges: int) -> rn.RodGraph:
    """Square net of so many rods each way, with ``edges`` edges from crossing to crossing."""
    figure = rn.StickFigure()
    s = PITCH / edges * np.arange((rods - 1) * edges + 1)
    for k in range(rods):
        line = np.stack([s, np.full_like(s, k * PITCH), np.zeros_like(s)], axis=1)
        figure.rod(f"x{k}", line, material=NYLON, radius=RADIUS)
    for k in range(rods):
        points: list[Any] = [(k * PITCH, y, 0.0) for y in s]
        points[::edges] = [f"x{row}:{k * edges}" for row in range(rods)]
        figure.rod(f"y{k}", points, material=NYLON, radius=RADIUS)
    return figure.build()


def hang(rods: int = 60, edges: int = 1, held: str = "corners") -> tuple[rn.Trajectory, float]:
    """Let the net sag; return its equilibrium and the seconds that it took to find it."""
    first, last = "0", str(rods - 1)
    where = {
        "rim": [axis + k for axis in "xy" for k in (first, last)],
        "corners": [f"x{k}.{end}" for k in (first, last) for end in ("start", "end")],
    }[held]
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Hinge(at=where, name="support")]
    robot = rn.Robot(draw(rods, edges), terms)
    begin = time.perf_counter()
    return rn.equilibrium(robot), time.perf_counter() - begin


def picture(traj: rn.Trajectory, path: str) -> None:
    """Draw the net as it hangs."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    for rod in traj.rods.values():
        axes.plot(*traj.x[-1, rod.nodes].T, color="tab:blue", linewidth=0.6)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_aspect("equal")
    figure.savefig(path, dpi=150)


def main(arguments: list[str] | None = None) -> list[dict[str, float]]:
    """Hang the net in both ways and return what is printed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rods", type=int, default=60, help="rods each way")
    parser.add_argument("--edges", type=int, default=1, help="edges from crossing to crossing")
    parser.add_argument("--out", help="picture of the net held at its corners")
    options = parser.parse_args(arguments)
    if options.rods < 2 or options.edges < 1:
        parser.error("a net needs --rods of 2 or more, and --edges of 1 or more")
    if options.out and not Path(options.out).parent.is_dir():
        parser.error(f"there is no directory {Path(options.out).parent} for --out {options.out}")
    results = []
    for held in ("rim", "corners"):
        traj, seconds = hang(options.rods, options.edges, held)
        graph = traj.robot.graph  # type: ignore[union-attr]
        support, weight = traj.reactions["support"], 9.81 * graph.node_mass.sum()
        results.append(
            {
                "nodes": graph.node_count,
                "sag": -float(traj.x[-1, :, 2].min()),
                "weight": float(weight),
                "lift": float(support.force[-1, 2]),
                "largest": float(np.linalg.norm(support.nodal[-1], axis=1).max()),
                "iterations": traj.stats["iterations"],
            }
        )
        print(
            "held at its {0}: {nodes} nodes sag by {sag:.4f} m; the supports carry {lift:.4f} N of {weight:.4f} N, "
            "one of them pulls with {largest:.4f} N; {iterations} iterations in {1:.1f} s".format(
                held, seconds, **results[-1]
            )
        )
    if options.out:
        picture(traj, options.out)
    return results


if __name__ == "__main__":
    main()
