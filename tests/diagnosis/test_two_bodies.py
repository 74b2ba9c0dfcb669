"""Trials of robots with different numbers of rods in one diagnosis: what is looked at fits all of them."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.forces import library_of
from rodnet.diagnosis.locate import locate
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial


def build(rec):
    return rn.robots.flagellated(int(rec.attrs["n_tails"]), 120.0, edges=4, root="clamped", tangent="edge")


def observe(rec, robot):
    return rn.Markers(robot, {"head": "head:1"}, plane="x")


@pytest.fixture(scope="module")
def bench():
    t = np.arange(0.0, 0.5, 0.05)
    recs = []
    for k, (n, size) in enumerate([(3, 1e-3), (2, 3e-3), (3, 2e-3), (2, 1e-3)]):
        x = np.zeros((len(t), 1, 3))
        x[:, 0, 0] = 0.02 + size * np.sin(5.0 * t)  # nothing like the model
        recs.append(rn.Recording(t, x, names=["head"], attrs={"n_tails": n}, name=f"trial {k}"))
    case = rn.Case(
        build, observe, free=["drag.viscosity"], options=lambda rec, robot: {"dt": 0.05}, name="tails"
    )
    return Workbench.of(case, recs, Serial(), 1e-3)


def test_the_force_is_located_in_trials_of_one_body(bench):
    """Those of the trial that is fitted worst; the others tell of what is free."""
    found = locate(bench, bench.evaluate(bench.problem(), np.zeros(1)))
    assert [one.number for one in found.trials] == [1, 3]
    assert set(found.rods) == {"head", "disc0", "tail0", "disc1", "tail1"}


def test_parts_are_those_that_all_trials_have(bench):
    assert bench.simplest.name == "trial 1"
    assert not any("tail2" in on for piece in library_of(bench) for on in piece.on)
