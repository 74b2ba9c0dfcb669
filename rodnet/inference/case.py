"""A case: a short Python file that says how a kind of recording becomes a robot and what was observed of it."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from rodnet.errors import CaseError
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

PARTS = (
    "free", "per_trial", "tied", "options", "candidates", "drives", "metric", "metric_name", "cut", "kind", "baselines",
    "noise",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """How recordings of one kind are simulated and compared.

    Parameters
    ----------
    build : callable
        ``build(rec) -> Robot``, at the beginning of the recording.
    observe : callable
        ``observe(rec, robot) -> Observation`` or a list of them: what was recorded of it.
    free : sequence of str
        Paths of the parameters to calibrate, the same in all trials: of the robot (``"drag.viscosity"``,
        ``"cable.E"``), or of an observation (``"markers.lag"``).
    per_trial : sequence of str
        Paths of nuisance parameters with a value for each trial: ``"initial.position"`` (a smooth change of the
        initial shape, and of the twist of bent rods), ``"initial.velocity"``, or any path that ``free`` may hold.
    tied : mapping
        Parameters that follow others: path -> function of {path: value} of the free ones.
    options : callable
        ``options(rec, robot) -> dict`` of `Simulation`: dt, stepper, velocity. By default the step is the largest
        part of the frame interval below 10 ms, the stepper ``"sdirk2"``, and the robot starts at rest.
    candidates : sequence
        What a diagnosis tries beside the installed candidates.
    drives : callable or None
        ``drives(rec) -> list``: what could be tried next.
    metric : callable or None
        ``metric(rec, predicted) -> float``, with one array for each observation: the set's own measure of error; by
        default the root mean square of all residuals.
    metric_name : str
        What it is called, with its unit.
    cut : callable or None
        ``cut(rec) -> Recording``: the part of a recording that is simulated; by default all of it.
    kind : callable or None
        ``kind(rec) -> str``: which recordings are summed up together; by default those of one folder.
    baselines : callable or None
        ``baselines(train) -> {name: predict}``: simpler models fitted to the recordings ``train``, with
        ``predict(rec)`` returning an array for each observation. `RestPose` and `LinearMotion` are such; a
        calibration keeps these with what it has fitted.
    noise : NoiseModel, float, mapping, callable or None
        What a calibration and a diagnosis weigh residuals with, as `calibrate` takes it, for a model that is known to
        be off by far more than its instruments: where whole motions count, ``0.01`` makes it plain least squares.
        By default that of the recordings.
    name : str
        For reports.
    path : Path or None
        The file it came from.
    """

    build: Callable[[Recording], Robot]
    observe: Callable[[Recording, Robot], Observation | Sequence[Observation]]
    free: Sequence[str] = ()
    per_trial: Sequence[str] = ()
    tied: Mapping[str, Callable[[Mapping[str, float]], float]] = field(default_factory=dict)
    options: Callable[[Recording, Robot], Mapping[str, Any]] | None = None
    candidates: Sequence[Any] = ()
    drives: Callable[[Recording], Sequence[Any]] | None = None
    metric: Callable[[Recording, list[Any]], float] | None = None
    metric_name: str = "rms (SI)"
    cut: Callable[[Recording], Recording] | None = None
    kind: Callable[[Recording], str] | None = None
    baselines: Callable[[Sequence[Recording]], Mapping[str, Callable[[Recording], list[Any]]]] | None = None
    noise: Any = None
    name: str = "case"
    path: Path | None = None

    def part(self, rec: Recording) -> Recording:
        """Return what of a recording is simulated; its times count from its first frame, as a simulation's do."""
        found = rec if self.cut is None else self.cut(rec)
        if not isinstance(found, Recording):
            raise CaseError(
                f"case '{self.name}': cut(rec) must return a Recording, got {type(found).__name__}"
            )
        if not found.t[0]:
            return found
        channels = {
            key: np.asarray(channel) for key, channel in found.channels.items()
        }  # without their times
        return found.replace(t=found.t - found.t[0], channels=channels)

    def kind_of(self, rec: Recording) -> str:
        """Return what a recording is summed up with."""
        if self.kind is not None:
            return str(self.kind(rec))
        return rec.path.resolve().parent.name if rec.path is not None else "all"

    def simpler(self, train: Sequence[Recording]) -> dict[str, Callable[[Recording], list[Any]]]:
        """Return the case's simpler models, fitted to what is simulated of recordings; none without ``baselines``."""
        if self.baselines is None:
            return {}
        found = self.baselines(train)
        if not isinstance(found, Mapping) or not all(callable(f) for f in found.values()):
            raise CaseError(
                f"case '{self.name}': baselines(train) must return functions of a recording by name"
            )
        return dict(found)

    def robot(self, rec: Recording) -> Robot:
        """Build the robot of a recording.

        Raises
        ------
        CaseError
            If ``build`` returns something else.
        """
        robot = self.build(rec)
        if not isinstance(robot, Robot):
            raise CaseError(
                f"case '{self.name}': build(rec) must return a rodnet.Robot, got {type(robot).__name__}"
            )
        return robot

    def observations(self, rec: Recording, robot: Robot) -> list[Observation]:
        """Return the instruments of a recording, checked against it."""
        found = self.observe(rec, robot)
        instruments = [found] if isinstance(found, Observation) else list(found)
        for one in instruments:
            if not isinstance(one, Observation):
                raise CaseError(
                    f"case '{self.name}': observe(rec, robot) must return rodnet observations, got {type(one).__name__}"
                )
            one.check(rec)
        names = [one.name for one in instruments]
        if not names or len(set(names)) != len(names):
            raise CaseError(f"case '{self.name}': observations need different names (name=...), got {names}")
        return instruments

    def menu(self, rec: Recording) -> list[tuple[str, Recording]]:
        """Return what could be tried next, as names and recordings of what is commanded; nothing without ``drives``.

        Raises
        ------
        CaseError
            If ``drives`` fails or returns something else, or what it lists cannot be told apart by its names.
        """
        if self.drives is None:
            return []
        try:
            listed = list(self.drives(rec))
        except Exception as error:
            raise CaseError(
                f"case '{self.name}': drives(rec) fails: {type(error).__name__}: {error}"
            ) from error
        found = {}
        for entry in listed:
            pair = isinstance(entry, tuple) and len(entry) == 2
            name, planned = (str(entry[0]), entry[1]) if pair else (getattr(entry, "name", ""), entry)
            if not isinstance(planned, Recording):
                raise CaseError(
                    f"case '{self.name}': drives(rec) must list recordings, or pairs (what to do, recording), "
                    f"got {entry!r:.80}"
                )
            if name in found or (name == rec.name and not pair):
                raise CaseError(
                    f"case '{self.name}': drives(rec) lists two trials, or one and a recording, called '{name}'; "
                    "list pairs (what to do, recording)"
                )
            found[name] = _everywhere(planned.replace(name=name))
        return list(found.items())

    def simulation(self, rec: Recording, robot: Robot) -> dict[str, Any]:
        """Return the options of the simulation of a recording: dt, stepper and so on."""
        frame = 1.0 / rec.rate
        parts = 1
        while frame / parts > 0.01 * (1 + 1e-6):
            parts += 1
        given = {} if self.options is None else dict(self.options(rec, robot))
        return {"dt": frame / parts, "stepper": "sdirk2", **given}


def _everywhere(rec: Recording) -> Recording:
    """What is planned, its markers seen in all frames: where they will be is not known, nor what will be lost."""
    lost = ~np.isfinite(rec.markers)
    first = np.argmax(~lost, axis=0, keepdims=True)
    begin = np.nan_to_num(np.take_along_axis(rec.markers, first, axis=0))
    return rec.replace(markers=np.where(lost, begin, rec.markers), suspect=None)


def load_case(path: str | Path) -> Case:
    """Load a case from a Python file: its functions and lists of these names are the parts of a `Case`.

    The file is a program of yours, and is run.

    Raises
    ------
    CaseError
        If there is no such file, it fails, or it lacks ``build`` or ``observe``.
    """
    path = Path(path)
    if not path.is_file():
        raise CaseError(f"there is no case file '{path}'")
    module = _run(path)
    missing = [n for n in ("build", "observe") if not callable(getattr(module, n, None))]
    if missing:
        raise CaseError(
            f"case '{path}' must define the function {' and '.join(missing)}; see the docs, howto: cases"
        )
    parts = {key: getattr(module, key) for key in PARTS if hasattr(module, key)}
    for key in ("free", "per_trial"):
        value = parts.get(key, ())
        if isinstance(value, str) or not all(isinstance(v, str) for v in value):
            raise CaseError(f"case '{path}': {key} must be a list of parameter paths, got {value!r}")
    for key in ("options", "drives", "metric", "cut", "kind", "baselines"):
        if parts.get(key) is not None and not callable(parts[key]):
            raise CaseError(f"case '{path}': {key} must be a function")
    return Case(module.build, module.observe, **parts, name=path.stem, path=path)


def _run(path: Path) -> ModuleType:
    """Run a case file as a module; what it raises names the file."""
    name = f"rodnet_case_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        what = "; a robot's file is for rodnet run, a case (repaired.py) for rodnet evaluate"
        raise CaseError(f"case '{path}' is not a Python file{what if path.suffix == '.toml' else ''}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    sys.path.insert(0, str(path.parent.resolve()))  # a case may import what lies beside it
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise CaseError(f"case '{path}' fails: {type(error).__name__}: {error}") from error
    finally:
        sys.path.pop(0)
    return module
