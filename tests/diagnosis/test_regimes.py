"""Where, when and in which regime a model is off: synthetic forces, errors of the drive, thresholds."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.locate import locate, strongest
from rodnet.diagnosis.regimes import find_regime
from rodnet.diagnosis.screen import screen
from tests.diagnosis import shaken
from tests.diagnosis.test_locate import bench_of, pressed

TRIALS = 3
FAST, ONSET = 0.15, 0.66


class Extra(rn.DragModel):
    """Drag that acts above a speed, or from a time on."""

    default_name = "extra"
    c = rn.Parameter(1.0, unit="N s/m^2", null=0.0)

    def __init__(self, when, **options):
        super().__init__(**options)
        self.when = when

    def force(self, site, p):
        v = np.linalg.norm(site.v, axis=1, keepdims=True)
        return -p.c * self.when(v, site.t) * site.v


def above(v, t):
    return 0.02 * np.logaddexp(0.0, (v - FAST) / 0.02) / np.maximum(v, 1e-9)


def later(v, t):
    return 1.0 / (1.0 + np.exp(-(t - ONSET) / 0.02))


def dragged(k, when, c):
    robot = shaken.robot(shaken.drive(k)).with_terms(Extra(when, c=c))
    return seen_by(robot, k)


def driven(k, gain):
    """The drive is stronger than commanded."""
    drive = shaken.drive(k)
    return seen_by(shaken.robot({**drive, "amplitude": drive["amplitude"] * (1.0 + gain)}), k)


def seen_by(robot, k):
    traj = rn.Simulation(robot, dt=shaken.DT, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(robot, shaken.POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=["a", "b", "c", "d"], name=f"trial{k}", attrs=shaken.drive(k))


def looked_at(recordings, channels=()):
    bench = bench_of(recordings)
    return locate(bench, bench.fit(), channels=channels)


def test_a_patch_of_force_is_found_where_and_when_it_is():
    graph = shaken.robot(shaken.drive(0)).graph
    s = np.linspace(0.0, 1.0, graph.node_count)
    weights = np.zeros((graph.node_count, 3))
    weights[:, 1] = 0.6 * np.exp(-(((s - 0.7) / 0.1) ** 2)) * shaken.LENGTH / shaken.EDGES
    course = lambda t: np.exp(-(((t - 0.8) / 0.15) ** 2))  # noqa: E731
    found = looked_at([pressed(k, weights, course) for k in range(2)])
    for one, b, t in strongest(found):
        assert one.score[b, t] > 3.0
        assert abs(one.hats.places[b] - 0.7) < 1.0 / 11.0
        assert abs(one.hats.times[t] - 0.8) < one.hats.times[1]
        assert abs(one.mean[b, t, 1] - 0.6) < 3.0 * one.sd[b, t, 1] + 0.2  # a hat is wider than its top
        early = one.score[:, one.hats.times.index(one.hats.times[t]) - 2]
        assert early.max() < 3.0
        assert one.blind[0].all() and not one.blind[8, 1:4].any()  # the root is held


def test_an_error_of_the_drive_is_no_force_on_the_body():
    found = looked_at([driven(k, 0.06) for k in range(2)], ("drive", "camera"))
    assert found.shares["drive"] > 0.9
    assert found.evidence["drive"] > 20.0 > 3.0 > found.evidence["force"]
    assert max(one.score.max() for one in found.trials) < 3.0
    for one in found.trials:
        mean, sd = one.own["motion.gain"]
        assert abs(mean - 0.06) < 4.0 * sd + 0.01
    assert find_regime(found) is None


def test_what_was_scored_has_its_derivatives_at_hand_for_locating():
    bench = bench_of([driven(k, 0.06) for k in range(2)])
    fitted = bench.fit()
    rec = bench.recordings[0]
    robot = bench.case.robot(rec)
    every = candidates(robot, bench.case.observations(rec, robot))
    asked = [c for c in every if c.group in ("actuator", "observation")]
    elsewhere = bench.evaluate(bench.problem(), np.full(len(fitted.quantities), 0.3))
    anew = locate(bench, fitted)
    for found in (
        locate(bench, fitted, screen(bench, fitted, asked)),
        locate(bench, fitted, screen(bench, elsewhere, asked), anew=True),
    ):
        for kind in ("force", "drive", "camera"):
            assert found.evidence[kind] == pytest.approx(anew.evidence[kind], rel=1e-4, abs=1e-3)
        for one, other in zip(found.trials, anew.trials, strict=True):
            assert one.own.keys() == other.own.keys()
            for path, (mean, sd) in one.own.items():
                assert mean == pytest.approx(other.own[path][0], abs=1e-3 * sd)


def test_drag_above_a_speed_is_a_regime_of_speed():
    regime = find_regime(looked_at([dragged(k, above, 1.5) for k in range(TRIALS)]))
    assert regime.variable == "speed" and regime.above
    assert regime.threshold and abs(np.log(regime.threshold[0] / FAST)) < np.log(2.0)
    assert "where the body moves faster than" in regime.words and regime.nats > 3.0
    assert regime.share > regime.body


def test_drag_from_a_time_on_is_a_regime_of_time():
    regime = find_regime(looked_at([dragged(k, later, 0.5) for k in range(TRIALS)]))
    assert regime.variable == "time" and regime.above
    assert abs(regime.onset - ONSET) < 0.2
    assert "after" in regime.words


def test_noise_alone_has_no_place_and_no_regime():
    found = looked_at([dragged(k, later, 0.0) for k in range(2)])
    assert found.evidence["force"] < 3.0
    assert find_regime(found) is None
    assert max(one.score.max() for one in found.trials) < 4.0
