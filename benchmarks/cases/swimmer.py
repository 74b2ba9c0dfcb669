"""The paper's robot: times real time, in every mode."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks import modes, rivals, scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, ratio, spread
from benchmarks.yardstick import Banded

TITLE = "The robot of Du et al."
DT = 0.01
START = 20.0  # until the tails have their shape [s]
REAL_TIME = 15.0  # two tails


def measure(options: Options) -> Result:
    """Time the robot's start, and the robot in its steady state."""
    tails = (2,) if options.quick else (2, 3, 5)
    duration = 1.0 if options.quick else 6.0
    start = 1.0 if options.quick else START
    table = Table(
        f"rodnet, dt = {DT} s (first step, where it is adaptive)",
        ["tails", "mode", "x real time", f"first {start:g} s", "ms per step", "steps per s",
         "iterations per step", "factorisations per step", "step per yardstick", "iteration per yardstick"],
    )  # fmt: skip
    text = (
        "Two, three and five tails at 100 rpm, with all that the paper's model has: in the steady state, after "
        f"{start:g} s, and until then."
    )
    result = Result(TITLE, text, [table])
    chosen = [mode for mode in modes.MODES if modes.available(mode)]
    for mode in [mode for mode in modes.MODES if mode not in chosen]:
        result.notes.append(f"This rodnet has no mode '{mode.name}'.")
    for count in tails:
        _one_robot(count, chosen, start, duration, options, table, result)
    result.notes += [f"{code}: cannot do this case ({why})." for code, why in rivals.REASONS_SWIMMER.items()]
    return result


def _one_robot(
    tails: int,
    chosen: list[modes.Mode],
    start: float,
    duration: float,
    options: Options,
    table: Table,
    result: Result,
) -> None:
    robot = scenes.swimmer(tails)
    sims, starts = {}, {}
    for mode in chosen:
        modes.advance(modes.simulate(robot, DT, mode), 0.1)  # compiles
        sims[mode.name] = sim = modes.simulate(robot, DT, mode)
        starts[mode.name] = start / options.clock.time(lambda: modes.advance(sim, start))  # noqa: B023
    banded, repeat = Banded(len(sim.model.free)), 2000
    contenders: dict[str, Callable[[], Work]] = {"yardstick": lambda: banded.contender(repeat)}
    for name, sim in sims.items():
        contenders[name] = lambda sim=sim: lambda: modes.advance(sim, duration)
    rounds = interleave(contenders, options.repeats, options.clock)
    yard = rounds["yardstick"].per(repeat)
    for mode in chosen:
        own = rounds[mode.name]
        speed = spread([duration / t for t in own.seconds])
        steps, iterations, factorisations = (sum(counts) for counts in zip(*own.returned, strict=True))
        per_step, per_iteration = own.per(lambda done: done.steps), own.per(lambda done: done.iterations)
        table.rows.append(
            [
                tails, mode.name, speed, starts[mode.name], spread(per_step, 1e3),
                steps / duration / len(own.seconds), iterations / steps, factorisations / steps,
                ratio(per_step, yard), ratio(per_iteration, yard),
            ]
        )  # fmt: skip
        if tails == 2 and mode is modes.EULER:
            result.demands.append(
                Demand("two tails, implicit Euler", REAL_TIME, speed["median"], "times real time", least=True)
            )
