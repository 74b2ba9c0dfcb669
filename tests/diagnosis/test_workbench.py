"""What a model is computed with: values that are not free."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import Candidate, add_terms, candidates
from rodnet.diagnosis.carried import restated
from rodnet.diagnosis.columns import _derivatives
from rodnet.diagnosis.forces import force_columns, held_gains, library_of, placebo
from rodnet.diagnosis.heldout import common_columns
from rodnet.diagnosis.library import simple
from rodnet.diagnosis.numerics import carrying, measure
from rodnet.diagnosis.remainder import _smooth
from rodnet.diagnosis.remainder import test_remainder as smooth_remainder
from rodnet.diagnosis.screen import Basis
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


def test_a_model_that_is_known_beside_another_numerical_error_is_not_run_again():
    recs = [shaken.record(k).cut(0.0, 0.5) for k in range(2)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    plain = bench.fit()
    first = measure(bench, plain)
    known = carrying(bench, first).fit(values=plain.values, own=plain.own)
    twice = [{n: tuple(2.0 * f for f in own) for n, own in one.items()} for one in first.fields]
    over = carrying(bench, replace(first, fields=twice))
    problem = over.problem((), known.values, known.own)
    z = np.zeros(len(problem.quantities))
    found, wanted = restated(problem, z, known), problem.fits(z)
    assert found is not None and wanted is not None
    for one, run in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one.residual, run.residual, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(one.jacobian, run.jacobian, rtol=1e-9, atol=1e-12)
    assert restated(over.problem((), {**known.values, "rod.E": 3e6}), z, known) is None  # it is elsewhere


def test_what_is_smooth_is_what_the_nominal_parameters_leave_of_all_directions_together():
    recs = [shaken.record(k).cut(0.0, 0.5) for k in range(2)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    fitted = bench.evaluate(bench.problem((), {"rod.E": 2.2e6}), np.zeros(1))
    blocks = [_smooth(fit.whitened[0], fit.seen[0])[0] for fit in fitted.fits]
    S = np.zeros((len(fitted.residual), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        S[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    beside = S[:, [0, 5]] + 0.0  # of some directions nothing is left
    basis = Basis.of(np.hstack([fitted.jacobian, beside]))
    r = basis.out(fitted.residual)
    Q, s, _ = np.linalg.svd(basis.out(S), full_matrices=False)
    Q = Q[:, s > 1e-6 * s[0]]
    smooth, m = float(np.sum((Q.T @ r) ** 2)), Q.shape[1]
    rough = (float(r @ r) - smooth) / (fitted.samples - m - basis.U.shape[1])
    assert m == S.shape[1] - 2
    assert smooth_remainder(fitted, beside=beside).ratio == pytest.approx(smooth / m / rough, rel=1e-9)


def test_what_trials_do_not_tell_stays_near_what_the_case_says():
    """Where drag and stiffness are so large that inertia is nothing, motion tells their ratio alone."""
    times = 1e3

    def stiff(attrs, E):
        values = {"rod.E": E * times, "drag.eta_n": 2.0 * times, "drag.eta_t": times}
        return shaken.robot(attrs).with_parameters(values)

    def build(rec):
        return stiff(rec.attrs, 2e6)

    case = replace(shaken.CASE, build=build, free=["rod.E", "drag.eta_n"], tied={"drag.eta_t": halved})
    recs = [shaken.record(k, change=lambda robot, k=k: stiff(shaken.drive(k), 3e6)) for k in range(2)]
    bench = Workbench.of(case, recs, Serial(), shaken.SIGMA)
    far = bench.fit(values={"rod.E": 2e6 * times * 300.0, "drag.eta_n": 2.0 * times * 300.0})
    E, eta = far.values["rod.E"], far.values["drag.eta_n"]
    np.testing.assert_allclose(E / eta, 1.5e6, rtol=0.05)
    assert 0.2 < E / (2e6 * times) < 5.0 and 0.2 < eta / (2.0 * times) < 5.0
    assert far.sd("drag.eta_n") < np.log(10.0) * eta  # and this is how well they are known


def test_what_the_case_has_none_of_has_no_prior_about_it():
    def build(rec):
        return shaken.robot(rec.attrs).with_parameters({"drag.eta_t": 0.0})

    case = replace(shaken.CASE, build=build, free=["rod.E", "drag.eta_t"])
    bench = Workbench.of(case, [shaken.record(0).cut(0.0, 0.6)], Serial(), shaken.SIGMA)
    found = bench.fit()
    again = bench.fit(values=found.values | {"drag.eta_t": 0.3}, own=found.own)
    np.testing.assert_allclose(again.deviance, found.deviance, rtol=1e-3)
    assert [q.path for q in again.quantities if q.prior is not None] == ["rod.E"]


def test_a_weak_prior_is_as_strong_far_above_the_case_as_far_below():
    bench = Workbench.of(shaken.CASE, [shaken.record(0).cut(0.0, 0.4)], Serial(), shaken.SIGMA)
    (E,) = (q for q in bench.problem().quantities if q.path == "rod.E")
    for z in (-25.0, 0.0, 25.0):
        u, slope = E.prior_residual(z)
        np.testing.assert_allclose([u, slope], [z / np.log(10.0), 1.0 / np.log(10.0)], rtol=1e-6, atol=1e-12)


def halved(values):
    """Drag along the rod is half of that across it."""
    return 0.5 * values["drag.eta_n"]


def test_trials_of_another_length_have_other_coordinates_of_the_same_values():
    """Scales go with the length of the trials: derivatives are brought to those of the model before they are used."""
    recs = [shaken.record(0).cut(0.0, 0.5), shaken.record(1)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    (flow,) = candidates(shaken.build(recs[0]), [], ["flow"])
    model = bench.fit((flow,))
    single = bench.subset([0])
    problem = single.problem(model.candidates, model.values, [model.own[0]])
    alone = single.evaluate(problem, np.zeros(len(problem.quantities)), model.candidates)
    (path, *_) = flow.strength
    assert alone.slope(path) > 2.0 * model.slope(path)
    common = [q.trial is None for q in model.quantities]
    np.testing.assert_allclose(
        alone.by_coordinates_of(model, 0), model.jacobian_of(0)[:, common], rtol=1e-4, atol=1e-6
    )


def test_a_placebo_is_as_strong_in_trials_of_another_length():
    """Whatever changes of its coefficients the columns are for there."""
    bench = Workbench.of(shaken.CASE, [shaken.record(k) for k in range(2)], Serial(), shaken.SIGMA)
    held = bench.with_trials([shaken.record(2).cut(0.0, 0.7)], bench.noise[:1])
    base, some = bench.fit(), simple(library_of(bench))
    seen = held.fit(values=base.values, common=False)
    opened = SimpleNamespace(fitted=seen)
    common = common_columns(held, base, opened)
    forces, there = (force_columns(b, m, some) for b, m in ((bench, base), (held, seen)))
    (name,) = [n for n in forces.names if n.endswith("0.linear")]
    assert there.scales[name] < 0.7 * forces.scales[name]
    drawn = placebo(base, forces, 3, 2)
    gains = held_gains(base, forces, drawn, seen, common, there)
    again = replace(there, columns=there.columns * 0.5, scales={n: 0.5 * s for n, s in there.scales.items()})
    np.testing.assert_allclose(held_gains(base, forces, drawn, seen, common, again), gains, rtol=1e-9)
