"""Sweeps over parameters: how much faster two workers are than one, and could be."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys

from benchmarks.cases import Options, Result, Table
from benchmarks.process import ROOT, all_cores, one_core
from benchmarks.timing import spread

TITLE = "Sweeps"

# one worker's share of the runs: it waits for the start signal, so that imports are not timed
WORKER = """
import sys, time
from benchmarks import modes, scenes
modes.advance(modes.simulate(scenes.swimmer(2), 0.01), 0.1)
print("ready", flush=True)
sys.stdin.readline()
start = time.perf_counter()
for _ in range(int(sys.argv[1])):
    modes.advance(modes.simulate(scenes.swimmer(2), 0.01), float(sys.argv[2]))
print(time.perf_counter() - start, flush=True)
"""


def measure(options: Options) -> Result:
    """Measure what two processes gain here; `rodnet.sweep` itself once rodnet has it."""
    table = Table("Runs of the two-tailed robot", ["how", "wall time [s]", "times faster"])
    text = (
        "The ceiling on this machine: as many runs by one process and by two, start-up excluded. Two cores that share "
        "caches, memory and a power limit are not twice as fast as one."
    )
    result = Result(TITLE, text, [table])
    runs, duration = 4, 1.0 if options.quick else 10.0
    all_cores()  # the other cases stay on one
    try:
        times: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(2 if options.quick else 5):
            for workers in times:
                times[workers].append(_wall(workers, runs, duration))
    finally:
        one_core()
    one, two = times[1], times[2]
    table.rows.append(["one process", spread(one), 1.0])
    gain = spread([a / b for a, b in zip(one, two, strict=True)])
    table.rows.append(["two processes", spread(two), gain])
    if importlib.util.find_spec("rodnet.sweep") is None:
        result.notes.append("This rodnet has no rodnet.sweep.")
    else:
        result.notes.append("rodnet.sweep is not measured here yet.")
    return result


def _wall(workers: int, runs: int, duration: float) -> float:
    """Wall time until all workers have done their shares of the runs [s]."""
    command = [sys.executable, "-W", "ignore", "-c", WORKER, str(runs // workers), str(duration)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    processes = [subprocess.Popen(command, **pipes) for _ in range(workers)]
    try:
        for process in processes:
            process.stdout.readline()
        for process in processes:
            process.stdin.write("go\n")
            process.stdin.flush()
        return max(json.loads(process.stdout.readline()) for process in processes)
    finally:
        for process in processes:
            process.communicate()
