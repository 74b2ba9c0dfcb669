"""Profiles of what was found: what has come to nothing is bounded by what would have shown."""

from __future__ import annotations

import numpy as np

import rodnet as rn
from rodnet.diagnosis.begin import best_fit
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.confirm import doubts, profiles
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken
from tests.diagnosis.test_strong import CASE, turned

BEND = 0.05  # [s]


def record(k):
    """A trial of a rod, turned at its root, that loses energy as it bends and none as it twists."""
    attrs = {"angle": 1.2 + 0.3 * k, "frequency": 1.2 + 0.3 * k}
    true = turned(attrs).with_terms(rn.KelvinVoigt(bend=BEND))
    traj = rn.Simulation(true, dt=shaken.DT, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
    seen = seen + 0.1 * shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=list("abcd"), name=f"turned{k}", attrs=attrs)


def test_a_loss_of_twisting_that_is_none_is_less_than_would_have_shown():
    trials = [record(k) for k in range(3)]
    bench = Workbench.of(CASE, trials, Serial(), 0.1 * shaken.SIGMA)
    base = bench.fit()
    (score,) = screen(bench, base, candidates(CASE.robot(trials[0]), [], ["kelvin-voigt"]))
    model = best_fit(bench, base, score)
    path = "kelvin-voigt.torsion"
    found = profiles(bench, model, ["kelvin-voigt.bend", path])
    assert found["kelvin-voigt.bend"].low < BEND < found["kelvin-voigt.bend"].high
    none = found[path]
    assert none.open == (True, False) and none.low < 1e-3 < none.high < 0.5
    there = bench.fit(model.candidates, {**model.values, path: none.high}, model.own, held=[path])
    rise = (there.deviance - model.deviance) / doubts(bench, model)[model.place(path)]
    assert 1.0 < rise < 6.0  # 2.7 is asked for
