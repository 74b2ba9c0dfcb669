"""Sizes and moduli that look like another unit are told, usual ones are not."""

from __future__ import annotations

import pytest

import rodnet as rn
from rodnet.plausible import doubts


@pytest.mark.parametrize(
    ("size", "radius", "material", "message"),
    [
        (100.0, 2.0, {}, "radius of 'arm' is 2 m; if lengths are in millimetres"),
        (0.1, 0.02, {}, "edges of 'arm' are 0.01 m long and its radius is 0.02 m"),
        (0.1, 1e-3, {"E": 1.2}, "Young's modulus of 'arm' is 1.2 Pa; if it is in MPa"),
        (0.1, 1e-3, {"rho": 1.1}, r"density of 'arm' is 1.1 kg/m\^3; if it is in g/cm\^3"),
    ],
)
def test_units_that_are_not_meant_are_told(size, radius, material, message):
    made = rn.Material(**{"E": 1e6, **material})
    fig = rn.StickFigure().rod("arm", [(0, 0, 0), (size, 0, 0)], edges=10, material=made, radius=radius)
    with pytest.warns(rn.PlausibilityWarning, match=message):
        rn.Simulation(rn.Robot(fig.build(), [rn.Stretching()]))


def test_usual_units_raise_no_doubts():
    for made in (rn.robots.flagellated(2), rn.robots.flagellated(5, root="clamped")):
        assert doubts(made.graph) == []
