"""The tangent of every term that is installed, plug-ins' included, in a branched robot with joints of every kind."""

import numpy as np
import pytest

import rodnet as rn
from rodnet import registry
from rodnet.testing.check_in_robot import branched
from rodnet.testing.check_term import place
from rodnet.testing.report import Report
from tests.tangent import whole_runs as wr

TERMS = registry.terms()
STEPS, DT = 4, 1e-3
TOLERANCE = rn.Tolerance(residual=1e-12, update=1e-13, iterations=60)
# where examples make motion stop at once, or depend on a parameter by less than differences of runs can tell
ARGUMENTS = {
    "rod-contact": dict(reach=0.03, stiffness=1.0, rod_radius=1e-3, friction=0.4, slip=0.05, damping=0.2),
    "plane-contact": dict(
        point=(0, 0, -0.01), normal=(0, 0, 1), reach=0.03, stiffness=5.0, rod_radius=1e-3, friction=0.4, slip=0.05,
        damping=0.2,
    ),
    "granular-force": dict(CF=200.0, CS=400.0, gamma=4.0, surface=0.02, speed=0.05),
    "bingham-force": dict(viscosity=5.0, yield_stress=20.0, speed=0.05),
    "gravity": dict(fluid_density=300.0),
    "grain-yield": dict(speed=0.05),
    "jamming": dict(crowding=0.2, arch=10.0, speed=0.05),
}  # fmt: skip


def robot_with(name):
    """A robot whose fourth term is the named one."""
    cls, graph = TERMS[name].object, branched()
    term = cls(**ARGUMENTS[name]) if name in ARGUMENTS else cls
    company = [rn.Stretching(name="axial"), rn.Bending(name="bend"), rn.Twisting(name="twist")]
    return rn.Robot(graph, [*company, place(term, graph, Report(name))])


@pytest.mark.parametrize("name", sorted(TERMS))
def test_it_agrees_with_differences_of_whole_runs(name):
    """By each of its parameters, and by the material of rods that it may act on."""
    robot = robot_with(name)
    term = robot.terms[3]
    velocity = 0.1 * np.random.default_rng(0).normal(size=robot.graph.x0.shape)
    options = dict(dt=DT, stepper="sdirk2", velocity=velocity, tolerance=TOLERANCE)
    paths = [f"{term.name}.{key}" for key, p in term.parameter_items()] + ["rod.E", "arm.rho"]
    found = rn.sensitivities(robot, STEPS * DT, parameters=paths, save_every=STEPS, **options)
    end, parts = wr.at_end(found), wr.parts(robot)
    run = lambda changed: wr.last(changed, STEPS * DT, **options)  # noqa: E731
    here = run(robot)
    for c, path in enumerate(paths):
        expected, allowed = wr.by_one(robot, path, run, here, parts)
        assert np.all(np.abs(end[:, c] - expected) <= allowed), path
