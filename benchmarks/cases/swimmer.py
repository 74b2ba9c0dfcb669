"""The paper's robot: times real time, in every mode."""

from __future__ import annotations

from benchmarks import modes, rivals, scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, ratio, spread
from benchmarks.yardstick import Banded

TITLE = "The robot of Du et al."
DT = 0.01
REAL_TIME = 15.0  # two tails


def measure(options: Options) -> Result:
    """Time the robot from its steady state on."""
    tails = (2,) if options.quick else (2, 3, 5)
    duration = 1.0 if options.quick else 6.0
    table = Table(
        f"rodnet, dt = {DT} s (first step, where it is adaptive)",
        ["tails", "mode", "unknowns", "x real time", "ms per step", "steps per s", "iterations per step",
         "factorisations per step", "step per yardstick", "iteration per yardstick"],
    )  # fmt: skip
    text = "Two, three and five tails at 100 rpm, from 2 s on; all that the paper's model has."
    result = Result(TITLE, text, [table])
    chosen = [mode for mode in modes.MODES if modes.available(mode)]
    for mode in [mode for mode in modes.MODES if mode not in chosen]:
        result.notes.append(f"This rodnet has no mode '{mode.name}'.")
    for count in tails:
        _one_robot(count, chosen, duration, options, table, result)
    result.notes += [f"{code}: cannot do this case ({why})." for code, why in rivals.REASONS_SWIMMER.items()]
    return result


def _one_robot(
    tails: int, chosen: list[modes.Mode], duration: float, options: Options, table: Table, result: Result
) -> None:
    robot = scenes.swimmer(tails)
    sims, counts = {}, {}
    for mode in chosen:
        sims[mode.name] = modes.simulate(robot, DT, mode)
        modes.advance(sims[mode.name], 0.2 if options.quick else 2.0)  # compiles, and leaves the start behind

    def contender(name: str) -> Work:
        sim = sims[name]
        before = sim.model.solver.factorizations

        def run() -> None:
            steps, iterations = modes.advance(sim, duration)
            counts[name] = steps, iterations, sim.model.solver.factorizations - before

        return run

    unknowns = len(next(iter(sims.values())).model.free)
    banded, repeat = Banded(unknowns), 2000
    contenders = {mode.name: (lambda name=mode.name: contender(name)) for mode in chosen}
    times = interleave(
        contenders | {"yardstick": lambda: banded.contender(repeat)}, options.repeats, options.clock
    )
    yard = [t / repeat for t in times["yardstick"]]
    for mode in chosen:
        steps, iterations, factorisations = counts[mode.name]
        elapsed = times[mode.name]
        speed = spread([duration / t for t in elapsed])
        table.rows.append(
            [
                tails, mode.name, unknowns, speed, spread(elapsed, 1e3 / steps), steps / duration,
                iterations / steps, factorisations / steps, ratio(elapsed, yard, 1.0 / steps),
                ratio(elapsed, yard, 1.0 / iterations),
            ]
        )  # fmt: skip
        if tails == 2 and mode is modes.EULER:
            result.demands.append(
                Demand("two tails, implicit Euler", REAL_TIME, speed["median"], "times real time", least=True)
            )
