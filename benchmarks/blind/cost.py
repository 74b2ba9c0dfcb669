"""What a set costs, told before it is begun: CPU time of simulations, and of diagnoses as measured so far."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.blind.plan import Spec

# CPU seconds to simulate five trials at the usual mesh, measured on the machine of the benchmarks
SIMULATION = {
    ("elastica", "shaken"): 7.0,
    ("elastica", "spatial"): 7.0,
    ("elastica", "branched"): 90.0,
    ("finer", "shaken"): 37.0,
    ("finer", "spatial"): 37.0,
    ("finer", "branched"): 40.0,
    ("finer", "spun"): 9.0,
    ("finer", "tendon"): 110.0,
}
NOMINAL = 3  # simulations of a machine without the effect, two of them for derivatives
SIZING = 2.5  # of each effect, until it is as large as wanted
# CPU seconds of a diagnosis with all candidates, where none has been measured yet
DIAGNOSIS = {"effect": 900.0, "outside": 900.0, "control": 300.0, "alike": 900.0}
# of the cases end with a class, and are diagnosed again with the trial that is recommended
CLASSES = {"effect": 0.2, "alike": 0.5}


def simulations(specs: Sequence[Spec]) -> float:
    """CPU time of generating cases [s]."""
    total, machines = 0.0, set()
    for spec in specs:
        each = SIMULATION[spec.engine, spec.family]
        machine = spec.engine, spec.family, spec.machine
        if machine not in machines:
            total += each * (1 if spec.kind == "control" else NOMINAL)
            machines.add(machine)
        if spec.kind != "control":
            total += each * (SIZING * len(spec.effects) + (len(spec.effects) > 1))
    return total


def by_machine(specs: Sequence[Spec]) -> list[list[Spec]]:
    """Cases of one machine together, which share its motions without any effect; what takes longest first."""
    found: dict[tuple[object, ...], list[Spec]] = {}
    for spec in specs:
        found.setdefault((spec.engine, spec.family, spec.machine, spec.kind == "alike"), []).append(spec)
    return sorted(found.values(), key=simulations, reverse=True)


def diagnoses(specs: Sequence[Spec], sets: Path) -> tuple[float, int]:
    """CPU time of diagnosing cases [s], from those in a folder of sets, and how many those are."""
    seen: dict[str, list[float]] = {}
    for at in sets.glob("*/runs/*/diagnosis.json"):
        truth = at.parents[2] / "truth" / f"{at.parent.name}.json"
        used = json.loads(at.read_text()).get("cpu_seconds")
        if used and truth.exists():
            seen.setdefault(json.loads(truth.read_text())["kind"], []).append(used)
    each = DIAGNOSIS | {kind: sum(used) / len(used) for kind, used in seen.items()}
    total = sum(each[spec.kind] * (1.0 + CLASSES.get(spec.kind, 0.0)) for spec in specs)
    return total, sum(map(len, seen.values()))


def told(specs: Sequence[Spec], root: Path, workers: int) -> str:
    """The estimate in words, of what is left to do."""
    left = [spec for spec in specs if not (root / "truth" / f"{spec.name}.json").exists()]
    open_ = [spec for spec in specs if not (root / "runs" / spec.name / "diagnosis.json").exists()]
    making = simulations(left)
    running, measured = diagnoses(open_, root.parent)
    on = f"measured on {measured} cases" if measured else "guessed, none has been measured"
    hours = (making + running) / 3600.0
    return (
        f"{len(specs)} cases; to generate {len(left)}: about {making / 3600.0:.1f} CPU h; to diagnose {len(open_)}: "
        f"about {running / 3600.0:.1f} CPU h ({on}); together about {hours / workers:.1f} h with {workers} processes"
    )
