"""How fast the paper's robot runs on one core, compilation excluded, and where the time goes.

Times depend on the machine and on what else it does, so each is also given as a ratio: to real time,
and to a yardstick timed beside it, `scipy.linalg.solve_banded` of the same size and bandwidth.

    python benchmarks/speed.py [--tails 2 3 5] [--repeats 5] [--json]
"""

# ruff: noqa: E402
from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy is loaded

import argparse
import cProfile
import json
import platform
import pstats
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve_banded

import rodnet as rn

DT, RPM = 0.01, 100.0
REQUIRED = 15.0  # times real time, two tails
BAND = 10  # a spring couples 11 consecutive degrees of freedom of a rod
PACKAGE = str(Path(rn.__file__).parent)


def one_core() -> str:
    """Stay on one core, where the system can be asked to."""
    if not hasattr(os, "sched_setaffinity"):
        return "not pinned"
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    return f"pinned to core {core}"


def yardstick(size: int, count: int = 60) -> float:
    """Median time of a banded solve of this size [s]."""
    rng = np.random.default_rng(0)
    bands, right = rng.standard_normal((2 * BAND + 1, size)), rng.standard_normal(size)
    bands[BAND] += 4.0 * BAND
    times = []
    for _ in range(count):
        start = time.perf_counter()
        solve_banded((BAND, BAND), bands, right)
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def stepped(sim: rn.Simulation, steps: int) -> tuple[float, int]:
    """Time of so many steps [s], and their Newton iterations."""
    iterations = 0
    start = time.perf_counter()
    for _ in range(steps):
        result = sim.step()
        iterations += result.iterations
    elapsed = time.perf_counter() - start
    if not result.ok:
        raise SystemExit(f"a step failed: {result.status.value}")
    return elapsed, iterations


def spread(values: list[float]) -> dict[str, float]:
    """Median, best and worst."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def measure(tails: int, duration: float, repeats: int) -> dict[str, Any]:
    """Time a robot, from its steady state on."""
    sim = rn.Simulation(rn.robots.flagellated(n_tails=tails, rpm=RPM), dt=DT)
    stepped(sim, 200)  # compiles, and leaves the start behind
    steps = round(duration / DT)
    step, iteration, banded, ratio = [], [], [], []
    for _ in range(repeats):
        before = yardstick(sim.model.dof_count)
        elapsed, iterations = stepped(sim, steps)
        banded.append(0.5 * (before + yardstick(sim.model.dof_count)))
        step.append(1e3 * elapsed / steps)
        iteration.append(1e3 * elapsed / iterations)
        ratio.append(iteration[-1] / (1e3 * banded[-1]))
    return {
        "tails": tails,
        "dof": sim.model.dof_count,
        "realtime_factor": spread([1e3 * DT / s for s in step]),
        "ms_per_step": spread(step),
        "ms_per_newton_iteration": spread(iteration),
        "ms_yardstick": spread([1e3 * b for b in banded]),
        "iteration_per_yardstick": spread(ratio),
        "breakdown_us_per_step": breakdown(sim),
    }


def breakdown(sim: rn.Simulation, steps: int = 500) -> dict[str, float]:
    """Time in each compiled kernel [us per step]; the rest is Python and NumPy.

    In processor time. The profiler slows Python down, not the kernels: so the rest is what they leave of
    a step without the profiler.
    """
    start = time.process_time()
    stepped(sim, steps)
    whole = time.process_time() - start
    profile = cProfile.Profile(time.process_time)
    profile.enable()
    stepped(sim, steps)
    profile.disable()
    found: dict[str, float] = {}
    for (file, _, name), (_, _, own, _, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        if file.startswith(PACKAGE) and "kernels" in Path(file).name:
            found[name] = found.get(name, 0.0) + 1e6 * own / steps
    found = dict(sorted(found.items(), key=lambda item: -item[1]))
    found["Python and NumPy"] = 1e6 * whole / steps - sum(found.values())
    return found


def show(results: list[dict[str, Any]], pinned: str) -> None:
    """Print the tables."""
    cell = lambda s, style: f"{s['median']:{style}} ({s['min']:{style}}-{s['max']:{style}})"  # noqa: E731
    print(f"dt = {DT} s, {RPM:g} rpm, {pinned}; median (lowest-highest) over repeats\n")
    print(
        f"{'tails':>5} {'dof':>4}  {'x real time':18} {'ms/step':20} {'ms/Newton iteration':20} {'per banded solve'}"
    )
    for r in results:
        print(
            f"{r['tails']:5} {r['dof']:4}  {cell(r['realtime_factor'], '.1f'):18} {cell(r['ms_per_step'], '.3f'):20} "
            f"{cell(r['ms_per_newton_iteration'], '.3f'):20} {cell(r['iteration_per_yardstick'], '.1f')}"
        )
    print("\nWhere a step's time goes [us]:")
    for name in results[0]["breakdown_us_per_step"]:
        cells = [f"{r['breakdown_us_per_step'].get(name, 0.0):8.1f}" for r in results]
        print(f"  {name:22}{''.join(cells)}")
    two = next((r for r in results if r["tails"] == 2), None)
    if two is not None:
        factor = two["realtime_factor"]["max"]  # other processes can only slow it down
        verdict = "as required" if factor >= REQUIRED else f"LESS than the required {REQUIRED:g}"
        print(f"\nAt best, two tails run {factor:.1f} times faster than real time, {verdict}.")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tails", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--duration", type=float, default=10.0, help="seconds simulated per repeat")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    pinned = one_core()
    results = [measure(tails, options.duration, options.repeats) for tails in options.tails]
    if options.json:
        system = {"python": platform.python_version(), "machine": platform.machine(), "cores": pinned}
        print(json.dumps({"dt": DT, "rpm": RPM, "required": REQUIRED, "system": system, "results": results}))
    else:
        show(results, pinned)


if __name__ == "__main__":
    main()
