"""Sweeps: what is refused, and how results that do not fit are told."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import rodnet as rn
from tests.sweep_robots import cantilever, here, rest, sag


# -- bad input --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grid": {}}, "the grid is empty"),
        ({"grid": None}, "takes a grid"),
        ({"samples": [{"load": 1.0}]}, "one of the two"),
        ({"grid": {"load": []}}, "no values of load"),
        ({"grid": {"load": [1.0, 1]}}, "load = 1 twice"),
        ({"grid": {"load": [np.nan]}}, "cannot label"),
        ({"grid": {"load": [np.ones(3), np.ones(3)]}}, "twice"),
        ({"grid": {"error": [1.0]}, "build": lambda error: None}, "cannot be called 'error'"),
        ({"grid": {"weight": [1.0]}}, "cantilever takes no 'weight'; it takes load, edges, E"),
        ({"grid": {"arm.e": [1.0]}}, "no parameter 'arm.e'; did you mean 'arm.E'"),
        ({"grid": {"load": 1.0}, "build": lambda load, size: None}, "needs size"),
        ({"grid": []}, "no samples"),
        ({"grid": [{"load": 1.0}, {"E": 1.0}]}, "sample 1 and sample 0 differ in their names: E, load"),
        ({"grid": None, "samples": {"load": [1.0, 2.0], "E": [1e6]}}, "not equally long: load 2, E 1"),
        ({"duration": None}, "needs duration"),
        ({"duration": -1.0}, "duration = -1.0"),
        ({"dt": 0.0}, "dt = 0.0"),
        ({"options": {"steper": "alpha"}}, "takes no 'steper'; did you mean 'stepper'"),
        ({"options": {"stepper": "rk4"}}, "known are"),
        ({"save_every": 0}, "save_every = 0"),
        ({"simulate": rest}, "simulate= runs the simulation itself"),
        ({"metrics": "sag"}, "needs metrics"),
        ({"workers": 1, "executor": ThreadPoolExecutor(1)}, "either executor or workers"),
        ({"workers": -1}, "workers = -1"),
        ({"executor": 3}, "must be a concurrent.futures.Executor"),
        ({"build": 3}, "build must be a function"),
    ],
)
def test_bad_input_is_refused_before_computing(changes, message, tmp_path):
    arguments = {"build": cantilever, "grid": {"load": [1.0]}, "metrics": sag, "duration": 1.0}
    with pytest.raises(rn.ParameterError, match=message):
        rn.sweep(**arguments | changes, out=tmp_path / "sweep.nc", stop=lambda s: pytest.fail("computed"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_an_executor_that_was_shut_down(kind):
    with kind(1) as executor:
        pass
    with pytest.raises(rn.ParameterError, match="has been shut down"):
        rn.sweep(cantilever, {"load": [1.0]}, sag, executor, duration=1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"build": lambda load: 3}, "must return a Robot or a Simulation, not int"),
        ({"simulate": lambda robot: 3}, "simulate must return a Trajectory"),
        (
            {"build": lambda load: rn.Simulation(cantilever(load)), "duration": 1.0, "dt": 0.1},
            "has its own dt",
        ),
        (
            {"build": lambda load: rn.Simulation(cantilever(load)), "grid": {"load": 1.0, "arm.E": 1e6}},
            "arm.E can be set on a Robot only",
        ),
    ],
)
def test_functions_that_return_something_else_end_the_sweep(changes, message, tmp_path):
    with pytest.raises(rn.ParameterError, match=message):
        here(**{"grid": {"load": [1.0, 2.0]}, "out": tmp_path / "sweep.nc", **changes})
    assert (tmp_path / "sweep.nc.jsonl").read_text().count("\n") == 1


@pytest.mark.parametrize(
    ("metrics", "message"),
    [
        (lambda traj: {"colour": "red"}, "the metric 'colour' is 'red'.*load = 1.0"),
        (lambda traj: None, "returns nothing"),
        (lambda traj: {}, "the metrics are empty"),
        (lambda traj: {"load": 1.0}, "'load' is the name of a swept parameter"),
        (lambda traj: {"error": 1.0}, "cannot be called 'error'"),
        (lambda traj: {"x": np.zeros((200, 200))}, "40000 numbers"),
    ],
)
def test_metrics_that_cannot_be_tabulated_are_named(metrics, message):
    with pytest.raises(rn.ParameterError, match=message):
        here({"load": [0.1, 1.0]}, metrics)


def test_metrics_that_do_not_go_with_the_others_are_failures_of_their_robots():
    """Names may be missing; a shape that differs, or no numbers at some points, are recorded as errors."""

    def measure(traj):
        low = -traj.x[-1, -1, 2] < 0.01
        return {"low": 1.0} if low else {"deep": [1.0, 2.0]}

    found = here({"load": [0.1, 1.0]}, measure)
    assert np.array_equal(found.low, [1.0, np.nan], equal_nan=True) and not found.error.any()
    assert found.deep.shape == (2, 2) and np.isfinite(found.deep.values[1]).all()
    ragged = here({"load": [0.1, 1.0]}, lambda traj: {"x": [1.0] * (1 if traj.x[-1, -1, 2] > -0.01 else 2)})
    assert (
        ragged.error.values.tolist()[1] == "" and "shape (1,), at other points (2,)" in ragged.error[0].item()
    )
    nothing = here({"load": [0.1, 1.0]}, lambda traj: None if traj.x[-1, -1, 2] > -0.01 else 1.0)
    assert (
        nothing.state.values.tolist() == ["failed", "done"] and "returns nothing" in nothing.error[0].item()
    )


def test_a_metric_that_raises_or_is_nan():
    found = here({"load": [0.1]}, lambda traj: {"sag": 1.0 / 0.0})
    assert found.error.item().startswith("ZeroDivisionError") and found.state.item() == "failed"
    found = here({"load": [0.1]}, lambda traj: {"sag": float("nan")})
    assert found.state.item() == "done" and np.isnan(found.sag.item())
