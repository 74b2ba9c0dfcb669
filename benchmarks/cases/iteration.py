"""Where the time of a Newton iteration goes, against what this machine can do.

The kernels that a step calls are found by recording: for the length of a few steps, every compiled
function of rodnet is replaced in its module by one that notes its arguments. Each is then called
again with these, from Python and in a compiled loop, which is the floor; the difference is what handing
the arguments over costs. The interpreter's own time is that of the same steps with stand-ins that return
what the kernels returned. What is left is what kernels lose between other work: their data are no longer in the
first cache. So this keeps working while the core changes.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher

import rodnet as rn
from benchmarks import modes, scenes, yardstick
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.report import number
from benchmarks.timing import Clock, best_loop
from rodnet.solve.newton import Newton

TITLE = "One Newton iteration"
DT = 0.01
OVERHEAD = 15.0  # us
STEPS = 20  # that are recorded


class Loop:
    """Tells whether a step is inside Newton's loop, and how long it was."""

    def __init__(self) -> None:
        self.inside, self.seconds = False, 0.0

    @contextmanager
    def watched(self):
        """Wrap the loop for a while; where this rodnet has none by this name, all of a step counts as inside."""
        original = getattr(Newton, "_solve", None)
        self.seconds = 0.0
        if original is None:
            self.inside, self.seconds = True, math.nan
            yield
            return

        def solve(newton, *arguments, **options):
            self.inside, start = True, time.perf_counter()
            try:
                return original(newton, *arguments, **options)
            finally:
                self.seconds += time.perf_counter() - start
                self.inside = False

        Newton._solve = solve
        try:
            yield
        finally:
            Newton._solve = original


class Tape:
    """Results of all calls in their order, to be played back."""

    def __init__(self) -> None:
        self.results: list[Any] = []
        self.noting = False
        self.playing: Iterator[Any] | None = None


class Recorder:
    """Stands in for a compiled function; notes the arguments of its calls, or plays their results back."""

    def __init__(self, function: Dispatcher, name: str, loop: Loop, tape: Tape) -> None:
        self.function, self.name, self.loop, self.tape = function, name, loop, tape
        self.calls: Counter[tuple] = Counter()
        self.examples: dict[tuple, tuple[tuple, Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        if self.tape.playing is not None:
            return next(self.tape.playing)
        if not self.tape.noting:
            return self.function(*arguments)
        # the same function costs more or less with another flag (Jacobian or not) or another array
        kind = (self.loop.inside, *(_shape(a) for a in arguments if not isinstance(a, float | np.floating)))
        self.calls[kind] += 1
        result = self.function(*arguments)
        self.examples.setdefault(kind, (arguments, result))
        self.tape.results.append(result)
        return result

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def _shape(value: Any) -> Any:
    return value.shape if isinstance(value, np.ndarray) else value


@contextmanager
def recording(loop: Loop, tape: Tape):
    """Replace the compiled functions in rodnet's loaded modules; yields the recorders."""
    modules = [m for name, m in sys.modules.items() if name.startswith("rodnet") and "kernels" in name]
    recorders: dict[int, Recorder] = {}
    replaced = []
    for module in modules:
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher):
                replaced.append((module, name, value))
                setattr(module, name, recorders.setdefault(id(value), Recorder(value, name, loop, tape)))
    try:
        with loop.watched():
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


def _handing_over(arguments: tuple, result: Any, clock: Clock) -> float:
    """Time to call a compiled function that returns ``result``, numbers or None, at once [s]."""
    names = ", ".join(f"a{k}" for k in range(len(arguments)))
    nothing = njit(
        eval(f"lambda {names}: result", {"result": result})
    )  # one parameter per argument, as kernels have
    return best_loop(lambda: nothing(*arguments), clock)


@dataclass
class Anatomy:
    """An iteration taken to pieces: times in us.

    Attributes
    ----------
    kernels : list of dict
        Name, whether inside Newton's loop, calls per step, time of one call in a compiled loop, and what handing
        over its arguments takes.
    step, loop : float
        Time of a whole step, and of Newton's loop in it.
    python_step, python_loop : float
        The same with stand-ins for the kernels.
    iterations : float
        Iterations per step.
    """

    kernels: list[dict[str, Any]]
    step: float
    loop: float
    python_step: float
    python_loop: float
    iterations: float

    def share(self, inside: bool) -> tuple[float, float, float, float]:
        """Time per step inside or outside of the loop: compiled, handing over of arguments, Python, the rest."""
        mine = [k for k in self.kernels if k["inside"] == inside]
        compiled = sum(k["calls"] * k["compiled"] for k in mine)
        handed = sum(k["calls"] * k["handed"] for k in mine)
        whole = self.loop if inside else self.step - self.loop
        python = self.python_loop if inside else self.python_step - self.python_loop
        return compiled, handed, python, whole - compiled - handed - python


def dissect(robot: rn.Robot, clock: Clock, warm_up: float) -> Anatomy:
    """Record some steps and time their kernels one by one, and time steps as a whole."""
    loop, tape = Loop(), Tape()
    modes.advance(modes.simulate(robot, DT), DT)  # loads the modules that a step needs
    with recording(loop, tape) as recorders:
        sim = modes.simulate(robot, DT)  # terms may hold on to functions, so they are bound here
        modes.advance(sim, warm_up)
        tape.noting = True
        steps, iterations, _ = modes.advance(sim, STEPS * DT)
        recorded = sim  # the arguments hold addresses of its arrays
        tape.noting, python = False, []
        for _ in range(9):
            tape.playing = None
            sim = modes.simulate(robot, DT)
            modes.advance(sim, warm_up)
            tape.playing, loop.seconds = iter(tape.results), 0.0
            seconds = clock.time(lambda: modes.advance(sim, STEPS * DT))  # noqa: B023
            python.append((1e6 * seconds / steps, 1e6 * loop.seconds / steps))
        # what a stand-in costs is not the program's
        tape.playing = repeat(None)
        stand_in = 1e6 * best_loop(lambda: recorders[0](None), clock)
    python_step, python_loop = np.min(python, axis=0).tolist()
    calls = {
        inside: sum(n for r in recorders for kind, n in r.calls.items() if kind[0] == inside)
        for inside in (0, 1)
    }
    python_loop -= stand_in * calls[1] / steps
    python_step -= stand_in * (calls[0] + calls[1]) / steps
    found = []
    assert recorded.newton is not None
    for recorder in recorders:
        for kind, count in recorder.calls.items():
            arguments, result = recorder.examples[kind]
            found.append(
                {
                    "name": recorder.name, "inside": kind[0], "calls": count / steps,
                    "handed": 1e6 * _handing_over(arguments, result, clock),
                    "compiled": 1e6 * _compiled_loop(recorder.function, arguments, clock),
                }
            )  # fmt: skip
    whole, inside = [], []
    for _ in range(9):  # the same steps again
        sim = modes.simulate(robot, DT)
        modes.advance(sim, warm_up)
        with loop.watched():
            start = time.perf_counter()
            whole.append(clock.time(lambda: modes.advance(sim, STEPS * DT)) / steps)  # noqa: B023
            inside.append(loop.seconds / (time.perf_counter() - start))  # both of the wall clock
    step = 1e6 * float(np.median(whole))
    part = float(np.median(inside))
    part = step * part if math.isfinite(part) else step
    return Anatomy(found, step, part, python_step, python_loop, iterations / steps)


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


@njit(cache=True, error_model="numpy")
def _scatter(count, block, bands):
    """Add a block for every stencil to a banded matrix, one after the other: the least that an assembly must do."""
    width, last = block.shape[0], bands.shape[0] - block.shape[0]
    for s in range(count):
        first = min(4 * s, last)
        for i in range(width):
            for j in range(width):
                bands[first + i, yardstick.BAND + j - i] += block[i, j]


def floors(robot: rn.Robot, clock: Clock) -> dict[str, float]:
    """What the machine needs for the bare minimum of an iteration [us], in compiled code."""
    model = modes.simulate(robot, DT).model
    banded = yardstick.Banded(len(model.free))
    lu = banded.lu
    count = 500
    both = 1e6 * best_loop(lambda: banded.run(count), clock) / count
    factor = 1e6 * _compiled_loop(yardstick.factor, (banded.bands, lu), clock)
    out = {"banded factorisation": factor, "banded solution": both - factor}
    stencils = [dofs for b in model.bound for dofs in b.stencils] + [model.spring_dofs, model.stretch_dofs]
    out["additions of all stencils"] = sum(
        1e6 * _compiled_loop(_scatter, (len(dofs), np.ones((dofs.shape[1],) * 2), lu), clock)
        for dofs in stencils
        if len(dofs) and dofs.shape[1] <= yardstick.BAND + 1
    )
    return out


def measure(options: Options) -> Result:
    """Take the iterations of two robots and a long rod to pieces."""
    robots = {"robot, 2 tails": scenes.swimmer(2), "cantilever, 101 nodes": scenes.cantilever(100)}
    if not options.quick:
        robots["robot, 5 tails"] = scenes.swimmer(5)
    rates = yardstick.machine_rates(options.clock)
    text = (
        "Each compiled kernel of an iteration is called again in a compiled loop, with the arguments that a step gave "
        "it; handing these over is timed with a compiled function that does nothing. The same steps with stand-ins "
        "for the kernels give Python's own time. What is left is what kernels lose between other work, to colder "
        "caches. Least: what a banded LU of the same size takes, and the bare additions of all stencil matrices. "
        "Measured in the same run, the machine "
        f"streams {number(rates['cache_bytes_per_s'] / 1e9)} GB/s from its first cache, "
        f"{number(rates['memory_bytes_per_s'] / 1e9)} GB/s from memory, and makes "
        f"{number(rates['flops_per_s'] / 1e9)} additions and products per ns."
    )
    result = Result(TITLE, text, data={"bars": [], "machine_rates": rates})
    for name, robot in robots.items():
        _one_robot(name, robot, options, result)
    return result


def _one_robot(name: str, robot: rn.Robot, options: Options, result: Result) -> None:
    warm_up = 0.5
    anatomy = dissect(robot, options.clock, warm_up)
    least = floors(robot, options.clock)
    count = anatomy.iterations
    table = Table(
        f"{name}, {number(count)} iterations per step: inside Newton's loop",
        ["part", "calls per iteration", "us per call", "us per iteration", "share [%]", "least [us]"],
    )
    bare = {  # by how the kernels' names begin
        "factor": least["banded factorisation"],
        "solve": least["banded solution"],
        "quadratic": least["additions of all stencils"],
    }
    parts: dict[str, float] = {}
    bound = 0.0
    for kernel in sorted(anatomy.kernels, key=lambda k: -k["calls"] * k["compiled"]):
        if kernel["inside"]:
            each = kernel["calls"] * kernel["compiled"] / count
            parts[kernel["name"]] = parts.get(kernel["name"], 0.0) + each
            row = [kernel["name"], kernel["calls"] / count, kernel["compiled"], each]
            least_of_it = bare.pop(kernel["name"].split("_")[0], None)
            if least_of_it is not None:
                least_of_it *= kernel["calls"] / count
                bound += least_of_it
            table.rows.append([*row, 100.0 * each * count / anatomy.loop, least_of_it])
    compiled, handed, python, rest = (value / count for value in anatomy.share(inside=True))
    whole = anatomy.loop / count
    for label, value, floor in (
        ("compiled kernels", compiled, bound),
        ("handing arguments to them", handed, None),
        ("Python and NumPy", python, None),
        ("kernels between other work", rest, None),
        ("iteration", whole, None),
    ):
        table.rows.append([label, None, None, value, 100.0 * value / whole, floor])
    outside = Table(f"{name}: a step, outside of Newton's loop", ["part", "us per step"])
    outside.rows = [
        [label, value]
        for label, value in zip(
            (
                "compiled kernels",
                "handing arguments to them",
                "Python and NumPy",
                "kernels between other work",
            ),
            anatomy.share(inside=False),
            strict=True,
        )
    ]
    outside.rows.append(["whole step, loop included", anatomy.step])
    pieces = Table(f"{name}: the terms' own parts of an assembly, called from Python", ["term", "us"])
    pieces.rows = [[term, value] for term, value in terms(robot, options.clock, warm_up).items()]
    result.tables += [table, outside, pieces]
    result.demands.append(
        Demand(f"{name}, interpreter's share", OVERHEAD, handed + python, "us per iteration")
    )
    parts |= {"handing arguments": handed, "Python and NumPy": python, "kernels between other work": rest}
    result.data["bars"].append({"name": name, "parts": parts, "least": bound})
