"""Where the time of a Newton iteration goes, against what this machine can do.

The kernels that a step calls are found by recording: for the length of a few steps, every compiled
function of rodnet is replaced in its module by one that notes its arguments. Each is then called
again with these, from Python and in a compiled loop. The loop is the floor: what is left of a step
is the interpreter's, part for handing arguments to compiled code and part for everything else. So this keeps
working while the core changes.
"""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import contextmanager
from typing import Any

import numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher

import rodnet as rn
from benchmarks import modes, scenes, yardstick
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Clock, best_loop

TITLE = "One Newton iteration"
DT = 0.01
OVERHEAD = 15.0  # us
STEPS = 20  # that are recorded


class Recorder:
    """Stands in for a compiled function and notes the arguments of its calls."""

    def __init__(self, function: Dispatcher, name: str) -> None:
        self.function, self.name = function, name
        self.calls: Counter[tuple] = Counter()
        self.examples: dict[tuple, tuple] = {}

    def __call__(self, *arguments: Any) -> Any:
        # the same function costs more or less with another flag (Jacobian or not) or another array
        kind = tuple(np.shape(a) if isinstance(a, np.ndarray) else a for a in arguments if not _real(a))
        self.calls[kind] += 1
        self.examples.setdefault(kind, arguments)
        return self.function(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def _real(value: Any) -> bool:
    return isinstance(value, float | np.floating)


@contextmanager
def recording():
    """Replace the compiled functions in rodnet's loaded modules; yields the recorders."""
    modules = [m for name, m in sys.modules.items() if name.startswith("rodnet") and "kernels" in name]
    recorders: dict[int, Recorder] = {}
    replaced = []
    for module in modules:
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher):
                recorder = recorders.setdefault(id(value), Recorder(value, name))
                replaced.append((module, name, value))
                setattr(module, name, recorder)
    try:
        yield list(recorders.values())
    finally:
        for module, name, value in replaced:
            setattr(module, name, value)


def _compiled_loop(function: Dispatcher, arguments: tuple, clock: Clock) -> float:
    """Time of one call inside compiled code [s]."""

    @njit
    def loop(count, arguments):
        for _ in range(count):
            function(*arguments)

    count = 200
    return best_loop(lambda: loop(count, arguments), clock) / count


def kernels(robot: rn.Robot, clock: Clock, warm_up: float) -> tuple[list[dict[str, Any]], float, float]:
    """Each kernel's calls per iteration and times of one call, from Python and in a compiled loop [us].

    Also returns the time of an iteration with everything [us], and iterations per step.
    """
    modes.advance(modes.simulate(robot, DT), DT)  # loads the modules that a step needs
    with recording() as recorders:
        sim = modes.simulate(robot, DT)  # terms may hold on to functions, so they are bound here
        modes.advance(sim, warm_up)
        for recorder in recorders:
            recorder.calls.clear()
            recorder.examples.clear()
        steps, iterations = modes.advance(sim, STEPS * DT)
    found = []
    for recorder in recorders:
        for kind, count in recorder.calls.items():
            arguments = recorder.examples[kind]
            found.append(
                {
                    "name": recorder.name, "calls": count / iterations,
                    "python": 1e6 * best_loop(lambda: recorder.function(*arguments), clock),  # noqa: B023
                    "compiled": 1e6 * _compiled_loop(recorder.function, arguments, clock),
                }
            )  # fmt: skip
    sim = modes.simulate(robot, DT)
    modes.advance(sim, warm_up)
    per_step = []
    for _ in range(7):
        counts: list[int] = []
        elapsed = clock.time(lambda: counts.extend(modes.advance(sim, 5 * STEPS * DT)))  # noqa: B023
        per_step.append(1e6 * elapsed / counts[1])
    return found, float(np.median(per_step)), iterations / steps


def terms(robot: rn.Robot, clock: Clock, warm_up: float) -> dict[str, float]:
    """Time of each term's own part of an assembly with Jacobian, called from Python [us]."""
    sim = modes.simulate(robot, DT)
    modes.advance(sim, warm_up)
    model, ev = sim.model, sim.newton.ev
    F, data = ev.F.copy(), model.data.copy()
    found = {}
    for bound in model.bound:
        if type(bound).add is not rn.BoundTerm.add:
            found[bound.term.name] = 1e6 * best_loop(lambda: bound.add(ev, F, data, True), clock)  # noqa: B023
        if type(bound).stress is not rn.BoundTerm.stress:
            found[f"{bound.term.name} (stress)"] = 1e6 * best_loop(lambda: bound.stress(ev), clock)  # noqa: B023
    return found


@njit(cache=True)
def _scatter(slots, block, data):
    """Add a block of constants for every stencil: the least that an assembly must do."""
    for s in range(slots.shape[0]):
        for i in range(slots.shape[1]):
            for j in range(slots.shape[2]):
                data[slots[s, i, j]] += block[i, j]


def floors(robot: rn.Robot, clock: Clock) -> dict[str, float]:
    """What the machine needs for the bare minimum of an iteration [us], in compiled code."""
    model = modes.simulate(robot, DT).model
    banded = yardstick.Banded(len(model.free))
    lu = banded.lu
    count = 500
    both = 1e6 * best_loop(lambda: banded.run(count), clock) / count
    factor = 1e6 * _compiled_loop(yardstick.factor, (banded.bands, lu), clock)
    out = {"banded factorisation": factor, "banded solution": both - factor}
    blocks = [s for b in model.bound for s in b.slots] + [model.spring_slots, model.stretch_slots]
    data = np.zeros(model.pattern.nnz + 1)
    out["scatter of all stencils"] = sum(
        1e6 * _compiled_loop(_scatter, (slots, np.ones(slots.shape[1:]), data), clock)
        for slots in blocks
        if len(slots)
    )
    return out


def measure(options: Options) -> Result:
    """Take the iterations of two robots and a long rod to pieces."""
    robots = {"robot, 2 tails": scenes.swimmer(2), "cantilever, 101 nodes": scenes.cantilever(100)}
    if not options.quick:
        robots["robot, 5 tails"] = scenes.swimmer(5)
    rates = yardstick.machine_rates(options.clock)
    text = (
        "Each compiled kernel of an iteration is called again with the arguments that a step gave it, from Python "
        "and in a compiled loop. What the loops leave of an iteration is the interpreter's share, that of the step "
        "as a whole included. Least: a banded LU of the same size, and the additions of an assembly alone. "
        "Measured in the same run, the machine "
        f"streams {rates['cache_bytes_per_s'] / 1e9:.0f} GB/s from its first cache, "
        f"{rates['memory_bytes_per_s'] / 1e9:.0f} GB/s from memory, and makes {rates['flops_per_s'] / 1e9:.0f} "
        "additions and products per ns."
    )
    result = Result(TITLE, text, data={"bars": [], "machine_rates": rates})
    for name, robot in robots.items():
        _one_robot(name, robot, options, result)
    return result


def _one_robot(name: str, robot: rn.Robot, options: Options, result: Result) -> None:
    warm_up = 0.5
    found, whole, per_step = kernels(robot, options.clock, warm_up)
    table = Table(
        f"{name}: {per_step:.2g} iterations per step",
        ["part", "calls per iteration", "us per call", "us per iteration", "share [%]", "least [us]"],
    )
    least = floors(robot, options.clock)
    bare = {"factor": least["banded factorisation"], "elastic_forces": least["scatter of all stencils"]}
    bare["solve_vector"] = least["banded solution"]
    compiled = handed = 0.0
    parts: dict[str, float] = {}
    for kernel in sorted(found, key=lambda k: -k["calls"] * k["compiled"]):
        each = kernel["calls"] * kernel["compiled"]
        compiled += each
        handed += kernel["calls"] * max(kernel["python"] - kernel["compiled"], 0.0)
        parts[kernel["name"]] = parts.get(kernel["name"], 0.0) + each
        row = [kernel["name"], kernel["calls"], kernel["compiled"], each, 100.0 * each / whole]
        table.rows.append([*row, bare.pop(kernel["name"], None)])
    rest = whole - compiled - handed
    for label, value in (
        ("all compiled kernels", compiled),
        ("handing arguments to them", handed),
        ("Python and NumPy", rest),
        ("whole iteration", whole),
    ):
        table.rows.append([label, None, None, value, 100.0 * value / whole, None])
    table.rows[-1][-1] = sum(least.values())
    result.tables.append(table)
    pieces = Table(f"{name}: the terms' own parts of an assembly, called from Python", ["term", "us"])
    pieces.rows = [[term, value] for term, value in terms(robot, options.clock, warm_up).items()]
    result.tables.append(pieces)
    result.demands.append(Demand(f"{name}, interpreter's share", OVERHEAD, handed + rest, "us per iteration"))
    parts |= {"handing arguments": handed, "Python and NumPy": rest}
    result.data["bars"].append({"name": name, "parts": parts, "least": sum(least.values())})
