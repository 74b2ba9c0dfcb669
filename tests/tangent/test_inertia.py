"""Forces that depend on accelerations: the tangent follows them without whole evaluations."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.tangent.columns import make_columns
from rodnet.tangent.fast import Fast
from tests.tangent.whole_runs import at_end, by_parameter, error, parts


def shaken(*terms):
    """A rod in a fluid, shaken at its root and let go with a swing."""
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.3, 0, 0)], edges=8, material=rn.Material(E=1e6, rho=1100.0), radius=4e-3)
    grip = rn.ImperfectMotion(
        at="rod.start", name="grip", position=lambda t: np.array([0.0, 0.02 * np.sin(9.0 * t) ** 2, 0.0]),
        orientation=lambda t: np.eye(3), gain=0.1,
    )  # fmt: skip
    elastic = rn.Stretching(), rn.Bending(), rn.Twisting()
    return rn.Robot(
        fig.build(), [*elastic, rn.ResistiveForce(eta_t=0.1, eta_n=0.2, name="drag"), grip, *terms]
    )


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
@pytest.mark.parametrize("path", ["fluid.density", "rod.E", "drag.eta_n", "grip.gain", "rod.length"])
def test_derivatives_beside_added_mass_are_those_of_whole_runs(path, stepper):
    robot = shaken(rn.AddedMass(density=900.0))
    options = {
        "dt": 0.01,
        "stepper": stepper,
        "velocity": robot.graph.x0[:, :1] ** 2 * np.array([0.0, 0.0, 5.0]),
    }
    found = rn.sensitivities(robot, 0.2, parameters=[path], **options)
    expected = by_parameter(robot, [path], 0.2, relative=1e-4, **options)
    assert error(at_end(found)[:, 0], expected, parts(robot)) < 1e-5


def test_nothing_of_it_takes_whole_evaluations():
    sim = rn.Simulation(shaken(rn.AddedMass(density=900.0)), 0.01)
    assert sim.model.adding and any(b.inertial for b in sim.model.adding)
    columns = make_columns(sim.robot, ["rod.E", "fluid.density", "grip.gain"], None, {"dt": 0.01})
    assert all(part is not None for part in Fast(sim.model, sim.newton, columns).parts)
