"""What a start loads and says; real processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import rodnet as rn

HEAVY = {"numba", "scipy", "trimesh", "rerun", "matplotlib", "xarray", "h5py", "typer", "rich", "pandas"}


def loaded(code: str) -> set[str]:
    """Which heavy libraries are there after some code."""
    code += f"\nimport sys; print(*sorted({HEAVY!r} & set(sys.modules)))"
    env = {**os.environ, "PYTHONPATH": str(Path(rn.__file__).parents[1])}
    result = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return set(result.stdout.split())


def test_importing_loads_nothing_heavy():
    assert loaded("import rodnet") == set()


def test_stepping_loads_what_computes_and_nothing_that_shows():
    code = "import rodnet as rn\nrn.Simulation(rn.robots.flagellated(edges=4)).run(0.05)"
    assert loaded(code) == {"numba", "scipy"}
