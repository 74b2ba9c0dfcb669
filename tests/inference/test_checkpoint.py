"""What a calibration goes on from: the places of the same search only."""

import sys

import pytest

import rodnet as rn
from tests.inference.swings import POINTS, cable, record

WHITE = rn.NoiseModel(white=3e-4)
CASE = """
import swinging
from tests.inference.swings import eyes as observe
free = ["cable.E"]

def build(rec):
    return swinging.start(rec)
"""
BESIDE = "from tests.inference.swings import cable\n\ndef start(rec):\n    return cable(E=3e6)\n"


@pytest.fixture(scope="module")
def rec():
    return record(cable(), WHITE, 0, duration=0.1)


def evaluations(case, rec, kept, **options):
    """How many of them a calibration needs: none where it takes up one that has ended."""
    sys.modules.pop("swinging", None)
    told = []
    rn.calibrate(case, [rec], workers=0, checkpoint=kept, progress=told.append, **options)
    sys.modules.pop("swinging", None)
    return sum(text.startswith("evaluation") for text in told)


def test_modules_beside_a_case_count_as_its_code(tmp_path, rec, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # two edits within a second look the same to it
    case, beside, kept = tmp_path / "case.py", tmp_path / "swinging.py", tmp_path / "search.json"
    case.write_text(CASE)
    beside.write_text(BESIDE)
    assert evaluations(case, rec, kept) > 0
    assert evaluations(case, rec, kept) == 0
    beside.write_text(BESIDE.replace("3e6", "3e6, rate=1.0"))
    assert evaluations(case, rec, kept) > 0
    assert evaluations(case, rec, kept) == 0


def test_a_case_that_is_covered_by_options_counts(tmp_path, rec):
    case, kept = tmp_path / "case.py", tmp_path / "search.json"
    text = "from tests.inference.swings import cable, eyes as observe\nfree = ['cable.E']\n"
    text += "def build(rec):\n    return cable(E=3e6)\ndef options(rec, robot):\n    return {'stepper': STEPPER}\n"
    runs = []
    for stepper in ("sdirk2", "sdirk2", "euler"):
        case.write_text(text.replace("STEPPER", repr(stepper)))
        runs.append(evaluations(case, rec, kept, options={"dt": 0.01}) > 0)
    assert runs == [True, False, True]


@pytest.mark.parametrize(
    "changes",
    [
        {"attrs": {"payload": 0.1}},
        {"edges": [(0, 1)]},
        {"prescribed": [0]},
        {"group": "monday"},
        {"names": list(POINTS)[::-1]},
    ],
)
def test_what_else_is_known_of_a_recording_counts(tmp_path, rec, changes):
    """The case may build another robot, whose motion is another, of the same positions."""
    kept = tmp_path / "search.json"
    case = rn.Case(lambda rec: cable(E=3e6), lambda rec, robot: rn.Markers(robot, POINTS), free=["cable.E"])
    assert evaluations(case, rec, kept) > 0
    assert evaluations(case, rec, kept) == 0
    assert evaluations(case, rec.replace(**changes), kept) > 0


def test_a_search_that_has_not_converged_goes_on(tmp_path, rec):
    """With more evaluations the same call comes to the end, and then takes that."""
    kept = tmp_path / "search.json"
    case = rn.Case(lambda rec: cable(E=9e6), lambda rec, robot: rn.Markers(robot, POINTS), free=["cable.E"])
    first = rn.calibrate(case, [rec], workers=0, checkpoint=kept, evaluations=2)
    assert not first.success
    found = rn.calibrate(case, [rec], workers=0, checkpoint=kept, evaluations=60)
    assert found.success and abs(found.values["cable.E"] / 2e6 - 1.0) < 0.1
    assert evaluations(case, rec, kept, evaluations=60) == 0
