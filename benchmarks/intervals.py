"""How often stated 95 % intervals hold the truth: many simulated data sets, calibrated one by one.

    python benchmarks/intervals.py [--sets 100] [--workers 1]

Cells: white and slow noise, each with all samples, and with 20 % of the markers lost and 2 % outliers. Writes
benchmarks/results/intervals.json;
a run that was interrupted goes on where it ended (intervals.jsonl).
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import rodnet as rn
from rodnet.progress import meter

TRUTH = {"cable.E": 2e6, "mass_damping.rate": 1.5}
BEGIN = {"cable.E": 2.6e6, "mass_damping.rate": 1.0}
POINTS = {"mid": "cable@50%", "tip": "cable.end"}
NOISE = {
    "white": rn.NoiseModel(white=3e-4),
    "slow": rn.NoiseModel(white=5e-5, slow=5e-4, time=0.3),
}
CELLS = [(noise, gaps) for noise in NOISE for gaps in (False, True)]
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


def held(cell, seed):
    """Whether the interval of each parameter holds the truth, and by how many standard deviations it is off."""
    noise, gaps = CELLS[cell]
    found = rn.calibrate(
        cable(BEGIN), data_set(1000 * cell + seed, noise, gaps), free=list(TRUTH), workers=0,
        observe=lambda rec, robot: rn.Markers(robot, POINTS), options={"dt": 0.01},
    )  # fmt: skip
    of = found.parameters
    inside = {p: bool(of[p].low <= v <= of[p].high) for p, v in TRUTH.items()}
    off = {p: float(np.log(of[p].value / v) / of[p].sd) for p, v in TRUTH.items()}
    return {"cell": cell, "seed": seed, "held": inside, "off": off, "variance_factor": found.variance_factor}


def summary(rows):
    """Shares by cell and pooled."""
    table = []
    for cell, (noise, gaps) in enumerate(CELLS):
        own = [row for row in rows if row["cell"] == cell]
        if not own:
            continue
        entry = {"noise": noise, "lost_and_outliers": gaps, "sets": len(own)}
        entry["held"] = {p: sum(row["held"][p] for row in own) for p in TRUTH}
        off = np.array([[row["off"][p] for p in TRUTH] for row in own])
        entry["mean_off"], entry["sd_off"] = (
            dict(zip(TRUTH, f(axis=0).tolist(), strict=True)) for f in (off.mean, off.std)
        )
        table.append(entry)
    return {"cells": table, "pooled": float(np.mean([[row["held"][p] for p in TRUTH] for row in rows]))}


def main():
    """Run what is missing of all cells, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    OUT.parent.mkdir(parents=True, exist_ok=True)
    journal = OUT.with_suffix(".jsonl")
    rows = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    done = {(row["cell"], row["seed"]) for row in rows}
    todo = [(c, s) for s in range(given.sets) for c in range(len(CELLS)) if (c, s) not in done]
    with ProcessPoolExecutor(given.workers, get_context("fork")) as executor, journal.open("a") as file:
        jobs = [executor.submit(held, *one) for one in todo]
        with meter(True, "calibrating") as show:
            for n, job in enumerate(as_completed(jobs), 1):
                rows.append(job.result())
                print(json.dumps(rows[-1]), file=file, flush=True)
                show(n / len(jobs))
    found = summary([row for row in rows if row["seed"] < given.sets])
    OUT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
