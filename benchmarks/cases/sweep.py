"""Sweeps over parameters: how much faster two workers are than one, and could be."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time

from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.process import ROOT, all_cores, one_core
from benchmarks.timing import ratio, spread

TITLE = "Sweeps"

# one worker's share of the runs: it waits for the start signal, so that imports are not timed
WORKER = """
import json, sys, time
from benchmarks import modes, scenes
modes.advance(modes.simulate(scenes.swimmer(2), 0.01), 0.1)
print("ready", flush=True)
sys.stdin.readline()
start, begin = time.perf_counter(), time.process_time()
for _ in range(int(sys.argv[1])):
    modes.advance(modes.simulate(scenes.swimmer(2), 0.01), float(sys.argv[2]))
print(json.dumps([time.perf_counter() - start, time.process_time() - begin]), flush=True)
"""


SWEEP = ["sweep", "flagellated", "--set", "n_tails=2,3,4,5", "--set"]


def measure(options: Options) -> Result:
    """Measure what two processes can gain here, and what `rodnet sweep` makes of it."""
    table = Table(
        "Runs of the two-tailed robot", ["how", "wall time [s]", "times faster", "wall over processor time"]
    )
    text = (
        "The ceiling on this machine: as many runs by one process and by two, start-up excluded. Two cores that share "
        "caches, memory and a power limit are not twice as fast as one."
    )
    result = Result(TITLE, text, [table])
    runs, duration = 4, 1.0 if options.quick else 10.0
    all_cores()  # the other cases stay on one
    try:
        times: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
        for _ in range(2 if options.quick else 5):
            for workers, samples in times.items():
                samples.append(_walls(workers, runs, duration))
    finally:
        one_core()
    walls = {workers: [wall for wall, _ in samples] for workers, samples in times.items()}
    for workers, label in ((1, "one process"), (2, "two processes")):
        disturbed = spread([wall / processor for wall, processor in times[workers]])
        table.rows.append([label, spread(walls[workers]), ratio(walls[1], walls[workers]), disturbed])
    result.notes.append(
        "Wall over processor time is 1 where nothing else runs; other processes cost two most."
    )
    for seconds, rounds in ((2.0, 2),) if options.quick else ((25.0, 3), (60.0, 2)):
        samples: dict[int, list[float]] = {1: [], 2: []}
        all_cores()
        try:
            for _ in range(rounds):
                for workers, wall in samples.items():
                    wall.append(_sweep(workers, seconds, options.quick))
        finally:
            one_core()
        for workers, label in ((1, "one worker"), (2, "two workers")):
            row = [f"rodnet sweep, {seconds:g} s each, {label}", spread(samples[workers])]
            table.rows.append([*row, ratio(samples[1], samples[workers]), "-"])
    if not options.quick:  # what every command takes to start counts less the more there is to do
        value = ratio(samples[1], samples[2])["median"]
        result.demands.append(Demand("rodnet sweep, two workers over one", 1.8, value, "times", least=True))
    result.notes.append(
        "rodnet sweep is the command for 2, 3, 4 and 5 tails at 12 speeds, from its start to its end: imports, "
        "processes, journal and file included; 60 s are its default."
    )
    return result


def _sweep(workers: int, seconds: float, quick: bool) -> float:
    """Wall time of the command from its start to its end [s], with kernels that are compiled."""
    points = ["rpm=100:300:2" if quick else "rpm=25:300:12", "--duration", f"{seconds:g}"]
    with tempfile.TemporaryDirectory() as folder:
        options = [*points, "--workers", str(workers), "--out", f"{folder}/s.nc", "--no-progress"]
        command = [
            sys.executable,
            "-W",
            "ignore",
            "-c",
            "from rodnet.cli import main; main()",
            *SWEEP,
            *options,
        ]
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        }
        start = time.perf_counter()
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return time.perf_counter() - start


def _walls(workers: int, runs: int, duration: float) -> tuple[float, float]:
    """Wall time until all workers have done their shares of the runs, and processor time of the slowest [s]."""
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
        return max(tuple(json.loads(process.stdout.readline())) for process in processes)
    finally:
        for process in processes:
            process.communicate()
