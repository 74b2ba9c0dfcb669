"""Calibration: what was put in comes back, with intervals that mean something."""

from __future__ import annotations

import json

import numpy as np
import pytest

import rodnet as rn
from rodnet.inference.comparison import Comparison
from rodnet.inference.identifiability import identify
from rodnet.inference.quantities import Quantity
from tests.inference.swings import POINTS, cable, eyes, record

WHITE = rn.NoiseModel(white=3e-4)
SLOW = rn.NoiseModel(white=5e-5, slow=5e-4, time=0.3)
FREE = ["cable.E", "mass_damping.rate"]


def calibrate(recordings, robot=None, free=FREE, **options):
    options = {"observe": eyes, "workers": 0, **options}
    return rn.calibrate(robot or cable(E=3e6, rate=0.8), recordings, free=free, **options)


@pytest.fixture(scope="module")
def fitted():
    return calibrate([record(cable(), WHITE, k) for k in range(2)])


def test_stiffness_and_damping_come_back(fitted):
    assert fitted.success
    for path, truth in (("cable.E", 2e6), ("mass_damping.rate", 1.5)):
        one = fitted.parameters[path]
        sd = np.log(one.high / one.low) / 3.92
        assert abs(np.log(one.value / truth)) < 3.5 * sd
        assert 1e-4 < sd < 0.1
    assert fitted.variance_factor == 1.0
    assert 0.7 < fitted.chi2 / fitted.samples < 1.3
    assert fitted.robot().parameters["cable.E"].value == fitted.values["cable.E"]


def test_what_was_found_is_saved_and_read(fitted, tmp_path):
    path = fitted.save(tmp_path)
    assert rn.Fitted.load(tmp_path).values == pytest.approx(fitted.values)
    notes = json.loads(path.read_text())["notes"]["calibration"]
    assert np.array(notes["covariance"]["values"]).shape == (2, 2)


def test_residual_has_the_derivative_of_its_differences():
    noise = rn.NoiseModel(white=1e-4, slow=5e-4, time=0.2, common=2e-4)
    rec = record(cable(), noise, 0, 0.1)
    case = rn.Case(lambda rec: cable(), eyes)
    values = {
        "cable.E": 2.5e6, "mass_damping.rate": 1.0, "markers.lag": 0.013, "markers.scale": 1.01,
        "markers.rotation[1]": 0.02, "initial.position[1]": 1e-3, "initial.velocity[0]": 0.05, "initial.time": 0.004,
    }  # fmt: skip
    scales = {
        "cable.E": 2e6, "mass_damping.rate": 1.0, "markers.lag": 0.01, "markers.scale": 1.0,
        "markers.rotation[1]": 0.1, "initial.position[1]": 1e-3, "initial.velocity[0]": 0.05, "initial.time": 0.01,
    }  # fmt: skip
    tight = rn.Tolerance(residual=1e-12, update=1e-14, iterations=60)
    trial = Comparison(
        rn.Case(case.build, eyes, options=lambda rec, robot: {"tolerance": tight}), rec, {"markers": noise}, 2
    )
    J = trial.evaluate(values, scales).jacobian
    for k, path in enumerate(scales):
        step = 1e-4 * scales[path]
        up, down = (trial.evaluate({**values, path: values[path] + s * step}).residual for s in (1, -1))
        quotient = (up - down) / (2 * step)
        assert np.abs(J[:, k] - quotient).max() < 2e-5 * np.abs(quotient).max(), path


def test_unknown_start_is_a_nuisance_of_each_trial():
    kick = np.zeros((5, 3))
    kick[:, 2] = np.linspace(0.0, 0.15, 5)
    recs = [record(cable(), WHITE, k, velocity=s * kick) for k, s in ((0, 1.0), (1, -0.6))]
    found = calibrate(recs, per_trial=["initial.velocity"], modes=3)
    E = found.parameters["cable.E"]
    assert E.low < 2e6 * 1.01 and E.high > 2e6 * 0.99
    assert 0.6 < found.chi2 / found.samples < 1.5
    assert set(found.per_trial["trial1"]) == {f"initial.velocity[{k}]" for k in range(3)}


def test_lost_markers_and_outliers_do_no_harm():
    recs = [record(cable(), SLOW, k) for k in range(2)]
    rng = np.random.default_rng(0)
    for k, rec in enumerate(recs):
        x = rec.markers.copy()
        x[rng.random(x.shape[:2]) < 0.2] = np.nan
        bad = rng.random(x.shape[:2]) < 0.03
        x[bad] += 0.02 * rng.standard_normal((bad.sum(), 3))
        recs[k] = rec.replace(markers=x)
    found = calibrate(recs)
    one = found.parameters["cable.E"]
    sd = np.log(one.high / one.low) / 3.92
    assert found.outliers > 0
    assert abs(np.log(one.value / 2e6)) < 3.5 * sd < 0.1
    assert 0.5 < found.chi2 / found.samples < 1.5


def test_only_a_product_is_determined(fitted):
    # without gravity a cable knows only E / rho
    figure_free = ["cable.E", "cable.rho"]

    def light(E, rho=1200.0):
        robot = cable(E=E, rate=1.5)
        terms = [t for t in robot.terms if not isinstance(t, rn.Gravity | rn.MassDamping)]
        return rn.Robot(robot.graph, terms).with_parameters({"cable.rho": rho})

    kick = np.zeros((5, 3))
    kick[:, 2] = np.linspace(0.0, 0.3, 5)
    rec = record(light(2e6), WHITE, 0, velocity=kick)
    found = calibrate([rec], light(2.4e6), figure_free, options={"velocity": kick})
    text = str(found.identifiability)
    assert "only in combination: cable." in text and " / cable." in text
    assert "undetermined: cable." in text and " × cable." in text
    ratio = found.values["cable.E"] / found.values["cable.rho"]
    assert ratio == pytest.approx(2e6 / 1200.0, rel=0.01)


def test_profile_agrees_with_the_interval(fitted):
    profile = fitted.profile("cable.E", workers=0, evaluations=4)
    E = fitted.parameters["cable.E"]
    assert profile.low == pytest.approx(E.low, rel=0.2 * (E.high - E.low) / E.value)
    assert profile.high == pytest.approx(E.high, rel=0.2 * (E.high - E.low) / E.value)


def test_tied_parameters_follow():
    rec = record(cable(), WHITE)
    tied = {"mass_damping.rate": lambda p: 1.5 * (p["cable.E"] / 2e6) ** 0.5}
    found = calibrate([rec], free=["cable.E"], tied=tied)
    E = found.parameters["cable.E"]
    rate = found.parameters["mass_damping.rate"]
    assert E.low < 2e6 < E.high
    relative = (np.log(E.high / E.low), (rate.high - rate.low) / rate.value)
    assert relative[1] == pytest.approx(0.5 * relative[0], rel=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"free": ["cable.e"]}, r"no parameter 'cable.e'; did you mean 'cable.E'"),
        ({"free": ["cable.nu", "gravity.fluid_density", "cable.E"]}, "depends on"),
        ({"free": []}, "nothing is free"),
        ({"observe": None}, "nothing is observed"),
        ({"free": ["markers.zoom"]}, "has no parameter 'zoom'"),
        ({"free": ["markers.shift"]}, r"'markers.shift\[0\]'"),
        ({"free": ["initial.position"]}, "put it in per_trial"),
        ({"per_trial": ["initial.place"]}, "has no 'initial.place'"),
        ({"priors": {"cable.nu": 0.1}}, "is not free"),
        ({"priors": {"cable.E": -1.0}}, "prior of 'cable.E'"),
        ({"noise": {"eyes": 1e-3}}, "nothing observed is called 'eyes'"),
        ({"loss": "l1"}, "loss"),
        ({"starts": 0}, "starts"),
        ({"evaluations": 0}, "evaluations"),
        ({"modes": 2.5}, "modes"),
        ({"outliers": 1.0}, "outliers"),
        ({"start": {"cable.nix": 1.0}}, "start: 'cable.nix'"),
        ({"start": {"cable.E": -1.0}}, "cannot start at -1"),
        ({"options": {"adaptive": 1e-3}}, "fixed time step"),
        ({"free": "cable.E"}, "list of paths"),
        ({"tied": {"cable.rho": lambda p: p["nix"]}}, "tied 'cable.rho' fails"),
        ({"per_trial": ["initial.position"], "modes": 100}, "modes = 100"),
        ({"tied": {"cable.E": lambda p: 1.0}}, "given twice"),
    ],
)
def test_bad_input_is_named(changes, message):
    rec = record(cable(), WHITE, duration=0.05)
    with pytest.raises(rn.RodnetError, match=message):
        calibrate([rec], **{"free": FREE, **changes})


def test_nothing_recorded_and_no_recordings():
    rec = record(cable(), WHITE, duration=0.05)
    lost = rec.replace(suspect=np.ones(rec.markers.shape[:2], dtype=bool))
    with pytest.raises(rn.RodnetError):
        calibrate([lost])
    with pytest.raises(rn.ParameterError, match="at least one recording"):
        calibrate([])
    assert list(POINTS) == ["mid", "tip"]


def test_what_vanishes_is_not_needed():
    """A cable without mass damping: the interval of the rate is from zero to where damping would be seen.

    Over 0.3 s a rate c takes c t / 2 of a swing of a few centimetres: 0.02 1/s is about the noise.
    """
    found = calibrate([record(cable(rate=1e-9), WHITE, k) for k in range(2)])
    rate, stiff = (found.parameters[path] for path in ("mass_damping.rate", "cable.E"))
    assert rate.low == 0.0 < rate.value < 1e-3 and 3e-3 < rate.high < 0.1
    assert 0.99 * stiff.low < 2e6 < 1.01 * stiff.high
    determined, vanished = found.identifiability.sentences
    assert "cable.E" in determined and "determined" in determined
    assert "not needed: mass_damping.rate (0 fits as well as anything below" in vanished


def test_what_is_known_to_one_side_only():
    """Of what has grown a thousandfold its effect is linear in the inverse: it is at least so much."""
    q = Quantity("cable.E", "Pa", 1e6, 0.0, np.inf, 1e6, True)
    assert q.grown(np.log(2000.0)) and not q.grown(np.log(500.0))
    found = identify([q], np.array([[1e-8]]), least={"cable.E": 3.2e7})
    assert found.sentences == [
        "known to one side: cable.E is at least 3.2e+07 Pa, whatever is larger fits as well"
    ]
