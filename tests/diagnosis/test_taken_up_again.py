"""What a diagnosis goes on from: nothing that an earlier run has found of other recordings or other code."""

import importlib
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.pipeline import Pipeline
from tests.diagnosis import shaken

CASE = """
import numpy  # which lies elsewhere
from aside import POINTS
import inner.deep
free = ["rod.E"]

def build(rec):
    return inner.deep.rod(rec)

def observe(rec, robot):
    import rodnet as rn
    return rn.Markers(robot, POINTS)
"""
FILES = {
    "aside.py": "from tests.diagnosis.shaken import POINTS\n",
    "inner/__init__.py": "",
    "inner/deep.py": "from .deeper import robot\n\ndef rod(rec):\n    return robot(dict(rec.attrs))\n",
    "inner/deeper.py": "from tests.diagnosis.shaken import robot\n",
    "never.py": "X = 1\n",
}


@pytest.fixture(autouse=True)
def first_stage_only(monkeypatch):
    """A diagnosis that ends with one stage, which says what it was computed with."""

    def diagnose(self, replicas):
        one = self.stage("calibrate", lambda: 1)
        raise Ended(one)

    monkeypatch.setattr(Pipeline, "diagnose", diagnose)


class Ended(Exception):
    """Thrown instead of going on."""


def rec(name="trial0", **changes):
    t = np.arange(40) / 25.0
    markers = np.zeros((40, 4, 3)) + 1e-4 * np.arange(40)[:, None, None]
    markers[..., 0] += shaken.LENGTH * np.array([0.25, 0.5, 0.75, 1.0])
    markers[..., 1] = 0.0
    made = {
        "names": "abcd",
        "attrs": shaken.drive(0),
        "name": name,
        "noise": rn.NoiseModel(white=1e-3),
        **changes,
    }
    return rn.Recording(t, markers, **made)


def again(out, case=shaken.CASE, recs=None, **options):
    """Diagnose, and say whether that went on from an earlier run."""
    told = []
    options = {"workers": 0, "candidates": ["gravity"], "progress": told.append, **options}
    with pytest.raises(Ended):
        rn.diagnose(case, [rec()] if recs is None else recs, resume=out, **options)
    return any("taken from the earlier run" in text for text in told)


@pytest.mark.parametrize(
    "changes",
    [
        {"names": "abdc"},
        {"edges": [(0, 1), (1, 2), (2, 3)]},
        {"prescribed": [0]},
        {"planar": True},
        {"group": "monday"},
        {"attrs": shaken.drive(1)},
        {"noise": rn.NoiseModel(white=2e-3)},
    ],
)
def test_other_recordings_are_diagnosed_anew(tmp_path, changes):
    assert not again(tmp_path)
    assert again(tmp_path)
    assert not again(tmp_path, recs=[rec(**changes)])
    assert again(tmp_path, recs=[rec(**changes)]) and again(tmp_path)


def test_a_misfit_is_not_the_noise_of_an_instrument(tmp_path):
    """The same number weighs residuals in another sense where the case has it."""
    case = replace(shaken.CASE, noise=0.01)
    assert not again(tmp_path, noise=0.01)
    assert not again(tmp_path, case)
    assert again(tmp_path, noise=0.01) and again(tmp_path, case)


def test_recordings_of_another_folder_are_of_another_kind(tmp_path):
    """They are summed up by folders; whose these are does not matter."""
    one, other = tmp_path / "a" / "slow" / "x.npz", tmp_path / "b" / "slow" / "x.npz"
    assert not again(tmp_path, recs=[rec(path=one)])
    assert again(tmp_path, recs=[rec(path=other)])
    assert not again(tmp_path, recs=[rec(path=tmp_path / "a" / "fast" / "x.npz")])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A case with modules beside it; what it has imported is forgotten again, as by another process."""

    def forget():
        for name in ("aside", "never", "inner", "inner.deep", "inner.deeper"):
            sys.modules.pop(name, None)

    for name, text in {**FILES, "case.py": CASE}.items():
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # two edits within a second look the same to it
    yield SimpleNamespace(path=tmp_path / "project", forget=forget)
    forget()


@pytest.mark.parametrize(
    "name", ["case.py", "aside.py", "inner/__init__.py", "inner/deep.py", "inner/deeper.py"]
)
def test_modules_beside_a_case_count_as_its_code(tmp_path, folder, name):
    run = lambda: (folder.forget(), again(tmp_path / "out", folder.path / "case.py"))[1]  # noqa: E731
    assert not run()
    assert run()
    (folder.path / "never.py").write_text("X = 2\n")  # nobody has imported it
    assert run()
    path = folder.path / name
    path.write_text(path.read_text() + "\nY = 3\n")
    assert not run()
    assert run()


def test_a_module_that_was_edited_but_not_imported_again_is_what_it_was(tmp_path, folder):
    """What this process runs is the old code, whose results are not those of the new one."""
    case = folder.path / "case.py"
    assert not again(tmp_path / "out", case)
    (folder.path / "aside.py").write_text(FILES["aside.py"] + "POINTS = POINTS[::-1]\n")
    kept = sys.modules["aside"]
    assert kept.POINTS == shaken.POINTS and again(tmp_path / "out", case)
    folder.forget()
    assert not again(tmp_path / "out", case)


def test_modules_beside_the_functions_of_a_case_count_too(tmp_path, folder, monkeypatch):
    """Of a case that is no file: what its script has imported from beside itself."""
    monkeypatch.syspath_prepend(str(folder.path))
    (folder.path / "never.py").write_text(CASE)

    def run():
        folder.forget()
        never = importlib.import_module("never")

        return again(tmp_path / "out", rn.Case(never.build, never.observe, free=never.free))

    assert not run()
    assert run()
    (folder.path / "inner" / "deeper.py").write_text(FILES["inner/deeper.py"] + "Y = 3\n")
    assert not run()
    (folder.path / "never.py").write_text(f"{CASE}\nY = 3\n")
    assert run()  # of its own functions the code counts, and no more
