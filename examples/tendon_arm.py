"""A soft arm with four tendons leads its tip around a circle, as an arc of constant curvature would.

``python examples/tendon_arm.py`` commands the lengths that four tendons draw in, 90 degrees apart around
the arm, without and with friction at the eyelets. Without friction and weight the arm is an arc: it turns
by the drawn-in length over the tendons' offset, towards where they say. Friction eats the tension along the
arm while a tendon is drawn in, and holds it while it is let go. ``--out tendon_arm.png`` draws the arm, the
tip's path and the tensions.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import rodnet as rn

LENGTH, RADIUS, OFFSET = 0.3, 4e-3, 0.012  # of the arm, its core, and the tendons [m]
TURN = 1.0  # of the tip [rad]
PRETENSION = 0.1e-3  # length drawn in by all tendons [m]
RAMP, ROUND = 1.0, 2.0  # time to bend the arm, and of one round of the circle [s]
CORE = rn.Material(E=2e8, nu=0.45, rho=1100.0)


def bend(t: float) -> tuple[float, float]:
    """Commanded turn of the tip [rad] and its direction around the arm [rad]."""
    s = min(t / RAMP, 1.0)
    return TURN * s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 2.0 * np.pi * max(t - RAMP, 0.0) / ROUND


def arm(edges: int, friction: float) -> rn.Robot:
    """An arm along x with four tendons, named after the quarters that they bend it to."""
    figure = rn.StickFigure()
    figure.rod(
        "arm", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=CORE, radius=RADIUS, director=(0, 0, 1.0)
    )
    tendons = []
    for k in range(4):
        angle = 0.5 * np.pi * k
        route = [("arm", (OFFSET * np.cos(angle), OFFSET * np.sin(angle)))]

        def drawn(t: float, angle: float = angle) -> float:
            turn, towards = bend(t)
            return PRETENSION + OFFSET * turn * np.cos(towards - angle)

        tendons.append(
            rn.Tendon(
                route=route,
                pull=1.0,
                stiffness=2e4,
                friction=friction,
                reach=2e-4,
                schedule=drawn,
                name=f"tendon{k}",
            )
        )
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm.start")]
    damping = [rn.KelvinVoigt(bend=0.02, twist=0.02), rn.MassDamping(rate=5.0)]
    return rn.Robot(figure.build(), [*terms, *damping, *tendons])


def arcs(t: np.ndarray) -> np.ndarray:
    """Tip of an arc that turns as commanded, shape (T, 3) [m]."""
    out = []
    for time in t:
        turn, towards = bend(time)
        along = np.sinc(turn / np.pi)
        across = turn * 0.5 * np.sinc(0.5 * turn / np.pi) ** 2
        # m1 is z and m2 = t x m1 is -y
        out.append([along, -across * np.sin(towards), across * np.cos(towards)])
    return LENGTH * np.array(out)


def move(edges: int, friction: float, dt: float) -> dict[str, Any]:
    """Bend the arm, go round, and compare."""
    robot = arm(edges, friction)
    traj = rn.Simulation(robot, dt, stepper="sdirk2").run(RAMP + ROUND)
    tip, ideal = traj.at("arm.end"), arcs(traj.t)
    tensions = np.stack([t.tensions(traj) for t in robot.terms if isinstance(t, rn.Tendon)])
    circle = traj.t >= RAMP
    ratio = tensions[:, circle, -1] / tensions[:, circle, 0]
    return {
        "traj": traj,
        "tip": tip,
        "ideal": ideal,
        "tensions": tensions[..., 0],
        "error_mm": 1e3 * float(np.linalg.norm(tip - ideal, axis=1)[circle].mean()),
        "largest_N": float(tensions.max()),
        "ratio": (float(ratio.min()), float(ratio.max())),
    }


def picture(runs: dict[float, dict[str, Any]], path: str) -> None:
    """Shapes, the tip's path seen along the arm, and the tensions of the drives."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12.0, 3.8), layout="constrained")
    (plain, *_, rough), (free, *_, grip) = runs.values(), runs
    traj = rough["traj"]
    for k in range(0, int(np.searchsorted(traj.t, RAMP)) + 1, 10):
        axes[0].plot(1e3 * traj.x[k, :, 0], 1e3 * traj.x[k, :, 2], color=plt.cm.viridis(k / len(traj) * 3))
    axes[0].set(xlabel="x [mm]", ylabel="z [mm]", title="bending", aspect="equal")
    axes[1].plot(*1e3 * plain["ideal"][:, 1:].T, "k:", label="arc")
    for mu, run in ((free, plain), (grip, rough)):
        axes[1].plot(*1e3 * run["tip"][:, 1:].T, label=f"friction {mu:g}")
    axes[1].set(xlabel="y [mm]", ylabel="z [mm]", title="tip", aspect="equal")
    axes[1].legend(fontsize="small", loc="center right")
    for k, tension in enumerate(rough["tensions"]):
        axes[2].plot(traj.t, tension, label=f"tendon {k}")
    axes[2].set(xlabel="time [s]", ylabel="tension at the drive [N]", title=f"friction {grip:g}")
    axes[2].legend(fontsize="small")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> dict[float, dict[str, Any]]:
    """Run without and with friction, print and draw; return the results by coefficient of friction."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--edges", type=int, default=16, help="edges of the arm")
    parser.add_argument("--friction", type=float, default=0.2, help="coefficient of friction at the eyelets")
    parser.add_argument("--dt", type=float, default=0.02, help="time step [s]")
    parser.add_argument("--out", help="picture (.png)")
    options = parser.parse_args(arguments)
    runs = {mu: move(options.edges, mu, options.dt) for mu in (0.0, options.friction)}
    for mu, run in runs.items():
        low, high = run["ratio"]
        print(
            f"friction {mu:g}: tip {run['error_mm']:.1f} mm from the arc's on the circle; tensions up to "
            f"{run['largest_N']:.1f} N, at the anchor {low:.2f} to {high:.2f} of those at the drive"
        )
    if options.out:
        picture(runs, options.out)
    return runs


if __name__ == "__main__":
    main()
