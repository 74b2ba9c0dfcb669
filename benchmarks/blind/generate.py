"""Recordings of a set: machines, drives, effects as large as asked for, instruments; the truth apart."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import robots
from benchmarks.blind.effects import EFFECTS, in_engine_terms
from benchmarks.blind.instruments import Instrument, write_recording
from benchmarks.blind.plan import TRIALS, Spec, as_dict, generator

CASE = Path(__file__).parent / "cases" / "rods.py"
RATE, SPAN = 25.0, 4.0  # frames [Hz], length of a trial [s]
ELEMENTS = 40
NEAR = 0.12  # markers nearer to a hidden effect than that share of the rod's length are taken off
NUDGE = 0.03  # of a nominal parameter, for its derivative


@dataclass(frozen=True)
class Setting:
    """A machine, its drives and its markers."""

    machine: robots.Machine
    drives: list[robots.Drive]
    t: np.ndarray
    places: list[tuple[int, float]]
    engine: str = "elastica"

    def simulate(
        self, effects: dict[str, dict[str, Any]], elements: int, machine: robots.Machine | None = None
    ) -> np.ndarray:
        """The markers' true positions in all trials [m], shape (trials, T, M, 3)."""
        code = import_module(f"benchmarks.blind.{self.engine}")
        # of rodnet's own rods, twice as many edges as of Elastica's elements: four times those of the case
        count = elements if self.engine == "elastica" else 2 * elements
        machine = machine or self.machine
        rods = {k: in_engine_terms(k, v) for k, v in effects.items() if EFFECTS[k].acts == "rods"}
        lag = effects.get("record-lag", {}).get("lag", 0.0)
        found = []
        for drive in self.drives:
            moved = replace(
                drive, gain=1.0 + effects.get("drive-gain", {}).get("gain", 0.0),
                lag=effects.get("drive-lag", {}).get("lag", 0.0),
            )  # fmt: skip
            seen = code.converged(machine, moved, rods, self.t - lag, self.places, elements=count)
            found.append(_through_camera(seen, self.t, self.places, machine, effects))
        return np.array(found)


def _through_camera(
    x: np.ndarray, t: np.ndarray, places: list[tuple[int, float]], machine: robots.Machine, effects: Any
) -> np.ndarray:
    if scaled := effects.get("camera-scale"):
        x = x * (1.0 + scaled["excess"])
    if turned := effects.get("camera-rotation"):
        x = x @ robots.rotations(turned["angle"] * np.array([turned["axis"]]))[0].T
    if slip := effects.get("slipping-marker"):
        # towards the next marker on its rod, by so much of the distance
        m = slip["marker"]
        length = machine.arms[places[m][0]].length * abs(places[m + 1][1] - places[m][1])
        share = np.clip(slip["speed"] * t / length, 0.0, 1.0)[:, None]
        x = x.copy()
        x[:, m] = (1.0 - share) * x[:, m] + share * x[:, m + 1]
    return x


def setting(seed: str, spec: Spec) -> Setting:
    """Draw machine and drives."""
    rng = generator(seed, "machine", spec.family, spec.machine)
    machine = robots.machine(spec.family, rng)
    drives = robots.drives(spec.family, rng, TRIALS)
    t = np.arange(round(SPAN * RATE) + 1) / RATE
    places = [(0, (k + 1) / 8) for k in range(8)]
    for arm in range(1, len(machine.arms)):
        places += [(arm, s) for s in (1 / 3, 2 / 3, 1.0)]
    return Setting(machine, drives, t, places, spec.engine)


def generate(seed: str, spec: Spec, root: Path, elements: int = ELEMENTS) -> None:
    """Simulate and write one case: ``data/NAME`` and, last of all, ``truth/NAME.json``."""
    truth = root / "truth" / f"{spec.name}.json"
    if truth.exists():
        return
    there = setting(seed, spec)
    sigma = spec.sigma * there.machine.arms[0].length
    rng = generator(seed, "case", spec.name)
    nominal, slopes = _nominal(seed, spec, there, root, elements)
    effects = {id: EFFECTS[id].draw(rng, there.machine) for id in spec.effects if id in EFFECTS}
    kept = _kept(spec, effects, there.places)
    sizes: dict[str, float] = {}
    for id, values in effects.items():
        effects[id], sizes[id] = _sized(id, values, there, nominal, slopes, kept, spec.size * sigma, elements)
    clean = there.simulate(effects, elements) if effects else nominal
    if len(effects) == 1:
        sizes = {id: _left(clean - nominal, slopes, kept) for id in effects}
    instrument = Instrument(sigma, slow=spec.slow)
    guess = {
        "young": there.machine.young * float(np.exp(rng.normal(0.0, 0.1))),
        "viscosity": there.machine.viscosity * float(np.exp(rng.normal(0.0, 0.1))),
    }
    data = root / "data" / spec.name
    shutil.rmtree(data, ignore_errors=True)
    for k, drive in enumerate(there.drives):
        seen = instrument.see(clean[k], 1.0 / RATE, rng)[:, kept]
        write_recording(
            data / f"trial_{k}.npz", there.machine, there.t, seen, [there.places[m] for m in kept],
            instrument.drive(drive, there.t, rng), instrument, guess,
        )  # fmt: skip
    shutil.copy(CASE, data / "CASE.py")
    told = as_dict(spec) | {
        "truth": effects, "post_refit": {k: v / sigma for k, v in sizes.items()}, "sigma_m": sigma,
        "machine_is": {"young": there.machine.young, "viscosity": there.machine.viscosity,
                       "length": there.machine.arms[0].length},
        "raw": float(np.sqrt(np.mean((clean - nominal)[:, :, kept] ** 2))) / sigma,
    }  # fmt: skip
    truth.parent.mkdir(parents=True, exist_ok=True)
    truth.write_text(json.dumps(told, default=_plain, indent=1))
    np.savez_compressed(truth.with_suffix(".npz"), clean=clean[:, :, kept].astype(np.float32))


def _plain(value: Any) -> Any:
    return np.asarray(value).tolist()


def _nominal(
    seed: str, spec: Spec, there: Setting, root: Path, elements: int
) -> tuple[np.ndarray, list[np.ndarray]]:
    """What the machine does without any effect, and how that depends on what will be refitted."""
    kept = root / "machines" / f"{spec.engine}_{spec.family}_{spec.machine}_{elements}.npz"
    if not kept.exists():
        base = there.simulate({}, elements)
        slopes = [
            there.simulate(
                {}, elements, replace(there.machine, **{name: (1.0 + NUDGE) * getattr(there.machine, name)})
            )
            - base
            for name in ("young", "viscosity")
        ]
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(f".{spec.name}.npz")
        np.savez_compressed(part, base=base, slopes=np.array(slopes))
        part.replace(kept)
    with np.load(kept) as file:
        return file["base"], list(file["slopes"])


def _left(change: np.ndarray, slopes: list[np.ndarray], kept: list[int]) -> float:
    """Rms over the markers that stay on of what a refit of the nominal parameters leaves, to first order [m]."""
    A = np.stack([s[:, :, kept].ravel() for s in slopes], axis=1)
    seen = change[:, :, kept].ravel()
    left = seen - A @ np.linalg.lstsq(A, seen, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _sized(
    id: str, values: dict[str, Any], there: Setting, nominal: np.ndarray, slopes: list[np.ndarray],
    kept: list[int], size: float, elements: int,
) -> tuple[dict[str, Any], float]:  # fmt: skip
    """Parameters of an effect that leaves so much after the refit [m], and what it leaves."""
    effect, values = EFFECTS[id], dict(values)
    left = 0.0
    for _ in range(4):
        left = _left(there.simulate({id: values}, elements) - nominal, slopes, kept)
        if 0.85 < left / size < 1.2:
            break
        # close to linear in the strength; a large step is not trusted
        factor = float(np.clip(size / max(left, 1e-12), 0.1, 10.0))
        strength = float(np.clip(factor * values[effect.strength], -effect.most, effect.most))
        if strength == values[effect.strength]:
            break
        values[effect.strength] = strength
    return values, left


def _kept(spec: Spec, effects: dict[str, Any], places: list[tuple[int, float]]) -> list[int]:
    """Markers that stay on: all, or those away from the effect."""
    if spec.concealed != "away":
        return list(range(len(places)))
    local = [v["place"] for v in effects.values() if "place" in v]
    if local:
        return [m for m, (arm, s) in enumerate(places) if arm or all(abs(s - p) > NEAR for p in local)]
    return [m for m, (arm, s) in enumerate(places) if not arm and s <= 0.51]
