"""Reactions balance loads; internal forces and moments are in equilibrium at every node and edge."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import EI, MATERIAL, WEIGHT, L, R, beam, elastic, rest

G = 9.81


def hook():
    """A space curve of several rods and a branch under weight, a force and a torque, clamped and hinged."""
    figure = rn.StickFigure()
    options = {"material": MATERIAL, "radius": R}
    figure.rod("arm", [(0, 0, 0), (0.1, 0, 0), (0.15, 0.08, 0.02)], edges=12, **options)
    figure.rod("leg", ["arm.end", (0.15, 0.1, -0.1)], edges=7, **options)
    figure.rod("twig", ["arm:5", (0.1, -0.07, 0.03)], edges=6, **options)
    return rn.Robot(
        figure.build(),
        [
            *elastic(),
            rn.Gravity(g=G),
            rn.PointForce(at="twig.end", force=(0.01, 0.02, -0.05)),
            rn.PointTorque(on="arm:8-9", torque=(1e-3, 2e-3, 0)),
            rn.Clamp(at="arm.start"),
            rn.Hinge(at="leg.end"),
        ],
    )


@pytest.fixture(scope="module")
def traj():
    return rest(hook())


def external(traj):
    """Forces on the nodes of loads and constraints, shape (N, 3)."""
    graph = traj.robot.graph
    f = -G * graph.node_mass[:, None] * np.array([0, 0, 1.0])
    f[graph.node("twig.end")] += (0.01, 0.02, -0.05)
    f += traj.term_forces("torque")[-1]
    return f


def test_reactions_balance_the_loads(traj):
    f, x = external(traj), traj.x[-1]
    clamp, hinge = traj.reactions["clamp"], traj.reactions["hinge"]
    scale = np.abs(f).sum()
    assert f.sum(axis=0) + clamp.force[-1] + hinge.force[-1] == pytest.approx(np.zeros(3), abs=1e-7 * scale)
    moments = [clamp.moment[-1] + np.cross(clamp.point[-1], clamp.force[-1])]
    moments.append(hinge.moment[-1] + np.cross(hinge.point[-1], hinge.force[-1]))
    total = np.sum(moments, axis=0) + np.cross(x, f).sum(axis=0)
    # the part of the torque along its edge acts on the twist and not through nodal forces
    i, j = traj.edges[traj.robot.graph.edge_indices("arm:8-9")[0]]
    tangent = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
    total += tangent * (tangent @ (1e-3, 2e-3, 0))
    assert total == pytest.approx(np.zeros(3), abs=1e-7 * scale * L)
    assert hinge.moment[-1] == pytest.approx(np.zeros(3), abs=1e-12)


def test_forces_at_every_node(traj):
    """What flows in through one edge flows out through the others, less the load."""
    tangents = np.diff(traj.x[-1][traj.edges], axis=1)[:, 0]
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    internal = traj.internal
    flow = internal.tension[-1][:, None] * tangents + internal.shear[-1]
    assert np.abs(np.sum(internal.shear[-1] * tangents, axis=1)).max() < 1e-12
    total = external(traj)
    np.add.at(total, traj.edges[:, 0], flow)
    np.subtract.at(total, traj.edges[:, 1], flow)
    held = [traj.robot.graph.node(n) for n in ("arm.start", "leg.end")]
    free = np.setdiff1d(np.arange(len(total)), held)
    assert np.abs(total[free]).max() < 1e-7 * np.abs(flow).max()
    assert total[held[1]] == pytest.approx(-traj.reactions["hinge"].force[-1], abs=1e-9)


def test_moments_at_every_edge(traj):
    """Moments of the springs at both ends of an edge, the couple of its force, and the torque on it."""
    graph, internal = traj.robot.graph, traj.internal
    vectors = np.diff(traj.x[-1][traj.edges], axis=1)[:, 0]
    tangents = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    flow = internal.tension[-1][:, None] * tangents + internal.shear[-1]
    total = np.cross(vectors, flow)
    e = graph.edge_count
    for (first, second), moment in zip(internal.spring_edges, internal.moment[-1], strict=True):
        if first < e:
            total[first] += moment
        if second < e:
            total[second] -= moment
    # without shear deformation edges take forces as couples; a torque on one is part of its balance
    loaded = graph.edge_indices("arm:8-9")[0]
    quiet = np.setdiff1d(np.arange(e), [loaded])
    scale = np.abs(internal.moment).max()
    assert np.abs(total[quiet]).max() < 1e-7 * scale
    twist = tangents[loaded] @ total[loaded]
    assert twist == pytest.approx(-tangents[loaded] @ (1e-3, 2e-3, 0), abs=1e-7 * scale)


def test_moment_and_shear_along_a_cantilever():
    n = 20
    g = 1e-3 * 8.0 * EI / (WEIGHT * L**3)
    w = WEIGHT * g
    robot = beam(n, rn.Gravity(g=g), rn.Clamp(at="beam.start"))
    traj = rest(robot)
    along = traj.internal.along("beam")
    s = np.arange(n) * L / n
    assert along.s_node == pytest.approx(s)
    assert along.moment[-1, :, 1] == pytest.approx(0.5 * w * (L - s) ** 2, rel=1e-4)
    assert along.shear[-1, :, 2] == pytest.approx(-w * (L - along.s_edge), rel=1e-4)
    clamp = traj.reactions["clamp"]
    assert clamp.force[-1] == pytest.approx((0, 0, w * L), abs=1e-8 * w * L)
    assert clamp.moment[-1, 1] == pytest.approx(-0.5 * w * L**2, rel=1e-5)
    assert clamp.point[-1] == pytest.approx(np.zeros(3), abs=0)


def test_a_wall_at_a_node_of_several_rods_carries_them_all():
    figure = rn.StickFigure()
    figure.rod("left", [(0, 0, 0), (0.1, 0, 0)], edges=6, material=MATERIAL, radius=R)
    figure.rod("right", ["left.start", (-0.15, 0, 0)], edges=9, material=MATERIAL, radius=R)
    robot = rn.Robot(figure.build(), [*elastic(), rn.Gravity(g=G), rn.Clamp(at="left.start")])
    traj = rest(robot)
    clamp = traj.reactions["clamp"]
    assert clamp.force[-1, 2] == pytest.approx(WEIGHT * G * 0.25, rel=1e-7)
    sagged = traj.x[-1]
    moment = np.cross(sagged, -G * robot.graph.node_mass[:, None] * np.array([0, 0, 1.0])).sum(axis=0)
    assert clamp.moment[-1] == pytest.approx(-moment, abs=1e-7 * np.abs(moment).max())
    # each of the two is a cantilever of its own
    alone = rest(beam(6, rn.Gravity(g=G), rn.Clamp(at="beam.start"), points=[(0, 0, 0), (0.1, 0, 0)]))
    assert sagged[robot.graph.node("left.end")] == pytest.approx(alone.x[-1, -1], abs=1e-9)
