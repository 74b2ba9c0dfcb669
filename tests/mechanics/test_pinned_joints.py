"""Hinges that are held: beams between two pins, and a linkage on the ground."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import EI, MATERIAL, L, R, elastic, end, rest
from tests.mechanics.linkages import BARS, four_bar

ROD = {"material": MATERIAL, "radius": R}
Z, Y, X = np.eye(3)[::-1]


def test_a_beam_between_two_pins():
    """Simply supported in the plane of the pins, P L^3 / 48 EI; clamped across it, P L^3 / 192 EI."""
    P, errors = 1e-5 * EI / L**2, []
    for n in (16, 32):
        figure = rn.StickFigure().rod("beam", [(0, 0, 0), (L, 0, 0)], edges=n, **ROD)
        pins = [rn.Hinge(at=f"beam.{where}", axis=Y, name=where) for where in ("start", "end")]
        load = rn.PointForce(at=f"beam:{n // 2}", force=P * (Y + Z))
        _, y, z = end(rest(rn.Robot(figure.build(), [*elastic(), *pins, load])), f"beam:{n // 2}")
        errors.append((y / (P * L**3 / (192 * EI)) - 1.0, z / (P * L**3 / (48 * EI)) - 1.0))
    coarse, fine = np.array(errors)
    assert np.abs(fine).max() < 0.01
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.05)


def test_a_linkage_between_two_pins_on_the_ground():
    """A crank that a motor turns all round; no rod stands for the ground."""
    a, b = four_bar(0.5, *BARS)
    stiff = {"material": rn.Material(E=1e11), "radius": 3e-3, "edges": 2}
    figure = rn.StickFigure()
    figure.rod("crank", [(0, 0, 0), a], **stiff)
    figure.rod("coupler", ["crank.end", b], **stiff)
    figure.rod("rocker", ["coupler.end", (BARS[3], 0, 0)], **stiff)
    for node in ("crank.end", "coupler.end"):
        figure.joint(node, kind="hinge", axis=Z)
    pins = [
        rn.Hinge(at="crank.start", axis=Z, stiffness=1e3, name="driven"),
        rn.Hinge(at="rocker.end", axis=Z, name="free"),
    ]
    motor = rn.Motor(at="crank.start", angle=lambda t: t)
    traj = rn.Simulation(rn.Robot(figure.build(), [*elastic(), *pins, motor]), 0.05).run(7.0)
    for k in range(len(traj)):
        found = [traj.at(name)[k] for name in ("crank.end", "coupler.end")]
        assert found == pytest.approx(np.array(four_bar(0.5 + traj.t[k], *BARS)), abs=2e-6)
    assert traj.joint_angle("crank.start")[-1] == pytest.approx(7.0, abs=1e-5)
