"""Linearity: time and memory per node of chains and trees, each in a process of its own."""

from __future__ import annotations

from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.process import ChildFailure, child
from benchmarks.timing import spread

TITLE = "Large chains and trees"
SIZES = (100, 1000, 10_000, 100_000)
KINDS = {"chain": "chain", "branched tree": "tree"}
PATIENCE = 100.0  # s per size

# what one process does; its memory is counted from where it stands after imports and compilation
CODE = """
import json, resource, sys, time
from benchmarks import modes, scenes

def memory(field):
    try:
        with open("/proc/self/status") as status:
            return next(1024 * int(line.split()[1]) for line in status if line.startswith(field))
    except OSError:  # not Linux: the peak of the whole process
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

kind, nodes, rounds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
modes.advance(modes.simulate(getattr(scenes, kind)(100), 1e-2), 2e-2)  # compiles
try:
    with open("/proc/self/clear_refs", "w") as peak:
        peak.write("5")  # the peak begins anew
except OSError:
    pass
before = memory("VmRSS")
start = time.process_time()
sim = modes.simulate(getattr(scenes, kind)(nodes), 1e-2)
setup = time.process_time() - start
steps, repeats = 3, max(1, 10_000 // nodes)
modes.advance(sim, 1e-2 * steps)
used, begin = memory("VmHWM") - before, sim.state
samples, iterations = [], 0
for _ in range(rounds):
    start, count = time.process_time(), 0
    for _ in range(repeats):  # the same steps for all sizes, or their iterations would not compare
        sim.restore(begin)
        count += modes.advance(sim, 1e-2 * steps).iterations
    samples.append((time.process_time() - start) / count)
    iterations += count
print(json.dumps({"nodes": sim.model.graph.node_count, "setup_s": setup, "samples": samples,
                  "memory": used, "fallbacks": sim.model.solver.fallbacks,
                  "per_step": iterations / (rounds * steps * repeats)}))
"""


def measure(options: Options) -> Result:
    """Measure each size in a new process."""
    sizes = SIZES[:2] if options.quick else SIZES
    rounds = 2 if options.quick else 5
    table = Table(
        "Three steps, just after rest, under gravity and drag, implicit Euler, dt = 0.01 s",
        ["graph", "nodes", "us per node and iteration", "against 1000 nodes", "iterations per step",
         "memory [kB per node]", "set-up [s]", "set-up [us per node]"],
    )  # fmt: skip
    text = (
        "Rods of 1 cm edges: one long chain, and a tree whose rods of 33 edges end in two more each. Each size runs "
        "in a process of its own. Memory is the peak, set-up included, less what the process held before."
    )
    result = Result(TITLE, text, [table])
    for label, kind in KINDS.items():
        rows = {}
        for nodes in sizes:
            try:
                rows[nodes] = child(CODE, kind, nodes, rounds, timeout=PATIENCE)
            except ChildFailure as failure:
                _add(label, rows, table, result)
                table.rows.append([label, nodes, f"none: {failure}", None, None, None, None, None])
                result.demands.append(Demand(f"{label}, {nodes} nodes done within", PATIENCE, None, "s"))
                break  # larger ones would not do better
        else:
            _add(label, rows, table, result)
    return result


def _add(label: str, rows: dict[int, dict], table: Table, result: Result) -> None:
    """Turn what the processes said into rows of the table, and demands."""
    if not rows:
        return
    times = {n: [1e6 * s / r["nodes"] for s in r["samples"]] for n, r in rows.items()}
    best = {n: min(samples) for n, samples in times.items()}  # large sizes have too few samples for a median
    reference, memory = best.get(1000), None
    for nodes, row in rows.items():
        memory = row["memory"] / row["nodes"] / 1e3
        table.rows.append(
            [
                label, row["nodes"], spread(times[nodes]), reference and best[nodes] / reference,
                row["per_step"], memory, row["setup_s"], 1e6 * row["setup_s"] / row["nodes"],
            ]
        )  # fmt: skip
        if row["fallbacks"]:
            result.notes.append(f"{label}, {row['nodes']} nodes: {row['fallbacks']} pivoted factorisations.")
    if len(rows) > 2:
        sizes = f"{min(rows)} to {max(rows)} nodes"
        value = max(best.values()) / min(best.values())
        result.demands.append(
            Demand(f"{label}, time per node, most over least of {sizes}", 1.5, value, "times")
        )
        result.demands.append(Demand(f"{label}, memory per node at {max(rows)} nodes", 4.0, memory, "kB"))
