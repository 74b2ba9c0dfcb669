"""The paper's robot where grains jam: four tails stop and slip, two advance steadily, and slow motors move nothing.

    python examples/jamming_robot.py [--out DIR] [--quick | --convergence]

Needs the plug-in: python -m pip install -e plugins/rodnet-jamming. What is measured in grains is in Fig. 4 (b, c) of
Du et al. and in their text: n = 2 at 250 rpm is steady, n = 4 at 208 rpm is not, nothing moves below about 50 rpm.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import rodnet as rn

try:
    from rodnet_jamming import intermittency, jamming_robot
except ImportError:
    raise SystemExit("this needs the plug-in: python -m pip install -e plugins/rodnet-jamming") from None

matplotlib.use("Agg")
import matplotlib.pyplot as plt

CASES = {(2, 250.0): "steady", (4, 208.0): "stick-slip"}
DT = 0.04  # [s]
BEGIN = 10.0  # from here on motion is evaluated [s]


def advance(traj: rn.Trajectory) -> np.ndarray:
    """Distance of the head from its start along the robot's first axis [m]."""
    x = traj.x[:, traj.rods["head"].nodes[1], 0]
    return x - x[0]


def threshold(speeds: list[float], edges: int) -> tuple[np.ndarray, np.ndarray]:
    """Speeds of two tails [m/s] with the yield stress of the grains, and in resistive force theory."""
    found = [
        [
            float(np.gradient(advance(traj), traj.t)[-1])
            for rpm in speeds
            for traj in [
                rn.Simulation(jamming_robot(2, rpm, jam=jam, edges=edges), DT).run(12.0, save_every=5)
            ]
        ]
        for jam in (True, False)
    ]
    return np.array(found[0]), np.array(found[1])


def convergence() -> None:
    """Print how stops and slips of four tails depend on the mesh and the time step."""
    print(f"{'edges':>6}{'dt':>8}{'speed':>13}{'stopped':>9}{'slips every':>13}{'a slip is':>12}")
    for edges, dt in ((14, DT), (20, DT), (27, DT), (27, DT / 2), (40, DT), (54, DT)):
        robot = jamming_robot(4, 208.0, edges=edges)
        traj = rn.Simulation(robot, dt).run(130.0, save_every=round(0.2 / dt))
        found, late = intermittency(traj, start=BEGIN), traj.t >= BEGIN
        v, t = np.gradient(advance(traj), traj.t)[late], traj.t[late]
        slips = t[1:][(v[1:] > 5e-4) & (v[:-1] <= 5e-4)]  # faster than two tails at 250 rpm: a slip
        way = np.ptp(advance(traj)[late]) / len(slips)
        print(
            f"{edges:6d}{dt:6g} s{1e3 * found.speed:8.3f} mm/s{found.stopped:9.0%}"
            f"{np.diff(slips).mean():11.1f} s{1e3 * way:9.2f} mm",
            flush=True,
        )


def draw(runs: dict, speeds: list[float], moved: tuple[np.ndarray, np.ndarray], file: Path) -> None:
    """Draw the positions, the jam that four tails have left, and the threshold."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 3.8), layout="constrained")
    for (n, rpm), traj in runs.items():
        left.plot(traj.t, 1e3 * advance(traj), label=f"n = {n}, {rpm:g} rpm")
    left.set(xlabel="time [s]", ylabel="position [mm]")
    left.legend()
    traj = runs[4, 208.0]
    cells, memory = traj.medium("jam")
    shown = memory[:, 0] > 0.02
    dots = middle.scatter(
        *(1e3 * cells[shown, :2].T), c=memory[shown, 0], s=25, cmap="inferno_r", vmin=0.0, vmax=1.0
    )
    for rod in traj.rods.values():
        middle.plot(*(1e3 * traj.x[-1, rod.nodes, :2].T), color="tab:blue", lw=1)
    middle.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="jam after the last step, n = 4")
    figure.colorbar(dots, ax=middle, label="J", shrink=0.7)
    for v, label, style in zip(
        moved, ("with yield stress", "resistive force theory"), ("o-", "k:"), strict=True
    ):
        right.plot(speeds, 1e3 * v, style, label=label)
    right.axvline(50.0, color="0.7", lw=0.8)
    right.set(xlabel="motor [rpm], n = 2", ylabel="speed [mm/s]")
    right.legend()
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("jamming_robot"), help="directory of the results")
    parser.add_argument("--quick", action="store_true", help="shorter runs on a coarse mesh")
    parser.add_argument(
        "--convergence", action="store_true", help="how it depends on the mesh instead; minutes"
    )
    options = parser.parse_args(arguments)
    if options.convergence:
        convergence()
        return {}
    options.out.mkdir(parents=True, exist_ok=True)
    edges, duration = (14, 26.0) if options.quick else (27, 90.0)
    speeds = [40.0, 70.0] if options.quick else [30.0, 40.0, 50.0, 55.0, 60.0, 70.0, 85.0, 100.0]
    runs, result = {}, {}
    print(f"{'tails':>6}{'motor':>9}{'speed':>12}{'variation':>12}{'stopped':>9}   in the paper")
    for (n, rpm), said in CASES.items():
        traj = rn.Simulation(jamming_robot(n, rpm, edges=edges), DT).run(duration, save_every=5)
        found = intermittency(traj, start=BEGIN)
        runs[n, rpm], result[n] = traj, found
        print(
            f"{n:6d}{rpm:5g} rpm{1e3 * found.speed:7.3f} mm/s{found.variation:12.2f}{found.stopped:9.0%}   {said}"
        )
    moved = threshold(speeds, edges=10)
    print("\n   motor   speed of two tails   without yield stress")
    for rpm, with_stress, without in zip(speeds, *moved, strict=True):
        print(f"{rpm:5g} rpm{1e3 * with_stress:15.4f} mm/s{1e3 * without:18.4f} mm/s")
    result["threshold"] = dict(zip(speeds, moved[0] / moved[1], strict=True))
    draw(runs, speeds, moved, options.out / "jamming_robot.png")
    print(f"written: {options.out / 'jamming_robot.png'}")
    return result


if __name__ == "__main__":
    main()
