"""The numerical error that is carried along is that of the model that moves like the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis import fineness, numerics
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.scales import LEAST
from rodnet.diagnosis.verdict import TIMES
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


def test_it_is_measured_again_where_an_effect_makes_it_another_one():
    """A rod with a short soft spot bends where a mesh is coarse: that is what the spot's model must have a share of."""
    recordings = [shaken.record(k).cut(0.0, 0.6) for k in range(2)]
    precise = Workbench.of(shaken.CASE, recordings, Serial(), 1e-5)
    plain = precise.fit()
    assert numerics.renewed(precise, plain) is None  # nothing is carried along
    measured = numerics.measure(precise, plain)
    case = numerics.carried(precise.case, recordings, measured)
    bench = replace(precise, case=case, priors=numerics.priors(case, measured))
    base = bench.evaluate(bench.problem((), plain.values), np.zeros(3))
    assert numerics.renewed(bench, base) is None  # it is the same as it was
    spot = rn.candidates(shaken.build(recordings[0]), [], ["stiffness-defect"])[0]
    values = dict(zip(spot.paths, (0.9, 0.25, 0.05, 1.0), strict=True))
    problem = bench.problem([spot], {**base.values, **values})
    soft = bench.evaluate(problem, np.zeros(len(problem.quantities)), [spot])
    renewed = numerics.renewed(bench, soft)
    assert renewed is not None
    over, error = renewed
    assert over.case.free == bench.case.free
    expected = numerics.measure(precise, precise.evaluate(
        precise.problem([spot], {**base.values, **values}), np.zeros(5), [spot]
    ))  # fmt: skip
    assert error.kept == pytest.approx(expected.kept, rel=1e-6)
    trial = recordings[0]
    (seen,) = over.case.observations(trial, over.case.robot(trial))
    for found, wanted in zip(seen.corrections, expected.fields[0]["markers"], strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_what_would_hide_the_smallest_effect_is_refined():
    """Until three times what carrying leaves of the error is 0.1 sigma; beside a misfit the search goes on as it is."""
    recordings = [shaken.record(k).cut(0.0, 0.6) for k in range(2)]
    fitted = (unit := Workbench.of(shaken.CASE, recordings, Serial(), 1e-3)).fit()
    error = numerics.measure(unit, fitted)
    assert error.kept["mesh"] > 2.0 * error.kept["time step"]  # each falls to a quarter where it is refined

    def calibrated(worst, case=shaken.CASE, patience=ENDLESS, refined=2):
        """Nodes of the robot, where the largest error is so many sigmas before."""
        sigma = 1e-3 * error.worst / worst
        bench = Workbench.of(replace(case, noise=sigma if case.noise else None), recordings, Serial(), sigma)
        _, left, bench, *_ = fineness.calibrated(bench, lambda text: None, patience, refined)
        return bench.case.robot(recordings[0]).graph.node_count, left

    nodes = shaken.EDGES + 1
    assert calibrated(0.1)[0] == nodes
    assert calibrated(0.2, refined=0)[0] == nodes
    refined, left = calibrated(0.2)
    assert refined == 2 * shaken.EDGES + 1 and TIMES * left.left < LEAST
    assert left.coarser == {"mesh": pytest.approx(0.2, rel=0.05)}  # that of the case's own
    assert calibrated(0.1)[1].coarser == {}
    assert calibrated(0.2, replace(shaken.CASE, noise=1e-3))[0] == nodes
    for rest, count in (
        (80.0, refined),
        (200.0, nodes),
    ):  # [s] of a diagnosis on the coarse mesh, which may take 5 min
        assert calibrated(0.2, patience=Patience(minutes=5.0, rest=lambda s=rest: s))[0] == count


def test_nothing_is_found_where_nothing_is_missing():
    """The truth is finer than the model: a numerical difference is no physics."""
    recs = [shaken.record(k) for k in range(5)]
    tried = ["stiffness-defect", "yield", "gravity", "kelvin-voigt"]
    found = rn.diagnose(shaken.CASE, recs, candidates=tried, noise=shaken.SIGMA, workers=0)
    assert found.verdict == "none"
    assert not found.findings


def test_a_trial_goes_to_other_processes_with_its_own_error_alone():
    """What is sent grows with the number of trials, not with its square."""
    recordings = [shaken.record(k).cut(0.0, 0.6) for k in range(6)]
    bench = Workbench.of(shaken.CASE, recordings, Serial(), shaken.SIGMA)
    carried = numerics.carrying(bench, numerics.measure(bench, bench.fit()))
    effect = candidates(shaken.CASE.robot(recordings[0]), [], ["gravity"])[0]
    for known in ([], [effect]):
        plain, some = (len(one.problem(known).packed[0]) for one in (bench, carried))
        field = recordings[0].markers.nbytes  # of the time step, and of the mesh
        assert 2 * field < some - plain < 3 * field


def test_refinements_are_counted_in_whatever_order():
    """What a case refined already is off by is that of its last refinement, and so many are left of it."""
    rec = shaken.record(0)
    case = shaken.CASE
    coarse = case.robot(rec)
    assert numerics.refinements(case) == (0, 0)
    finer = numerics.halved(numerics.doubled(numerics.halved(case)))
    assert numerics.refinements(finer) == (2, 1)
    robot = finer.robot(rec)
    assert len(robot.graph.edges) == 2 * len(coarse.graph.edges)
    assert finer.simulation(rec, robot)["dt"] == case.simulation(rec, coarse)["dt"] / 4
