"""Rods that begin in motion: where initial positions are free, initial velocities are, as far as they would show."""

from dataclasses import replace

import numpy as np

import rodnet as rn
from rodnet.diagnosis.in_motion import begun_in_motion
from rodnet.diagnosis.remainder import test_remainder as smooth_remainder
from rodnet.diagnosis.verdict import complete
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.modes import soft_modes
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

CASE = replace(shaken.CASE, per_trial=("initial.position",))
MODES = 6
SPEEDS = 2.0 * np.array(  # of the first four modes, in five trials [m/s]
    [[0.03, -0.05, 0.08, 0.0], [-0.04, 0.0, -0.06, 0.1], [0.0, 0.06, 0.1, -0.07], [0.05, 0.04, 0.0, 0.08],
     [-0.03, 0.05, -0.09, 0.05]]
)  # fmt: skip


def moving(k):
    """A trial whose rod begins straight, and with these velocities; the true mesh is that of the case."""
    true = shaken.robot(shaken.drive(k))
    shapes = soft_modes(true, MODES)[:4, : true.graph.x0.size].reshape(4, *true.graph.x0.shape)
    speeds = np.einsum("j,jnd->nd", SPEEDS[k], shapes)
    traj = rn.Simulation(true, dt=shaken.DT, stepper="sdirk2", velocity=speeds).run(shaken.DURATION)
    plain = shaken.record(k)
    seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, plain.t)[0]
    return replace(plain, markers=seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape))


def in_honey(rec):
    """Where the medium stops the rod at once."""
    plain = shaken.build(rec)
    honey = rn.ResistiveForce(eta_t=100.0, eta_n=200.0)
    return rn.Robot(plain.graph, [honey if type(t) is rn.ResistiveForce else t for t in plain.terms])


def fitted(case, trials):
    bench = Workbench.of(case, trials, Serial(), shaken.SIGMA)
    still = bench.fit()
    over = begun_in_motion(bench, still)
    return bench, still, over, over.fit(values=still.values, own=still.own)


def test_velocities_are_found_that_no_initial_position_makes():
    bench, still, over, model = fitted(CASE, [moving(k) for k in range(4)])
    assert not complete(smooth_remainder(still, bench.noise))
    left = smooth_remainder(model, over.noise)
    assert complete(left) and left.p > 0.01
    paths = [p for p in over.case.per_trial if p.startswith("initial.velocity")]
    assert paths[:4] == [f"initial.velocity[{j}]" for j in range(4)]
    C = model.covariance()
    off = []
    for k, own in enumerate(model.own):
        for j, path in enumerate(paths[:4]):
            place = next(i for i, q in enumerate(model.quantities) if (q.path, q.trial) == (path, k))
            sd = np.sqrt(C[place, place]) * model.quantities[place].scale
            off.append((own[path] - SPEEDS[k, j]) / sd)
    assert np.max(np.abs(off)) < 4.0 and np.mean(np.square(off)) < 2.0
    assert abs(model.values["rod.E"] - 2e6) < 3.0 * model.sd("rod.E")


def test_nothing_is_missing_where_rods_begin_in_motion():
    trials = [moving(k) for k in range(5)]
    bank = ["gravity", "camera-shift", "added-mass"]
    found = rn.diagnose(CASE, trials[:4], hold_out=trials[4:], noise=shaken.SIGMA, workers=0, candidates=bank)
    assert found.verdict == "none" and not found.findings
    assert found.held.unexplained < 0.1


def test_what_would_not_show_is_not_free():
    """Of a rod in honey, or of one that nothing is known to lack in its initial shape."""
    trials = [shaken.record(k) for k in range(2)]
    bench, _, over, _ = fitted(shaken.CASE, trials)
    assert over is bench
    stiff = replace(CASE, build=in_honey)
    bench = Workbench.of(stiff, trials, Serial(), shaken.SIGMA)
    assert begun_in_motion(bench, bench.fit()) is bench


def test_what_a_case_says_of_velocities_stays():
    """It is not free where sigma is what the model is off by, either."""
    trials = [shaken.record(k) for k in range(2)]
    known = replace(CASE, per_trial=("initial.position", "initial.velocity[0]"))
    bench = Workbench.of(known, trials, Serial(), shaken.SIGMA)
    assert begun_in_motion(bench, bench.fit()) is bench
    rough = replace(CASE, noise=0.01)
    bench = Workbench.of(rough, trials, Serial(), 0.01)
    assert begun_in_motion(bench, bench.fit()) is bench
