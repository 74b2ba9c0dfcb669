"""What a column of the tangent costs, against a plain simulation of the same robot."""

from __future__ import annotations

from typing import Any

import numpy as np

import rodnet as rn
from benchmarks import scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, ratio
from rodnet.tangent.columns import make_columns
from rodnet.tangent.follow import Tangent

TITLE = "Sensitivities"
LIMIT = 0.06  # of a plain simulation, per column
DT = 0.01
DURATION = 2.0


def measure(options: Options) -> Result:
    """Time runs from rest with tangents of 24 and 48 columns, and without."""
    duration = 0.5 if options.quick else DURATION
    counts = (24,) if options.quick else (24, 48)
    table = Table(
        f"{duration:g} s from rest, dt = {DT} s, about 60 nodes: cost of a column over that of a plain simulation",
        ["robot", "stepper", *(f"{k} columns" for k in counts), *(f"whole run, {k}" for k in counts)],
    )
    text = (
        "Exact derivatives of the whole motion by parameters of materials, drag and motors and by random initial "
        "velocities, as `rodnet.sensitivities` computes them, over plain runs; setting up is left out of both."
    )
    result = Result(TITLE, text, [table])
    robots = {"two tails": scenes.swimmer(2), "clamped chain": scenes.chain(60)}
    for name, robot in robots.items():
        for stepper in ("euler", "sdirk2"):
            costs, wholes = [], []
            for count in counts:
                whole = _compare(robot, stepper, count, duration, options)
                cost = {k: (v - 1.0) / count for k, v in whole.items()}
                costs.append(cost)
                wholes.append(whole)
                what = f"{name}, {stepper}, {count} columns: one of them"
                result.demands.append(Demand(what, LIMIT, cost["median"], "of a plain simulation"))
            table.rows.append([name, stepper, *costs, *wholes])
    return result


def _compare(
    robot: rn.Robot, stepper: str, count: int, duration: float, options: Options
) -> dict[str, float]:
    """Time of a run with so many columns over that of a plain run."""
    settings: dict[str, Any] = {"dt": DT, "stepper": stepper}
    paths = [path for path in robot.parameters if not path.endswith((".nu", ".fluid_density"))]
    rng = np.random.default_rng(0)
    shape = robot.graph.x0.shape
    pushes = {f"push{k}": {"v": 1e-3 * rng.standard_normal(shape)} for k in range(count - len(paths))}
    columns = make_columns(robot, paths, pushes, settings)
    steps = round(duration / DT)

    def plain() -> Work:
        sim = rn.Simulation(robot, **settings)
        return lambda: _advance(sim, steps)

    def with_tangent() -> Work:
        sim = rn.Simulation(robot, **settings)
        tangent = Tangent(sim, columns)

        def work() -> int:
            with tangent:
                return _advance(sim, steps)

        return work

    rounds = interleave({"plain": plain, "tangent": with_tangent}, options.repeats, options.clock)
    return ratio(rounds["tangent"].per(steps), rounds["plain"].per(steps))


def _advance(sim: rn.Simulation, steps: int) -> int:
    for _ in range(steps):
        sim.step()
    return steps
