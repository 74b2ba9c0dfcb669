"""A robot from an STL file: a soft swimmer with a tapering tail and two whiskers, imported, equipped and run.

``python examples/robot_from_stl.py`` makes the mesh as a CAD program would, imports it, lets a wave of
bending run down the tail in a viscous liquid, and writes into ``robot_from_stl/``: the mesh
(swimmer.stl), the mesh with its rods (rods.png), the robot (robot.toml, for ``rodnet run``) and the
motion (run.rrd, for ``rodnet view``). With ``--stl FILE`` it does the same with a mesh of yours; the wave
runs along its longest limb.
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
