"""The paper's robot: times real time, in every mode."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import rodnet as rn
from benchmarks import modes, rivals, scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, ratio, spread
from benchmarks.yardstick import Banded

TITLE = "The robot of Du et al."
DT = 0.01
START = 20.0  # until the tails have their shape [s]
WHOLE = 60.0  # of a run from rest whose results are compared [s]
# times real time: tails and mode
DEMANDS = {(2, modes.UNPREDICTED.name): 30.0, (2, modes.EULER.name): 60.0, (5, modes.EULER.name): 12.0}
FACTORISATIONS, ALIKE = 1.2, 1e-7
FAST, ACCURATE = 100.0, 1e-3  # with step size control: times real time, and error of both speeds


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
    for count in tails:
        _one_robot(count, modes.MODES, start, duration, options, table, result)
    _from_rest(options, result)
    result.notes += [f"{code}: cannot do this case ({why})." for code, why in rivals.REASONS_SWIMMER.items()]
    return result


def _from_rest(options: Options, result: Result) -> None:
    """Compare what all modes find after a run from rest, and how fast they are over all of it."""
    whole = 4.0 if options.quick else WHOLE
    table = Table(
        f"Two tails, {whole:g} s from rest, every state recorded: results against SDIRK2 with dt = {DT} s",
        ["mode", "x real time", "speed [mm/s]", "head [rpm]", "speed off by", "head off by"],
    )
    found, last, faster = {}, {}, {}
    for mode in modes.MODES:
        sim = modes.simulate(scenes.swimmer(2), DT, mode)
        trajectories: list[rn.Trajectory] = []
        faster[mode.name] = whole / options.clock.time(lambda: trajectories.append(sim.run(whole)))  # noqa: B023
        metrics = rn.robots.flagellated_metrics(trajectories[0])
        found[mode.name], last[mode.name] = (metrics.speed, metrics.head_rpm), trajectories[0].x[-1]
    reference = found[modes.SDIRK2.name]
    off = {name: [abs(a / b - 1.0) for a, b in zip(v, reference, strict=True)] for name, v in found.items()}
    for name, (speed, rpm) in found.items():
        errors = [f"{value:.1e}" for value in off[name]]
        table.rows.append([name, faster[name], 1e3 * speed, rpm, *errors])
    apart = np.abs(last[modes.EULER.name] - last[modes.UNPREDICTED.name]).max() / np.ptp(
        last[modes.EULER.name]
    )
    adaptive = modes.ADAPTIVE.name
    result.tables.append(table)
    result.demands += [
        Demand("positions with and without prediction, by the robot's length", ALIKE, float(apart), ""),
        Demand(f"two tails, {adaptive}, from rest", FAST, faster[adaptive], "times real time", least=True),
        Demand(f"two tails, {adaptive}: both speeds off by", ACCURATE, max(off[adaptive]), ""),
    ]


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
        demand = DEMANDS.get((tails, mode.name))
        if demand is not None:
            name = f"{tails} tails, {mode.name}"
            result.demands.append(Demand(name, demand, speed["median"], "times real time", least=True))
        if tails == 2 and mode is modes.EULER:
            each = factorisations / steps
            result.demands.append(
                Demand(f"2 tails, {mode.name}: factorisations", FACTORISATIONS, each, "a step")
            )
