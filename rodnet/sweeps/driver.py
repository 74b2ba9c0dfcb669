"""`sweep`: many robots, each built, simulated and measured by the same functions."""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import os
import platform
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rodnet
from rodnet.errors import OutputError, ParameterError
from rodnet.names import meant
from rodnet.storage import check_writable
from rodnet.sweeps.collect import Serial
from rodnet.sweeps.fingerprint import fingerprint, qualified_name
from rodnet.sweeps.job import DT, Task, pack, parameters
from rodnet.sweeps.journal import SUFFIX, Journal
from rodnet.sweeps.meter import SweepProgress
from rodnet.sweeps.points import Points, check_arguments, make_points
from rodnet.sweeps.processes import Processes
from rodnet.sweeps.study import Study

if TYPE_CHECKING:
    import xarray as xr


def sweep(
    build: Callable[..., Any] | str,
    grid: Any = None,
    metrics: Callable[[Any], Any] | None = None,
    executor: Executor | None = None,
    *,
    samples: Any = None,
    duration: float | None = None,
    dt: float | None = None,
    options: Mapping[str, Any] | None = None,
    save_every: int = 5,
    stop: Callable[[Any], bool] | None = None,
    simulate: Callable[[Any], Any] | None = None,
    out: str | Path | None = None,
    save: str | Path | None = None,
    workers: int | None = None,
    retry: bool = False,
    progress: bool | Callable[[SweepProgress], None] = False,
    units: Mapping[str, str] | None = None,
) -> xr.Dataset:
    """Simulate and measure a robot at every point of a grid, or for every row of samples.

    A robot that fails is recorded with its error, and the others go on. Every result is on disk as soon
    as it is there; after a crash, Ctrl-C or a power cut the same call computes only what is missing.

    Parameters
    ----------
    build : callable or str
        ``build(**parameters)`` returns a `Robot` or a `Simulation`; or the id of an installed robot,
        ``"flagellated"``, or a robot's file, ``"robot.toml"``.
    grid : mapping, or a table
        Values by name, ``{"n_tails": [2, 3], "rpm": [50, 100]}``: every combination is a point. A single
        value is the same everywhere. Names are arguments of ``build``, or paths of the robot's
        parameters, which have a dot in them, ``"drag.viscosity"``. A sequence of mappings or a data
        frame is taken for ``samples``.
    metrics : callable, optional
        ``metrics(trajectory)`` returns a dict, namedtuple or dataclass of numbers or short arrays, always
        of the same names, and if there is something to say of them, why one is NaN, a text by the name
        ``note``. Installed robots have metrics of their own.
    executor : concurrent.futures.Executor, optional
        Where points are computed; left running. By default ``workers`` processes of this machine.
    samples : sequence of mappings, mapping of columns, or data frame
        One point per row, in place of a grid.
    duration : float
        Time to simulate [s]; not with ``simulate``.
    dt : float, optional
        Time step [s], 0.01 by default; not for a ``build`` that returns a `Simulation`.
    options : mapping, optional
        Other arguments of `Simulation`, such as ``stepper`` and ``adaptive``; not for a ``build`` that
        returns one.
    save_every, stop
        As in `Simulation.run`. A ``stop`` that remembers starts afresh at each point.
    simulate : callable, optional
        ``simulate(robot)`` returns the `Trajectory`, in place of all the above: to stop when steady, say,
        or to find an equilibrium. It gets what ``build`` returns.
    out : path, optional
        NetCDF file of the results. Beside it lies a journal (``.jsonl``), which a restart reads. Without
        it, results are in memory only.
    save : path, optional
        Directory for the trajectories, and for the recordings of steps that did not converge.
    workers : int, optional
        Number of processes, each with one thread; by default one per core. 0 computes in this process.
    retry : bool
        Compute those points again that failed in an earlier run.
    progress : bool or callable
        Show progress and the time left on standard error, or call with a `SweepProgress` after every point.
    units : mapping, optional
        Units of parameters and metrics by name. Those of parameter paths, and of dataclass fields with
        ``metadata={"unit": ...}``, are known.

    Returns
    -------
    xarray.Dataset
        Metrics over the swept parameters (of samples, over ``sample``), NaN where a robot failed. Of every
        point also ``state`` ("done", "failed", "missing"), ``error`` (class and message, or empty),
        ``error_time`` [s] (simulated, when it failed), ``seconds`` that it took, and ``note`` where metrics gave
        one. The attribute ``status`` is "finished", or "interrupted" after Ctrl-C: then it has what was computed.

    Raises
    ------
    ParameterError
        For bad input, before anything is computed: an empty grid, an unknown parameter, an executor
        that was shut down. Also if the first metrics are no numbers.
    OutputError
        If ``out`` cannot be written, holds another sweep, or another process is computing this one.
    SweepError
        If worker processes do not start, or the executor stops.
    """
    points = make_points(grid, samples)
    with ExitStack() as stack:
        if executor is None:  # its processes load what they need while this one does
            executor = start(workers, len(points.rows))
            stack.callback(executor.shutdown, cancel_futures=True)
        elif workers is not None:
            raise ParameterError("an executor has its own workers; give either executor or workers")
        build, metrics = _resolve(build, metrics)
        check_arguments(build, points.names)
        save = None if save is None else str(Path(save).resolve())
        task = Task(build, metrics, simulate, duration, dt, dict(options or {}), save_every, stop, save)
        _check(task, executor)
        identity = _identity(task)
        mark = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:8]
        packed = pack(replace(task, mark=f"-{mark}"), "functions")
        _check_paths(task, points)
        if save is not None:
            check_writable(Path(save) / "trajectory.nc")
        study = Study(packed, points, {"status": "unfinished", "identity": identity}, dict(units or {}))
        if out is not None:
            study.out = check_writable(out)
            place = study.out.with_name(study.out.name + SUFFIX)
            if study.out.exists() and not place.exists():
                raise OutputError(
                    f"'{out}' exists and has no journal '{place}' beside it; choose another file, or delete it"
                )
            study.journal = stack.enter_context(Journal(place, identity))
            study.recall(retry, kept=save is not None)
        return study.finish(executor, progress)


def start(workers: Any, jobs: int) -> Executor:
    """Start as many processes as are asked for and of use, by default one per core; 0 is this process."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
        raise ParameterError(f"workers = {workers!r} must be a number of processes, or 0 for this process")
    return Processes(min(workers, jobs)) if workers else Serial()


def _resolve(build: Any, metrics: Any) -> tuple[Callable[..., Any], Callable[[Any], Any]]:
    """Return the functions: those of an installed robot, if it is given by name."""
    from rodnet.robots.flagellated import flagellated, flagellated_metrics
    from rodnet.runs import robot_factory

    if isinstance(build, str):
        build = robot_factory(build)
    if not callable(build):
        raise ParameterError(
            f"build must be a function that returns a Robot, or the name of one, not {build!r:.60}"
        )
    if metrics is None:
        metrics = flagellated_metrics if build is flagellated else getattr(build, "metrics", None)
    if not callable(metrics):
        raise ParameterError(
            "a sweep needs metrics, a function of a trajectory that returns numbers by name: "
            "lambda traj: {'distance': float(traj.x[-1, 0, 0])}"
        )
    return build, metrics


def _check(task: Task, executor: Any) -> None:
    """Check the options."""
    if task.simulate is None:
        if task.duration is None:
            raise ParameterError("a sweep needs duration=..., the time to simulate [s] (or simulate=...)")
        if isinstance(task.duration, str) or not (math.isfinite(task.duration) and task.duration > 0):
            raise ParameterError(f"duration = {task.duration!r} must be a positive time [s]")
        if int(task.save_every) != task.save_every or task.save_every < 1:
            raise ParameterError(f"save_every = {task.save_every!r} must be a positive integer")
    elif any(given is not None for given in (task.duration, task.dt, task.stop)) or task.options:
        raise ParameterError(
            "simulate= runs the simulation itself; do not give duration, dt, options or stop with it"
        )
    if task.dt is not None and (isinstance(task.dt, str) or not (math.isfinite(task.dt) and task.dt > 0)):
        raise ParameterError(f"dt = {task.dt!r} must be a positive time step [s]")
    _check_options(task.options)
    for label, function in (("stop", task.stop), ("simulate", task.simulate)):
        if function is not None and not callable(function):
            raise ParameterError(f"{label} must be a function, not {function!r:.60}")
    if not callable(getattr(executor, "submit", None)):
        raise ParameterError(
            f"executor must be a concurrent.futures.Executor, not {type(executor).__name__} "
            "(a dask client has one: client.get_executor())"
        )


def _check_options(options: Mapping[str, Any]) -> None:
    from rodnet.simulation import Simulation
    from rodnet.solve.steppers import make_stepper

    known = set(inspect.signature(Simulation).parameters) - {"robot", "dt"}
    unknown = sorted(set(options) - known)
    if unknown:
        raise ParameterError(
            f"options: a Simulation takes no {unknown[0]!r}; {meant(unknown[0], known)}it takes "
            f"{', '.join(sorted(known))}"
        )
    if "stepper" in options:
        make_stepper(options["stepper"])


def _check_paths(task: Task, points: Points) -> None:
    """Build a robot to see whether it has the parameters that are given by path."""
    paths = [name for name in points.names if "." in name]
    known: set[str] = set()
    for row in (points.rows[0], points.rows[-1]) if paths else ():  # robots may differ in their rods
        try:
            known |= set(parameters(task.robot({k: v for k, v in row.items() if k not in paths})))
        except Exception:  # this robot fails, others may not: the sweep records it
            continue
    unknown = [path for path in paths if known and path not in known]
    if unknown:
        raise ParameterError(
            f"the robot has no parameter {unknown[0]!r}; {meant(unknown[0], known)}there are {', '.join(sorted(known))}"
        )


def _identity(task: Task) -> dict[str, Any]:
    """Return what all results depend on, besides the parameters of each."""
    found: dict[str, Any] = {}
    for name in ("build", "metrics", "simulate", "stop"):
        function = getattr(task, name)
        if function is not None:
            found[name] = {"name": qualified_name(function), "code": fingerprint(function)}
    if task.simulate is None:
        found["duration"], found["save_every"] = task.duration, task.save_every
        found["dt"] = DT if task.dt is None else task.dt
        for name, value in task.options.items():
            found[name] = value if isinstance(value, str | int | float | None) else fingerprint(value)
    found["rodnet"] = rodnet.__version__
    found["python"] = ".".join(platform.python_version_tuple()[:2])
    return found
