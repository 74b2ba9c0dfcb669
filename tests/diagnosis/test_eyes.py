"""What a camera's lens does is no force: it is drafted as a lens, and the repaired case has it in its instruments."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.eyes import eyes_of
from rodnet.diagnosis.forces import force_columns, library_of
from rodnet.diagnosis.law import draft
from rodnet.diagnosis.library import Piece, law_of
from rodnet.diagnosis.workbench import Workbench
from rodnet.report.law_words import parts_in_words
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

LENS, MIDDLE = 1.5, [0.3, 0.0, 0.0]


def record(k: int) -> rn.Recording:
    """A trial seen through a lens that makes a cushion of the picture."""
    attrs = {**shaken.drive(k), "lift": 3.0}
    true = shaken.robot(attrs, 2 * shaken.EDGES)
    traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, shaken.POINTS, lens=LENS, middle=MIDDLE)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=list("abcd"), name=f"trial{k}", attrs=attrs)


@pytest.fixture(scope="module")
def bench():
    return Workbench.of(shaken.CASE, [record(k) for k in range(3)], Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def model(bench):
    return bench.fit()


def test_a_lens_is_drafted_as_a_lens(bench, model):
    """Its middle, too, though the library begins in that of what was seen."""
    found = draft(bench, model, force_columns(bench, model, library_of(bench)), 0.0, lambda text: None)
    assert found is not None and found.judgement.accepted
    assert "eye" in {piece.kind for piece in found.pieces}
    fitted = found.refit.fitted
    assert fitted.values["markers.lens"] == pytest.approx(LENS, rel=0.05)
    assert fitted.values["markers.middle[0]"] == pytest.approx(MIDDLE[0], abs=0.03)
    assert fitted.deviance - fitted.samples < 0.05 * (model.deviance - fitted.samples)
    words = parts_in_words(found.pieces)
    assert "far" in words["markers.lens"] and "(of markers)" in words["markers.lens"]


def test_columns_of_a_lens_are_difference_quotients(bench, model):
    """About the middle of what was seen, which the instruments of the case know nothing of."""
    (piece,) = eyes_of(bench)
    assert piece == Piece.from_dict(piece.to_dict())
    columns, law = force_columns(bench, model, [piece]), law_of([piece])
    assert set(columns.names) == set(piece.paths)
    for path in ("markers.lens", "markers.keystone[0]", "markers.bow[2]"):
        ends = []
        for sign in (1.0, -1.0):
            values = {**model.values, **piece.shape, path: sign * columns.scales[path]}
            problem = bench.problem([law], values, model.own, free=[])
            ends.append(np.concatenate([f.residual for f in problem.fits(np.zeros(1), slopes=False)]))
        quotient = 0.5 * (ends[0] - ends[1])
        mine = columns.columns[:, columns.names.index(path)]
        np.testing.assert_allclose(mine, quotient, atol=1e-6 * np.abs(quotient).max(), err_msg=path)


def test_a_camera_whose_markers_drive_the_model_has_no_lens(bench):
    driven = [rec.replace(prescribed=[0]) for rec in bench.recordings]
    assert eyes_of(replace(bench, recordings=driven)) == []


def observed_by(bench, observe):
    """Trials of a case with other instruments."""
    return replace(bench, case=replace(bench.case, observe=observe))


def test_a_camera_that_some_trials_lack_has_no_lens(bench):
    def two(rec, robot):
        both = [
            rn.Markers(robot, shaken.POINTS, name="left"),
            rn.Markers(robot, shaken.POINTS, name="right"),
        ]
        return both[: 1 if rec.name == "trial0" else 2]

    (piece,) = eyes_of(observed_by(bench, two))
    assert piece.paths[0] == "left.lens"


def test_of_axes_those_count_that_all_trials_see(bench):
    def planes(rec, robot):
        return [rn.Markers(robot, shaken.POINTS, plane="xz" if rec.name == "trial1" else "xyz")]

    (piece,) = eyes_of(observed_by(bench, planes))
    assert set(piece.shape) == {"markers.middle[0]", "markers.middle[2]"}
    assert "markers.keystone[1]" not in piece.paths


def test_a_lens_that_is_known_is_none_that_is_missing(bench):
    known = observed_by(bench, lambda rec, robot: [rn.Markers(robot, shaken.POINTS, lens=LENS)])
    assert eyes_of(known) == []
