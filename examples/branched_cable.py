"""A branched cable carried by two grippers that lift it, turn it and bring it to another place.

``python examples/branched_cable.py`` holds a cable with two branches at both ends of its trunk, by position
and orientation, carries it along a smooth path while one gripper turns half round, and prints what the
grippers feel. It writes ``branched_cable.png`` and ``branched_cable.rrd`` (view: ``rodnet view``) to ``--out``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import rodnet as rn

TRUNK, BRANCH, RADIUS = 0.8, 0.25, 3e-3  # m
RUBBER = rn.Material(E=8e6, nu=0.45, rho=1100.0)
CARRY, REST = 2.0, 3.0  # s
SHIFT = np.array([0.1, 0.4, 0.2])  # of both grippers [m]
CLOSER = 0.2  # how much closer the grippers come [m]
TURN = np.pi  # of the right gripper about the trunk [rad]


def progress(t: float) -> float:
    """From 0 to 1 with continuous acceleration."""
    s = min(max(t / CARRY, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def left(t: float) -> np.ndarray:
    """Displacement of the left gripper [m]."""
    s = progress(t)
    return s * SHIFT + np.array([0.5 * CLOSER * s, 0.0, 0.15 * np.sin(np.pi * s)])


def right(t: float) -> np.ndarray:
    """Displacement of the right gripper [m]."""
    s = progress(t)
    return s * SHIFT + np.array([-0.5 * CLOSER * s, 0.0, 0.15 * np.sin(np.pi * s)])


def turning(t: float) -> np.ndarray:
    """Orientation of the right gripper, as a quaternion (x, y, z, w)."""
    return Rotation.from_rotvec([TURN * progress(t), 0.0, 0.0]).as_quat()


def build(edges: int) -> rn.Robot:
    """A trunk along x with two branches, one of them thinner."""
    figure = rn.StickFigure()
    figure.rod("trunk", [(0, 0, 0), (TRUNK, 0, 0)], edges=edges, material=RUBBER, radius=RADIUS)
    for name, share, side, radius in (("near", 3, 1.0, RADIUS), ("far", 5, -1.0, 0.7 * RADIUS)):
        node = edges * share // 8
        root = np.array([TRUNK * node / edges, 0.0, 0.0])
        tip = root + BRANCH * np.array([0.6, 0.8 * side, 0.0])
        figure.rod(name, [f"trunk:{node}", tuple(tip)], edges=edges // 3, material=RUBBER, radius=radius)
    last = f"trunk:{edges - 1}-{edges}"
    terms = [
        rn.Stretching(),
        rn.Bending(),
        rn.Twisting(),
        rn.Gravity(),
        rn.KelvinVoigt(stretch=5e-3, bend=5e-3, twist=5e-3),
        rn.MassDamping(rate=3.0),
        rn.PrescribedMotion(at="trunk:0-1", position=left, orientation=lambda t: np.eye(3), name="left"),
        rn.PrescribedMotion(at=last, position=right, orientation=turning, name="right"),
    ]
    return rn.Robot(figure.build(), terms)


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Carry the cable; return what the grippers feel."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--edges", type=int, default=32, help="edges of the trunk, a multiple of 8")
    parser.add_argument("--dt", type=float, default=0.01, help="time step [s]")
    parser.add_argument("--out", default=".", help="directory of the picture and the recording")
    options = parser.parse_args(arguments)
    robot = build(options.edges)
    sim = rn.Simulation(robot, options.dt, stepper="sdirk2")
    sagging = rn.equilibrium(robot).state()  # the grippers begin with the cable at rest
    sim.restore(sagging)
    traj = sim.run(CARRY + REST, progress=sys.stderr.isatty())
    grips = {name: traj.reactions[name] for name in ("left", "right")}
    weight = 9.81 * robot.graph.node_mass.sum()
    result = {
        "weight_N": float(weight),
        "lift_N": float(sum(g.force[-1, 2] for g in grips.values())),
        "peak_N": float(max(np.linalg.norm(g.force, axis=1).max() for g in grips.values())),
        "torque_mNm": 1e3 * float(grips["right"].moment[-1, 0]),
        "turned_deg": float(np.degrees(np.abs(traj.theta[-1, robot.graph.edge_indices("trunk")]).max())),
        "speed_mm_s": 1e3 * float(np.linalg.norm(traj.v[-1], axis=1).max()),
    }
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    rn.viz.plot_shapes(traj, out / "branched_cable.png")
    rn.viz.log_rerun(traj, out / "branched_cable.rrd")
    print(f"{robot.graph}")
    print(
        "the grippers carry {lift_N:.3f} N of {weight_N:.3f} N in the end, and {peak_N:.3f} N at most, one of them; "
        "torque {torque_mNm:.2f} mN m after half a turn".format(**result)
    )
    print(f"written: {out / 'branched_cable.rrd'} (view: rodnet view) and {out / 'branched_cable.png'}")
    return result


if __name__ == "__main__":
    main()
