"""Nets and grids, graphs full of loops: symmetry, balance, membrane theory, and nets that buckle all over."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix

PITCH, RADIUS = 0.02, 1e-3


def net(cells, edges=1, E=1e6, nu=0.4, pitch=PITCH, radius=RADIUS):
    """Square net of (cells + 1)^2 welded crossings, rods x0.. along x and y0.. along y."""
    material = rn.Material(E=E, nu=nu, rho=1200.0)
    figure, s = rn.StickFigure(), np.arange(cells * edges + 1) * pitch / edges
    for j in range(cells + 1):
        figure.rod(f"x{j}", [(x, j * pitch, 0.0) for x in s], material=material, radius=radius)
    for i in range(cells + 1):
        points = [(i * pitch, y, 0.0) for y in s]
        for j in range(cells + 1):
            points[j * edges] = f"x{j}:{i * edges}"
        figure.rod(f"y{i}", points, material=material, radius=radius)
    return figure.build()


def rim(cells):
    return [f"{axis}{k}" for axis in "xy" for k in (0, cells)]


def corners(cells):
    return [f"x{k}.{end}" for k in (0, cells) for end in ("start", "end")]


def hung(graph, at, **gravity):
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(**gravity), rn.Hinge(at=at)]
    return rn.Robot(graph, terms)


def crossings(traj, cells, edges=1):
    """Positions of the crossings in the last state, shape (cells + 1, cells + 1, 3), by column and row."""
    x, rods = traj.x[-1], traj.robot.graph.rods
    return np.stack([x[rods[f"y{i}"].nodes[::edges]] for i in range(cells + 1)])


@pytest.mark.parametrize("held", [rim, corners])
def test_reactions_carry_the_weight_and_the_sag_is_symmetric(held):
    cells = 10
    robot = hung(net(cells), held(cells))
    traj = rn.equilibrium(robot)
    weight = 9.81 * robot.graph.node_mass.sum()
    force = traj.reactions["hinge"].force[-1]
    assert force == pytest.approx([0.0, 0.0, weight], abs=1e-6 * weight)
    z = crossings(traj, cells)[:, :, 2]
    for turned in (z[::-1], z[:, ::-1], z.T):
        assert np.abs(z - turned).max() < 1e-6 * np.abs(z).max()
    assert z.min() < -0.01 and z.argmin() == z.size // 2


def test_tight_net_sags_like_a_membrane():
    """Center deflection of a square membrane of side L, load q and tension S per length: 0.07367 q L^2 / S."""
    stretch, side, radius = 1.02, 0.32, 2e-4
    sags = []
    for cells in (8, 16):
        slack = net(cells, pitch=side / cells, radius=radius)
        graph = slack.with_positions(stretch * slack.x0)
        tension = graph.EA[0] * (stretch - 1.0) / (stretch * side / cells)
        load = 2.0 * 9.81e-3 * 1200.0 * np.pi * radius**2 / (side / cells) / stretch**2
        traj = rn.equilibrium(hung(graph, rim(cells), g=9.81e-3))
        z = crossings(traj, cells)[cells // 2, cells // 2, 2]
        sags.append(-z / (load * (stretch * side) ** 2 / tension))
    errors = np.array(sags) / 0.07367 - 1.0
    assert abs(errors[1]) < 4e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=1.0)


def test_finer_rods_between_the_crossings_converge_to_second_order():
    """Welds without a hub are exact where rods bend as they twist, EI = GJ."""
    cells, depth = 6, []
    for edges in (1, 2, 4):
        traj = rn.equilibrium(hung(net(cells, edges, E=1e7, nu=0.0), corners(cells), g=0.01))
        depth.append(crossings(traj, cells, edges)[:, :, 2].min())
    first, second = np.diff(depth)
    assert first / second == pytest.approx(4.0, abs=0.05)


def test_floppy_net_settles_in_a_minimum():
    """Newton's method is drawn to a saddle here, where rods near the corners are about to buckle."""
    cells = 11
    robot = hung(net(cells, E=1e4), corners(cells))
    traj = rn.equilibrium(robot)
    K, _ = stiffness_matrix(robot, traj.state())
    K = K.toarray()
    scale = 1.0 / np.sqrt(K.diagonal())
    assert np.abs(K - K.T).max() < 1e-9 * np.abs(K).max()
    assert np.linalg.eigvalsh(scale[:, None] * K * scale).min() > 0.0
    weight = 9.81 * robot.graph.node_mass.sum()
    assert traj.reactions["hinge"].force[-1, 2] == pytest.approx(weight, rel=1e-6)
