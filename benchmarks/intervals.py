"""How often stated 95 % intervals hold the truth: many simulated data sets, calibrated one by one.

    python benchmarks/intervals.py [--sets 100] [--workers 2]

Cells: white and slow noise, each with all samples, and with 20 % of the markers lost and 2 % outliers. Writes
benchmarks/results/intervals.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import rodnet as rn
from rodnet.progress import meter
from rodnet.sweeps.driver import start

TRUTH = {"cable.E": 2e6, "mass_damping.rate": 1.5}
BEGIN = {"cable.E": 2.6e6, "mass_damping.rate": 1.0}
POINTS = {"mid": "cable@50%", "tip": "cable.end"}
NOISE = {
    "white": rn.NoiseModel(white=3e-4),
    "slow": rn.NoiseModel(white=5e-5, slow=5e-4, time=0.3),
}
LOST, OUTLIERS, FAR = 0.2, 0.02, 0.02  # shares; size of an outlier [m]
OUT = Path(__file__).parent / "results" / "intervals.json"


def cable(values):
    """A clamped cable that swings."""
    figure = rn.StickFigure()
    material = rn.Material(E=values["cable.E"], nu=0.5, rho=1200.0)
    figure.rod("cable", [(0, 0, 0), (0.2, 0, -0.1)], edges=4, material=material, radius=4e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="cable.start")]
    return rn.Robot(figure.build(), [*terms, rn.MassDamping(rate=values["mass_damping.rate"])])


def data_set(seed, noise, gaps):
    """One trial of the true cable."""
    rng = np.random.default_rng(seed)
    robot = cable(TRUTH)
    traj = rn.Simulation(robot, dt=0.01, stepper="sdirk2").run(0.4)
    (x,) = rn.observe(rn.Markers(robot, POINTS), traj, traj.t)
    x = x + NOISE[noise].sample(traj.t, len(POINTS), rng)
    if gaps:
        far = rng.random(x.shape[:2]) < OUTLIERS
        x[far] += FAR * rng.standard_normal((int(far.sum()), 3))
        x[rng.random(x.shape[:2]) < LOST] = np.nan
    return rn.Recording(traj.t, x, names=list(POINTS), noise=NOISE[noise])


def held(seed, noise, gaps):
    """Whether the interval of each parameter holds the truth."""
    found = rn.calibrate(
        cable(BEGIN), data_set(seed, noise, gaps), free=list(TRUTH), workers=0,
        observe=lambda rec, robot: rn.Markers(robot, POINTS), options={"dt": 0.01},
    )  # fmt: skip
    return {p: bool(found.parameters[p].low <= v <= found.parameters[p].high) for p, v in TRUTH.items()}


def main():
    """Run all cells and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    cells = [(noise, gaps) for noise in NOISE for gaps in (False, True)]
    table, total = [], []
    executor = start(given.workers, given.sets * len(cells))
    try:
        with meter(True, "calibrating") as show:
            for n, (noise, gaps) in enumerate(cells):
                jobs = [executor.submit(held, 1000 * n + seed, noise, gaps) for seed in range(given.sets)]
                hits = []
                for job in jobs:
                    hits.append(job.result())
                    show((len(total) + len(hits)) / (given.sets * len(cells)))
                total += hits
                share = {p: sum(h[p] for h in hits) for p in TRUTH}
                table.append({"noise": noise, "lost_and_outliers": gaps, "sets": given.sets, "held": share})
                print(json.dumps(table[-1]), flush=True)
    finally:
        executor.shutdown(cancel_futures=True)
    pooled = float(np.mean([[h[p] for p in TRUTH] for h in total]))
    OUT.parent.mkdir(parents=True, exist_ok=True)
    OUT.write_text(json.dumps({"cells": table, "pooled": pooled}, indent=1) + "\n", encoding="utf-8")
    print(f"pooled: {100 * pooled:.1f} % (written: {OUT})")


if __name__ == "__main__":
    main()
