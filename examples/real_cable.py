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
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import rodnet as rn

NOISE = 3e-5  # white part of the markers' noise [m]; the splines of the grasps are smoothed to it


def load(path: str | Path) -> dict[str, np.ndarray]:
    """Read and check a recording; lost and suspect samples become NaN."""
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            rec = {name: file[name] for name in file.files}
    except (OSError, ValueError) as error:
        raise rn.OutputError(f"cannot read the recording '{path}': {error}") from None
    missing = {"t", "markers", "edges", "prescribed"} - set(rec)
    if missing:
        raise rn.OutputError(f"'{path}' lacks {', '.join(sorted(missing))}; it has {', '.join(rec)}")
    rec["t"] = np.asarray(rec["t"], dtype=float)
    rec["markers"] = np.array(rec["markers"], dtype=float)
    if rec["markers"].shape[:1] != rec["t"].shape or rec["markers"].ndim != 3 or rec["markers"].shape[2] != 3:
        raise rn.OutputError(f"'{path}': markers {rec['markers'].shape} do not go with t {rec['t'].shape}")
    if len(rec["t"]) < 10 or np.any(np.diff(rec["t"]) <= 0):
        raise rn.OutputError(f"'{path}': needs at least 10 frames at increasing times")
    rec["t"] -= rec["t"][0]
    rec["shown"] = rec["markers"].copy()
    if "suspect" in rec:
        rec["markers"][rec["suspect"].astype(bool)] = np.nan
    return rec


def first_frames(rec: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of the markers at t = 0, shapes (M, 3) [m], [m/s].

    From frames 0 and 1; where one of them is lost or suspect, a line through the first good ones.
    """
    t, markers = rec["t"], rec["markers"]
    position, velocity = markers[0].copy(), (markers[1] - markers[0]) / (t[1] - t[0])
    for m in np.flatnonzero(np.isnan(velocity).any(axis=1)):
        good = np.flatnonzero(np.isfinite(markers[:50, m]).all(axis=1))[:5]
        if len(good) < 2:
            raise rn.OutputError(f"marker {m} is lost for the first half second; it cannot start the cable")
        velocity[m], position[m] = np.polyfit(t[good], markers[good, m], 1)
    return position, velocity


def chains(edges: np.ndarray) -> list[list[int]]:
    """Split the marker graph into chains: a new one begins where the list of edges jumps."""
    out: list[list[int]] = []
    for i, j in edges.tolist():
        if out and out[-1][-1] == i:
            out[-1].append(j)
        else:
            out.append([i, j])
    return out


def build(
    rec: dict[str, np.ndarray],
    material: rn.Material,
    radius: float,
    damping: float,
    edges_per_metre: float = 40.0,
) -> tuple[rn.Robot, np.ndarray, np.ndarray]:
    """Return the robot, the node of each marker, and the initial node velocities [m/s]."""
    position, velocity = first_frames(rec)
    grasped = [(int(i), int(j)) for i, j in rec["edges"] if {i, j} <= set(rec["prescribed"].tolist())]
    figure = rn.StickFigure()
    reference: dict[int, str] = {}
    node_velocity: list[np.ndarray] = []
    terms: list[rn.Term] = []
    for k, chain in enumerate(chains(rec["edges"])):
        name = "cable" if k == 0 else f"branch{k}"
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position[chain], axis=0), axis=1))])
        # a grasped pair is one edge, so that the gripper holds exactly that
        counts = [
            1 if pair in grasped else max(int(np.ceil(step * edges_per_metre)), 2)
            for pair, step in zip(pairwise(chain), np.diff(s), strict=True)
        ]
        station = np.concatenate(
            [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(s[:-1], s[1:], counts, strict=True)]
        )
        station = np.append(station, s[-1])
        points: list = list(CubicSpline(s, position[chain])(station))
        speeds = CubicSpline(s, velocity[chain])(station)
        joined = chain[0] in reference
        if joined:
            points[0] = reference[chain[0]]
        node_velocity.append(speeds[1:] if joined else speeds)
        figure.rod(name, points, material=material, radius=radius, natural="straight")
        for marker, n in zip(chain, np.concatenate([[0], np.cumsum(counts)]), strict=True):
            reference.setdefault(marker, f"{name}:{n}")
    graph = figure.build()
    single = set(rec["prescribed"].tolist()) - {m for pair in grasped for m in pair}
    for i, j in grasped:
        rod, n = reference[i].split(":")
        start = rn.smooth_motion(rec["t"], rec["markers"][:, i], NOISE)
        tangent = rn.smooth_motion(rec["t"], rec["markers"][:, j] - rec["markers"][:, i], NOISE)
        end = f"{rod}:{n}-{int(n) + 1}"
        grip = rn.Grasp(
            at=end,
            position=start,
            tangent=tangent,
            twist="no-spin",
            duration=float(rec["t"][-1]),
            name=f"grasp{i}",
        )
        terms.append(grip)
    for i in sorted(single):
        path = rn.smooth_motion(rec["t"], rec["markers"][:, i], NOISE)
        origin = graph.x0[graph.node(reference[i])]
        terms.append(
            rn.PrescribedMotion(
                at=reference[i], position=lambda t, p=path, o=origin: p(t) - o, name=f"held{i}"
            )
        )
    drag = damping * material.rho * np.pi * radius**2
    robot = rn.Robot(
        graph,
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.Gravity(),
            rn.ResistiveForce(eta_t=drag, eta_n=drag, name="damping"),
            *terms,
        ],
    )
    nodes = np.array([graph.node(reference[m]) for m in range(rec["markers"].shape[1])])
    return robot, nodes, np.vstack(node_velocity)


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
        rec = load(args.file)
        material = rn.Material(E=args.E, nu=0.4, rho=args.density)
        robot, nodes, velocity = build(rec, material, args.radius, args.damping)
        sim = rn.Simulation(robot, dt=args.dt, stepper="sdirk2", velocity=velocity)
        duration = float(rec["t"][-1])
        traj = sim.run(duration, progress=sys.stderr.isatty())
    except rn.RodnetError as error:
        sys.exit(f"error: {error}")
    predicted = np.stack(
        [np.stack([np.interp(rec["t"], traj.t, traj.x[:, n, a]) for a in range(3)], axis=1) for n in nodes],
        axis=1,
    )
    distance = np.linalg.norm(predicted - rec["markers"], axis=2) * 1e3
    free = np.setdiff1d(np.arange(len(nodes)), rec["prescribed"])
    result = {
        "mean_mm": float(np.nanmean(distance[2:, free])),
        "mean_mm_first_second": float(np.nanmean(distance[2:][rec["t"][2:] <= 1.0][:, free])),
        "newton_iterations_per_step": traj.stats["iterations"] / traj.stats["steps"],
    }
    out = Path(args.out)
    stem = f"{Path(args.file).resolve().parent.name}_{Path(args.file).stem}"
    rn.viz.log_comparison(out / f"{stem}.rrd", rec["t"], rec["shown"], predicted, rec["edges"], traj)
    title = f"{stem}: mean distance {result['mean_mm']:.1f} mm over free markers"
    rn.viz.plot_comparison(
        out / f"{stem}.png", rec["t"], rec["markers"], predicted, rec["edges"], title=title, free=free
    )
    print(f"{robot.graph}")
    first = result["mean_mm_first_second"]
    print(f"mean distance over free markers: {result['mean_mm']:.1f} mm (first second {first:.1f} mm)")
    print(f"written: {out / stem}.rrd (view: rodnet view {out / stem}.rrd) and {out / stem}.png")
    return result


if __name__ == "__main__":
    main()
