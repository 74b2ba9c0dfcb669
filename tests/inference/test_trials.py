"""What trials are made of: parts that are cut out once, paths of any kind, instruments that read ahead or differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.inference.trial import Trial
from tests.diagnosis import shaken


def called(name, k=0):
    return shaken.record(k).cut(0.0, 0.6).replace(name=name)


def test_a_menu_is_checked_and_its_markers_may_be_lost():
    """What is planned has names that tell it apart, and whatever was lost in a trial that it was made of is seen."""
    rec = called("trial")
    markers = rec.markers.copy()
    markers[[0, 3], 0] = np.nan
    lost = rec.replace(markers=markers)

    def menu(listed):
        return replace(shaken.CASE, drives=listed).menu(rec)

    assert shaken.CASE.menu(rec) == []
    found = dict(menu(lambda rec: [("lower", lost), (2, lost), rec.replace(name="slower")]))
    assert list(found) == ["lower", "2", "slower"] == [one.name for one in found.values()]
    filled = found["lower"].markers
    np.testing.assert_array_equal(filled[[0, 3], 0], markers[[1, 1], 0])
    np.testing.assert_array_equal(filled[:, 1:], markers[:, 1:])
    for wrong, words in {
        lambda rec: [("twice", rec), ("twice", rec)]: "called 'twice'",
        lambda rec: [(1, rec), (1, rec)]: "called '1'",
        lambda rec: [rec.replace(attrs={"amplitude": 0.1})]: "called 'trial'; list pairs",
        lambda rec: ["slower"]: "must list recordings",
        lambda rec: None: "drives.rec. fails: TypeError",
        lambda rec: [rec.attrs["unknown"]]: "drives.rec. fails",
    }.items():
        with pytest.raises(rn.CaseError, match=words):
            menu(wrong)


def test_a_part_is_cut_out_once():
    """In whatever process a trial is run: units are not converted twice, and no more is cut off."""
    recs = [called(f"trial{k}", k) for k in range(2)]
    cut = [rec.cut(0.0, 0.4) for rec in recs]
    plain = rn.calibrate(shaken.CASE, cut, noise=shaken.SIGMA, workers=0)

    def part(rec):
        return rec.cut(rec.t[0], rec.t[-1] - 0.2).replace(markers=0.1 * rec.cut(0.0, 0.4).markers)

    far = [rec.replace(markers=10.0 * rec.markers) for rec in recs]
    case = replace(shaken.CASE, cut=part)
    found = rn.calibrate(case, far, noise=shaken.SIGMA, workers=0)
    assert found.values["rod.E"] == pytest.approx(plain.values["rod.E"], rel=1e-9)
    told, expected = (
        rn.diagnose(*given, candidates=["gravity"], noise=shaken.SIGMA, workers=0)
        for given in ((case, far), (shaken.CASE, cut))
    )
    assert told.base.deviance == pytest.approx(expected.base.deviance, rel=1e-6)
    # as the case is given the part of a recording, so is whoever asks for its robot
    assert found.robot(far[0]).parameters["rod.E"].value == pytest.approx(plain.values["rod.E"], rel=1e-9)


def branched(rec):
    """A rod whose drag has one viscosity for each half edge."""
    robot = shaken.build(rec)
    count = 2 * robot.graph.edge_count
    terms = [t for t in robot.terms if t.name != "drag"]
    return rn.Robot(robot.graph, [*terms, rn.ResistiveForce(eta_t=1.0, eta_n=np.full(count, 2.0))])


def test_single_values_of_arrays_and_whole_ones_are_taken_beside_others():
    case, rec = replace(shaken.CASE, build=branched), called("a")
    count = 2 * branched(rec).graph.edge_count
    some = Trial.of(case, rec, {"drag.eta_n[0]": 5.0, "rod.E": 3e6, "drag.eta_n[2]": 7.0}).robot.parameters
    np.testing.assert_array_equal(some["drag.eta_n"].value[:3], [5.0, 2.0, 7.0])
    assert some["rod.E"].value == 3e6
    whole = Trial.of(case, rec, {"drag.eta_n": np.arange(1.0, count + 1), "rod.E": 3e6}).robot.parameters
    assert whole["drag.eta_n"].value[-1] == count and whole["rod.E"].value == 3e6
    with pytest.raises(rn.CaseError, match=r"no parameter 'rod\.EE' in 'a'"):
        Trial.of(case, rec, {"drag.eta_n[0]": 5.0, "rod.EE": 3e6})


def test_what_is_tied_to_a_glob_follows_what_is_drawn():
    """Without a fitted model as with one; what cannot be computed is told with its recording."""
    case = replace(shaken.CASE, free=["r?d.E"], tied={"drag.eta_t": lambda v: 1e-6 * v["r?d.E"]})
    trial = Trial.of(case, called("a"))
    assert trial.robot.parameters["drag.eta_t"].value == pytest.approx(2.0)
    wrong = replace(case, tied={"drag.eta_t": lambda v: v["rod.F"]})
    found = rn.evaluate(wrong, [called("a")], workers=0)
    assert "tied 'drag.eta_t' fails" in found.files[0]["failure"]


def test_an_instrument_that_reads_ahead_sees_the_end():
    """As in a calibration: the last tenth of a second is not frozen."""
    rec = called("a")
    robot = shaken.build(rec)
    traj = rn.Simulation(robot, dt=shaken.DT, stepper="sdirk2").run(0.8)
    ahead = rn.observe(rn.Markers(robot, shaken.POINTS), traj, rec.t + 0.1)[0]
    trial = Trial.of(shaken.CASE, rec, {"markers.lag": -0.1})
    (seen,), failure = trial.predict()
    assert not failure
    np.testing.assert_allclose(seen, ahead, atol=1e-9)


def height(view):
    """Height of the tip [m]."""
    return float(view.x[-1, 2])


def either(rec, robot):
    eye = rn.Markers(robot, shaken.POINTS)
    return [eye, rn.Reading(robot, "laser", height, unit="m")] if "laser" in rec.channels else [eye]


def test_an_instrument_may_be_in_any_trial(tmp_path):
    """Its noise is given by name, the page shows it, and so does what is held out."""
    from rodnet.report.calibration import calibration_page

    recs = [called(f"trial{k}", k) for k in range(3)]
    with_laser = [recs[0], *(r.replace(channels={"laser": r.markers[:, -1, 2].copy()}) for r in recs[1:])]
    case = replace(shaken.CASE, observe=either)
    noise = {"markers": shaken.SIGMA, "laser": 2e-3}
    found = rn.calibrate(case, with_laser[:2], noise=noise, workers=0)
    assert [len(found.instruments[name]) for name in ("trial0", "trial1")] == [1, 2]
    held = found.predictions(with_laser[2:])
    assert held["trial2"].rms["laser"] > 0.0
    alone = rn.calibrate(case, recs[:1], noise=shaken.SIGMA, workers=0)  # which no trial had
    assert alone.comparison(with_laser[2]).noise["laser"].white > 0.0
    assert "laser" in calibration_page(found, held).save(tmp_path / "page.html").read_text(encoding="utf-8")
    with pytest.raises(rn.ParameterError, match="nothing observed is called 'lazer'"):
        rn.calibrate(case, with_laser[:2], noise={"lazer": 1.0}, workers=0)


def test_recordings_of_one_name_are_predicted_each():
    recs = [called("trial", k) for k in range(3)]
    found = rn.calibrate(shaken.CASE, recs[:1], noise=shaken.SIGMA, workers=0)
    held = found.predictions(recs[1:])
    assert list(held) == ["trial", "trial#2"]
    assert held["trial"].rms != held["trial#2"].rms


def turning(rec):
    return rn.robots.flagellated(2, rpm=float(rec.attrs["rpm"]), edges=4)


def dial(rec, robot):
    return rn.HeadAngle(robot, "dial")


def test_the_first_reading_of_a_dial_is_in_all_others():
    """Which count from it: what is left of a true model is the noise all the same, whatever that reading was."""
    robot = turning(rn.Recording(np.arange(3.0), np.zeros((3, 1, 3)), attrs={"rpm": 90.0}))
    traj = rn.Simulation(robot, dt=0.02).run(1.6)
    (angle,) = rn.observe(rn.HeadAngle(robot), traj, traj.t)
    case = rn.Case(
        turning, dial, free=["drag.viscosity"], options=lambda rec, robot: {"dt": 0.02, "stepper": "euler"}
    )
    sizes = []
    for seed in range(12):
        noise = 0.05 * np.random.default_rng(seed).standard_normal(len(angle))
        rec = rn.Recording(
            traj.t, np.zeros((len(angle), 1, 3)), channels={"dial": angle + noise}, attrs={"rpm": 90.0}
        )
        trial = rn.calibrate(case, [rec], noise=0.05, workers=0, evaluations=1).comparison(rec)
        fit = trial.evaluate({})
        sizes.append(float(fit.residual @ fit.residual) / len(fit.residual))
        assert len(fit.residual) == len(angle) - 1
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.1) and max(sizes) < 1.6


def test_of_recordings_in_the_plane_the_two_coordinates_count():
    """The third stands as zero, without any noise: it is no evidence."""
    recs = [called(f"trial{k}", k) for k in range(2)]
    flat = [rec.replace(markers=np.delete(rec.markers, 1, axis=2)) for rec in recs]
    found = rn.calibrate(shaken.CASE, flat, noise=shaken.SIGMA, workers=0)
    assert found.samples == sum(rec.markers[..., :2].size for rec in recs)
    assert found.chi2 / found.samples == pytest.approx(1.0, abs=0.15)
