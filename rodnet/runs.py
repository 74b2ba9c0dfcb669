"""Whole runs as the command line makes them: checked, simulated, written to a directory, summed up."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import math
import platform
import shlex
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rodnet
from rodnet import registry
from rodnet.errors import ConvergenceError, OutputError, ParameterError, RodnetError
from rodnet.metrics import effort, travel, why_at_rest
from rodnet.names import meant
from rodnet.numbers import plain
from rodnet.robot import Robot
from rodnet.robots.flagellated import FlagellatedMetrics, flagellated, flagellated_metrics
from rodnet.simulation import WHOLE, Simulation
from rodnet.solve.steppers import State
from rodnet.steps import StepResult
from rodnet.storage import check_free, check_writable
from rodnet.trajectory import Trajectory

Say = Callable[[str], None]
CONTENTS = "contents of the file"
FILES = {"trajectory": "run.nc", "rerun": "run.rrd", "shapes": "shapes.png", "summary": "summary.json"}


class TimedSimulation(Simulation):
    """A simulation that knows how long its steps took, without recording and writing."""

    seconds = 0.0

    def step(self, inputs: Mapping[str, Any] | None = None) -> StepResult:
        """Take one step and add its time to ``seconds``."""
        start = time.perf_counter()
        try:
            return super().step(inputs)
        finally:
            self.seconds += time.perf_counter() - start


class FileRobot:
    """Builds the robot of a file, which is read once."""

    def __init__(self, path: str) -> None:
        from rodnet.files.robot_file import read_text

        self.path, self.text = path, read_text(path)

    def __call__(self) -> Robot:
        from rodnet.files.robot_file import parse

        return parse(self.text, self.path)


def is_file(robot: str) -> bool:
    """Whether a robot is named by its file."""
    return robot.endswith(".toml")


def robot_factory(robot: str) -> Callable[..., Any]:
    """Return the function that makes a robot: by its id, or from its file."""
    if not is_file(robot) and Path(robot).is_file():
        raise ParameterError(f"'{robot}' must end in .toml to be a robot file; a case is for rodnet evaluate")
    return FileRobot(robot) if is_file(robot) else registry.robot(robot)


def label(robot: str) -> str:
    """Return a word for files that are named after a robot."""
    return Path(robot).stem if is_file(robot) else robot


def contents(robot: str) -> dict[str, str]:
    """What tells that a robot's file has changed: nothing for an installed robot."""
    if not is_file(robot):
        return {}
    return {CONTENTS: hashlib.sha256(FileRobot(robot).text.encode()).hexdigest()[:16]}


@dataclass(frozen=True)
class RunSpec:
    """What to simulate.

    Parameters
    ----------
    robot : str
        Id of an installed robot (see `rodnet.registry.robots`), or a robot file, ``"robot.toml"``.
    settings : mapping
        Arguments of the robot's function (``L3``), and parameter paths (``drag.viscosity``).
    duration, dt : float
        Time to simulate and time step [s].
    stepper : str
        Name of the time stepper.
    save_every : int
        Keep every so many-th step.
    adaptive : float, optional
        Tolerance of the step size control [1] (see `rodnet.Adaptive`); ``dt`` is then the first step.
    """

    robot: str = "flagellated"
    settings: Mapping[str, Any] = field(default_factory=dict)
    duration: float = 60.0
    dt: float = 0.01
    stepper: str = "euler"
    save_every: int = 5
    adaptive: float | None = None

    def identity(self) -> dict[str, Any]:
        """What must not change when a run is continued."""
        named = {"robot": self.robot, **contents(self.robot)}
        control = {} if self.adaptive is None else {"adaptive": self.adaptive}
        return {**named, **self.settings, "dt": self.dt, "stepper": self.stepper, **control}

    def defaults(self) -> dict[str, Any]:
        """What the robot's function takes for the arguments that are not given."""
        taken = inspect.signature(robot_factory(self.robot)).parameters.values()
        return {p.name: p.default for p in taken if p.default is not p.empty}

    def build(self) -> Robot:
        """Return the robot.

        Raises
        ------
        ParameterError
            For a setting that is neither an argument of the robot nor one of its parameters.
        """
        factory = robot_factory(self.robot)
        signature = inspect.signature(factory).parameters
        taken = {k: p for k, p in signature.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
        arguments = {k: v for k, v in self.settings.items() if "." not in k}
        anything = any(p.kind is p.VAR_KEYWORD for p in signature.values())
        unknown = [] if anything else sorted(set(arguments) - set(taken))
        if unknown and is_file(self.robot):
            raise ParameterError(
                f"'{self.robot}' has no {unknown[0]!r}; its parameters go by path: {', '.join(factory().parameters)}"
            )
        if unknown:
            known = ", ".join(taken) or "none"
            raise ParameterError(
                f"the robot '{self.robot}' takes no {', '.join(map(repr, unknown))}; {meant(unknown[0], taken)}"
                f"it takes {known} "
                "(and parameters by path, such as drag.viscosity=10; rodnet run --help has examples)"
            )
        try:
            return factory(**arguments).with_parameters({k: v for k, v in self.settings.items() if "." in k})
        except (TypeError, ValueError, ArithmeticError) as error:
            if isinstance(error, RodnetError):
                raise
            given = ", ".join(f"{k}={v!r}" for k, v in self.settings.items())
            raise ParameterError(f"cannot build the robot '{self.robot}' with {given}: {error}") from error

    def simulation(self) -> TimedSimulation:
        """Return the simulation at its beginning, everything checked."""
        if not (math.isfinite(self.duration) and self.duration > 0):
            raise ParameterError(f"duration = {self.duration!r} must be a positive time [s]")
        if self.save_every < 1:
            raise ParameterError(f"save_every = {self.save_every!r} must be a positive integer")
        return TimedSimulation(self.build(), self.dt, stepper=self.stepper, adaptive=self.adaptive)


@dataclass
class Outcome:
    """A trajectory, its summary (plain values), and the error that ended it, if one did."""

    trajectory: Trajectory
    summary: dict[str, Any]
    error: ConvergenceError | None = None


def execute(
    spec: RunSpec, out: str | Path, *, resume: bool = False, progress: bool = True, say: Say = lambda _: None
) -> Outcome:
    """Simulate and write ``run.nc``, ``run.rrd``, ``shapes.png`` and ``summary.json`` to a directory.

    Everything is checked before anything is computed. An interrupted run (Ctrl-C) and one that fails
    keep what was computed; ``resume`` continues ``run.nc`` up to the spec's duration, bit-equal to a
    run that was never interrupted.

    Raises
    ------
    RodnetError
        For bad input. A step that does not converge is not raised, but returned with what came before.
    """
    sim = spec.simulation()
    files = check_directory(out)
    check_free(files["trajectory"])
    if files["trajectory"].exists() and resume:
        traj = _continue(sim, spec, files)
        say(f"continuing {files['trajectory']} from t = {sim.t:g} s")
    else:
        traj, resume = None, False
        if files["trajectory"].exists():  # hours of computing must not vanish for want of a flag
            earlier = files["trajectory"].replace(_unused(files["trajectory"]))
            say(f"an earlier trajectory is kept as {earlier}; --resume would have continued it")
        for kind in ("rerun", "shapes"):  # they are of that one
            files[kind].unlink(missing_ok=True)
    begun, idle = sim.state, why_at_rest(sim)
    warmup = 0.0
    error = None
    if spec.duration - begun.t > WHOLE * spec.dt:
        _write_json(files["summary"], {"status": "running", "spec": spec.identity()})
        warmup = warm_up(spec)
        try:
            traj = sim.run(
                until=spec.duration,
                save_every=spec.save_every,
                out=files["trajectory"],
                progress=progress,
                append=resume,
            )
        except ConvergenceError as caught:
            traj, error = caught.trajectory, caught
    elif traj is not None and traj.status in ("interrupted", "unfinished"):  # it had got so far already
        traj.status = "finished"
        traj.save(files["trajectory"])
    assert traj is not None
    summary = summarise(spec, sim, traj, begun, warmup)
    if idle is not None:
        summary["note"] = f"{summary['note']}; {idle}" if summary.get("note") else idle
    views = traj.status != "interrupted" and len(traj) > 1
    summary["files"] = {k: str(p) for k, p in files.items() if views or k not in ("rerun", "shapes")}
    if error is not None:
        summary["error"] = str(error)
    _write_json(files["summary"], summary)
    if views:
        say("writing the rerun recording and the figure")
        rodnet.viz.log_rerun(traj, files["rerun"])
        rodnet.viz.plot_shapes(traj, files["shapes"])
    return Outcome(traj, summary, error)


def warm_up(spec: RunSpec) -> float:
    """Take one step on a scratch simulation, so that kernels are compiled; return the time it took [s]."""
    start = time.perf_counter()
    spec.simulation().step()
    return time.perf_counter() - start


def summarise(
    spec: RunSpec, sim: TimedSimulation, traj: Trajectory, begun: State, warmup: float
) -> dict[str, Any]:
    """Return what there is to say about a run, as plain values for JSON."""
    stats, steps, factory = traj.stats, sim.state.index - begun.index, robot_factory(spec.robot)
    try:
        found = measure(factory, traj)
    except Exception as error:  # somebody's metrics: the run itself has been made
        found = {"converged": None, "note": f"the metrics fail: {type(error).__name__}: {error}"}
    if not has_metrics(factory):
        found |= effort(traj)
    return {
        **found,
        "status": traj.status,
        "t_end": float(traj.t[-1]),
        "duration": spec.duration,
        "dt": spec.dt,
        "stepper": spec.stepper,
        "adaptive": spec.adaptive,
        "steps": steps,
        "resumed_from": begun.t if begun.index else None,
        # of the whole run, also if it was resumed
        "newton_iterations_per_step": stats["iterations"] / stats["steps"] if stats.get("steps") else None,
        "realtime_factor": (sim.t - begun.t) / sim.seconds if steps else None,
        "stepping_s": sim.seconds,
        "warmup_s": warmup,
        "substeps": stats.get("substeps"),
        "factorizations": stats.get("factorizations"),
        "fallbacks": stats.get("fallbacks"),
        "spec": spec.identity(),
        "versions": versions(),
    }


def has_metrics(factory: Callable[..., Any]) -> bool:
    """Whether a robot says itself what is measured on it."""
    return factory is flagellated or hasattr(factory, "metrics")


def measure(factory: Callable[..., Any], traj: Trajectory) -> dict[str, Any]:
    """What is measured on a robot: the paper's numbers, or what the ``metrics`` of a plug-in returns.

    Of a robot without metrics of its own, how far it comes (`rodnet.metrics.travel`).

    ``converged`` (steady state) is None where the robot doesn't say.
    """
    if factory is flagellated:
        try:
            values = dataclasses.asdict(flagellated_metrics(traj))
            if not values["converged"]:
                window = f"{values['turns']} motor turns"
                values["note"] = (
                    f"not steady: {window} are fewer than the 10 that are averaged over"
                    if values["turns"] < 10
                    else f"not steady: the speed drifts by {values['drift']:.1e} over the last {window}"
                ) + f"; run longer than {traj.t[-1]:g} s for the values of steady motion"
        except ParameterError as error:  # too short for a mean over whole turns
            values = dict.fromkeys((f.name for f in dataclasses.fields(FlagellatedMetrics)), math.nan)
            values |= {"converged": False, "turns": 0, "note": str(error)}
        return {"speed_mm_s": 1e3 * values.pop("speed"), **values}
    found: Any = getattr(factory, "metrics", travel)(traj)
    if dataclasses.is_dataclass(found) and not isinstance(found, type):
        found = dataclasses.asdict(found)
    return {"converged": None, **found}


def versions() -> dict[str, str]:
    """Versions of what computed."""
    from importlib.metadata import version

    return {"rodnet": rodnet.__version__, "python": platform.python_version()} | {
        name: version(name) for name in ("numpy", "scipy", "numba")
    }


# -- pieces ---------------------------------------------------------------------------------
def check_directory(out: str | Path) -> dict[str, Path]:
    """Return where the results go, each file checked to be writable.

    Raises
    ------
    OutputError
        If a file cannot be written there.
    """
    out = Path(out)
    if out.exists() and not out.is_dir():
        raise OutputError(f"cannot write to '{out}': it is a file; give a directory")
    return {kind: check_writable(out / name) for kind, name in FILES.items()}


def command(identity: Mapping[str, Any]) -> str:
    """Return the command that makes the run of an identity, without what doesn't decide on it."""
    options = {"n_tails": "--tails", "rpm": "--rpm", "edges": "--edges", "root": "--root"}
    options |= {"dt": "--dt", "stepper": "--stepper", "adaptive": "--adaptive"}
    words = ["rodnet", "run", str(identity["robot"])]
    for name, value in identity.items():
        if name not in ("robot", CONTENTS):
            text = value if isinstance(value, str) else json.dumps(value)
            words += [options[name], text] if name in options else ["--set", f"{name}={text}"]
    return shlex.join(words)


def _continue(sim: Simulation, spec: RunSpec, files: Mapping[str, Path]) -> Trajectory:
    """Put the simulation at the end of a recorded run, after checking that it is the same run."""
    try:
        before = json.loads(files["summary"].read_text())["spec"]
    except (OSError, ValueError, KeyError, TypeError):
        before = None
    if before is not None:
        defaults = plain(spec.defaults())
        then, now = defaults | before, defaults | plain(spec.identity())
        differing = [
            f"{key} was {then.get(key, 'not set')} and is now {now.get(key, 'not set')}"
            for key in {**then, **now}
            if then.get(key) != now.get(key)
        ]
        if differing:
            raise ParameterError(
                f"cannot continue '{files['trajectory']}', which is another run: {'; '.join(differing)}. "
                f"Repeat the options of that run, {command(before)} --resume, or choose another --out for this one"
            )
    try:
        traj = Trajectory.load(files["trajectory"], sim.robot)
    except (OutputError, KeyError) as error:
        raise OutputError(
            f"cannot continue '{files['trajectory']}': {error}. Start again without --resume"
        ) from None
    if traj.dt != spec.dt or traj.header.get("stepper") != spec.stepper:
        raise ParameterError(
            f"cannot continue '{files['trajectory']}': it has dt = {traj.dt:g} s and the stepper "
            f"{traj.header.get('stepper')!r}, not {spec.dt:g} s and {spec.stepper!r}"
        )
    if bool(traj.header.get("adaptive")) != (spec.adaptive is not None):
        how = "with" if spec.adaptive is None else "without"
        raise ParameterError(
            f"cannot continue '{files['trajectory']}': it was computed {how} "
            "step size control; continue it with the --adaptive of that run, or choose another --out"
        )
    sim.restore(traj.state(-1))
    return traj


def _unused(path: Path) -> Path:
    """A name for an earlier trajectory that none has yet: run.previous.nc, run.previous-2.nc and so on."""
    place, number = path.with_name("run.previous.nc"), 2
    while place.exists():
        place, number = path.with_name(f"run.previous-{number}.nc"), number + 1
    return place


def _write_json(path: Path, values: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(plain(values), indent=2, allow_nan=False) + "\n")
