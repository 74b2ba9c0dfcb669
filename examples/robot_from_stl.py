"""A robot from an STL file: a soft swimmer with a tapering tail and two whiskers, imported, equipped and run.

``python examples/robot_from_stl.py`` makes the mesh as a CAD program would, imports it, lets a wave of
bending run down the tail in a viscous liquid, and writes into ``robot_from_stl/``: the mesh
(swimmer.stl), the mesh with its rods (rods.png), mesh, rods and motion in one picture (swimmer.png), the
robot (robot.toml, for ``rodnet run``) and the motion (run.rrd, for ``rodnet view``). With ``--stl FILE`` it
does the same with a mesh of yours; the wave runs along its longest limb.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import rodnet as rn

SILICONE = rn.Material(E=1.5e6, nu=0.49, rho=1100.0)


def make_stl(path: Path) -> None:
    """Write a mesh in millimetres: three tapering limbs with round ends, united."""
    import trimesh

    limbs = []
    for end, root, tip in (((200, 0, 0), 9.0, 4.0), ((-60, 45, 15), 6.0, 2.5), ((-60, -45, 15), 6.0, 2.5)):
        balls = [trimesh.creation.icosphere(subdivisions=3, radius=r) for r in (root, tip)]
        balls[1].apply_translation(end)
        # the hull of two balls is a cone with round ends
        limbs.append(trimesh.convex.convex_hull(np.vstack([ball.vertices for ball in balls])))
    trimesh.boolean.union(limbs).export(path)


def draw(found: rn.ImportedFigure, traj: rn.Trajectory, path: Path) -> None:
    """Draw the mesh in the light, the rods found in it, and the robot at some instants, seen from above."""
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(3, 1, figsize=(7.5, 8.2), layout="constrained", height_ratios=(1, 1, 1.15))
    corners = 1e3 * found.surface.vertices[found.surface.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    from_front = np.argsort(corners[:, :, 2].mean(axis=1))
    light = np.clip(normal @ (-0.4, 0.5, 0.77), 0.0, 1.0)[from_front, None]
    paint = 0.25 + 0.75 * light * np.array([0.95, 0.72, 0.45]) + 0.1 * light**20
    shaded = mpl.collections.PolyCollection(
        corners[from_front][:, :, :2], facecolors=np.clip(paint, 0, 1), edgecolors="face", lw=0.3
    )
    axes[0].add_collection(shaded)

    def tube(ax, x: np.ndarray, radius: np.ndarray, **style) -> None:
        """Fill the outline of a rod with a radius per edge [m]."""
        r = np.interp(np.arange(len(x)), np.arange(len(radius)) + 0.5, radius)[:, None]
        along = np.gradient(x, axis=0)
        left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        ax.fill(*(1e3 * np.vstack([x + r * left, (x - r * left)[::-1]])).T, **style)

    specs = found.figure.specs
    radii = {rod: np.array([section.radius for section in specs[rod].sections]) for rod in specs}
    for k, (rod, spec) in enumerate(specs.items()):
        x = found.figure.points[spec.nodes][:, :2]
        tube(axes[1], x, radii[rod], color=f"C{k}", alpha=0.35, lw=0)
        axes[1].plot(*(1e3 * x).T, f"C{k}", marker="o", ms=3, label=f"{rod}, {len(spec.nodes) - 1} edges")
    frames = np.linspace(0, len(traj.t) - 1, 4).astype(int)
    for k in frames:
        color = mpl.colormaps["viridis"](0.9 * traj.t[k] / traj.t[-1])
        for j, rod in enumerate(specs):
            label = f"{traj.t[k]:.1f} s" if j == 0 else None
            tube(
                axes[2],
                traj.x[k, traj.rods[rod].nodes, :2],
                radii[rod],
                color=color,
                alpha=0.6,
                lw=0,
                label=label,
            )
    titles = "the mesh", "the rods found in it", "the robot swims"
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, loc="left")
        ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        ax.autoscale_view()
    axes[1].legend(fontsize=8, loc="lower right")
    axes[2].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Import, run and measure; return what is printed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stl", type=Path, help="a mesh of your own, in millimetres")
    parser.add_argument("--out", type=Path, default=Path("robot_from_stl"), help="directory of the results")
    parser.add_argument("--duration", type=float, default=4.0, help="seconds to simulate")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.stl is None:
        options.stl = options.out / "swimmer.stl"
        make_stl(options.stl)

    found = rn.from_mesh(options.stl, units="mm", material=SILICONE, edge_length=8e-3)
    print(found.report)
    rn.viz.plot_import(found, options.out / "rods.png")

    # what was imported is a stick figure like any other: name, add, join, then build
    figure = found.figure
    figure.group("whiskers", [rod.name for rod in found.report.rods[1:]])
    tail = found.report.rods[0]
    wave = rn.CurvatureWave("limb0", amplitude=4.0 / tail.length, wavelength=0.8 * tail.length, frequency=1.0)
    terms = [
        rn.Stretching(),
        rn.Bending(),
        rn.Twisting(),
        rn.ResistiveForce(viscosity=1.0, axial_torque=True),
        wave,
    ]
    robot = rn.Robot(figure.build(), terms)
    robot.save(options.out / "robot.toml")
    traj = rn.Simulation(robot, dt=1e-2).run(options.duration)
    rn.viz.log_rerun(traj, options.out / "run.rrd")
    draw(found, traj, options.out / "swimmer.png")

    mass = robot.graph.node_mass
    centre = np.einsum("tnc,n->tc", traj.x, mass) / mass.sum()
    result = {
        "rods": len(found.report.rods),
        "coverage": found.report.coverage,
        "mass": float(mass.sum()),
        "way": float(np.linalg.norm(centre[-1] - centre[0])),
    }
    print(
        "{rods} rods weigh {1:.1f} g and swim {2:.1f} mm in {0:g} s".format(
            options.duration, 1e3 * result["mass"], 1e3 * result["way"], **result
        )
    )
    return result


if __name__ == "__main__":
    main()
