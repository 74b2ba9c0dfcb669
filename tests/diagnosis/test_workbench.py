"""What a model is computed with: values that are not free."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import Candidate, add_terms, candidates
from rodnet.diagnosis.columns import _derivatives
from rodnet.diagnosis.workbench import Workbench
from rodnet.parameters import Parameter
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


@pytest.mark.parametrize("path", ["r?d.E", "rod.E"])
def test_a_value_that_is_not_free_is_that_of_the_model(path):
    """Trials that nothing is fitted to are predicted with a model's values, those of globs among them."""
    case = replace(shaken.CASE, free=[path])
    bench = Workbench.of(case, [shaken.record(0)], Serial(), shaken.SIGMA)
    problem = bench.problem((), {path: 3e6})
    fitted = bench.evaluate(problem, np.zeros(1))
    predicted = bench.fit((), {path: 3e6}, common=False)
    np.testing.assert_allclose(predicted.fits[0].residual, fitted.fits[0].residual, rtol=1e-12)
    drawn = bench.fit((), {path: 2e6}, common=False)
    assert predicted.deviance > 2.0 * drawn.deviance
    assert predicted.values[path] == 3e6


@pytest.mark.parametrize("id", ["dry-friction", "drag"])
def test_places_that_are_told_from_one_run_are_those_of_runs_of_their_own(id):
    """Also where all places have the strength from their candidate, and where its term shares it, as this drag does."""
    recs = [shaken.record(k).cut(0.0, 0.5) for k in range(2)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    fitted = bench.fit()
    if id == "drag":
        strength = Parameter(0.0, unit="Pa s", null=0.0)
        options = {"eta_t": strength, "eta_n": strength, "name": "more"}
        build = partial(add_terms, parts=((rn.ResistiveForce, options),))
        one = Candidate("more", "", "medium", build=build, strength=("more.eta_n",), falsifier="")
        shapes = [{}, {}]
    else:
        (one,) = candidates(bench.case.robot(recs[0]), [], [id])
        shapes = [{"dry-friction.curvature": c} for c in (0.5, 5.0)]
    scales = {p: 1e-3 for p in one.strength}
    together, _ = _derivatives(bench, fitted, one, shapes, scales)
    alone = np.hstack([_derivatives(bench, fitted, one, [shape], scales)[0] for shape in shapes])
    np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9 * np.abs(alone).max())
