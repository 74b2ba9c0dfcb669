"""The template of a plug-in, renamed as the tutorial says, builds, installs and is found."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TEMPLATE = Path(__file__).parents[1] / "plugins" / "rodnet-quadratic"
TERMS = "import sys; from rodnet.cli import main; sys.argv = ['rodnet', 'terms']; main()"
CHECK = """
import json, rodnet as rn
law = rn.term("form-drag")
rn.testing.check_term(law)
record = rn.registry.terms()["form-drag"]
print(json.dumps([law.__module__, record.distribution, [p.name for p in record.parameters]]))
"""


def run(*command: str, **environment: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder with the renamed template installed from its wheel, as a search path."""
    pytest.importorskip("hatchling", reason="the wheel is built without network: pip install hatchling")
    work = tmp_path_factory.mktemp("form-drag")
    mine = shutil.copytree(
        TEMPLATE, work / "rodnet-form-drag", ignore=shutil.ignore_patterns("__pycache__", "dist")
    )
    (mine / "rodnet_quadratic.py").rename(mine / "rodnet_form_drag.py")
    file = mine / "pyproject.toml"
    text = file.read_text().replace("rodnet-quadratic", "rodnet-form-drag")
    text = text.replace("rodnet_quadratic", "rodnet_form_drag").replace("quadratic = ", "form-drag = ")
    file.write_text(text)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "-q")
    run(*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(work / "dist"), str(mine))
    (wheel,) = (work / "dist").glob("*.whl")
    run(*pip, "install", "--no-deps", "--no-index", "--target", str(work / "site"), str(wheel))
    return os.pathsep.join([str(work / "site"), str(TEMPLATE.parents[1]), os.environ.get("PYTHONPATH", "")])


def test_it_is_installed_and_keeps_the_contract(installed):
    module, distribution, parameters = json.loads(run(sys.executable, "-c", CHECK, PYTHONPATH=installed))
    assert (module, distribution, parameters) == ("rodnet_form_drag", "rodnet-form-drag 0.1.0", ["c"])


def test_the_command_line_lists_it(installed):
    listing = run(sys.executable, "-c", TERMS, PYTHONPATH=installed)
    assert "form-drag  rodnet_form_drag.Quadratic  rodnet-form-drag 0.1.0" in listing
