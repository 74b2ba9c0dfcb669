"""A real cable: measured and simulated side by side.

    python examples/real_cable.py FILE.npz [--E 2e7 --radius 4e-3 --density 1100 --damping 1.0 --out DIR]

The recording (``.npz``) holds ``t`` (T,) [s], ``markers`` (T, M, 3) [m], ``edges`` (pairs of markers
joined by cable), ``prescribed`` (markers whose motion is the input) and optionally ``suspect`` (T, M).
The cable or network is built from the first frames, its grasped pairs of markers are moved as measured,
and the rest is predicted. Nothing is fitted: stiffness and damping are arguments.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import rodnet as rn
from rodnet.robots import Cables


def build(cables: Cables, E: float, radius: float, density: float, damping: float) -> rn.Robot:
    """Return the cables as they hang in their grippers, straight where nothing bends them."""
    return rn.Robot(
        cables.figure(rn.Material(E=E, nu=0.4, rho=density), radius).build(),
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.Gravity(),
            rn.MassDamping(rate=damping),
            *cables.held(),
        ],
    )


def main(argv: list[str] | None = None) -> dict[str, float]:
    """Simulate one recording; return the mean distance over free markers [mm]."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", help="recording (.npz)")
    parser.add_argument("--E", type=float, default=2e7, help="Young's modulus [Pa]")
    parser.add_argument("--radius", type=float, default=4e-3, help="radius [m]")
    parser.add_argument("--density", type=float, default=1100.0, help="density [kg/m^3]")
    parser.add_argument("--damping", type=float, default=1.0, help="mass-proportional damping rate [1/s]")
    parser.add_argument("--dt", type=float, default=5e-3, help="time step [s]")
    parser.add_argument("--out", default="real_cable", help="directory for the .rrd and the .png")
    args = parser.parse_args(argv)
    try:
        rec = rn.read_recording(args.file)
        cables = Cables(rec, edges_per_metre=40.0)
        robot = build(cables, args.E, args.radius, args.density, args.damping)
        sim = rn.Simulation(robot, dt=args.dt, stepper="sdirk2", velocity=cables.velocity)
        traj = sim.run(rec.duration, progress=sys.stderr.isatty())
    except rn.RodnetError as error:
        sys.exit(f"error: {error}")
    t = rec.t - rec.t[0]
    (predicted,) = rn.observe(rn.Markers(robot, cables.points), traj, t)
    distance = np.linalg.norm(predicted - rec.trusted, axis=2)[2:, rec.free] * 1e3
    result = {
        "mean_mm": float(np.nanmean(distance)),
        "mean_mm_first_second": float(np.nanmean(distance[t[2:] <= 1.0])),
        "newton_iterations_per_step": traj.stats["iterations"] / traj.stats["steps"],
    }
    out = Path(args.out)
    stem = f"{Path(args.file).resolve().parent.name}_{Path(args.file).stem}"
    rn.viz.log_comparison(out / f"{stem}.rrd", t, rec.markers, predicted, rec.edges, traj)
    title = f"{stem}: mean distance {result['mean_mm']:.1f} mm over free markers"
    rn.viz.plot_comparison(
        out / f"{stem}.png", t, rec.trusted, predicted, rec.edges, title=title, free=rec.free
    )
    print(f"{robot.graph}")
    first = result["mean_mm_first_second"]
    print(f"mean distance over free markers: {result['mean_mm']:.1f} mm (first second {first:.1f} mm)")
    print(f"written: {out / stem}.rrd (view: rodnet view {out / stem}.rrd) and {out / stem}.png")
    return result


if __name__ == "__main__":
    main()
