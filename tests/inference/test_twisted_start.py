"""Rods that begin with a twist that nodes say nothing of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.inference.comparison import Comparison
from rodnet.inference.modes import twist_mode
from tests.diagnosis import shaken

POINTS = ["rod@40%", "rod@70%", "rod.end"]


def bent(edges: int = 16, turn: float = 0.8) -> rn.Robot:
    """A quarter of a circle in a viscous fluid, held at its root; straight without ``turn``."""
    angle = turn * np.linspace(0.0, 1.0, edges + 1)
    ahead = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    nodes = np.vstack([np.zeros(3), np.cumsum(0.3 / edges * ahead[:-1], axis=0)])
    figure = rn.StickFigure()
    figure.rod("rod", list(nodes), material=rn.Material(E=1e6, rho=1100.0), radius=5e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.ResistiveForce(eta_t=1.0, eta_n=2.0)]
    return rn.Robot(figure.build(), [*terms, rn.Clamp(at="rod:0-1")])


def test_the_softest_twist() -> None:
    """Of a rod held at one end and free at the other a quarter of a sine; of a straight one nothing shows."""
    assert twist_mode(bent(turn=0.0)) is None
    for edges in (16, 32):
        robot = bent(edges)
        mode = twist_mode(robot)
        assert mode is not None
        held = 0.5 / edges  # where the edge is that the clamp holds
        s = ((np.arange(edges) + 0.5) / edges - held) / (1.0 - held)
        np.testing.assert_allclose(
            mode / mode[-1], np.sin(0.5 * np.pi * s) / np.sin(0.5 * np.pi * s[-1]), atol=0.12 / edges
        )
        assert np.mean(mode**2) == pytest.approx(1.0)


def case(robot: rn.Robot, **more: object) -> rn.Case:
    return replace(
        shaken.CASE, build=lambda rec: robot, observe=lambda rec, robot: rn.Markers(robot, POINTS), free=["rod.E"],
        options=lambda rec, robot: {"dt": 0.01, "stepper": "sdirk2"}, per_trial=["initial.position"], **more,
    )  # fmt: skip


def still(robot: rn.Robot, t: np.ndarray) -> rn.Recording:
    (seen,) = rn.observe(rn.Markers(robot, POINTS), rn.Simulation(robot, dt=0.01).run(float(t[-1])), t)
    return rn.Recording(t, seen, names=["a", "b", "c"])


@pytest.mark.parametrize("stepper", ["sdirk2", "alpha"])
def test_derivatives_by_the_initial_twist(stepper: str) -> None:
    robot, t = bent(), np.arange(0.0, 0.6, 0.02)
    own = replace(case(robot), options=lambda rec, robot: {"dt": 0.01, "stepper": stepper})
    trial = Comparison(own, still(robot, t), {"markers": rn.NoiseModel(white=1e-4)})
    at = {"initial.twist": 0.2, "initial.position[0]": 2e-3, "rod.E": 1.1e6}
    _, slopes = trial.predict(at, {"initial.twist": 0.5, "initial.position[0]": 3e-3})
    h = 1e-4
    for k, (path, step) in enumerate({"initial.twist": h, "initial.position[0]": 1e-2 * h}.items()):
        ends = [trial.predict({**at, path: at[path] + sign * step})[0][0] for sign in (1.0, -1.0)]
        quotient = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(slopes[0][..., k], quotient, atol=2e-5 * np.abs(quotient).max())
        assert np.abs(quotient[3:]).max() > 1e-4


def test_a_twist_that_was_there_at_first_is_found() -> None:
    """A bent rod that begins twisted by 0.8 rad, rms: its modulus is right, and so is the twist."""
    robot, t = bent(), np.arange(0.0, 1.0, 0.02)
    mode = twist_mode(robot)
    assert mode is not None
    begun = rn.Robot(robot.graph.twisted(0.8 * mode), robot.terms, robot.sensors)
    rec = still(robot, t)
    (seen,) = rn.observe(
        rn.Markers(begun, POINTS), rn.Simulation(begun, dt=0.01, stepper="sdirk2").run(1.0), t
    )
    assert np.abs(seen - rec.markers).max() > 1e-3  # though the nodes begin where they are drawn
    assert np.abs(seen[0] - rec.markers[0]).max() < 1e-12
    noisy = seen + 1e-4 * np.random.default_rng(0).standard_normal(seen.shape)
    found = rn.calibrate(
        case(robot),
        [rec.replace(markers=noisy)],
        start={"rod.E": 1.3e6, "initial.twist": 0.3},
        noise=1e-4,
        workers=0,
    )
    own = next(iter(found.per_trial.values()))
    assert own["initial.twist"].value == pytest.approx(0.8, rel=0.1)
    assert found.values["rod.E"] == pytest.approx(1e6, rel=0.05)
