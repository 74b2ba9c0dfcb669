"""Rigid bodies that touch walls, rods and each other, and that move in a fluid: derivatives, momentum, no penetration."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.testing.states import Probe

G = 9.81
SOFT = rn.Material(E=1e7, rho=1000.0)
WIDE = {"reach": 0.1, "stiffness": 10.0, "rod_radius": 1e-5, "friction": 0.4, "slip": 0.05}


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def gripper(tilt=0.0):
    """A cross of stiff parts as one body with a soft rod on it, and a free rod beside it."""
    figure = rn.StickFigure()
    figure.rod("arm", [(0.02, 0, 0), (0.05, 0.01, 0), (0.08, 0, 0.01)], material=SOFT, radius=2e-3)
    figure.rod("bar", [(0.0, -0.03, 0.02), (0.02, 0.0, 0.03), (0.05, 0.03, 0.02 + tilt)], material=SOFT, radius=2e-3)
    figure.rigid("stem", [(-0.02, 0, 0), "arm.start"], radius=3e-3)
    figure.rigid("cross", [(0, -0.03, 0), (0, 0.03, 0.005)], radius=3e-3)
    figure.body(["stem", "cross"], name="hub", mass=0.01, com=(0.003, 0.001, 0), inertia=(2e-6, 3e-6, 4e-6))
    return figure.build()


@pytest.mark.parametrize(
    "term",
    [
        rn.RodContact(**WIDE),
        rn.PlaneContact((0, 0, -0.1), (0.3, 0.1, 1.0), **{**WIDE, "reach": 0.4, "stiffness": 0.1}),
        rn.TubeContact(((0, 0, -0.3), (1, 0.2, -0.3)), 0.6, **{**WIDE, "reach": 0.55, "stiffness": 0.1}),
        rn.TubeContact(((0, 0, -0.1), (1, 0.2, -0.1)), 0.02, inside=False, **{**WIDE, "stiffness": 0.1}),
    ],
)
def test_derivatives_of_contact_on_bodies(term):
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(6):
        probe = Probe(rn.Robot(gripper(), [term]), rng, turn=0.6, stretch=(0.7, 1.4), source_turn=0.5)
        if not np.any(probe.forces()[probe.model.bodies.own]):
            continue
        checked += 1
        for by, (error, where) in probe.jacobian_errors().items():
            assert error < 2e-6, f"{by}: {where}"
    assert checked >= 2
