"""A net of cords dropped on a tube: contact with the tube and of the cords with each other, with friction.

``python examples/net_on_tube.py`` drops a net of 9 by 9 cords across a fixed tube, prints what the tube
carries, how near the cords came to it and to each other, and what it took; with ``--out folder`` it writes
a figure and a recording for the rerun viewer.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import rodnet as rn

PITCH, RADIUS = 0.02, 1e-3  # of the cords [m]
TUBE = 0.008  # radius of the tube [m]
RUBBER = rn.Material(E=5e5, nu=0.45, rho=1100.0)
FRICTION = 0.5


def draw(cords: int, edges: int, height: float) -> rn.RodGraph:
    """Square net of so many cords each way above the tube's axis, ``edges`` edges from knot to knot."""
    figure = rn.StickFigure()
    s = PITCH / edges * np.arange((cords - 1) * edges + 1)
    middle = 0.5 * s[-1]
    turn = np.radians(20.0)  # across the tube at an angle, so that it does not drape evenly
    along, across = np.array([np.cos(turn), np.sin(turn), 0]), np.array([-np.sin(turn), np.cos(turn), 0])

    def place(a: np.ndarray, b: Any) -> np.ndarray:
        return (a[:, None] - middle) * along + (np.reshape(b, (-1, 1)) - middle) * across + (0, 0, height)

    for k in range(cords):
        figure.rod(f"x{k}", place(s, k * PITCH), material=RUBBER, radius=RADIUS)
    for k in range(cords):
        points: list[Any] = list(place(np.full_like(s, k * PITCH), s))
        points[::edges] = [f"x{row}:{k * edges}" for row in range(cords)]
        figure.rod(f"y{k}", points, material=RUBBER, radius=RADIUS)
    return figure.build()


def drop(cords: int, edges: int, duration: float, dt: float, progress: bool = False) -> rn.Trajectory:
    """Let the net fall on the tube, whose axis is the x axis."""
    air = 0.01  # drag of the surroundings [Pa s], which brings the net to rest
    terms = [
        rn.Stretching(),
        rn.Bending(),
        rn.Twisting(),
        rn.Gravity(),
        rn.ResistiveForce(eta_t=air, eta_n=air),
        rn.TubeContact(((0, 0, 0), (1, 0, 0)), TUBE, inside=False, friction=FRICTION),
        rn.RodContact(friction=FRICTION),
    ]
    robot = rn.Robot(draw(cords, edges, 4.0 * TUBE), terms)
    return rn.Simulation(robot, dt).run(duration, progress=progress)


def clearances(traj: rn.Trajectory) -> tuple[float, float]:
    """Least distance of any cord's surface from the tube, and of two cords' axes over their diameter."""
    x, edges = traj.x, traj.edges
    s = np.linspace(0.0, 1.0, 9)[:, None]
    wall = np.inf
    for state in x:
        points = state[edges[:, :1]] * (1 - s) + state[edges[:, 1:]] * s
        wall = min(wall, float(np.linalg.norm(points[..., 1:], axis=2).min()) - TUBE - RADIUS)
    bound = next(b for b in rn.Simulation(traj.robot).model.bound if b.term.name == "contact")
    near = [bound.gaps(np.ascontiguousarray(state))[1] for state in x]
    least = min((float(g.min()) for g in near if len(g)), default=np.inf)
    return wall, least


def picture(traj: rn.Trajectory, path: Path) -> None:
    """Draw the net as it falls and as it lies."""
    import matplotlib.pyplot as plt
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    figure = plt.figure(figsize=(12.0, 4.2))
    phi, z = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(-0.11, 0.11, 2))
    for k, share in enumerate((0.0, 0.35, 1.0)):
        state = round(share * (len(traj) - 1))
        axes = figure.add_axes((k / 3, 0.0, 1 / 3, 0.92), projection="3d", computed_zorder=False)
        x = traj.x[state]
        eye = np.array([np.cos(np.radians(-62.0)), np.sin(np.radians(-62.0)), 0.45])
        front = (x[traj.edges].mean(axis=1) * [0, 1, 1]) @ eye > 0.0  # before or behind the tube's axis
        for some, order in ((~front, 1), (front, 3)):
            ends = x[traj.edges[some]]
            cords = Line3DCollection(
                ends, colors="#b5540a" if order == 1 else "#f28e2b", linewidths=1.3, zorder=order
            )
            axes.add_collection3d(cords)
        tube = (z, TUBE * np.cos(phi), TUBE * np.sin(phi))
        axes.plot_surface(*tube, color="#9aa5b1", alpha=0.9, linewidth=0, zorder=2)
        axes.set(xlim=(-0.1, 0.1), ylim=(-0.09, 0.09), zlim=(-0.09, 0.05))
        axes.set_box_aspect((0.2, 0.18, 0.14), zoom=1.35)  # lengths are true
        axes.set_axis_off()
        axes.view_init(22, -62)
        figure.text((k + 0.5) / 3, 0.93, f"t = {traj.t[state]:.2f} s", ha="center", size=12)
    figure.text(
        0.5,
        0.02,
        f"net of {np.ptp(traj.x[0, :, 0]) * 1e3:.0f} mm on a tube of radius {TUBE * 1e3:g} mm",
        ha="center",
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Drop the net and return what is printed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cords", type=int, default=9, help="cords each way")
    parser.add_argument("--edges", type=int, default=2, help="edges from knot to knot")
    parser.add_argument("--duration", type=float, default=0.6, help="seconds")
    parser.add_argument("--dt", type=float, default=5e-3, help="time step [s]")
    parser.add_argument("--out", type=Path, help="folder for the figure and the recording")
    options = parser.parse_args(arguments)
    begin = time.perf_counter()
    traj = drop(options.cords, options.edges, options.duration, options.dt, progress=True)
    seconds = time.perf_counter() - begin
    wall, least = clearances(traj)
    mass = traj.robot.graph.node_mass  # type: ignore[union-attr]
    found = {
        "nodes": len(mass),
        "weight": float(9.81 * mass.sum()),
        "carried": float(traj.term_forces("tube", [-1])[0, :, 2].sum()),
        "wall": wall,
        "least": least,
        "speed": float(np.linalg.norm(traj.v[-1], axis=1).max()),
        "iterations": traj.stats["iterations"],
    }
    print(
        "{nodes} nodes; at the end the tube carries {carried:.4f} N of {weight:.4f} N and nothing moves faster than "
        "{speed:.3f} m/s; cords came within {wall:.2g} m of the tube and {least:.2g} m of each other; {iterations} "
        "iterations in {0:.1f} s".format(seconds, **found)
    )
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        picture(traj, options.out / "net_on_tube.png")
        rn.viz.log_rerun(traj, options.out / "net_on_tube.rrd")
    return found


if __name__ == "__main__":
    main()
