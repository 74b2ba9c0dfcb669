"""The derivative of drag that neighbours change: the crowd at the nodes is a memory that follows the motion."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.bank.neighbours import crowd
from rodnet.diagnosis.candidate import with_term
from rodnet.tangent.columns import by_added, by_parameter, by_replaced
from rodnet.tangent.differences import Differences
from rodnet.tangent.follow import Tangent
from rodnet.tangent.parts import Part, Unfit
from tests.tangent import whole_runs as wr

SOFT = rn.Material(E=2e5, nu=0.5, rho=1000.0)


def pair(softness=1.0):
    """Two soft bent rods side by side, clamped at one end, of which a load pulls one past the other."""
    figure = rn.StickFigure()
    for name, y in (("one", 0.0), ("other", 0.015)):
        figure.rod(name, [(0, y, 0), (0.06, y, 0), (0.09, y, -0.03)], edges=6, material=SOFT, radius=2e-3)
    terms = [
        rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="one.start"), rn.Clamp(at="other.start"),
        rn.CrowdedForce(viscosity=2.0, crowding=0.8, range=0.05, softness=softness, name="crowd"),
        rn.PointForce(at="one.end", force=(0.0, 0.02, 0.01)),
    ]  # fmt: skip
    return rn.Robot(figure.build(), terms)


@pytest.mark.parametrize("softness", [0.9, 0.4])
@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_by_what_the_crowd_depends_on(stepper, softness, monkeypatch):
    """As differences of whole runs, and without whole evaluations of the model for each column and step."""
    robot, duration = pair(softness), 0.3
    options = {"dt": 0.02, "stepper": stepper}
    whole = lambda *a, **k: pytest.fail("a whole evaluation")  # noqa: E731
    monkeypatch.setattr(Differences, "residual", whole)
    monkeypatch.setattr(Differences, "rates", whole)
    paths = ["crowd.crowding", "crowd.range", "crowd.softness", "crowd.viscosity", "one.E"]
    push = np.where(robot.graph.x0[:, :1] > 0.0, [[0.0, 0.1, 0.2]], 0.0) * robot.graph.x0[:, :1]
    found = rn.sensitivities(
        robot, duration, parameters=paths, initial={"push": {"v": push}}, tolerance=wr.ROUND_OFF, **options
    )
    assert np.abs(found.trajectory.x[-1] - robot.graph.x0).max() > 5e-3  # a third of the gap
    split = wr.parts(robot)
    for k, path in enumerate(paths):
        # third derivatives of the step jump: short differences
        expected = wr.by_parameter(robot, [path], duration, relative=3e-4, **options)
        assert wr.error(wr.at_end(found)[:, k], expected, split) < 1e-5, path
    expected = wr.quotient(lambda s: wr.last(robot, duration, velocity=s * push, **options), 1e-2)
    assert wr.error(wr.at_end(found)[:, len(paths)], expected, split) < 1e-5


def test_the_crowd_multiplies_a_change_of_drag():
    """Twice the drag at all places and times is twice the viscosity, neighbours or not."""
    robot, options = pair(), {"dt": 0.02, "stepper": "sdirk2"}
    twice = rn.SwitchedDrag(gain=1.0, onset=-100.0, name="twice")
    viscosity = 2.0 * robot.parameters["crowd.viscosity"].value
    expected = wr.last(robot.with_parameters({"crowd.viscosity": viscosity}), 0.3, **options)
    assert wr.last(robot.with_terms(twice), 0.3, **options) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("softness", [1.0, 0.6])
@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_by_changes_of_drag_beside_neighbours(stepper, softness, monkeypatch):
    """As differences of whole runs, whether a change is there or not, and without whole evaluations."""
    options, duration = {"dt": 0.02, "stepper": stepper}, 0.3
    changes = [
        rn.PowerLawChange(exponent=0.7, speed=0.05, name="thin"), rn.DragRegion(name="region", width=0.2),
        rn.DragAnisotropy(along=0.4, name="along"), rn.BackgroundFlow(name="still"),
        rn.BackgroundFlow(u_y=0.05, name="flow"),
    ]  # fmt: skip
    robot = pair(softness).with_terms(*changes)
    whole = lambda *a, **k: pytest.fail("a whole evaluation")  # noqa: E731
    monkeypatch.setattr(Differences, "residual", whole)
    monkeypatch.setattr(Differences, "rates", whole)
    paths = [
        "crowd.crowding", "crowd.range", "crowd.viscosity", "thin.exponent", "region.gain", "along.along",
        "still.u_x", "flow.u_y", *(["crowd.softness"] if softness < 1.0 else []),
    ]  # fmt: skip
    found = rn.sensitivities(robot, duration, parameters=paths, tolerance=wr.ROUND_OFF, **options)
    for k, path in enumerate(paths):
        expected = wr.by_parameter(robot, [path], duration, relative=3e-4, **options)
        assert wr.error(wr.at_end(found)[:, k], expected, wr.parts(robot)) < 1e-5, path


LACKED = [
    (rn.DragAnisotropy, "along"), (rn.DragRegion, "gain"), (rn.PowerLawChange, "exponent"),
    (rn.BackgroundFlow, "u_y"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "strength"), LACKED)
def test_by_a_change_of_drag_that_a_robot_lacks(kind, strength):
    """What a change beside neighbours would do, found along a run without it."""
    options, duration, robot = {"dt": 0.02, "stepper": "sdirk2"}, 0.3, pair()
    null = kind.declared()[strength].null
    changed = lambda value: robot.with_terms(kind(name="it", **{strength: value}))  # noqa: E731
    sim = rn.Simulation(robot, tolerance=wr.ROUND_OFF, **options)
    with Tangent(sim, [by_added(robot, changed(null), f"it.{strength}", None)]) as tangent:
        sim.run(duration)
        end = tangent.current
    found = np.concatenate([end.q[: 3 * robot.graph.node_count, 0], end.v[: 3 * robot.graph.node_count, 0]])
    expected = wr.quotient(lambda v: wr.last(changed(null + v), duration, **options), 1e-3)
    split = wr.parts(robot)[:2]
    assert wr.error(found, expected[: sum(split)], split) < 1e-5


REGION = rn.DragRegion(gain=1.0, place=0.6, width=0.2, name="region")


def without_neighbours(*more):
    """The pair in a medium that does not depend on neighbours, and with terms that change it."""
    robot = pair()
    law = next(k for k, term in enumerate(robot.terms) if term.name == "crowd")
    return with_term(robot, law, rn.ResistiveForce(viscosity=2.0, name="crowd")).with_terms(*more)


@pytest.mark.parametrize("more", [(), (REGION,)])
def test_a_run_without_neighbours_does_not_tell_what_they_do(more):
    """They move on while it remembers nothing of them."""
    robot, options = without_neighbours(*more), {"dt": 0.02, "stepper": "sdirk2"}
    sim = rn.Simulation(robot, **options)
    column = by_parameter(crowd(robot, "crowd", 0.05), "crowd.crowding", 0.1, options)
    with pytest.raises(Unfit):
        Part(sim.model, sim.newton.ev, column)


def test_what_neighbours_would_do_is_found_along_a_run_without():
    """By two laws beside the robot's own that remember them."""
    robot, options, duration = without_neighbours(), {"dt": 0.02, "stepper": "sdirk2"}, 0.3
    edited = crowd(robot, "crowd", 0.05)
    column = by_replaced(robot, edited, "crowd.crowding", 0.1)
    sim = rn.Simulation(robot, tolerance=wr.ROUND_OFF, **options)
    with Tangent(sim, [column]) as tangent:
        sim.run(duration)
        end = tangent.current
    found = np.concatenate([end.q[: 3 * robot.graph.node_count, 0], end.v[: 3 * robot.graph.node_count, 0]])
    changed = lambda value: edited.with_parameters({"crowd.crowding": value})  # noqa: E731
    expected = wr.quotient(lambda v: wr.last(changed(v), duration, **options), 1e-3)
    split = wr.parts(robot)[:2]
    assert wr.error(found, expected[: sum(split)], split) < 1e-5
    assert by_replaced(robot, robot.with_terms(REGION), "region.gain", 1.0) is None
