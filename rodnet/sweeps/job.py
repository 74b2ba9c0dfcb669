"""The work at one point of a sweep: build the robot, simulate, measure. Runs in any process."""

from __future__ import annotations

import dataclasses
import io
import math
import os
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import ParameterError, RodnetError

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.simulation import Simulation
    from rodnet.trajectory import Trajectory

LARGEST = 10_000  # numbers in one metric; more is a trajectory
DT = 1e-2  # time step [s] if nothing is said


class ContractError(ParameterError):
    """A function of the sweep returns what it must not: every point would fail in the same way."""


@dataclass(frozen=True)
class Task:
    """What is done at every point; see `rodnet.sweep` for the fields.

    ``save`` is an absolute path; ``mark`` is in the names of the files there, those of another sweep have another.
    """

    build: Callable[..., Any]
    metrics: Callable[[Any], Any]
    simulate: Callable[[Any], Any] | None = None
    duration: float | None = None
    dt: float | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    save_every: int = 5
    stop: Callable[[Any], bool] | None = None
    save: str | None = None
    mark: str = ""

    def robot(self, row: Mapping[str, Any]) -> Robot | Simulation:
        """Return what ``build`` makes of a point, with the parameters that have a dot in their name."""
        from rodnet.robot import Robot
        from rodnet.simulation import Simulation

        paths = {k: v for k, v in row.items() if "." in k}
        made = self.build(**{k: v for k, v in row.items() if k not in paths})
        if isinstance(made, Simulation):
            if paths:
                raise ContractError(
                    f"{', '.join(paths)} can be set on a Robot only, and the building function returns a Simulation: "
                    "return the robot, or take the value as an argument"
                )
            if self.dt is not None or self.options:
                raise ContractError(
                    "the building function returns a Simulation, which has its own dt and options; do not give "
                    "them to the sweep"
                )
        elif not isinstance(made, Robot):
            raise ContractError(
                f"the building function must return a Robot or a Simulation, not {type(made).__name__}"
            )
        return made.with_parameters(paths) if paths else made

    def begin(self, row: Mapping[str, Any]) -> Robot | Simulation:
        """Return what is simulated at a point: a simulation at its beginning, or what ``simulate`` takes."""
        from rodnet.robot import Robot
        from rodnet.simulation import Simulation

        made = self.robot(row)
        if isinstance(made, Robot) and self.simulate is None:
            return Simulation(made, DT if self.dt is None else self.dt, **self.options)
        return made

    def units(self, begun: Robot | Simulation, row: Mapping[str, Any]) -> dict[str, str]:
        """Return the units of the robot's parameters that a point sets."""
        known = parameters(begun)
        return {path: known[path].unit for path in row if "." in path}

    def run(self, begun: Any) -> Trajectory:
        """Simulate."""
        from rodnet.trajectory import Trajectory

        if self.simulate is None:
            assert self.duration is not None
            return begun.run(self.duration, save_every=self.save_every, stop=self.stop)
        traj = self.simulate(begun)
        if not isinstance(traj, Trajectory):
            raise ContractError(
                f"simulate must return a Trajectory, as sim.run(...) does, not {type(traj).__name__}"
            )
        return traj


def parameters(made: Robot | Simulation) -> Mapping[str, Any]:
    """Parameters by path of a robot, or of a simulation's."""
    from rodnet.simulation import Simulation

    return (made.robot if isinstance(made, Simulation) else made).parameters


def pack(things: Any, what: str) -> bytes:
    """Return functions or values as bytes that a process elsewhere can read, those of scripts and notebooks too.

    Raises
    ------
    ParameterError
        If they hold on to something that only lives in this process.
    """
    import cloudpickle

    class Pickler(cloudpickle.CloudPickler):
        """Tells in which modules what it packs is defined, however deep inside that is."""

        def reducer_override(self, obj: Any) -> Any:
            if isinstance(obj, type | FunctionType | ModuleType):
                names.add(obj.__name__ if isinstance(obj, ModuleType) else obj.__module__)
            return super().reducer_override(obj)

    names: set[str | None] = set()
    known, strangers = {*cloudpickle.list_registry_pickle_by_value(), "__main__", "builtins"}, []
    try:
        while True:  # what a stranger's functions use may be another's
            out = io.BytesIO()
            Pickler(out).dump(things)
            found = [
                sys.modules[n] for n in names - known if n in sys.modules and not importable(sys.modules[n])
            ]
            known |= names
            if not found:
                return out.getvalue()
            for module in found:
                cloudpickle.register_pickle_by_value(module)
            strangers += found
    except (TypeError, pickle.PicklingError, AttributeError, RecursionError) as error:
        raise ParameterError(
            f"the {what} cannot be sent to other processes ({error}); they must not hold open files, locks or the "
            "like: make such things inside the building function"
        ) from None
    finally:
        for module in strangers:
            cloudpickle.unregister_pickle_by_value(module)


def importable(module: Any) -> bool:
    """Whether another process with the same path imports this module by its name (not one loaded by hand)."""
    name, path, spec = "", None, None
    for part in module.__name__.split("."):
        name = f"{name}.{part}" if name else part
        finders = (f for f in sys.meta_path if hasattr(f, "find_spec"))
        spec = next((s for f in finders if (s := f.find_spec(name, path)) is not None), None)
        if spec is None:
            return False
        path = spec.submodule_search_locations
    here = getattr(module, "__file__", None)
    there = spec.origin if spec is not None and spec.has_location else None
    return here is None or there is None or (os.path.exists(there) and os.path.samefile(there, here))


def load(packed: bytes) -> str:
    """Load a task, so that a worker which cannot do that is found before any computing; return rodnet's version."""
    import rodnet

    pickle.loads(packed)
    return rodnet.__version__


def run_point(packed: bytes, key: str, row: bytes) -> dict[str, Any]:
    """Compute one point; return what its record says of it, as plain values.

    These are ``seconds`` and either ``metrics`` and ``units``, or ``error`` (``type``, ``message``, ``time`` [s],
    ``traceback``), or ``invalid`` if the functions do not keep to their contract.
    """
    from threadpoolctl import threadpool_limits

    start = time.perf_counter()
    with threadpool_limits(1):  # points are what runs side by side
        try:
            # each point has its own copy: functions with a memory start afresh
            record = _record(pickle.loads(packed), key, pickle.loads(row))
        except Exception as error:  # parameters that cannot be loaded there
            record = {"error": describe(error)}
    return {**record, "seconds": time.perf_counter() - start}


def _record(task: Task, key: str, row: Mapping[str, Any]) -> dict[str, Any]:
    record: dict[str, Any] = {}
    begun = traj = None
    try:
        begun = task.begin(row)
        known = task.units(begun, row)
        with _debug_files(task.save, key + task.mark):
            traj = task.run(begun)
        if traj.status == "interrupted":
            raise KeyboardInterrupt
        if task.save is not None:
            record["trajectory"] = str(_keep(traj, task.save, key + task.mark))
        metrics, units, note = tabulate(task.metrics(traj))
    except ContractError as error:
        record["invalid"] = str(error)
    except (Exception, SystemExit) as error:  # whatever a robot does, the others go on
        partial = getattr(error, "trajectory", None)
        if task.save is not None and partial is not None:
            record["trajectory"] = str(_keep(partial, task.save, key + task.mark))
        record["error"] = describe(error, _time_of(error, begun, traj))
    else:
        record["metrics"], record["units"] = metrics, known | units
        if note:
            record["note"] = note
    return record


def describe(error: BaseException, at: float = math.nan) -> dict[str, Any]:
    """Return what a record keeps of an error."""
    message = str(error)
    debug = getattr(error, "debug_path", None)
    if debug is not None and not os.path.exists(debug):
        message = message.replace(f" The failing step is in {debug}.", "")
    trace = "" if isinstance(error, RodnetError) else "".join(traceback.format_exception(error))
    return {"type": type(error).__name__, "message": message, "time": at, "traceback": trace}


def _time_of(error: BaseException, begun: Any, traj: Any) -> float:
    """Time that a simulation had reached when it failed [s]; NaN before it began."""
    told = getattr(error, "time", math.nan)
    if isinstance(told, float) and math.isfinite(told):
        return told
    return float(traj.t[-1]) if traj is not None else float(getattr(begun, "t", math.nan))


@contextmanager
def _debug_files(save: str | None, key: str) -> Iterator[None]:
    """Put the recording of a failing step beside the trajectories; without a place for them, leave none."""
    try:
        yield
    except RodnetError as error:
        debug = getattr(error, "debug_path", None)
        if debug is not None and save is None:
            Path(debug).unlink(missing_ok=True)
        elif debug is not None and save is not None:
            place = Path(save) / f"{key}.debug.rrd"
            os.replace(debug, place)
            error.args = (str(error).replace(debug, str(place)), *error.args[1:])
            error.debug_path = str(place)  # type: ignore[attr-defined]
        raise


def _keep(traj: Trajectory, folder: str, key: str) -> Path:
    """Save a trajectory, whole or not at all."""
    path = Path(folder) / f"{key}.nc"
    unfinished = path.with_suffix(".part.nc")
    traj.save(unfinished)
    os.replace(unfinished, path)
    traj.path = path
    return path


# -- metrics ----------------------------------------------------------------------------------
def tabulate(found: Any) -> tuple[dict[str, Any], dict[str, str], str]:
    """Return the values by name (one alone is called ``value``), plain, their units as far as they are known, a note.

    Raises
    ------
    ContractError
        If they are not numbers, truth values or short arrays of such.
    """
    units: dict[str, str] = {}
    if dataclasses.is_dataclass(found) and not isinstance(found, type):
        fields = dataclasses.fields(found)
        units = {f.name: f.metadata["unit"] for f in fields if "unit" in f.metadata}
        found = {f.name: getattr(found, f.name) for f in fields}
    elif hasattr(found, "_asdict"):
        found = found._asdict()
    elif found is None:
        raise ContractError("the metrics function returns nothing; return {'speed': ...}")
    elif not isinstance(found, Mapping):
        found = {"value": found}
    note = found["note"] if isinstance(found.get("note"), str) else ""
    found = {name: value for name, value in found.items() if not (name == "note" and isinstance(value, str))}
    if not found:
        raise ContractError("the metrics are empty; return at least one number by name")
    return {_metric_name(name): _plain(name, value) for name, value in found.items()}, units, note


def _metric_name(name: Any) -> str:
    if not isinstance(name, str) or not name or "/" in name:
        raise ContractError(f"{name!r} is no name of a metric; names are words without a slash")
    return name


def _plain(name: str, value: Any) -> Any:
    if value is None:
        return math.nan
    if isinstance(value, bool | int | float):
        return value
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        array = np.asarray(None)
    if array.dtype.kind not in "biuf":
        raise ContractError(
            f"the metric '{name}' is {value!r:.60}; metrics are numbers, truth values or arrays of them"
        )
    if array.size > LARGEST:
        raise ContractError(
            f"the metric '{name}' has {array.size} numbers, more than {LARGEST}; keep trajectories instead, by save="
        )
    return array.tolist()
