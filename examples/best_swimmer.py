"""The best speed and stiffness: the most advance per torque, by a library's optimiser on top of sweeps.

    python examples/best_swimmer.py [--out DIR] [--workers 2] [--quick]

The efficiency of the flagellated robot is that of the paper, eta = 6 pi C1 mu a^2 v / (8 pi C2 mu a^3 omega_h). A
coarse sweep over the motor's speed and the tails' Young's modulus finds where to begin; from its two best
points Nelder and Mead's method (SciPy) goes on. Every evaluation is a point of a sweep, so nothing is computed
twice, and an interrupted search goes on where it stopped.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import rodnet as rn

RPM, E = (40.0, 300.0), (0.4e6, 4.0e6)  # bounds of the search [rpm], [Pa]


def build(rpm: float, E: float) -> rn.Robot:
    return rn.robots.flagellated(2, rpm, E=E)


def simulate(robot: rn.Robot) -> rn.Trajectory:
    """Run until the motion is steady, which takes the longer the softer the tails, and for 12 motor turns more."""
    parameters = robot.parameters
    settling = 24.0 * max(1.2e6 / parameters["tail0.E"].value, 1.0)
    sim = rn.Simulation(robot, dt=0.01, stepper="sdirk2", adaptive=0.03)
    return sim.run(settling + 12 * 60.0 / parameters["motor.rpm"].value, save_every=1)


def evaluate(points, out: Path, **options):
    """Measure all points of a grid, or of samples."""
    return rn.sweep(build, points, rn.robots.flagellated_metrics, simulate=simulate, out=out, **options)


def search(start: dict[str, float], out: Path, tolerance: float) -> tuple[dict[str, float], float, int]:
    """Climb from a point; return the best one, its efficiency, and the number of evaluations."""
    tried = []

    def loss(z: np.ndarray) -> float:
        tried.append({"rpm": float(np.exp(z[0])), "E": float(np.exp(z[1]))})
        # a single robot is not worth another process
        return -float(evaluate(tried[-1:], out, workers=0)["efficiency"].item())

    bounds = [tuple(np.log(RPM)), tuple(np.log(E))]
    begin = np.log([start["rpm"], start["E"]])
    options = {"xatol": tolerance, "fatol": 1e-7}
    answer = minimize(loss, begin, method="Nelder-Mead", bounds=bounds, options=options)
    evaluate(list({tuple(p.values()): p for p in tried}.values()), out, workers=0)  # all of them, on disk
    return {"rpm": float(np.exp(answer.x[0])), "E": float(np.exp(answer.x[1]))}, -answer.fun, answer.nfev


def main(arguments: list[str] | None = None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("best_swimmer"), help="directory of the results")
    parser.add_argument("--workers", type=int, help="processes (default: the cores at hand)")
    parser.add_argument("--quick", action="store_true", help="a coarser sweep and search")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    count = 4 if options.quick else 6
    grid = {"rpm": np.geomspace(*RPM, count).tolist(), "E": np.geomspace(*E, count).tolist()}
    found = evaluate(grid, options.out / "grid.nc", workers=options.workers, progress=True)
    efficiency = found["efficiency"]
    low, high = float(efficiency.min()), float(efficiency.max())
    print(f"a sweep of {efficiency.size} robots: efficiencies from {low:.4f} to {high:.4f}")
    # the best point of the slow half and of the fast half of the sweep
    half = count // 2
    best = []
    for name, part in (("slow", efficiency[:half]), ("fast", efficiency[half:])):
        at = part.stack(point=("rpm", "E")).idxmax("point").item()
        start = {"rpm": float(at[0]), "E": float(at[1])}
        point, value, tried = search(start, options.out / f"{name}.nc", 0.1 if options.quick else 0.01)
        ratio = point["rpm"] / (1e-6 * point["E"])
        print(
            f"from {start['rpm']:5.1f} rpm, {1e-6 * start['E']:.2f} MPa: efficiency {value:.5f} at "
            f"{point['rpm']:5.1f} rpm, {1e-6 * point['E']:.3f} MPa, {ratio:.1f} rpm/MPa ({tried} evaluations)"
        )
        best.append((point, value))
    print(
        "Where drag and elasticity rule, a robot of twice the stiffness does in half the time what the softer one\n"
        "does: the efficiency depends on rpm / E alone, and the best speed and stiffness are a line. What else the\n"
        "robot has to do decides where on it: the speed of advance goes with rpm, the torque of the motor with E."
    )
    return best


if __name__ == "__main__":
    main()
