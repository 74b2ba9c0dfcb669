"""The set-up that all measurements share: one thread, one core, and a record of what was measured on what."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
PACKAGES = (
    "rodnet",
    "numpy",
    "scipy",
    "numba",
    "pyelastica",
    "dismech-newton",
    "newton",
    "warp-lang",
    "mujoco",
    "cosseratbench",
    "pysindy",
)
_cores: set[int] = set()


def one_thread() -> None:
    """Let linear algebra use one thread; to be called before NumPy is loaded."""
    for name in THREADS:
        os.environ[name] = "1"


def one_core() -> bool:
    """Stay on one core, where the system can be asked to; subprocesses inherit it."""
    if not hasattr(os, "sched_setaffinity"):
        return False
    _cores.update(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {max(_cores)})
    return True


def all_cores() -> None:
    """Undo `one_core`, for measurements of parallel runs."""
    if _cores:
        os.sched_setaffinity(0, _cores)


class ChildFailure(RuntimeError):
    """A subprocess failed or took too long."""


def child(
    code: str, *arguments: Any, timeout: float = 300.0, environment: dict[str, str] | None = None
) -> dict[str, Any]:
    """Run Python code in a new process and return the JSON object of its last line of output.

    Raises
    ------
    ChildFailure
        With the reason in one line.
    """
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    variables |= environment or {}
    command = [sys.executable, "-W", "ignore", "-c", code, *map(str, arguments)]
    try:
        done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        raise ChildFailure(f"not done after {timeout:g} s") from None
    if done.returncode:
        reason = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise ChildFailure(reason[-1][:200])
    return json.loads(done.stdout.strip().splitlines()[-1])


def versions() -> dict[str, str]:
    """Versions of the packages that matter, those that are installed."""
    import rodnet

    found = {"rodnet": rodnet.__version__}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """What was measured, on what: nothing that names a person, a computer or a place on it."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": versions(),
        "commit": _commit(),
        "date": datetime.date.today().isoformat(),
    }


def _cpu() -> str:
    """Model of the processor; where it has no more than a family name, with family and model number."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
    except OSError:
        return platform.processor() or "unknown"
    facts = {k.strip(): v.strip() for k, _, v in (line.partition(":") for line in lines)}
    name = facts.get("model name", "unknown")
    if "cpu family" in facts:
        name += f" (family {facts['cpu family']}, model {facts.get('model', '?')})"
    return name


def _commit() -> str:
    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--", "rodnet", "benchmarks/*.py", "plugins")
        return git("rev-parse", "--short", "HEAD") + (" with changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
