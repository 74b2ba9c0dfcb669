"""Walls that give: what rests on them, beams on an elastic foundation, and that nothing is lost in them."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import order

E, R, RHO, LENGTH, G = 2e6, 2e-3, 1000.0, 0.6, 9.81
EI, WEIGHT = E * np.pi * R**4 / 4, RHO * np.pi * R**2 * G
K, LAYER = 400.0, 1e-5  # springs [N/m^2]
ELASTIC = (rn.Stretching, rn.Bending, rn.Twisting)


def rod(*terms, edges=60, direction=(1.0, 0.0, 0.0)):
    figure = rn.StickFigure()
    ends = [np.zeros(3), LENGTH * np.asarray(direction)]
    figure.rod("rod", ends, edges=edges, material=rn.Material(E=E, rho=RHO), radius=R)
    return rn.Robot(figure.build(), [*(term() for term in ELASTIC), rn.Gravity(g=G), *terms])


def test_a_rod_sinks_in_until_the_springs_bear_it():
    traj = rn.equilibrium(rod(rn.ElasticWall(stiffness=K, layer=LAYER)))
    assert traj.x[-1, :, 2] == pytest.approx(np.full(61, -(WEIGHT / K + 0.5 * LAYER)), rel=1e-6)


def test_a_beam_on_a_foundation_is_bent_as_winkler_and_hetenyi_say():
    """A force on a long beam: w = F b / (2 k) e^(-b s) (cos b s + sin b s), b^4 = k / (4 EI)."""
    b, force = (K / (4.0 * EI)) ** 0.25, 2e-3
    assert b * LENGTH > 10.0  # its ends do not notice
    bed, sizes, errors = rn.ElasticWall(stiffness=K, layer=LAYER), (80, 160, 320), []
    for edges in sizes:
        rests = rn.equilibrium(rod(bed, edges=edges)).x[-1]
        load = rn.PointForce(at="rod@50%", force=(0, 0, -force))
        pressed = rn.equilibrium(rod(bed, load, edges=edges)).x[-1]
        s = np.abs(rests[:, 0] - rests[edges // 2, 0])
        expected = force * b / (2.0 * K) * np.exp(-b * s) * (np.cos(b * s) + np.sin(b * s))
        errors.append(np.abs(rests[:, 2] - pressed[:, 2] - expected).max() / expected.max())
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 2e-3


def test_a_rod_that_falls_on_it_bounces_back_as_high():
    """No friction, no loss: the springs give back what they take, all but what the steps lose."""
    bed = rn.ElasticWall(stiffness=K, position=-0.02, layer=1e-3)
    traj = rn.Simulation(rod(bed, edges=4), 2e-4, stepper="sdirk2").run(0.2)
    height = traj.x[:, :, 2].mean(axis=1)
    low = int(np.argmin(height))
    assert height[low] < -0.02 and traj.x[:, :, 0] == pytest.approx(
        np.broadcast_to(traj.x[0, :, 0], (len(height), 5))
    )
    assert height[low:].max() == pytest.approx(0.0, abs=2e-4)


def test_its_normal_must_be_a_direction():
    with pytest.raises(rn.TermError, match="ElasticWall: normal must not be zero"):
        rn.ElasticWall(normal=(0, 0, 0))
    with pytest.raises(rn.TermError, match="flow= is for media"):
        rn.ElasticWall(flow=(0.1, 0, 0))
    tilted = rn.ElasticWall(normal=(0, 3, 4), stiffness=K, layer=LAYER)
    assert tilted.normal == pytest.approx([0.0, 0.6, 0.8])
