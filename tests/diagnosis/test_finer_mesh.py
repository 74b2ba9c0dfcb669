"""A robot on a finer mesh: the same places by name, the same robot in the limit."""

from itertools import pairwise

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model


def arm(edges: int, natural: str = "initial") -> rn.Robot:
    """A quarter circle held at its root, in its own weight."""
    s = np.linspace(0.0, 0.5 * np.pi, edges + 1)
    fig = rn.StickFigure()
    line = 0.3 * np.stack([np.sin(s), 0.0 * s, np.cos(s)], axis=1)
    fig.rod("arm", line, material=rn.Material(E=1e7, rho=1000.0), radius=4e-3, natural=natural)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="arm.start")]
    return rn.Robot(fig.build(), terms)


def tip(robot: rn.Robot) -> np.ndarray:
    return rn.equilibrium(robot).x[-1][robot.graph.node("arm.end")]


def test_names_stay_where_they_were():
    robot = arm(8)
    finer = robot.refined().refined()
    for name in ("arm.start", "arm:3", "arm:7", "arm.end"):
        np.testing.assert_array_equal(
            finer.graph.x0[finer.graph.node(name)], robot.graph.x0[robot.graph.node(name)]
        )
    assert len(finer.graph.edge_indices("arm:3-4")) == 4
    assert len(finer.graph.nodes("arm:2-4")) == 9
    assert finer.graph.node_name(finer.graph.node("arm:5")) == "arm:5"
    with pytest.raises(rn.GraphError, match="nodes 0 to 8"):
        finer.graph.node("arm:9")


def test_new_nodes_lie_on_the_curve():
    """A polygon's sagitta is one part in 8 of the square of the turning angle; the cubic's error is of fourth order."""
    errors = []
    for edges in (8, 16):
        graph = arm(edges).refined().graph
        errors.append(np.abs(np.linalg.norm(graph.x0, axis=1) - 0.3).max())
    assert errors[0] < 0.3 * (0.5 * np.pi / 8) ** 2 / 8 / 5
    assert errors[1] < errors[0] / 5


@pytest.mark.parametrize(("natural", "order"), [("initial", 2.0), ("straight", 1.0)])
def test_refinement_is_a_step_of_the_convergence_study(natural, order):
    """The tip of a refined robot is that of one that was drawn finer, and differences fall with the mesh.

    A wall holds the first edge's direction: of a rod that is straight by nature but drawn bent, that is the
    curve's own tangent to first order only.
    """
    coarse = arm(10, natural)
    tips = [tip(coarse), tip(coarse.refined()), tip(coarse.refined().refined())]
    drawn = tip(arm(20, natural))
    first, second = (np.linalg.norm(b - a) for a, b in pairwise(tips))
    assert np.linalg.norm(tips[1] - drawn) < 0.1 * first
    assert abs(np.log2(first / second) - order) < 0.35


def test_what_is_held_or_stiff_stays_whole():
    fig = rn.StickFigure()
    steel = rn.Material(E=1e7, rho=1000.0)
    fig.rod("cable", [(0, 0, 0), (0.5, 0, 0)], edges=10, material=steel, radius=3e-3)
    fig.rigid("end", ["cable.end", (0.55, 0, 0)], mass=0.01)
    robot = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="cable:0-1")])
    finer = robot.refined().graph
    assert len(finer.edge_indices("cable:0-1")) == 1
    assert len(finer.edge_indices("end")) == 1
    assert finer.edge_count == 2 * 9 + 2
    parents = robot.mesh_parents()
    np.testing.assert_allclose(robot.graph.x0[parents].mean(axis=1), finer.x0, atol=1e-12)


def test_a_refined_robot_with_another_material_is_held_at_the_same_places():
    """Rods are drawn anew for another material: selectors must go on naming the places that they did."""
    figure = rn.StickFigure()
    line = [(0.02 * k, 0.0, -0.01 * np.sin(0.4 * k)) for k in range(9)]
    figure.rod("cable", line, material=rn.Material(E=2e6, rho=1100.0), radius=4e-3, natural="straight")
    ends = [
        rn.PrescribedMotion(at=f"cable:{a}-{a + 1}", position=lambda t: np.zeros(3), orientation=lambda t: np.eye(3),
                            name=f"hand{a}") for a in (0, 7)
    ]  # fmt: skip
    finer = rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), *ends]).refined()
    other = finer.with_parameters({"cable.E": 3e6})
    for place in ("cable:3", "cable:7-8", "cable.end"):
        assert np.array_equal(other.graph.nodes(place), finer.graph.nodes(place))
    assert rn.Simulation(other, dt=1e-2).run(0.02).x.shape[1] == finer.graph.node_count


def test_forces_at_points_and_torques_on_edges_stay_what_they_are_on_a_finer_mesh():
    """Their sums, and so what holds the root."""
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.4, 0, 0)], edges=6, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3)
    push = rn.PointForce(at="rod:2-5", force=(0.0, 0.0, 1e-3))
    turn = rn.PointTorque(on=["rod:1-2", "rod:2-3", "rod:4-5"], torque=(0.0, 2e-4, 1e-4))
    for term, size in ((push, 4e-3), (turn, 3 * 1e-4)):
        robot = rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), term])
        for _ in range(3):
            model = Model(robot)
            ev, x = Evaluation(model), model.graph.x0
            ev.x[:] = x
            F = model.bound[-1].forces(ev)
            f = F[: 3 * len(x)].reshape(-1, 3)
            if term is push:
                assert np.allclose(f.sum(axis=0), [0.0, 0.0, size])
                assert np.allclose(np.cross(x, f).sum(axis=0), [0.0, -1e-3 * 0.4 / 6 * (2 + 3 + 4 + 5), 0.0])
            else:
                assert np.allclose(f.sum(axis=0), 0.0, atol=1e-12)
                assert np.allclose(np.cross(x, f).sum(axis=0), [0.0, 2.0 * size, size])
            robot = robot.refined()
