"""The recordings that ship with the tests: ``python -m benchmarks.blind.shipped [NAME ...]`` makes them again."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.drives import drives
from benchmarks.blind.effects import EFFECTS
from benchmarks.blind.generate import CASE, RATE, Setting, write_trials
from benchmarks.blind.instruments import Instrument
from benchmarks.blind.plan import ROOT, TRIALS, generator
from benchmarks.blind.robots import machine

FOLDER = ROOT / "tests" / "data" / "blind"
SPAN, ELEMENTS, SIGMA = 2.0, 32, 2e-3
# the case is coarser than those of a set, for a diagnosis in seconds
COARSER = {"EDGES = 20": "EDGES = 12", "of 10 ms": "of 20 ms", '"dt": 0.01': '"dt": 0.02'}
# what is in them: a root that gives as much as so many metres of rod; nothing; a shear flow that pulses
CASES: dict[str, dict[str, dict[str, Any]]] = {
    "give": {"root-compliance": {"length": 0.03}},
    "nothing": {},
    "pulse": {"shear-flow": {"rate": 0.25, "pulse": 1.5}},
}


def ship(name: str, folder: Path = FOLDER) -> None:
    """Simulate and write one: the recordings in ``NAME/``, the truth in ``NAME.json``."""
    rng = generator("shipped", name)
    rods = machine("shaken", rng)
    t = np.arange(round(SPAN * RATE) + 1) / RATE
    places = [(0, (k + 1) / 8) for k in range(8)]
    there = Setting(rods, drives("shaken", rng, TRIALS), t, places)
    clean = there.simulate(CASES[name], ELEMENTS)
    camera = Instrument(SIGMA * rods.arms[0].length)
    guess = {"young": 1.08 * rods.young, "viscosity": 0.93 * rods.viscosity}
    data = folder / name
    write_trials(data, there, camera, guess, clean, list(range(len(places))), rng)
    case = CASE.read_text()
    for fine, coarse in COARSER.items():
        case = case.replace(fine, coarse)
    (data / "CASE.py").write_text(case)
    right = [list(EFFECTS[id].right) for id in CASES[name]]
    told = {
        "kind": "control" if not right else "effect" if all(right) else "outside",
        "effects": list(CASES[name]) or ["white"], "right": right, "concealed": "plain", "truth": CASES[name],
        "machine_is": {"young": rods.young, "viscosity": rods.viscosity}, "sigma_m": camera.sigma,
    }  # fmt: skip
    (folder / f"{name}.json").write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    for name in sys.argv[1:] or CASES:
        ship(name)
