"""The columns of many candidates along one run are those of runs with the effects."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.columns import all_columns, bank_columns
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.comparison import Comparison
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

# forces, some with memory or of inertia; masses, stiffnesses, natural shapes; what takes runs of its own; a camera
IDS = [
    "medium-friction", "gravity", "kelvin-voigt", "anisotropy", "dry-friction", "plastic-set", "added-mass",
    "jam-onset", "local-mass", "stiffness-gradient", "kink", "drive-gain", "camera-scale",
]  # fmt: skip


@pytest.fixture(scope="module")
def bench():
    return Workbench.of(shaken.CASE, [shaken.record(0)], Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def fitted(bench):
    return bench.fit()


@pytest.fixture(scope="module")
def bank(bench, fitted):
    rec = bench.recordings[0]
    robot = shaken.build(rec)
    found = candidates(robot, [shaken.observe(rec, robot)], IDS)
    return dict(
        zip(
            [c.family for c in found], zip(found, all_columns(bench, fitted, found), strict=True), strict=True
        )
    )


@pytest.mark.parametrize("family", IDS)
def test_columns_are_difference_quotients_of_runs(family, bench, fitted, bank):
    """The last place of each bank, by its first strength: a quotient of second order, to the one side there is."""
    candidate, places = bank[family]
    place, path = places[-1], candidate.strength[0]
    case, small, residuals = bench.case, 2e-3, []
    for times in (0.0, 1.0, 2.0):
        values = {"rod.E": fitted.values["rod.E"]}
        moved = {**place.shape, path: place.nulls[path] + times * small * place.scales[path]}
        if candidate.observe:
            values |= moved
            edited = case
        else:
            edited = replace(
                case, build=lambda rec, moved=moved: candidate.build(shaken.build(rec)).with_parameters(moved)
            )
        trial = Comparison(edited, bench.recordings[0], bench.noise[0], bench.modes)
        residuals.append(trial.evaluate(values).residual)
    quotient = (4.0 * residuals[1] - residuals[2] - 3.0 * residuals[0]) / (2.0 * small)
    column = place.columns[:, 0]
    assert np.abs(quotient).max() > 0.0
    np.testing.assert_allclose(column, quotient, atol=1e-3 * np.abs(quotient).max())


@pytest.mark.parametrize("family", ["gravity", "natural-curvature", "stiffness-gradient"])
def test_a_law_beside_one_that_remembers(family, bench):
    """Where the model itself has a memory that the tangent knows, one run tells the same quotients, unless it begins
    otherwise.
    """
    rec = bench.recordings[0]
    friction = rn.DryFriction(moment=1e-4, torque=1e-4, curvature=0.5, twist=0.5)
    case = replace(shaken.CASE, build=lambda rec: shaken.build(rec).with_terms(friction))
    other = Workbench.of(case, [rec], Serial(), shaken.SIGMA)
    fitted = other.fit()
    one = candidates(case.build(rec), [], [family])[0]
    before = other.simulated
    place = bank_columns(other, fitted, one)[0]
    assert other.simulated == before + (2 if family == "natural-curvature" else 1)
    residuals = []
    for change in (1e-4, -1e-4):
        moved = {**place.shape, one.strength[0]: change * place.scales[one.strength[0]]}
        edited = replace(
            case, build=lambda rec, moved=moved: one.build(case.build(rec)).with_parameters(moved)
        )
        values = {"rod.E": fitted.values["rod.E"]}
        residuals.append(Comparison(edited, rec, other.noise[0], other.modes).evaluate(values).residual)
    quotient = (residuals[0] - residuals[1]) / 2e-4
    np.testing.assert_allclose(place.columns[:, 0], quotient, atol=1e-3 * np.abs(quotient).max())


DRIVEN = [
    "gravity",
    "medium-friction",
    "kelvin-voigt",
    "stiffness-gradient",
    "natural-curvature",
    "local-mass",
]


@pytest.fixture(scope="module", params=["motor", "wave", "tendon"])
def driven(request):
    """A curved rod in a fluid that a motor spins, or that bends in waves; some of its columns, and what these took."""
    rec = shaken.record(0)
    case = replace(shaken.CASE, build=partial(_driven, request.param))
    bench = Workbench.of(case, [rec], Serial(), shaken.SIGMA)
    fitted = bench.fit()
    found = candidates(case.build(rec), [], DRIVEN)
    before = bench.simulated
    columns = all_columns(bench, fitted, found)
    columns = dict(zip([c.family for c in found], zip(found, columns, strict=True), strict=True))
    return bench, fitted, columns, bench.simulated - before


def _driven(drive, rec):
    plain = shaken.build(rec)
    held = [rn.Clamp(at="rod:0-1"), rn.term("natural-curvature")(kappa1=1.0, name="drawn")]
    motor = rn.Motor(at="rod:1", rpm=60.0)
    wave = rn.CurvatureWave(amplitude=3.0, wavelength=0.4, frequency=1.0)
    tendon = rn.Tendon(route=[("rod", (4e-3, 1e-3))], tension=0.5, schedule=_to_and_fro)
    drives = {"motor": motor, "wave": wave, "tendon": tendon}
    return rn.Robot(plain.graph, plain.terms[:4]).with_terms(*held, drives[drive])


def _to_and_fro(t):
    return np.sin(np.pi * t) ** 2


def test_what_a_drive_remembers_is_followed_along_the_one_run(driven):
    """Of a robot with a drive, too, one run of each trial tells the columns of all that changes forces and shapes."""
    *_, runs = driven
    assert runs == 1


@pytest.mark.parametrize("family", DRIVEN)
def test_columns_of_a_robot_with_a_drive(family, driven):
    bench, fitted, columns, _ = driven
    candidate, places = columns[family]
    place, path = places[-1], candidate.strength[0]
    residuals = []
    for change in (0.0, 2e-3, 4e-3):
        moved = {**place.shape, path: place.nulls[path] + change * place.scales[path]}
        edited = replace(
            bench.case,
            build=lambda rec, moved=moved: candidate.build(bench.case.build(rec)).with_parameters(moved),
        )
        trial = Comparison(edited, bench.recordings[0], bench.noise[0], bench.modes)
        residuals.append(trial.evaluate({"rod.E": fitted.values["rod.E"]}).residual)
    quotient = (4.0 * residuals[1] - residuals[2] - 3.0 * residuals[0]) / 4e-3
    assert np.abs(quotient).max() > 0.0
    np.testing.assert_allclose(place.columns[:, 0], quotient, atol=1e-3 * np.abs(quotient).max())


def _pulled(rec):
    return _driven("tendon", rec).with_terms(rn.Gravity())


@pytest.mark.parametrize(("family", "least"), [("buoyancy", 0.9999), ("tendon-friction", 0.9)])
def test_columns_of_strengths_that_the_robot_has_already(family, least):
    rec = shaken.record(0)
    bench = Workbench.of(replace(shaken.CASE, build=_pulled), [rec], Serial(), shaken.SIGMA)
    fitted, (candidate,) = bench.fit(held=["rod.E"]), candidates(_pulled(rec), [], [family])
    (place,) = bank_columns(bench, fitted, candidate)
    (path,) = candidate.strength

    def residual(change):
        moved = {path: place.nulls[path] + change * place.scales[path]}
        edited = replace(bench.case, build=lambda rec: _pulled(rec).with_parameters(moved))
        trial = Comparison(edited, rec, bench.noise[0], bench.modes)
        return trial.evaluate({"rod.E": fitted.values["rod.E"]}).residual

    expected, found = residual(0.1) - residual(0.0), place.columns[:, 0]
    assert found @ expected > least * np.linalg.norm(found) * np.linalg.norm(expected)
    assert 0.3 < 0.1 * np.linalg.norm(found) / np.linalg.norm(expected) < 3.0  # friction saturates
