"""Error against time: the falling cantilever with rodnet's steppers and with PyElastica.

The error is that of the tip over the first half second, at 10 times, against what the same code
converges to. The two models are not quite the same (PyElastica's rod shears, and its sections resist turning by
inertia), so how far their limits are apart is stated too: errors below that cannot be compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import modes, rivals, scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, spread

TITLE = "Error against time"
EDGES, END, SAMPLES = 100, 0.5, 10
FASTER = 10.0
USUAL = "at the wall"
RODS = {"E = 10 MPa": 1e7, "E = 1 GPa": 1e9}
DT = {
    "implicit Euler": (2.5e-2, 1e-2, 5e-3, 2.5e-3, 1e-3, 5e-4),
    "SDIRK2": (2.5e-2, 1e-2, 5e-3, 2.5e-3, 1.25e-3),
    "SDIRK2, residual 1e-4": (2.5e-2, 1e-2, 5e-3, 2.5e-3, 1.25e-3),
}
TOLERANCES = (3e-2, 1e-2, 3e-3, 1e-3)


def path(advance: Callable[[float], Any], tip: Callable[[], np.ndarray]) -> np.ndarray:
    """Positions of the tip at the sample times [m], shape (SAMPLES, 3)."""
    points = []
    for _ in range(SAMPLES):
        advance(END / SAMPLES)
        points.append(tip())
    return np.array(points)


def fall(edges: int, young: float, mode: modes.Mode, dt: float, **changes: Any) -> np.ndarray:
    """Path of the tip by rodnet [m], shape (SAMPLES, 3)."""
    sim = modes.simulate(scenes.cantilever(edges, young), dt, mode, **changes)
    return path(lambda duration: modes.advance(sim, duration), lambda: scenes.tip(sim))


def limit(young: float, quick: bool) -> np.ndarray:
    """What rodnet converges to: second order in space and time, extrapolated in both."""
    edges, dt = (50, 2e-3) if quick else (200, 5e-4)
    coarse, fine = (fall(n, young, modes.SDIRK2, dt) for n in (edges, 2 * edges))
    long, short = (fall(edges // 2, young, modes.SDIRK2, h) for h in (dt, 0.5 * dt))
    return fine + (fine - coarse) / 3.0 + (short - long) * 4.0 / 3.0


def rival_limit(adapter: Any, young: float, quick: bool) -> np.ndarray:
    """What PyElastica converges to: its time steps are so short that only space counts."""
    edges = 25 if quick else 100 if young > 1e8 else 200
    rods = [adapter.Cantilever(n, young=young) for n in (edges, 2 * edges)]
    coarse, fine = (path(rod.advance, rod.tip) for rod in rods)
    return fine + (fine - coarse) / 3.0


def error(found: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square distance over the sample times, by the length."""
    return float(np.sqrt(np.mean(np.sum((found - reference) ** 2, axis=1))) / scenes.LENGTH)


def measure(options: Options) -> Result:
    """Run every method on every rod."""
    table = Table(
        f"PyElastica with {EDGES + 1} nodes, and the least time in which rodnet is as accurate",
        ["rod", "PyElastica's clamp", "its error", "compared at", "its time [s]", "rodnet's time [s]", "by",
         "times faster"],
    )  # fmt: skip
    points = Table("All points", ["rod", "method", "setting", "steps", "time [s]", "error"])
    text = (
        "The cantilever from above and one that is 100 times stiffer fall for 0.5 s without damping. Error: root mean "
        f"square over {SAMPLES} times of the distance of the tip from where the same code converges to, by the length."
    )
    result = Result(TITLE, text, [table, points], data={"curves": [], "apart": {}})
    found, missing = rivals.load(tuple(name for name in options.rivals if name == "pyelastica"))
    for label, reason in missing.items():
        result.notes.append(f"{label}: {reason}.")
    for rod, young in list(RODS.items())[: 1 if options.quick else None]:
        _one_rod(rod, young, found[0] if found else None, options, result)
    result.notes += [
        f"rodnet has {EDGES} edges in every point; PyElastica's points are numbers of edges at nearly its largest "
        "stable time step.",
        "PyElastica clamps its first edge. 'At the wall' is its usual clamp, which loses half an edge and makes "
        "it first order; 'centred' is of our making: that edge straddles the wall, which makes it second order.",
        "rodnet's residual is 1e-8 of the largest force unless another is named. 1e-4 saves iterations and changes no "
        "error of long steps; of short ones on the stiff rod, which begin so close to balance that they stay as "
        "predicted, it makes the error larger.",
    ]
    return result


def _one_rod(rod: str, young: float, adapter: Any, options: Options, result: Result) -> None:
    reference = limit(young, options.quick)
    runs = _rodnet_runs(young, options)
    own = list(runs)
    references = dict.fromkeys(own, reference)
    apart = 0.0
    if adapter is not None:
        theirs = rival_limit(adapter, young, options.quick)
        apart = error(reference, theirs)
        result.data["apart"][rod] = apart
        result.notes.append(
            f"{rod}: the limits of rodnet and PyElastica are {apart:.1e} of the length apart; "
            "smaller errors are not compared."
        )
        rival_runs = _rival_runs(adapter, young, options)
        references |= dict.fromkeys(rival_runs, theirs)
        runs |= rival_runs
    contenders = {key: _contender(prepare) for key, prepare in runs.items()}
    rounds = interleave(contenders, 1 if options.quick else 3, options.clock)  # type: ignore[type-var]
    measured = {}
    for key in runs:
        steps, positions = rounds[key].returned[-1]
        wrong = error(positions, references[key]) if np.all(np.isfinite(positions)) else None
        measured[key] = (wrong, spread(rounds[key].seconds)["median"])
        result.tables[1].rows.append([rod, *key, steps, spread(rounds[key].seconds), _short(wrong)])
    for name in dict.fromkeys(name for name, _ in measured):
        curve = [
            {"setting": setting, "error": wrong, "seconds": seconds}
            for (other, setting), (wrong, seconds) in measured.items()
            if other == name
        ]
        result.data["curves"].append({"rod": rod, "name": name, "points": curve})
    for name, clamp in (("PyElastica, usual clamp", USUAL), ("PyElastica", "centred")):
        if (name, f"{EDGES} edges") in measured:
            rival = measured[name, f"{EDGES} edges"]
            _compare(rod, clamp, rival, apart, {k: measured[k] for k in own}, result)


def _rodnet_runs(young: float, options: Options) -> dict[tuple[str, str], Callable]:
    def run(mode: modes.Mode, dt: float, **changes: Any) -> Callable:
        def prepare() -> tuple[Callable, Callable]:
            sim = modes.simulate(scenes.cantilever(EDGES, young), dt, mode, **changes)
            return (lambda duration: modes.advance(sim, duration).steps), (lambda: scenes.tip(sim))

        return prepare

    runs = {}
    for mode in (modes.EULER, modes.SDIRK2, modes.LOOSE):
        steps = DT[mode.name]
        for dt in steps[:4] if options.quick else steps:
            runs[f"rodnet, {mode.name}", f"dt = {1e3 * dt:g} ms"] = run(mode, dt)
    for tolerance in TOLERANCES[:2] if options.quick else TOLERANCES:
        name = f"rodnet, {modes.ADAPTIVE.name}", f"tolerance {tolerance:g}"
        runs[name] = run(modes.ADAPTIVE, 1e-3, adaptive=tolerance)
    return runs


def _rival_runs(adapter: Any, young: float, options: Options) -> dict[tuple[str, str], Callable]:
    def run(edges: int, straddle: bool) -> Callable:
        def prepare() -> tuple[Callable, Callable]:
            rod = adapter.Cantilever(edges, young=young, straddle=straddle)
            return rod.advance, rod.tip

        return prepare

    sizes = (25, 50, 100) if options.quick or young > 1e8 else (12, 25, 50, 100, 200)
    runs = {("PyElastica", f"{n} edges"): run(n, True) for n in sizes}
    return runs | {("PyElastica, usual clamp", f"{n} edges"): run(n, False) for n in sizes}


def _contender(prepare: Callable) -> Callable[[], Work]:
    def start() -> Work:
        advance, tip = prepare()

        def run() -> tuple[int, np.ndarray]:
            steps: list[int] = []
            positions = path(lambda duration: steps.append(advance(duration)), tip)
            return sum(steps), positions

        return run

    return start


def _compare(
    rod: str, clamp: str, rival: tuple, apart: float, own: dict[tuple[str, str], tuple], result: Result
) -> None:
    """Find the least time in which rodnet is as accurate as the rival, or as exact as the two models agree."""
    wrong, seconds = rival
    bound = None if wrong is None else max(wrong, apart)
    good = {key: t for key, (e, t) in own.items() if e is not None and bound is not None and e <= bound}
    best = min(good, key=good.__getitem__) if good else None
    factor = seconds / good[best] if best else None
    by = f"{best[0].removeprefix('rodnet, ')}, {best[1]}" if best else "none of these"
    mine = good[best] if best else None
    result.tables[0].rows.append([rod, clamp, _short(wrong), _short(bound), seconds, mine, by, factor])
    if clamp == USUAL:  # the other one is of our making
        what = f"{rod}: faster than PyElastica at equal error, {EDGES + 1} nodes"
        result.demands.append(Demand(what, FASTER, factor, "times", least=True))


def _short(value: float | None) -> str | None:
    return None if value is None else f"{value:.1e}"
