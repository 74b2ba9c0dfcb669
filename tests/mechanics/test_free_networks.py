"""Free networks with joints in flight: what no internal force may change."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import elastic

ROD = {"material": rn.Material(E=1e6, rho=1000.0), "radius": 3e-3}


def ring():
    """A closed ring of four rods on hinges askew."""
    figure = rn.StickFigure()
    corners = 0.1 * np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)])
    start = corners[0]
    for k, end in enumerate([*corners[1:], "rod0.start"]):
        figure.rod(f"rod{k}", [start, end], edges=4, **ROD)
        start = f"rod{k}.end"
        figure.joint(start, kind="hinge", axis=(0.2, 0.0, 1.0), stiffness=1e-3 if k == 3 else None)
    return figure.build()


def grid():
    """Three rods across three, on ball joints."""
    figure = rn.StickFigure()
    for i in range(3):
        figure.rod(
            f"x{i}", [(0.0, 0.05 * i, 0.0), (0.05, 0.05 * i, 0.0), (0.1, 0.05 * i, 0.0)], edges=4, **ROD
        )
    for j in range(3):
        x = 0.05 * j
        line = [f"x0:{2 * j}", (x, 0.025, 0.0), f"x1:{2 * j}", (x, 0.075, 0.0), f"x2:{2 * j}"]
        figure.rod(f"y{j}", line, **ROD)
    for i in range(3):
        for j in range(3):
            figure.joint(f"x{i}:{2 * j}", kind="ball")
    return figure.build()


def branches():
    """A branch on a branch, both on elastic joints, and a hinge on a stiff part."""
    figure = rn.StickFigure()
    figure.rod("trunk", [(0, 0, 0), (0.2, 0, 0)], edges=8, **ROD)
    figure.rod("branch", ["trunk:4", (0.1, 0.1, 0)], edges=6, **ROD)
    figure.rod("twig", ["branch:3", (0.15, 0.05, 0.05)], edges=4, **ROD)
    figure.rigid("stiff", ["trunk.end", (0.25, 0, 0)], mass=2e-3)
    figure.rod("flap", ["stiff.end", (0.25, 0.1, 0.03)], edges=4, **ROD)
    figure.joint("trunk:4", kind="elastic", of="branch", stiffness=1e-3)
    figure.joint("branch:3", kind="elastic", of="twig", stiffness=(1e-3, 5e-4), axis=(1, 0, 1))
    figure.joint("stiff.end", kind="hinge", axis=(0, 0, 1))
    return figure.build()


def momenta(traj):
    """Momentum and angular momentum at all times, spins of edges included."""
    graph, x = traj.robot.graph, traj.x
    p = np.einsum("n,tni->ti", graph.node_mass, traj.v)
    orbital = np.einsum("n,tni->ti", graph.node_mass, np.cross(x, traj.v))
    along = x[:, graph.edges[:, 1]] - x[:, graph.edges[:, 0]]
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    return p, orbital + np.einsum("e,te,tei->ti", graph.edge_inertia, traj.w, along)


@pytest.mark.parametrize("network", [ring, grid, branches])
def test_a_free_network_keeps_momentum_and_energy(network):
    """Momentum to round-off, angular momentum almost; what energy the stepper damps vanishes with the time step."""
    graph = network()
    x = graph.x0 - graph.x0.mean(axis=0)
    velocity = np.cross([2.0, 3.0, 6.0], x) + 10.0 * x[:, :1] * x[:, 1:2] * [0, 0, 1] + [0.1, 0.2, 0.3]
    losses = []
    for dt in (2e-3, 1e-3):
        robot, tolerance = rn.Robot(graph, elastic()), rn.Tolerance(residual=1e-12)
        sim = rn.Simulation(robot, dt, stepper="sdirk2", velocity=velocity, tolerance=tolerance)
        traj = sim.run(0.1)
        assert sim.model.solver.fallbacks == 0
        p, whole = momenta(traj)
        assert p == pytest.approx(np.tile(p[0], (len(p), 1)), abs=1e-9 * np.abs(p).max())
        energy = sum(traj.energies.values())
        # that a spinning edge resists a turn of its axis is left out of rods' inertia
        assert np.abs(whole - whole[0]).max() < 2e-4 * np.abs(whole[0]).max()
        losses.append(1.0 - energy[-1] / energy[0])
    assert 0.0 < losses[1] < 0.5 * losses[0] < 1e-3
