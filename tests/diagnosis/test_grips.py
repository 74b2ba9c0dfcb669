"""A small remainder that is an error of where each trial is held is told from one that is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.grips import WANDER, beside_grips
from rodnet.diagnosis.records import record_noise
from rodnet.diagnosis.remainder import test_remainder as smooth_remainder
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import complete
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

TRIALS, ERROR = 4, 2.5e-4  # [m]


def remainders(trials):
    """The remainder of the plain model, and the same beside grips."""
    bench = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    base = bench.fit()
    robot = bench.case.robot(bench.recordings[0])
    scores = screen(bench, base, candidates(robot, [], ["grasp-offset", "grasp-twist", "root-direction"]))
    plain = smooth_remainder(base, bench.noise)
    return plain, beside_grips(base, scores, bench.noise, plain)


def held_elsewhere(size):
    """Trials that are each held beside their record by so much [m], every time elsewhere; and by how much."""
    return held(size * np.random.default_rng(3).standard_normal((TRIALS, 3)))


def held(shifts):
    """Trials that are held beside their record by these vectors [m]; and by how much."""
    trials = []
    for k, shift in enumerate(shifts):
        there = {f"motion.shift_{axis}": value for axis, value in zip("xyz", shift, strict=True)}
        true = moved(shaken.robot(shaken.drive(k)), there)  # on the mesh of the model: nothing else is wrong
        trials.append(shaken.record(k, change=lambda _, true=true: true))
    return trials, float(np.sqrt(np.mean(shifts**2)))


def moved(robot, there):
    """The robot held elsewhere."""
    return candidates(robot, [], ["grasp-offset"])[0].build(robot).with_parameters(there)


def test_a_smoothed_record_is_off_most_where_it_begins():
    """Of shakes at 0.3 to 1.1 Hz, recorded at 25 Hz for 4 s: by more than the noise there, by less over all."""
    rng, t, noise, errors = np.random.default_rng(0), np.arange(101) / 25.0, 5e-5, []
    for _ in range(60):
        frequency, size = rng.uniform(0.3, 1.1, 3), rng.uniform(0.01, 0.05, 3)
        true = (
            size * np.sin(2.0 * np.pi * frequency * t[:, None]) * (1.0 - np.exp(-((t[:, None] / 0.3) ** 2)))
        )
        smooth = rn.smooth_motion(t, true + noise * rng.standard_normal(true.shape), noise)
        errors.append((np.array([smooth(float(time)) for time in t]) - true) / noise)
    size = np.sqrt(np.mean(np.square(errors), axis=(0, 2)))
    over_all = float(np.sqrt(np.mean(size**2)))
    assert over_all == pytest.approx(0.65, abs=0.07)
    assert size[0] > 1.0
    assert over_all < WANDER * size[0]


def test_a_smoothed_record_wanders_less_than_grips_that_stay_take_off():
    """Shifts and turns of four trials, as a rod of 0.3 m shows them: what six numbers a trial leave and take off."""
    rng, t, noise, turning = np.random.default_rng(1), np.arange(101) / 25.0, 5e-5, 2e-4
    points = np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]])
    one = np.eye(3)
    kept = [np.tile(axis, (3, 1)) for axis in one] + [np.cross(axis, points) for axis in one]
    M = np.stack([np.tile(k, (len(t), 1, 1)).ravel() for k in kept], axis=1)
    taken, left = [], []
    for _ in range(60):
        frequency, size = (
            rng.uniform(0.3, 1.1, (2, 3)),
            np.array([[0.03], [0.3]]) * rng.uniform(0.3, 1.0, (2, 3)),
        )
        ramp = 1.0 - np.exp(-((t[:, None] / 0.3) ** 2))
        shift, angle = (
            s * np.sin(2.0 * np.pi * f * t[:, None]) * ramp for s, f in zip(size, frequency, strict=True)
        )
        turned = Rotation.from_rotvec(angle)
        seen = turned * Rotation.from_rotvec(turning * rng.standard_normal(angle.shape))
        grip = rn.smooth_motion(t, shift + noise * rng.standard_normal(shift.shape), noise)
        turn = rn.smooth_rotation(t, seen.as_quat(), turning)
        off = np.array([grip(s) - grip(0.0) + points @ np.asarray(turn(s)).T for s in t.tolist()])
        off -= shift[:, None] + np.einsum("tij,nj->tni", turned.as_matrix(), points)
        stays = M @ np.linalg.lstsq(M, off.ravel(), rcond=None)[0]
        taken.append(np.mean(stays**2))
        left.append(np.mean((off.ravel() - stays) ** 2))
    sets = rng.integers(60, size=(1000, TRIALS))
    ratio = np.sqrt(np.array(left)[sets].mean(axis=1) / np.array(taken)[sets].mean(axis=1))
    assert 0.3 < np.median(ratio) < 0.8
    assert np.mean(ratio < WANDER) > 0.97


def test_errors_of_where_each_trial_is_held_are_no_remainder():
    """Each trial is held a quarter of sigma beside its record."""
    trials, size = held_elsewhere(ERROR)
    plain, left = remainders(trials)
    assert not complete(plain)
    assert complete(left)
    assert left.excess < 0.15
    assert left.grips == pytest.approx(size / shaken.SIGMA, rel=0.3)


def test_noise_of_a_record():
    """Whatever else a recording holds; what stays has none."""
    rng, trials = np.random.default_rng(5), []
    for k, rec in enumerate(held_elsewhere(ERROR)[0]):
        way = np.array([shaken.Shake(**shaken.drive(k))(float(t)) for t in rec.t])
        grip = 0.3 + way + 0.1 * ERROR * rng.standard_normal(way.shape)
        trials.append(replace(rec, channels={"other": way[:, 0], "grip": grip}))
    bare = record_noise(shaken.CASE.robot, [replace(trials[0], channels={})])["motion"]
    assert bare.shift is None and not bare.known
    found = record_noise(shaken.CASE.robot, trials)["motion"]
    assert found.shift == pytest.approx(0.1 * ERROR, rel=0.2)
    assert found.turn == 0.0 and found.known


@pytest.mark.parametrize("late", [0.03, 0.3])
def test_what_differs_smoothly_is_no_noise_of_a_record(late):
    """The path that was commanded a little later, or that of another point: how noisy the record was nobody knows."""
    rng, rec = np.random.default_rng(5), held_elsewhere(ERROR)[0][0]
    shake = shaken.Shake(**shaken.drive(0))
    way = np.array([shake(max(float(t) - late, 0.0)) for t in rec.t])
    grip = way + 0.01 * ERROR * rng.standard_normal(way.shape)
    assert not record_noise(shaken.CASE.robot, [replace(rec, channels={"grip": grip})])["motion"].known


def test_axes_that_stand_still_have_no_share_in_the_noise():
    """They are exact; what moves is as noisy as it is."""
    rng, rec = np.random.default_rng(5), held_elsewhere(ERROR)[0][0]
    way = np.array([shaken.Shake(**shaken.drive(0))(float(t)) for t in rec.t])
    grip = way + ERROR * rng.standard_normal(way.shape) * [0.0, 1.0, 0.0]
    found = record_noise(shaken.CASE.robot, [replace(rec, channels={"grip": grip})])["motion"]
    assert found.shift == pytest.approx(ERROR, rel=0.2)


@pytest.mark.parametrize("drawn", [0.5, np.pi])
def test_noise_of_a_record_of_turns(drawn):
    """Of a gripper that turns, drawn turned, whatever the signs of its quaternions."""
    rng, t = np.random.default_rng(6), np.arange(101) / 25.0
    true = Rotation.from_rotvec(np.outer(0.4 * np.sin(2.0 * t), [0.3, 1.0, -0.2]))
    seen = true * Rotation.from_rotvec(1e-3 * rng.standard_normal((len(t), 3)))
    turn = rn.smooth_rotation(t, seen.as_quat(), 1e-3)
    robot = shaken.robot(shaken.drive(0))
    terms = [*robot.terms[:-1], rn.PrescribedMotion(at="rod:0-1", orientation=turn)]
    markers, drawn = np.zeros((len(t), 1, 3)), Rotation.from_euler("x", drawn)
    channel = np.sign(rng.standard_normal(len(t)))[:, None] * (seen * drawn).as_quat()
    rec = rn.Recording(t, markers, names=["tip"], channels={"turn": channel})
    found = record_noise(lambda _: rn.Robot(robot.graph, terms), [rec])["motion"]
    assert found.shift == 0.0
    assert found.turn == pytest.approx(1e-3, rel=0.25)


@pytest.mark.parametrize(("signs", "same"), [((1, 1, 1, 1), True), ((1, 1, 1, -0.2), False)])
def test_one_explanation_for_all_trials_is_the_better_one_unless_they_contradict_each_other(signs, same):
    """Three trials that are held elsewhere by the same vector and one that is not are no grip that is off."""
    shift = 2.0 * ERROR * np.array([1.0, -0.8, 0.6])
    plain, left = remainders(held(np.outer(signs, shift))[0])
    assert not complete(plain) and plain.excess < 0.5
    assert (left is plain) == same


def test_a_large_remainder_is_no_error_of_a_record():
    """Three sigma are no noise of a drive's record, whatever they look like."""
    plain, left = remainders(held_elsewhere(12.0 * ERROR)[0])
    assert plain.excess > 1.0
    assert left is plain


def test_what_is_no_error_of_grips_remains():
    """A soft spot that leaves as much is not made good by holding each trial elsewhere."""
    spot = {"loss": 0.25, "place": 0.5, "width": 0.06}
    plain, left = remainders([shaken.record(k, "stiffness-defect", spot) for k in range(TRIALS)])
    assert 0.2 < plain.excess < 0.5
    assert left is plain
