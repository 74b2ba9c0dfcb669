"""Parameter studies: many robots, by any executor, each result kept as it comes."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.journal import Journal

if TYPE_CHECKING:
    import xarray as xr

    from rodnet.simulation import Simulation
    from rodnet.trajectory import Trajectory

RESERVED = {"error", "seconds", "sample"}


def sweep(
    build: Callable[..., Any],
    grid: Any,
    metrics: Callable[[Trajectory], Any],
    executor: Executor | None = None,
    *,
    duration: float | None = None,
    dt: float = 1e-2,
    save_every: int = 5,
    options: Mapping[str, Any] | None = None,
    simulate: Callable[[Any], Trajectory] | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    retry: bool = False,
    units: Mapping[str, str] | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Build, run and measure a robot for every combination of parameters, or every sample.

    Parameters
    ----------
    build : callable
        ``build(**parameters)`` returns a `Robot`, or a `Simulation` of one.
    grid : mapping or sequence of mappings
        Values of each parameter, of which every combination is run (one dimension each); or
        samples, one mapping of parameters each (or a table that has ``to_dict("records")``), along one
        dimension ``sample``.
    metrics : callable
        ``metrics(trajectory)`` returns numbers by name: a mapping, a dataclass, a named tuple; or one
        number, ``value``. Arrays are allowed, of the same shape in every run.
    executor : concurrent.futures.Executor, optional
        Who computes: threads, a cluster; by default processes on this machine.
    duration, dt : float
        Time to simulate and time step [s].
    save_every : int
        What `Simulation.run` keeps for ``metrics``.
    options : mapping, optional
        Other arguments of `Simulation`, such as ``stepper`` and ``adaptive``.
    simulate : callable, optional
        ``simulate(robot)`` returns the trajectory, instead of all the above: to stop when steady, say.
    out : path, optional
        NetCDF file of the results. Beside it a journal (``.jsonl``) keeps each result as it comes:
        interrupted or killed and called again, a sweep computes only what is missing, also of a larger
        grid.
    workers : int, optional
        Number of processes (default: the cores at hand).
    retry : bool
        Run again what the journal says has failed.
    units : mapping, optional
        Units of the metrics.
    progress : bool
        Show progress and the time left.

    Returns
    -------
    xarray.Dataset
        Metrics over the parameters (NaN where a run failed), ``error`` (empty where none happened) and
        ``seconds``.

    Raises
    ------
    ParameterError
        For an empty grid, parameters that ``build`` does not take, or a missing duration.
    OutputError
        If ``out`` cannot be written, or its journal is of another sweep.
    """
    from rodnet.storage import check_writable
    from rodnet.sweep_jobs import run_jobs

    study = Study.of(grid)
    study.check(build)
    if simulate is None:
        if duration is None or not (np.isfinite(duration) and duration > 0):
            raise ParameterError(
                f"sweep: duration = {duration!r} must be a positive time [s]; or give simulate="
            )
        simulate = Run(float(duration), float(dt), save_every, dict(options or {}))
    for name, function in (("build", build), ("metrics", metrics), ("simulate", simulate)):
        if not callable(function):
            raise ParameterError(f"sweep: {name} must be a function, got {function!r}")
    path = None if out is None else check_writable(out)
    parts = {"build": build, "metrics": metrics, "simulate": simulate}
    journal = Journal(
        None if path is None else path.with_name(path.name + ".jsonl"),
        {name: identity(function) for name, function in parts.items()},
    )
    try:
        missing = {
            key: point
            for key, point in study.points.items()
            if key not in journal.results or (retry and "error" in journal.results[key])
        }
        run_jobs(tuple(parts.values()), missing, journal.add, executor, workers, progress, len(study.points))
    except BaseException:
        with contextlib.suppress(Exception):  # what there is, without hiding why there is not more
            if path is not None:
                _write(study.dataset(journal.results, units or {}), path)
        raise
    finally:
        journal.close()
    found = study.dataset(journal.results, units or {})
    if path is not None:
        _write(found, path)
    return found


@dataclass(frozen=True)
class Run:
    """Simulate a robot for a time; the default way of a sweep."""

    duration: float
    dt: float
    save_every: int = 5
    options: dict[str, Any] = field(default_factory=dict)

    def __call__(self, made: Any) -> Trajectory:
        from rodnet.robot import Robot
        from rodnet.simulation import Simulation

        if isinstance(made, Robot):
            made = Simulation(made, self.dt, **self.options)
        if not isinstance(made, Simulation):
            raise ParameterError(f"build must return a Robot or a Simulation, got {type(made).__name__}")
        sim: Simulation = made
        return sim.run(self.duration, save_every=self.save_every)


@dataclass(frozen=True)
class Study:
    """The points of a sweep, by key, and the dimensions along which they are laid out.

    ``keys`` has one for every place, in order; equal samples share a point.
    """

    dims: dict[str, list[Any]]
    keys: list[str]
    points: dict[str, dict[str, Any]]
    sampled: bool

    @classmethod
    def of(cls, grid: Any) -> Study:
        """Take a grid or samples."""
        if hasattr(grid, "to_dict") and not isinstance(grid, Mapping):
            grid = grid.to_dict("records")
        if isinstance(grid, Mapping):
            dims = {name: _values(values) for name, values in grid.items()}
            for name, values in dims.items():
                if not values:
                    raise ParameterError(f"sweep: the grid has no values for '{name}'")
                if len({_key({name: v}) for v in values}) < len(values):
                    raise ParameterError(f"sweep: the grid has the same value of '{name}' twice")
            points = [
                dict(zip(dims, combination, strict=True)) for combination in itertools.product(*dims.values())
            ]
        else:
            points = [dict(sample) for sample in grid]
            names = list(points[0]) if points else []
            for k, sample in enumerate(points):
                if list(sample) != names:
                    raise ParameterError(
                        f"sweep: sample {k} has parameters {list(sample)}, the first one {names}"
                    )
            dims = {name: [_plain(sample[name]) for sample in points] for name in names}
        if not points or not dims:
            raise ParameterError(
                "sweep: nothing to run; give grid={'rpm': [50, 100], ...} or a list of samples"
            )
        reserved = [name for name in dims if name in RESERVED]
        if reserved:
            raise ParameterError(f"sweep: a parameter cannot be named {reserved[0]!r}, which the results are")
        keys = [_key(p) for p in points]
        return cls(dims, keys, dict(zip(keys, points, strict=True)), not isinstance(grid, Mapping))

    def check(self, build: Callable[..., Any]) -> None:
        """Refuse parameters that ``build`` does not take, before anything is computed."""
        try:
            taken = inspect.signature(build).parameters
        except (TypeError, ValueError):
            return
        if any(p.kind is p.VAR_KEYWORD for p in taken.values()):
            return
        unknown = [name for name in self.dims if name not in taken]
        if unknown:
            raise ParameterError(
                f"sweep: build takes no {', '.join(map(repr, unknown))}; it takes {', '.join(taken) or 'nothing'}"
            )

    def dataset(self, results: Mapping[str, Mapping[str, Any]], units: Mapping[str, str]) -> xr.Dataset:
        """Lay the results out along the dimensions."""
        import xarray as xr

        found = [results.get(key, {}) for key in self.keys]
        dims = ("sample",) if self.sampled else tuple(self.dims)
        shape = (len(found),) if self.sampled else tuple(len(v) for v in self.dims.values())
        coords = {
            name: (("sample",) if self.sampled else (name,), _coordinate(v)) for name, v in self.dims.items()
        }
        data: dict[str, Any] = {}
        for name in dict.fromkeys(n for r in found for n in r.get("values", {})):
            sample = next(np.asarray(r["values"][name]) for r in found if name in r.get("values", {}))
            nothing = np.full(sample.shape, np.nan)
            rows = [np.asarray(r.get("values", {}).get(name, nothing), dtype=float) for r in found]
            rows = [row if row.shape == sample.shape else nothing for row in rows]
            extra = tuple(f"{name}_{k}" for k in range(sample.ndim))
            data[name] = (dims + extra, np.stack(rows).reshape(shape + sample.shape))
        data["seconds"] = (dims, np.array([r.get("seconds", np.nan) for r in found]).reshape(shape))
        errors = np.array([r.get("error", "") for r in found], dtype=object).reshape(shape)
        data["error"] = (dims, errors)
        dataset = xr.Dataset(data, coords)
        dataset["seconds"].attrs["units"] = "s"
        for name, unit in units.items():
            if name in dataset:
                dataset[name].attrs["units"] = unit
        return dataset


def identity(function: Callable[..., Any]) -> str:
    """Name and hash of what a function does, as far as its own source and what it holds on to tell."""
    if isinstance(function, functools.partial):
        return f"{identity(function.func)} {_digest([function.args, function.keywords])}"
    if inspect.ismethod(function):
        return f"{identity(function.__func__)} {_digest(function.__self__)}"
    shown: Any = function if inspect.isfunction(function) else type(function)
    try:
        source = inspect.getsource(shown)
    except (OSError, TypeError):
        source = ""
    held = (
        [
            [c.cell_contents for c in function.__closure__ or ()],
            function.__defaults__,
            function.__kwdefaults__,
        ]
        if inspect.isfunction(function)
        else getattr(function, "__dict__", repr(function))
    )
    return f"{shown.__module__}.{shown.__qualname__} {_digest([source, held])}"


def numbers(found: Any, taken: Iterable[str] = ()) -> dict[str, Any]:
    """Return what ``metrics`` has found as plain numbers by name.

    Raises
    ------
    ParameterError
        If there is anything else in it, or a name is ``taken`` by a parameter or by the results.
    """
    if dataclasses.is_dataclass(found) and not isinstance(found, type):
        found = {f.name: getattr(found, f.name) for f in dataclasses.fields(found)}
    elif hasattr(found, "_asdict"):
        found = found._asdict()
    elif not isinstance(found, Mapping):
        found = {"value": found}
    out = {}
    for name, value in found.items():
        if name in RESERVED or name in taken:
            raise ParameterError(
                f"metrics cannot return '{name}': that is a parameter or a name of the results"
            )
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(f"metrics must return numbers, but '{name}' is {value!r}") from None
        out[str(name)] = array.tolist()
    return out


def _values(values: Any) -> list[Any]:
    if isinstance(values, str) or not isinstance(values, Iterable):
        values = [values]
    return [_plain(v) for v in values]


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _coordinate(values: Sequence[Any]) -> np.ndarray:
    """Values as a coordinate: numbers or words; anything else by its name."""
    array = np.array([v if isinstance(v, bool | int | float | str) else repr(v) for v in values])
    return array if array.dtype.kind in "biufU" else array.astype(str)


def _key(point: Mapping[str, Any]) -> str:
    return _digest(dict(sorted(point.items())))


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(_code(value)).encode()).hexdigest()[:24]


def _code(value: Any) -> Any:
    """A value as JSON knows it, the same for equal values in every process; else a hash of all of it."""
    value = _plain(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(k): _code(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_code(v) for v in value]
    if isinstance(value, np.ndarray) and value.dtype != object:
        return [
            str(value.dtype),
            value.shape,
            hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest(),
        ]
    if inspect.isfunction(value):
        return identity(value)
    import cloudpickle

    return hashlib.sha256(cloudpickle.dumps(value)).hexdigest()


def _write(dataset: xr.Dataset, path: Path) -> None:
    """Write to a file beside it first, so that no half-written one is ever seen."""
    draft = path.with_name(f".{path.name}.part")
    dataset.to_netcdf(draft, engine="h5netcdf")
    draft.replace(path)
