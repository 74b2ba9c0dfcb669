"""Recordings of a set: machines, drives, effects as large as asked for, instruments; the truth apart."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.blind import drives as driving
from benchmarks.blind import robots
from benchmarks.blind.effects import EFFECTS, in_engine_terms
from benchmarks.blind.instruments import Instrument, write_recording
from benchmarks.blind.plan import ALIKE, HELD_OUT, TRIALS, Spec, as_dict, generator, made_by

CASE = Path(__file__).parent / "cases" / "rods.py"
RATE, SPAN = 25.0, 4.0  # frames [Hz], length of a trial [s]
ELEMENTS = 40
PLANNED = 6  # trials to choose the next one from
TRIES = 4  # at an effect of the wanted size
CALMER, HALVINGS = 0.5, 12  # of a strength at which a simulation blows up, so often at most
NEAR = 0.12  # markers nearer to a hidden effect than that share of the rod's length are taken off
LAST = 7  # marker of the first rod, at its end
STATIONS = 9  # along a rod, of a marker that gets elsewhere
NUDGE = 0.03  # of a nominal parameter, for its derivative


@dataclass(frozen=True)
class Setting:
    """A machine, its drives and its markers."""

    machine: robots.Machine
    drives: list[driving.AnyDrive]
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
            if isinstance(drive, driving.Drive):
                gain = 1.0 + effects.get("drive-gain", {}).get("gain", 0.0)
                drive = replace(drive, gain=gain, lag=effects.get("drive-lag", {}).get("lag", 0.0))
            ways = {id: _way(v["marker"], self.places) for id, v in effects.items() if "marker" in v}
            every = [*self.places, *(place for way in ways.values() for place in way)]
            seen = code.converged(machine, drive, rods, self.t - lag, every, elements=count)
            seen = _slipped(seen, self.t, len(self.places), ways, machine, effects)
            found.append(_through_camera(seen, machine, effects))
        return np.array(found)


def _way(marker: int, places: list[tuple[int, float]]) -> list[tuple[int, float]]:
    """Places on a rod from a marker's to its end, from which it is told where the marker gets to."""
    rod, place = places[marker]
    return [(rod, float(s)) for s in np.linspace(place, 1.0, STATIONS)]


def _slipped(
    x: np.ndarray, t: np.ndarray, count: int, ways: dict[str, list[tuple[int, float]]], machine: robots.Machine,
    effects: Any,
) -> np.ndarray:  # fmt: skip
    """The markers as they are seen, some of them elsewhere along their rods, or on their way."""
    seen, begin = x[:, :count].copy(), count
    for id, way in ways.items():
        rod, s = way[0][0], np.array([place for _, place in way])
        length, moved = machine.arms[rod].length, effects[id]
        away = np.broadcast_to(moved["along"] if "along" in moved else moved["speed"] * t, len(t))
        at = np.minimum(s[0] + away / length, 1.0)
        stations = x[:, begin : begin + len(way)]
        seen[:, moved["marker"]] = [CubicSpline(s, row)(p) for row, p in zip(stations, at, strict=True)]
        begin += len(way)
    return seen


def _through_camera(x: np.ndarray, machine: robots.Machine, effects: Any) -> np.ndarray:
    if scaled := effects.get("camera-scale"):
        x = x * (1.0 + scaled["excess"])
    if moved := effects.get("camera-shift"):
        x = x + in_engine_terms("camera-shift", moved)["shift"]
    if turned := effects.get("camera-rotation"):
        x = x @ robots.rotations(turned["angle"] * np.array([turned["axis"]]))[0].T
    if lens := effects.get("lens"):
        # what is far from the middle of the picture is seen farther off: a cushion
        length = machine.arms[0].length
        off = x - np.array([0.5 * length, 0.0, 0.0])
        x = x + lens["excess"] * np.sum((off / length) ** 2, axis=-1, keepdims=True) * off
    return x


def setting(seed: str, spec: Spec) -> Setting:
    """Draw machine and drives."""
    rng = generator(seed, "machine", *_machine(spec))
    machine = robots.machine(spec.family, rng)
    drives = (driving.alike if spec.kind == ALIKE else driving.drives)(spec.family, rng, TRIALS)
    t = np.arange(round(SPAN * RATE) + 1) / RATE
    places = [(0, (k + 1) / 8) for k in range(8)]
    for arm in range(1, len(machine.arms)):
        places += [(arm, s) for s in (1 / 3, 2 / 3, 1.0)]
    return Setting(machine, drives, t, places, spec.engine)


def _machine(spec: Spec) -> tuple[object, ...]:
    """What tells one machine with its drives from others."""
    return spec.family, spec.machine, *([ALIKE] if spec.kind == ALIKE else [])


def generate(seed: str, spec: Spec, root: Path, elements: int = ELEMENTS) -> None:
    """Simulate and write one case: ``data/NAME`` and, last of all, ``truth/NAME.json``.

    A case that was made otherwise is made anew, and what was found in it is removed.
    """
    truth = root / "truth" / f"{spec.name}.json"
    if truth.exists():
        if json.loads(truth.read_text()).get("made_by") == made_by():
            return
        truth.unlink()
        shutil.rmtree(root / "runs" / spec.name, ignore_errors=True)
    there = setting(seed, spec)
    sigma = spec.sigma * there.machine.arms[0].length
    rng = generator(seed, "case", spec.name)
    nominal, slopes = _nominal(seed, spec, there, root, elements)
    effects = {id: EFFECTS[id].draw(rng, there.machine) for id in spec.effects if id in EFFECTS}
    if "wall" in effects:  # beyond what the rods get to
        effects["wall"]["height"] += float(nominal[..., 2].max())
    if "obstacle" in effects:  # on the way up from where they begin: what they begin in is a bed of springs
        begin, tops = float(nominal[:, 0, :, 2].max()), nominal[:-HELD_OUT, ..., 2].max(axis=(1, 2))
        often = float(np.sort(tops)[-2])  # two trials to learn from get there at least
        effects["obstacle"]["height"] = begin + effects["obstacle"]["height"] * (often - begin)
    if "puddle" in effects:  # where a marker of the first rod's outer half gets to
        way = nominal[:-HELD_OUT, :, 3:8].reshape(-1, 3)
        effects["puddle"]["at"] = way[rng.integers(len(way))]
    kept = _kept(spec, effects, there.places)
    sizes: dict[str, float] = {}
    clean = nominal
    for id, values in effects.items():
        wanted = spec.size * sigma
        effects[id], clean = _sized(id, values, there, nominal, slopes, kept, wanted, elements)
        sizes[id] = left_over(clean - nominal, slopes, kept)
    if len(effects) > 1:
        clean = there.simulate(effects, elements)
        if wild(clean, there.machine):
            raise ArithmeticError(f"{' and '.join(effects)} together make a motion that is none")
    guess = {
        "young": there.machine.young * float(np.exp(rng.normal(0.0, 0.1))),
        "viscosity": there.machine.viscosity * float(np.exp(rng.normal(0.0, 0.1))),
    }
    camera = Instrument(sigma, slow=spec.slow)
    data = root / "data" / spec.name
    shutil.rmtree(data, ignore_errors=True)
    write_trials(data, there, camera, guess, clean, kept, rng)
    _write_plans(data, there, planned(seed, spec), camera, guess, kept)
    write_case(data / "CASE.py", there.machine)
    told = as_dict(spec) | {
        "made_by": made_by(), "truth": effects,
        "post_refit": {k: v / sigma for k, v in sizes.items()}, "sigma_m": sigma, "kept": kept,
        "machine_is": {"young": there.machine.young, "viscosity": there.machine.viscosity,
                       "length": there.machine.arms[0].length},
        "guess": guess, "raw": float(np.sqrt(np.mean((clean - nominal)[:, :, kept] ** 2))) / sigma,
    }  # fmt: skip
    truth.parent.mkdir(parents=True, exist_ok=True)
    part = truth.with_suffix(".part")
    part.write_text(json.dumps(told, default=_plain, indent=1))
    np.savez_compressed(truth.with_suffix(".npz"), clean=clean[:, :, kept].astype(np.float32))
    part.replace(truth)


def write_trials(
    folder: Path, there: Setting, camera: Instrument, guess: dict[str, float], clean: np.ndarray, kept: list[int],
    rng: np.random.Generator, first: int = 0,
) -> None:  # fmt: skip
    """Write what the instruments make of the truth, ``trial_K.npz`` for each drive."""
    places = [there.places[m] for m in kept]
    for k, drive in enumerate(there.drives):
        seen = camera.see(clean[k], 1.0 / RATE, rng)[:, kept]
        record = drive.reading(there.t, rng, camera.grip, camera.turn)
        write_recording(
            folder / f"trial_{first + k}.npz", there.machine, there.t, seen, places, record, camera, guess
        )


def write_case(path: Path, machine: robots.Machine) -> None:
    """The case for machines with so many rods."""
    path.write_text(CASE.read_text().replace("RODS = 1", f"RODS = {len(machine.arms)}"))


def planned(seed: str, spec: Spec) -> list[driving.AnyDrive]:
    """Drives that could be tried next."""
    return driving.menu(spec.family, generator(seed, "plan of trials", spec.family, spec.machine), PLANNED)


def _write_plans(
    data: Path, there: Setting, plans: list[driving.AnyDrive], camera: Instrument, guess: dict[str, float],
    kept: list[int],
) -> None:  # fmt: skip
    """Trials that have not been recorded: their commands, and markers where they are drawn."""
    rng = np.random.default_rng(0)  # nothing is random in a plan
    places = [there.places[m] for m in kept]
    drawn = np.array(
        [
            there.machine.arms[k].shape(np.array([0.0, s * there.machine.arms[k].length]))[0][1]
            for k, s in places
        ]
    )
    still = np.broadcast_to(drawn, (len(there.t), *drawn.shape))
    for k, drive in enumerate(plans):
        record = drive.reading(there.t, rng, 0.0, 0.0)
        write_recording(
            data / "plans" / f"plan_{k}.npz", there.machine, there.t, still, places, record, camera, guess
        )


def _plain(value: Any) -> Any:
    return np.asarray(value).tolist()


def nominal_file(seed: str, spec: Spec, root: Path, elements: int) -> Path:
    """Where the motions of a machine without any effect are kept: another seed, or code, has others of that number."""
    drawn = int(generator(seed, "machine", *_machine(spec)).integers(2**32))
    machine = f"{spec.engine}_{spec.family}_{spec.machine}_{elements}"
    return root / "machines" / f"{machine}_{drawn:08x}_{made_by()[:8]}.npz"


def _nominal(
    seed: str, spec: Spec, there: Setting, root: Path, elements: int
) -> tuple[np.ndarray, list[np.ndarray]]:
    """What the machine does without any effect, and how that depends on what will be refitted."""
    kept = nominal_file(seed, spec, root, elements)
    if not kept.exists():
        base = there.simulate({}, elements)
        # machines of controls have nothing to be sized against
        names = () if spec.kind == "control" else ("young", "viscosity")
        slopes = [
            there.simulate(
                {}, elements, replace(there.machine, **{name: (1.0 + NUDGE) * getattr(there.machine, name)})
            )
            - base
            for name in names
        ]
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(f".{spec.name}.npz")
        np.savez_compressed(part, base=base, slopes=np.array(slopes))
        part.replace(kept)
    with np.load(kept) as file:
        return file["base"], list(file["slopes"])


def left_over(change: np.ndarray, slopes: list[np.ndarray], kept: list[int]) -> float:
    """Rms over the markers that stay on of what a refit of the nominal parameters leaves, to first order [m].

    In the trials to learn from: what shows in others alone cannot be named.
    """
    A = np.stack([s[:-HELD_OUT, :, kept].ravel() for s in slopes], axis=1)
    seen = change[:-HELD_OUT, :, kept].ravel()
    left = seen - A @ np.linalg.lstsq(A, seen, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _sized(
    id: str, values: dict[str, Any], there: Setting, nominal: np.ndarray, slopes: list[np.ndarray],
    kept: list[int], size: float, elements: int,
) -> tuple[dict[str, Any], np.ndarray]:  # fmt: skip
    """Parameters of an effect that leaves so much after the refit [m], and what is seen then."""
    effect = EFFECTS[id]
    stable = effect.most
    values, seen = _tamed(id, values, there, elements)
    for _ in range(TRIES):
        strength = float(values[effect.strength])
        left = left_over(seen - nominal, slopes, kept)
        if 0.85 < left / size < 1.2:
            break
        # close to linear in the strength; a large step is not trusted
        factor = float(np.clip(size / max(left, 1e-12), 0.1, 10.0))
        wanted = float(np.clip(factor * strength, -stable, stable))
        if wanted == strength:
            break
        values, seen = _tamed(id, values | {effect.strength: wanted}, there, elements)
        if values[effect.strength] != wanted:
            stable = abs(float(values[effect.strength]))
    return values, seen


def _tamed(
    id: str, values: dict[str, Any], there: Setting, elements: int
) -> tuple[dict[str, Any], np.ndarray]:
    """The motions with an effect, its strength halved until they are some: an explicit scheme is not always stable."""
    name = EFFECTS[id].strength
    for _ in range(HALVINGS):
        seen = _moved(there, {id: values}, elements)
        if not wild(seen, there.machine):
            return values, seen
        values = values | {name: CALMER * float(values[name])}
    raise ArithmeticError(f"{id} of {values[name]:.3g} makes a motion that is none")


def _moved(there: Setting, effects: dict[str, dict[str, Any]], elements: int) -> np.ndarray:
    """The motions with an effect, not a number where the rods fly apart."""
    try:
        return there.simulate(effects, elements)
    except FloatingPointError:
        return np.full((len(there.drives), len(there.t), len(there.places), 3), np.nan)


def wild(seen: np.ndarray, machine: robots.Machine) -> bool:
    """Whether a motion is none: not finite, or markers jump by more than half a length from frame to frame."""
    return not bool(np.abs(np.diff(seen, axis=1)).max() < 0.5 * machine.arms[0].length)


def _kept(spec: Spec, effects: dict[str, Any], places: list[tuple[int, float]]) -> list[int]:
    """Markers that stay on: all, those away from the effect, or the end's alone."""
    if spec.concealed == ALIKE:
        return sorted({LAST, *(v["marker"] for v in effects.values() if "marker" in v)})
    if spec.concealed != "away":
        return list(range(len(places)))
    local = [v["place"] for v in effects.values() if "place" in v]
    if local:
        return [m for m, (arm, s) in enumerate(places) if arm or all(abs(s - p) > NEAR for p in local)]
    return [m for m, (arm, s) in enumerate(places) if not arm and s <= 0.51]
