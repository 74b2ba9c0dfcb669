"""A falling cantilever: time per step beside the yardstick and the rivals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks import modes, rivals, scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, ratio, spread
from benchmarks.yardstick import Banded

TITLE = "Falling cantilever"
SIZES = (50, 100, 200, 400)
LIMITS = dict(zip(SIZES, (0.4, 0.7, 1.3, 2.6), strict=True))  # ms per step
DT, DURATION = 0.01, 1.0


def measure(options: Options) -> Result:
    """Time one second of the fall (less for codes whose steps all cost the same)."""
    sizes = SIZES[:2] if options.quick else SIZES
    duration = 0.2 if options.quick else DURATION
    found, missing = rivals.load(options.rivals)
    own = Table(
        "rodnet, implicit Euler, dt = 0.01 s",
        ["nodes", "unknowns", "ms per step", "iterations per step", "factorisations per step",
         "step per yardstick", "iteration per yardstick", "yardstick [us]"],
    )  # fmt: skip
    others = Table(
        "Other codes: the same fall",
        ["nodes", "code", "dt [ms]", "ms per step", "s per simulated s", "times rodnet's"],
    )
    result = Result(TITLE, _text(), [own, others])
    for edges in sizes:
        _one_size(edges, duration, found, options, own, others, result)
    for label, reason in missing.items():
        others.rows.append([None, label, None, reason, None, None])
    result.notes += [
        "PyElastica is explicit and MuJoCo bends its cable explicitly: both need time steps near their "
        "limit of stability, so the time per simulated second is what compares. It is not at equal accuracy: see "
        "'Error against time'.",
        "dismech-newton runs in single precision with 3 Newton iterations per step, always; its name for "
        "them is exact=True. MuJoCo's links cannot stretch; its unknowns are joint "
        "angles, with a full mass matrix for a chain.",
        "Codes other than rodnet hold a whole edge, here one that straddles the wall: as if it were clamped in "
        "its middle.",
    ]
    return result


def _text() -> str:
    return (
        "A rod of 1 m, radius 5 mm, E = 10 MPa, nu = 1/2, 1000 kg/m^3, clamped at one end, falls from rest under "
        "9.81 m/s^2. Tolerances: scaled residual 1e-8, update 1e-10. The yardstick is a compiled banded LU, "
        "factorisation and solution, with as many unknowns."
    )


def _one_size(
    edges: int, duration: float, found: list[Any], options: Options, own: Table, others: Table, result: Result
) -> None:
    robot = scenes.cantilever(edges)
    unknowns = len(modes.simulate(robot, DT).model.free)
    banded, repeat = Banded(unknowns), 2000 if options.quick else max(200, 100_000 // edges)
    contenders = {
        "rodnet": lambda: _work(modes.simulate(robot, DT), modes.advance, duration),
        "yardstick": lambda: banded.contender(repeat),
    }
    spans = {}
    for adapter in found:
        if edges in adapter.SIZES:
            spans[adapter.LABEL] = span = min(duration, adapter.SPAN)
            contenders[adapter.LABEL] = _rival(adapter, edges, span)
    rounds = interleave(contenders, options.repeats, options.clock)
    own_rounds = rounds["rodnet"]
    steps, iterations, factorisations = own_rounds.returned[-1]
    yard, step = rounds["yardstick"].per(repeat), own_rounds.per(steps)
    own.rows.append(
        [
            edges + 1, unknowns, spread(step, 1e3), iterations / steps, factorisations / steps,
            ratio(step, yard), ratio(own_rounds.per(iterations), yard), spread(yard, 1e6),
        ]
    )  # fmt: skip
    limit = LIMITS.get(edges)
    if limit is not None:
        result.demands.append(Demand(f"{edges + 1} nodes", limit, spread(step, 1e3)["median"], "ms per step"))
    per_second = own_rounds.per(duration)
    others.rows.append([edges + 1, "rodnet", 1e3 * DT, spread(step, 1e3), spread(per_second), 1.0])
    for label, span in spans.items():
        rival, dt = rounds[label].per(span), span / rounds[label].returned[-1]
        others.rows.append(
            [edges + 1, label, 1e3 * dt, spread(rival, 1e3 * dt), spread(rival), ratio(rival, per_second)]
        )


def _work(simulated: Any, advance: Callable[[Any, float], Any], duration: float) -> Work:
    return lambda: advance(simulated, duration)


def _rival(adapter: Any, edges: int, span: float) -> Callable[[], Work]:
    return lambda: _work(adapter.Cantilever(edges), lambda rod, duration: rod.advance(duration), span)
