"""Compiled kernels outlive their process, wherever rodnet is installed; real processes, real directories."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rodnet as rn

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="modes of files decide here")

# one small kernel of rodnet, used as `Simulation` uses it
PROBE = """
import json, sys
import numpy as np
import rodnet
from rodnet.kinematics.turn_kernels import turn_about
Q = np.zeros((1, 3, 3))
turn_about(np.stack([np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3)]), 0.3, 0, Q)
assert np.array_equal(Q[0], np.eye(3))
stats = turn_about.stats
print(json.dumps([rodnet.__file__, stats.cache_path, len(stats.cache_hits)]))
"""
LIMITED = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"  # as on a full disk


@pytest.fixture
def install(tmp_path):
    """A copy of the package, without anything compiled."""
    source = Path(rn.__file__).parent
    shutil.copytree(source, tmp_path / "site" / "rodnet", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "site"


def read_only(folder: Path) -> None:
    """Take away the right to write."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)


def start(install: Path, code: str = PROBE, **environment: str):
    """Run code that has to respect the modes of files, with an environment of its own."""
    command = [sys.executable, "-c", code]
    if os.geteuid() == 0:  # the superuser does not
        if shutil.which("setpriv") is None:
            pytest.skip("for the superuser every directory is writable")
        command = ["setpriv", "--bounding-set=-dac_override", *command]
    env = {"PYTHONPATH": str(install), "PATH": os.environ["PATH"], **environment}
    result = subprocess.run(command, cwd="/", env=env, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result


def probe(install: Path, **environment: str) -> tuple[Path | None, bool, str]:
    """Where a kernel is kept, whether it was found there, and what was said."""
    result = start(install, **environment)
    file, kept, hits = json.loads(result.stdout)
    assert Path(file).is_relative_to(install)
    return Path(kept) if kept else None, bool(hits), result.stderr


def new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def test_kept_beside_the_sources(install):
    kept, found, said = probe(install)
    assert kept.is_relative_to(install / "rodnet" / "__pycache__") and not found
    assert said.count("compiling") == 1 and str(kept.parent) in said
    assert probe(install) == (kept, True, "")


def test_a_read_only_install_uses_the_users_cache(install, tmp_path):
    read_only(install)
    home = new(tmp_path / "home")
    kept, found, said = probe(install, HOME=str(home))
    there = home / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "rodnet"
    assert kept.is_relative_to(there) and not found and "compiling" in said
    assert probe(install, HOME=str(home)) == (kept, True, "")
    elsewhere = new(tmp_path / "caches")
    assert probe(install, HOME=str(home), XDG_CACHE_HOME=str(elsewhere))[0].is_relative_to(
        elsewhere / "rodnet"
    )


def test_without_a_home_it_uses_temporary_files(install, tmp_path):
    read_only(install)
    home = new(tmp_path / "home")
    read_only(home)
    temporary = new(tmp_path / "tmp")
    environment = {"HOME": str(home), "TMPDIR": str(temporary)}
    kept, found, _ = probe(install, **environment)
    assert kept.is_relative_to(temporary) and not found
    assert (kept.relative_to(temporary).parts[0], probe(install, **environment)) == (
        f"rodnet-{os.geteuid()}",
        (kept, True, ""),
    )


def test_it_does_not_execute_what_others_left_among_temporary_files(install, tmp_path):
    read_only(install)
    home = new(tmp_path / "home")
    read_only(home)
    temporary = new(tmp_path / "tmp")
    trap = new(temporary / f"rodnet-{os.geteuid()}")
    trap.chmod(0o777)
    kept, found, said = probe(install, HOME=str(home), TMPDIR=str(temporary))
    assert kept is None and not found and "NUMBA_CACHE_DIR" in said
    assert not list(trap.iterdir())


def test_the_directory_that_the_user_names_comes_first(install, tmp_path):
    named = new(tmp_path / "named")
    kept, found, _ = probe(install, NUMBA_CACHE_DIR=str(named))
    assert kept.is_relative_to(named) and not found
    assert probe(install, NUMBA_CACHE_DIR=str(named)) == (kept, True, "")


def test_it_runs_where_nothing_can_be_written(install):
    result = start(install, LIMITED + PROBE)
    assert json.loads(result.stdout)[1:] == [None, 0]
    assert "NUMBA_CACHE_DIR" in result.stderr


def test_an_image_can_bring_its_kernels_along(install, tmp_path):
    """What was compiled before the install became read-only is used."""
    before, _, _ = probe(install)
    read_only(install)
    home = new(tmp_path / "home")
    kept, found, said = probe(install, HOME=str(home))
    assert kept.is_relative_to(home) and kept.name == before.name
    assert found and said == ""


def test_a_change_of_any_kernel_is_noticed(install):
    """Also of those in other files: numba itself looks at a kernel's own file only."""
    first, _, _ = probe(install)
    with (install / "rodnet" / "solve" / "tree_lu_kernels.py").open("a") as file:
        file.write("\n# another state\n")
    second, found, _ = probe(install)
    assert second.parent != first.parent and not found
    assert probe(install) == (second, True, "")


def test_logging_silences_it(install):
    quiet = "import logging; logging.getLogger('rodnet').setLevel('ERROR')\n"
    assert start(install, quiet + PROBE).stderr == ""


@pytest.mark.slow
def test_a_cold_run_says_that_it_compiles_and_a_warm_one_does_not(install, tmp_path):
    """What says nothing has compiled nothing: the line is printed when the compiler starts."""
    words = ["run", "flagellated", "--edges", "4", "--duration", "0.05", "--no-progress", "--out"]
    for said in (1, 0):
        arguments = [*words, str(tmp_path / f"run{said}")]
        result = start(
            install, f"import sys; sys.argv[1:] = {arguments}\nfrom rodnet.cli import main; main()"
        )
        assert result.stderr.count("rodnet: compiling its kernels, about 20 s; the next start") == said
    assert result.stderr == ""


# -- laws of users ------------------------------------------------------------------------------
LAW = """
import rodnet as rn

@rn.kernel
def linear(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    for i in range(3):
        f[i] = -{factor} * p[0] * v[i]
        dfdv[i, i] = -{factor} * p[0]

class Linear(rn.DragModel):
    c = rn.Parameter(1.0, unit="Pa s")
    kernel = linear

    def force(self, site, p):
        return -{factor} * p.c * site.v

fig = rn.StickFigure()
fig.rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=3, material=rn.Material(E=1e6), radius=2e-3)
robot = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), Linear()])
if __name__ == "__main__":
    from rodnet.terms.drag.site_loop import site_loop

    sim = rn.Simulation(robot)
    sim.step()
    compiled = [sum(k.stats.cache_misses.values()) for k in (linear, site_loop)]
    print(*compiled, sim.observe().position("rod.start")[2])
"""


def test_a_users_law_is_compiled_once(tmp_path):
    """The second process compiles neither the law nor the loop around it; a change of the law is noticed."""
    script = tmp_path / "law.py"

    def run() -> tuple[str, str, float]:
        result = subprocess.run([sys.executable, script], capture_output=True, text=True)
        assert result.returncode == 0, result.stderr
        law, loop, z = result.stdout.split()
        return law, loop, float(z)

    script.write_text(LAW.format(factor="1.0"))
    law, _, z = run()
    assert law == "1"
    assert run() == ("0", "0", z)
    script.write_text(LAW.format(factor="2.00"))
    law, loop, slower = run()
    assert (law, loop) == ("1", "0") and z < slower < 0.0


def test_a_law_from_a_prompt_is_compiled_all_the_same():
    result = subprocess.run(
        [sys.executable, "-"], input=LAW.format(factor="1.0"), capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert float(result.stdout.split()[-1]) < 0.0


def test_functions_without_a_module_are_compiled_too():
    """Whatever else numba compiles in the process is none of rodnet's business."""
    space = {"__name__": None}
    exec("import numba, rodnet.compiled\n@numba.njit\ndef one():\n    return 1\n", space)
    assert space["one"]() == 1


def sinking(kernel):
    """One step of a rod that sinks under a law with this twin."""

    class Linear(rn.DragModel):
        c = rn.Parameter(1.0, unit="Pa s")

        def force(self, site, p):
            return -p.c * site.v

    Linear.kernel = kernel
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=3, material=rn.Material(E=1e6), radius=2e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), Linear()]
    return rn.Simulation(rn.Robot(fig.build(), terms)).step()


def interpreted(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    f[0] = 0.0


@rn.kernel
def returning(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    return 1.0


@rn.kernel
def short(v, x):
    pass


@rn.kernel
def raising(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    if t > 0.0:
        raise ValueError("no such medium")


@pytest.mark.parametrize(
    "kernel, message",
    [
        (interpreted, "decorated by rodnet.kernel"),
        (returning, "returning must fill"),
        (short, "kernel short"),
    ],
)
def test_what_cannot_be_a_twin_is_named(kernel, message):
    with pytest.raises(rn.TermError, match=message):
        sinking(kernel)


def test_what_a_twin_raises_reaches_the_user():
    with pytest.raises(ValueError, match="no such medium"):
        sinking(raising)
