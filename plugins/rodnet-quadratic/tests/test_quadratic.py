"""The law, its derivatives and its compiled twin; and that rodnet finds it."""

import importlib.metadata

import numpy as np
import pytest

import rodnet as rn

try:
    importlib.metadata.distribution("rodnet-quadratic")
except importlib.metadata.PackageNotFoundError:
    pytest.skip(
        "rodnet-quadratic is not installed: pip install -e plugins/rodnet-quadratic", allow_module_level=True
    )

from rodnet_quadratic import Quadratic


class Interpreted(Quadratic):
    """The same law without its compiled twin."""

    kernel = None


def falling(law):
    """A rod that falls in the medium; its velocity at the end [m/s]."""
    figure = rn.StickFigure()
    material = rn.Material(E=1e7, rho=1200.0)
    figure.rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=8, material=material, radius=2e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), law]
    traj = rn.Simulation(rn.Robot(figure.build(), terms), dt=0.01).run(2.0)
    return traj.v[-1, :, 2]


def test_contract():
    rn.testing.check_term(Quadratic)
    rn.testing.check_in_robot(Quadratic)


def test_terminal_velocity():
    """At rest in its own fall, weight per length is c v^2."""
    c, weight = 2.0, 1200.0 * np.pi * 2e-3**2 * 9.81
    np.testing.assert_allclose(falling(Quadratic(c=c)), -np.sqrt(weight / c), rtol=1e-6)


def test_the_compiled_twin_is_the_law():
    np.testing.assert_allclose(falling(Quadratic(c=2.0)), falling(Interpreted(c=2.0)), rtol=1e-9)


def test_rodnet_finds_it():
    record = rn.registry.terms()["quadratic"]
    assert rn.term("quadratic") is Quadratic
    assert (record.kind, record.distribution) == ("drag", "rodnet-quadratic 0.1.0")
    assert "quadratic" in rn.registry.candidates()


def test_without_it_nothing_changes():
    """At its null value the law is the identity, bit for bit."""
    robot = rn.robots.flagellated(edges=6)
    plain = rn.Simulation(robot).run(0.1)
    null = rn.Simulation(robot.with_terms(Quadratic(on="tail*", c=0.0, name="form"))).run(0.1)
    assert np.array_equal(plain.x, null.x)
