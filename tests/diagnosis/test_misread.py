"""What records of drives are off by is each trial's own: it hides no effect, and is taken for none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.diagnosis import numerics
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.carried import Carried
from rodnet.diagnosis.misread import WIDE, carrying_records, record_errors, uncarried
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.remainder import test_remainder as smooth_remainder
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import complete, judge
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

TRIALS, ERROR = 4, 2.5e-4  # [m]
SPOT = {"loss": 0.25, "place": 0.5, "width": 0.06}


NOISY = 0.65 * shaken.SIGMA


def recorded(rec):
    """The rod, driven by its record."""
    plain, grip = shaken.robot(dict(rec.attrs)), rn.smooth_motion(rec.t, rec.channels["grip"], NOISY)
    held = rn.PrescribedMotion(at="rod.start", position=grip - grip(0.0), orientation=shaken.upright)
    return rn.Robot(plain.graph, [*plain.terms[:-1], held])


def held_elsewhere(effect="", values=None, noise=ERROR, far=1.0):
    """Trials held beside their records, which have noise of that size, and by which vectors, over it."""
    rng, trials = np.random.default_rng(3), []
    shifts = far * rng.standard_normal((TRIALS, 3))
    for k, shift in enumerate(shifts):
        there = {f"motion.shift_{axis}": ERROR * v for axis, v in zip("xyz", shift, strict=True)}
        true = candidates(shaken.robot(shaken.drive(k)), [], ["grasp-offset"])[0]
        true = true.build(shaken.robot(shaken.drive(k))).with_parameters(there)
        rec = shaken.record(k, effect, values, change=lambda _, true=true: true)
        way = np.array([shaken.Shake(**shaken.drive(k))(float(t)) for t in rec.t])
        grip = 0.3 + way + noise * rng.standard_normal(way.shape)
        trials.append(replace(rec, channels={"grip": grip}))
    return trials, shifts


def benches(trials, case=shaken.CASE):
    """Without and with errors of the records, each with its fit."""
    bench = Workbench.of(case, trials, Serial(), shaken.SIGMA)
    base = bench.fit()
    over = carrying_records(bench, base, record_errors(bench))
    return (bench, base), (over, over.fit(values=base.values, own=base.own))


def test_where_trials_are_held_is_found():
    """Errors are found in each trial, and the stiffness that had made up for them is as certain as it says."""
    trials, shifts = held_elsewhere()
    (bench, base), (over, model) = benches(trials)
    assert not complete(smooth_remainder(base, bench.noise))
    left = smooth_remainder(model, over.noise)
    assert complete(left) and not left.grips
    size = np.array([size for *_, size in record_errors(bench)])
    assert size == pytest.approx([ERROR] * 6, rel=0.2)
    found = np.array([[own[f"markers.records[{j}]"] for j in range(6)] for own in model.own])
    found = (
        found[:, :3] + found[:, 3:]
    )  # from the beginning, and soon after, which is nearly the same in thin air
    C = model.covariance()
    places = np.reshape([k for k, q in enumerate(model.quantities) if ".records[" in q.path], (TRIALS, 2, 3))
    both = [C[np.ix_(pair, pair)].sum() for trial in places for pair in trial.T]
    sd = np.sqrt(np.reshape(both, (TRIALS, 3))) * model.quantities[places[0, 0, 0]].scale
    off = (found * size[:3] - ERROR * shifts) / (sd * size[:3])
    assert np.all(np.abs(off) < 4.0) and np.mean(off**2) < 2.5
    true = 2e6
    assert abs(model.values["rod.E"] - true) < 3.0 * model.sd("rod.E")


def test_a_smoothed_record_leaves_nothing():
    """A rod that is drawn where it is, and driven by a spline through a record nearly as noisy as the markers."""
    rng, trials = np.random.default_rng(0), []
    for k in range(8):
        same = shaken.robot(shaken.drive(k))  # no error of a mesh beside it
        rec = shaken.record(k, change=lambda _, same=same: same)
        way = np.array([shaken.Shake(**shaken.drive(k))(float(t)) for t in rec.t])
        trials.append(replace(rec, channels={"grip": way + NOISY * rng.standard_normal(way.shape)}))
    (bench, base), (over, model) = benches(trials, replace(shaken.CASE, build=recorded))
    assert not complete(smooth_remainder(base, bench.noise))
    left = smooth_remainder(model, over.noise)
    assert left.p > 0.01 and not left.grips
    assert abs(model.values["rod.E"] - 2e6) < 3.0 * model.sd("rod.E")


def test_a_grip_that_is_off_in_all_trials_alike_is_an_effect():
    """Errors of records cost what they are unlikely; what they may do makes no effect small."""
    trials, shift = [], np.array([1.2e-3, -1.28e-3, 0.96e-3])
    for k, rec in enumerate(held_elsewhere()[0]):
        there = dict(zip(("motion.shift_x", "motion.shift_y", "motion.shift_z"), shift, strict=True))
        true = candidates(shaken.robot(shaken.drive(k)), [], ["grasp-offset"])[0]
        true = true.build(shaken.robot(shaken.drive(k))).with_parameters(there)
        plain = shaken.record(k, change=lambda _, true=true: true)
        trials.append(replace(plain, channels=rec.channels))
    _, (over, model) = benches(trials)
    bank = candidates(shaken.CASE.robot(trials[0]), [], ["grasp-offset"])
    (score,) = screen(over, model, bank)
    one = refit(over, model, [score], 100)[0]
    assert judge(one, 0.01).accepted
    assert one.effect_sigma == pytest.approx(np.linalg.norm(shift) / shaken.SIGMA / np.sqrt(3.0), rel=0.2)
    found = np.array([one.fitted.values[f"motion.shift_{axis}"] for axis in "xyz"])
    assert np.linalg.norm(found - shift) < 0.25 * np.linalg.norm(shift)
    shown = np.array(
        list(score.detectable.values())
    )  # what would be seen is no larger for what records may do
    assert score.survives > 0.9 and np.all(shown < 8.0 * ERROR)


def test_what_is_larger_than_its_noise_is_no_error_of_a_record():
    """What is off by ten times what smoothing takes off a record remains."""
    trials, _ = held_elsewhere(noise=0.1 * ERROR)
    _, (over, model) = benches(trials)
    assert not complete(smooth_remainder(model, over.noise))


def test_what_it_changes_is_what_a_grip_elsewhere_does():
    """To first order, at the recorded drive."""
    trials, _ = held_elsewhere()
    (bench, base), (over, _) = benches(trials)
    share = np.array([0.7, -1.1, 0.4, 0.0, 0.0, 0.0])
    own = [{f"markers.records[{j}]": v for j, v in enumerate(share)} for _ in trials]
    problem = over.problem((), base.values, own)
    added = problem.fits(np.zeros(len(problem.quantities)))
    grip = candidates(shaken.CASE.robot(trials[0]), [], ["grasp-offset"])[0]
    size = np.array([size for *_, size in record_errors(bench)])
    there = dict(zip(grip.strength, (share * size)[:3], strict=True))
    moved = bench.problem([grip], {**base.values, **there}, base.own)
    for one, other, known in zip(added, moved.fits(np.zeros(len(moved.quantities))), base.fits, strict=True):
        change = other.predicted[0] - known.predicted[0]
        assert np.abs(one.predicted[0] - other.predicted[0]).max() < 0.01 * np.abs(change).max()
    k = next(k for k, q in enumerate(problem.quantities) if ".records[" in q.path)
    near = 1e-3 * np.eye(len(problem.quantities))[k]
    ends = [problem.fits(s * near)[0].residual for s in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / 2e-3
    assert added[0].jacobian[:, k] == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())


def test_a_place_is_recorded_in_space():
    """By what it is off does not turn with the gripper: all that is seen is moved by as much, from then on."""
    turning = lambda t: Rotation.from_rotvec([0.0, 0.0, 1.2 * np.sin(2.0 * t)]).as_matrix()  # noqa: E731

    def turned(rec):
        plain, grip = shaken.robot(dict(rec.attrs)), rn.smooth_motion(rec.t, rec.channels["grip"], ERROR)
        held = rn.PrescribedMotion(
            at="rod.start", position=grip - grip(0.0), orientation=turning, name="grip"
        )
        return rn.Robot(plain.graph, [*plain.terms[:-1], held])

    trials = held_elsewhere()[0][:1]
    case = replace(shaken.CASE, build=turned)
    bench = Workbench.of(case, trials, Serial(), shaken.SIGMA)
    found = record_errors(bench)
    assert [path for _, path, _ in found] == [
        f"grip.{kind}_{axis}" for kind in ("off", "slip") for axis in "xyz"
    ]
    over = carrying_records(bench, bench.fit(), found)
    fields = over.case.observe.records[trials[0].name]["markers"]
    robot = turned(trials[0])
    x0 = robot.graph.x0[:1]
    for j, ((one, path, size), field) in enumerate(zip(found, fields, strict=True)):
        way = size * np.eye(3)[j % 3]
        still, moved = (one.build(robot).with_parameters({path: v}).terms[-1] for v in (0.0, size))
        places = [term.position(0.8, x0, term.values()) for term in (still, moved)]
        assert places[1] - places[0] == pytest.approx(way[None], abs=1e-9 * size)
        if j < 3:
            assert np.abs(field - way).max() < 1e-6 * size
        else:
            assert np.abs(field[0]).max() < 1e-6 * size
    # the rod is turned far enough that the frame matters
    assert np.linalg.norm(turning(0.8)[:, 0] - np.eye(3)[0]) > 0.9


def test_all_instruments_look_at_one_drive():
    """What a second camera sees is shifted by the same error, which each trial has once."""
    eyes = lambda rec, robot: [rn.Markers(robot, shaken.POINTS, name=name) for name in ("near", "far")]  # noqa: E731
    trials, _ = held_elsewhere()
    _, (over, model) = benches(trials[:2], replace(shaken.CASE, observe=eyes))
    paths = [q.path for q in model.quantities if q.trial == 0]
    assert paths == [f"near.records[{j}]" for j in range(6)]
    own = [{**one, "near.records[1]": one["near.records[1]"] + 1.0} for one in model.own]
    problem = over.problem((), model.values, own)
    for one, known in zip(problem.fits(np.zeros(len(problem.quantities))), model.fits, strict=True):
        near, far = (a - b for a, b in zip(one.predicted, known.predicted, strict=True))
        assert np.abs(near).max() > 0.5 * ERROR
        assert np.array_equal(near, far)


def test_what_each_trial_is_held_beside_by_more_than_its_noise_is_left():
    """However little of the readings that is: twelve numbers of thousands."""
    trials, _ = held_elsewhere(far=8.0)
    _, (_, true) = benches(held_elsewhere()[0])
    _, (over, model) = benches(trials)
    left = [smooth_remainder(one, over.noise) for one in (true, model)]
    assert left[0].records < 1.0 and left[1].records > 2.0
    assert not complete(replace(left[1], p=1.0, excess=0.0))


def test_no_effect_hides_behind_it():
    """A soft spot remains, as large as it was."""
    trials, _ = held_elsewhere()
    plain = [
        replace(shaken.record(k, "stiffness-defect", SPOT), channels=r.channels) for k, r in enumerate(trials)
    ]
    (bench, base), (over, model) = benches(plain)
    before, after = smooth_remainder(base, bench.noise), smooth_remainder(model, over.noise)
    assert not complete(after)
    assert after.excess > 0.7 * before.excess


def test_a_drive_without_a_record_has_no_error():
    """Nor has one whose record is exact, or a model that is off by what its case says."""
    trials, _ = held_elsewhere()
    bare = [replace(rec, channels={}) for rec in trials]
    assert not record_errors(Workbench.of(shaken.CASE, bare, Serial(), shaken.SIGMA))
    still = [replace(rec, channels={"grip": np.zeros((len(rec.t), 3))}) for rec in trials]
    assert not record_errors(Workbench.of(shaken.CASE, still, Serial(), shaken.SIGMA))
    assert not record_errors(Workbench.of(replace(shaken.CASE, noise=0.01), trials, Serial(), 0.01))


def test_what_cannot_be_carried_is_known():
    """An excuse as grips is for errors that nothing carries: of unknown size, or of trials seen by different eyes."""
    eyes = lambda rec, robot: [rn.Markers(robot, shaken.POINTS, name=rec.name)]  # noqa: E731
    trials, _ = held_elsewhere()
    case = replace(shaken.CASE, observe=eyes)
    bench = Workbench.of(case, trials[:2], Serial(), shaken.SIGMA)
    over = carrying_records(bench, bench.fit(), record_errors(bench))
    assert over is bench and record_errors(bench) and uncarried(bench)
    (plain, _), (carried, _) = benches(trials[:2])
    assert uncarried(plain) and not uncarried(carried)
    bare = [replace(rec, channels={}) for rec in trials]
    assert uncarried(Workbench.of(shaken.CASE, bare, Serial(), shaken.SIGMA))
    still = [replace(rec, channels={"grip": rec.channels["grip"] * 0.0}) for rec in trials]
    assert uncarried(Workbench.of(shaken.CASE, still, Serial(), shaken.SIGMA))  # no record of what moves
    assert not uncarried(Workbench.of(replace(shaken.CASE, noise=0.01), trials, Serial(), 0.01))


def test_it_stays_when_the_numerical_error_is_another_one():
    """Both are carried along, and neither takes the other's place."""
    trials, _ = held_elsewhere()
    (bench, base), (over, model) = benches(trials)
    both = numerics.carrying(over, numerics.measure(over, model))
    again = numerics.carrying(both, numerics.measure(both, both.fit(values=model.values, own=model.own)))
    for one in (both, again):
        assert isinstance(one.case.observe, Carried)
        assert one.case.observe.records == over.case.observe.records
        assert one.case.per_trial == over.case.per_trial
        paths = {q.path for q in one.problem().quantities}
        assert {"markers.numerics[0]", "markers.numerics[1]", "markers.records[2]"} <= paths
    prior = next(q.prior for q in again.problem().quantities if ".records[" in q.path)
    assert prior.mean() == 0.0 and prior.std() == WIDE
    assert bench.case.per_trial == shaken.CASE.per_trial and not base.own[0].get("markers.records[0]")
