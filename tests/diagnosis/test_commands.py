"""A drive that is stronger than commanded is so in proportion to each trial's own command."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.columns import bank_columns
from rodnet.diagnosis.diagnose import bank_of
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

AMPLITUDES = 2.0, 5.0, 8.0


def build(rec: rn.Recording) -> rn.Robot:
    """A rod in a gripper with a wave in it, whose amplitude and phase differ between trials."""
    wave = rn.CurvatureWave(
        amplitude=rec.attrs["wave"], wavelength=0.3, frequency=1.3, phase=0.2 * rec.attrs["wave"], name="wave"
    )
    return shaken.build(rec).with_terms(wave)


def record(k: int, **change: float) -> rn.Recording:
    rec = shaken.record(k)
    rec = rec.replace(attrs={**rec.attrs, "wave": AMPLITUDES[k]})
    robot = build(rec).with_parameters(change) if change else build(rec)
    traj = rn.Simulation(robot, shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
    seen = rn.observe([rn.Markers(robot, shaken.POINTS)], traj, rec.t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(10 + k).standard_normal(seen.shape)
    return rec.replace(markers=seen)


@pytest.fixture(scope="module")
def bench() -> Workbench:
    recs = [record(k, **{"wave.gain": 0.15}) for k in range(3)]
    case = rn.Case(build, shaken.observe, free=shaken.free, options=shaken.options)
    return Workbench.of(case, recs, Serial(), shaken.SIGMA)


def test_a_gain_is_found_where_commands_differ(bench):
    base, recs = bench.fit(), bench.recordings
    bank = bank_of(
        bench.case, recs[0], ["drive-gain", "gravity", "kelvin-voigt", "natural-curvature"], recs[1:]
    )
    (gain,) = (c for c in bank if c.id == "drive-gain@wave")
    nulls = dict(zip(gain.paths, (0.0,), strict=True))
    problem = bench.problem((gain,), {**base.values, **nulls})
    begin = np.array([q.coordinate({**base.values, **nulls}[q.path]) for q in problem.quantities])
    same = bench.evaluate(problem, begin, (gain,))
    assert same.deviance == pytest.approx(base.deviance, rel=1e-9)  # nothing is changed at the null value
    best = screen(bench, base, bank)[0]
    assert best.candidate is gain or best.candidate.id == gain.id
    (found,) = refit(bench, base, [best], 1)
    assert found.fitted.values["wave.gain"] == pytest.approx(0.15, abs=0.02)
    assert found.fitted.deviance < 1.2 * found.fitted.samples
    assert bank_columns(bench, base, gain)


def test_a_lag_is_found_where_phases_differ(bench):
    """A drive that runs late does so by one time, whatever the frequencies and the phases of the trials are."""
    recs = [record(k, **{"wave.lag": 0.04}) for k in range(3)]
    late = Workbench.of(bench.case, recs, Serial(), shaken.SIGMA)
    base = late.fit()
    best = screen(late, base, bank_of(late.case, recs[0], ["drive-lag", "drive-gain", "gravity"], recs[1:]))[
        0
    ]
    assert best.candidate.id == "drive-lag@wave"
    (found,) = refit(late, base, [best], 1)
    assert found.fitted.values["wave.lag"] == pytest.approx(0.04, abs=0.004)
    assert found.fitted.deviance < 1.2 * found.fitted.samples


def hinged(rec: rn.Recording) -> rn.Robot:
    """Two rods at a hinge, whose stiffness was changed between trials."""
    fig, soft = rn.StickFigure(), rn.Material(E=2e6, rho=1200.0)
    fig.rod("one", [(0, 0, 0), (0.2, 0, 0)], edges=4, material=soft, radius=3e-3)
    fig.rod("two", ["one.end", (0.4, 0, 0)], edges=4, material=soft, radius=3e-3)
    fig.joint("one.end", kind="hinge", axis=(0, 1, 0), stiffness=1e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="one.start")]
    return rn.Robot(fig.build(), [*terms, rn.JointElasticity(scale=rec.attrs["scale"])])


def test_what_one_value_would_change_in_some_trials_is_not_tried():
    """A scale that is free has one value for all trials: where they differ, another stiffness is no candidate."""
    recs = [shaken.record(k) for k in range(2)]
    case = rn.Case(hinged, lambda rec, robot: rn.Markers(robot, {"m0": "one.end", "m1": "two.end"}))
    for scales, tried in (((1.0, 1.0), True), ((1.0, 2.0), False)):
        some = [rec.replace(attrs={"scale": s}) for rec, s in zip(recs, scales, strict=True)]
        ids = {c.id for c in bank_of(case, some[0], None, some[1:])}
        assert ("joint-compliance@joints" in ids) == tried
