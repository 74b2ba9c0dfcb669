"""What a model is computed with: values that are not free."""

from dataclasses import replace

import numpy as np
import pytest

from rodnet.diagnosis.workbench import Workbench
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
