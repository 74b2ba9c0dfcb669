"""Trials in segments: where a whole trial cannot be predicted, its parts can."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.inference.comparison import Comparison
from rodnet.inference.segments import first_frames, make_segments
from tests.inference.test_instruments_and_starts import loaded

JOINTS = {"elbow": "upper.end", "tip": "lower.end"}
NOISE = rn.NoiseModel(white=5e-4)
FREE = ["gravity.g", "mass_damping.rate"]


def pendulum(g=9.81, rate=0.2):
    """Two stiff rods, hinged to each other and to a wall, let go far above their rest: chaotic."""
    figure, material = rn.StickFigure(), rn.Material(E=2e8, nu=0.5, rho=1200.0)
    elbow = 0.2 * np.array([0.9, 0.0, 0.436])
    tip = elbow + 0.15 * np.array([0.3, 0.0, 0.954])
    figure.rod("upper", [(0, 0, 0), tuple(elbow)], edges=2, material=material, radius=4e-3)
    figure.rod("lower", ["upper.end", tuple(tip)], edges=2, material=material, radius=4e-3)
    figure.joint("upper.end", kind="hinge", axis=(0, 1, 0))
    wall = rn.Hinge(at="upper.start", axis=(0, 1, 0))
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    return rn.Robot(figure.build(), [*elastic, rn.Gravity(g=g), wall, rn.MassDamping(rate=rate)])


def filmed(robot, points, noise, duration, **options):
    traj = rn.Simulation(robot, **options).run(duration)
    (seen,) = rn.observe(rn.Markers(robot, points), traj, traj.t)
    error = noise.sample(traj.t, len(points), np.random.default_rng(0))
    return rn.Recording(traj.t, seen + error, names=list(points), noise=noise)


def joints(rec, robot):
    return rn.Markers(robot, JOINTS)


@pytest.fixture(scope="module")
def swing():
    return filmed(pendulum(), JOINTS, NOISE, 0.8, dt=0.01, stepper="sdirk2")


def test_a_chaotic_pendulum_is_found_in_segments(swing):
    found = rn.calibrate(
        pendulum(9.0, 0.5), [swing], segments=2, modes=4, observe=joints, free=FREE, workers=0,
        outliers=None, options={"dt": 0.01},
    )  # fmt: skip
    for path, truth in zip(FREE, (9.81, 0.2), strict=True):
        one = found.parameters[path]
        sd = np.log(one.high / one.low) / 3.92
        assert abs(np.log(one.value / truth)) < 3.5 * sd < 0.5
    assert 0.8 < found.chi2 / found.samples < 1.2
    assert found.variance_factor == 1.0


def test_derivatives_of_segments_and_jumps_are_those_of_differences(swing):
    tight = rn.Tolerance(residual=1e-12, update=1e-14, iterations=60)
    case = rn.Case(
        lambda rec: pendulum(), joints, options=lambda rec, robot: {"dt": 0.01, "tolerance": tight}
    )
    trial = Comparison(case, swing.cut(0.0, 0.5), {"markers": NOISE}, 2)
    values = {"gravity.g": 9.7, "mass_damping.rate": 0.3}
    trial.segments = tuple(make_segments(trial, values, first_frames(trial.rec, 2), 3))
    names = list(trial.segments[0].paths())
    values |= {names[0]: 3e-3, names[4]: 0.05}
    scales = {"gravity.g": 1.0, "mass_damping.rate": 0.1, names[0]: 0.01, names[1]: 0.01, names[4]: 0.1}
    fit = trial.evaluate(values, scales)
    for k, path in enumerate(scales):
        h = 1e-4 * scales[path]
        up, down = (trial.evaluate({**values, path: values.get(path, 0.0) + s * h}) for s in (1, -1))
        for mine, a, b in (
            (fit.jacobian[:, k], up.residual, down.residual),
            (fit.jump_slopes[:, k], up.jumps, down.jumps),
        ):
            quotient = (a - b) / (2 * h)
            assert np.abs(mine - quotient).max() < 2e-5 * np.abs(quotient).max(), path


POINTS = {"nose": "head:0", "head": "head:1", "rim0": "tail0.start", "t0": "tail0.end", "t1": "tail1.end"}


def swimmer(mu):
    return rn.robots.flagellated(n_tails=2, rpm=100.0, edges=6, mu=mu)


def test_a_swimmer_that_was_pushed_aside():
    """Nothing brings its place back: a push makes the rest of a trial wrong, but not what its shape does."""
    noise = rn.NoiseModel(white=3e-4)
    rec = filmed(swimmer(6.8), POINTS, noise, 4.0, dt=0.05)
    x = rec.markers.copy()
    x[rec.t > 2.0] += [0.0, 4e-3, 2e-3]
    rec = rec.replace(markers=x)
    options = {
        "observe": lambda rec, robot: rn.Markers(robot, POINTS), "free": ["drag.viscosity"], "workers": 0,
        "options": {"dt": 0.05, "stepper": "euler"}, "outliers": None, "modes": 2,
    }  # fmt: skip
    found = rn.calibrate(swimmer(5.0), [rec], segments=2, continuity=False, **options)
    one = found.parameters["drag.viscosity"]
    assert abs(np.log(one.value / 6.8)) < 3.5 * one.sd < 0.1
    assert found.chi2 / found.samples < 1.2
    whole = rn.calibrate(swimmer(5.0), [rec], **options)
    assert whole.chi2 / whole.samples > 5.0


@pytest.mark.parametrize("segments", [0, -1.0, "2", True, 40])
def test_bad_segments_are_named(swing, segments):
    with pytest.raises(rn.ParameterError, match="segments"):
        rn.calibrate(
            pendulum(), [swing.cut(0.0, 0.2)], observe=joints, free=FREE, segments=segments, workers=0
        )


def test_what_crashed_goes_on_from_the_last_round(swing, tmp_path):
    """In its second round; what follows is the same as without, and nothing of the rounds before is searched again."""
    said: dict[str, list[str]] = {}

    def run(name, crash=False):
        told = said[name] = []

        def tell(text):
            told.append(text)
            if crash and sum(t.startswith("finding") for t in told) == 3:
                raise RuntimeError("power cut")

        return rn.calibrate(
            pendulum(9.0, 0.5), [swing.cut(0.0, 0.5)], segments=2, modes=4, observe=joints, free=FREE, workers=0,
            outliers=None, options={"dt": 0.01}, progress=tell, checkpoint=tmp_path / f"{name[0]}.json",
        )  # fmt: skip

    whole = run("whole")
    with pytest.raises(RuntimeError, match="power cut"):
        run("broken", crash=True)
    after = run("broken off")
    assert after.values == pytest.approx(whole.values, rel=1e-9)
    searched = {name: sum("residual" in text for text in told) for name, told in said.items()}
    assert searched["broken"] + searched["broken off"] <= searched["whole"] + 1
    again = run("whole once more")
    assert again.values == pytest.approx(whole.values, rel=1e-9) and again.chi2 == pytest.approx(whole.chi2)
    assert not any("residual" in text for text in said["whole once more"])


def test_rigid_bodies_are_refused_before_anything_is_simulated(swing):
    robot = loaded()
    told: list[str] = []
    with pytest.raises(rn.ParameterError, match=r"rigid body 'block': leave out segments="):
        rn.calibrate(
            robot, [swing], segments=2, free=["gravity.g"], workers=0, progress=told.append,
            observe=lambda rec, robot: rn.Markers(robot, ["cable:2", "block.end"]),
        )  # fmt: skip
    assert not told
