"""The derivative of drag that neighbours change: the crowd at the nodes is a memory that follows the motion."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.tangent.differences import Differences
from tests.tangent import whole_runs as wr

SOFT = rn.Material(E=2e5, nu=0.5, rho=1000.0)


def pair():
    """Two soft bent rods side by side, clamped at one end, of which a load pulls one past the other."""
    figure = rn.StickFigure()
    for name, y in (("one", 0.0), ("other", 0.015)):
        figure.rod(name, [(0, y, 0), (0.06, y, 0), (0.09, y, -0.03)], edges=6, material=SOFT, radius=2e-3)
    terms = [
        rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="one.start"), rn.Clamp(at="other.start"),
        rn.CrowdedForce(viscosity=2.0, crowding=0.8, range=0.05, name="crowd"),
        rn.PointForce(at="one.end", force=(0.0, 0.02, 0.01)),
    ]  # fmt: skip
    return rn.Robot(figure.build(), terms)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_by_what_the_crowd_depends_on(stepper, monkeypatch):
    """As differences of whole runs, and without whole evaluations of the model for each column and step."""
    robot, duration = pair(), 0.3
    options = {"dt": 0.02, "stepper": stepper}
    whole = lambda *a, **k: pytest.fail("a whole evaluation")  # noqa: E731
    monkeypatch.setattr(Differences, "residual", whole)
    monkeypatch.setattr(Differences, "rates", whole)
    paths = ["crowd.crowding", "crowd.range", "crowd.viscosity", "one.E"]
    push = np.where(robot.graph.x0[:, :1] > 0.0, [[0.0, 0.1, 0.2]], 0.0) * robot.graph.x0[:, :1]
    found = rn.sensitivities(
        robot, duration, parameters=paths, initial={"push": {"v": push}}, tolerance=wr.ROUND_OFF, **options
    )
    assert np.abs(found.trajectory.x[-1] - robot.graph.x0).max() > 5e-3  # a third of the gap
    split = wr.parts(robot)
    for k, path in enumerate(paths):
        expected = wr.by_parameter(robot, [path], duration, **options)
        assert wr.error(wr.at_end(found)[:, k], expected, split) < 1e-5, path
    expected = wr.quotient(lambda s: wr.last(robot, duration, velocity=s * push, **options), 1e-2)
    assert wr.error(wr.at_end(found)[:, len(paths)], expected, split) < 1e-5


def test_a_change_of_drag_beside_neighbours_changes_what_is_without_them():
    """As that of a law without neighbours where these do nothing, and differentiable where they do."""
    robot, options = pair(), {"dt": 0.02, "stepper": "sdirk2"}
    thin = rn.PowerLawChange(exponent=0.7, speed=0.05, name="thin")
    changed = robot.with_terms(thin)
    none = changed.with_parameters({"crowd.crowding": 0.0})
    terms = [t.alone if isinstance(t, rn.CrowdedForce) else t for t in robot.terms]
    plain = rn.Robot(robot.graph, [*terms, thin])
    assert wr.last(none, 0.1, **options) == pytest.approx(wr.last(plain, 0.1, **options), abs=1e-12)
    paths = ["crowd.crowding", "crowd.viscosity", "thin.exponent"]
    found = rn.sensitivities(changed, 0.3, parameters=paths, tolerance=wr.ROUND_OFF, **options)
    for k, path in enumerate(paths):
        expected = wr.by_parameter(changed, [path], 0.3, **options)
        assert wr.error(wr.at_end(found)[:, k], expected, wr.parts(robot)) < 1e-5, path
