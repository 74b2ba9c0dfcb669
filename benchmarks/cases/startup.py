"""Start-up: import, the first step of a run, and compilation, each in new processes."""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

from benchmarks import rivals
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.process import ROOT, ChildFailure, child

TITLE = "Start-up and compilation"

IMPORT = """
import json, sys, time
start = time.process_time()
__import__(sys.argv[1])
print(json.dumps({"processor": time.process_time() - start, "heavy": [
    name for name in ("numba", "scipy", "matplotlib", "xarray", "rerun", "trimesh") if name in sys.modules]}))
"""

# the command as a user types it, stopped after its first step
COMMAND = """
import json, os, sys, time
spawned, out = float(sys.argv[1]), sys.argv[2]
from rodnet.solve.newton import Newton
step = Newton.step
def first(self, *arguments, **options):
    result = step(self, *arguments, **options)
    print(json.dumps({"wall": time.time() - spawned, "processor": time.process_time()}), flush=True)
    os._exit(0)
Newton.step = first
from rodnet.cli import main
sys.argv = ["rodnet", "run", "flagellated", "--duration", "1", "--out", out]
main()
"""

# time of the first step less that of the second: what a cantilever compiles, or loads from a cache
FIRST = """
import json, os, sys, time
if sys.argv[1] == "rodnet":
    from benchmarks import modes, scenes
    sim = modes.simulate(scenes.cantilever(50), 0.01)
    advance = lambda: modes.advance(sim, 0.01)
else:
    from benchmarks.rivals import load
    adapter = load((sys.argv[1],))[0][0]
    rod = adapter.Cantilever(50)
    advance = lambda: rod.advance(rod.dt)
print(json.dumps({"processor": time.process_time()}), flush=True)
advance()
print(json.dumps({"processor": time.process_time()}), flush=True)
os._exit(0)
"""


def measure(options: Options) -> Result:
    """Start everything a few times."""
    repeats = 2 if options.quick else 5
    table = Table("rodnet", ["what", "seconds"])
    text = "Each in new processes. Cold: with an empty cache of compiled code; warm: with a full one."
    result = Result(TITLE, text, [table])
    samples = [child(IMPORT, "rodnet") for _ in range(repeats)]
    light = statistics.median(s["processor"] for s in samples)
    table.rows.append(["import rodnet, processor", _spread([s["processor"] for s in samples])])
    whole = [child(IMPORT, "rodnet.simulation")["processor"] for _ in range(repeats)]
    table.rows.append(["import of what a simulation needs, processor", _spread(whole)])
    heavy = samples[0]["heavy"]
    result.notes.append(f"`import rodnet` loads {', '.join(heavy) if heavy else 'no heavy package'}.")
    with tempfile.TemporaryDirectory() as out:
        _command(out)  # fills the cache, if it is not full yet
        runs = [_command(out) for _ in range(repeats)]
    table.rows.append(["rodnet run, warm, to its first step, wall", _spread([r["wall"] for r in runs])])
    table.rows.append(
        ["rodnet run, warm, to its first step, processor", _spread([r["processor"] for r in runs])]
    )
    warm = statistics.median(r["wall"] for r in runs)
    result.demands += [Demand("import rodnet", 0.4, light, "s"), Demand("rodnet run, warm", 2.0, warm, "s")]
    if not options.quick:
        with tempfile.TemporaryDirectory() as out, _nothing_compiled() as environment:
            cold = _command(out, environment)
        table.rows.append(["rodnet run, cold, to its first step, wall", cold["wall"]])
    result.tables.append(_first_steps(options, result))
    return result


@contextmanager
def _nothing_compiled():
    """Environment of a process that finds no compiled code: an install brings along what lies beside its sources."""
    with tempfile.TemporaryDirectory() as folder:
        install = Path(folder) / "install"
        shutil.copytree(ROOT / "rodnet", install / "rodnet", ignore=shutil.ignore_patterns("__pycache__"))
        yield {
            "NUMBA_CACHE_DIR": folder,
            "WARP_CACHE_PATH": folder,
            "PYTHONPATH": os.pathsep.join([str(install), str(ROOT)]),
            "PYTHONSAFEPATH": "1",  # or the current directory would come first
        }


def _command(out: str, environment: dict[str, str] | None = None) -> dict[str, float]:
    return child(COMMAND, time.time(), f"{out}/run", environment=environment)


def _first_steps(options: Options, result: Result) -> Table:
    """Processor time from nothing to a first step of the cantilever, warm and cold, in every code."""
    table = Table(
        "To the first step of the cantilever, 51 nodes, processor time with import and set-up",
        ["code", "warm [s]", "cold [s]"],
    )
    found, missing = rivals.load(options.rivals)
    names = ["rodnet"] + [adapter.__name__.rpartition(".")[2] for adapter in found]
    labels = ["rodnet"] + [adapter.LABEL for adapter in found]
    for name, label in zip(names, labels, strict=True):
        try:
            child(FIRST, name)
            warm: object = _spread(
                [child(FIRST, name)["processor"] for _ in range(1 if options.quick else 3)]
            )
            cold: object = None
            if not options.quick:
                with _nothing_compiled() as environment:
                    cold = child(FIRST, name, environment=environment)["processor"]
        except ChildFailure as failure:
            warm, cold = f"none: {failure}", None
        table.rows.append([label, warm, cold])
    table.rows += [[label, reason, None] for label, reason in missing.items()]
    return table


def _spread(values: list[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}
