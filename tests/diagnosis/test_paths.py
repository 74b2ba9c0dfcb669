"""Scores are of the fitted model, however its free values are named, and what follows from others follows by trial."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.stage_files import Stages, identity, named
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

SOME = ["gravity", "kelvin-voigt", "natural-curvature"]


def soft(rec: rn.Recording) -> rn.Robot:
    """The robot with a first guess of its modulus that is far off."""
    return shaken.build(rec).with_parameters({"rod.E": 5e5})


def scores_of(case: rn.Case):
    recs = [shaken.record(k, change=lambda r: r.with_terms(rn.Gravity(g=0.15))) for k in range(3)]
    bench = Workbench.of(case, recs, Serial(), shaken.SIGMA)
    base = bench.fit()
    robot = case.robot(bench.recordings[0])
    return base, {s.candidate.id: s for s in screen(bench, base, candidates(robot, [], SOME))}


def test_a_glob_of_free_parameters_is_scored_as_its_name():
    case = replace(shaken.CASE, build=soft)
    (one, by_name), (other, by_glob) = (scores_of(replace(case, free=(path,))) for path in ("rod.E", "ro*.E"))
    assert other.deviance == pytest.approx(one.deviance, rel=1e-6)
    for id, score in by_name.items():
        assert by_glob[id].chi2 == pytest.approx(score.chi2, rel=1e-3), id
        np.testing.assert_allclose(
            by_glob[id].columns, score.columns, atol=1e-3 * np.abs(score.columns).max()
        )


def test_what_follows_from_a_value_of_each_trial_follows_by_trial():
    """With the drag along tied to the one across, a value of each trial, as with both in one number."""
    tied = {"drag.eta_t": lambda known: 0.5 * known["drag.eta_n"]}
    case = replace(shaken.CASE, per_trial=("drag.eta_n",), tied=tied)
    base, scores = scores_of(case)
    assert all("drag.eta_n" in own for own in base.own)
    assert max(scores.values(), key=lambda s: s.chi2).candidate.id == "gravity"


def test_a_case_whose_noise_is_a_function_is_kept_in_stages(tmp_path):
    """By its name, like its other functions."""
    case = replace(shaken.CASE, noise=lambda rec: 0.01)
    recs = {"training": [shaken.record(0)]}
    stages = Stages(tmp_path, identity(case, recs, [], {}), named(case, recs, []))
    changed = stages("one", lambda: replace(case, free=("rod.E",)))
    again = Stages(tmp_path, identity(case, recs, [], {}), named(case, recs, []))
    taken = again("one", lambda: pytest.fail("it was not kept"))
    assert taken.noise is case.noise and taken.free == changed.free
