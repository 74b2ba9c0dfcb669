"""Loss of stability: Euler's columns, Michell's ring, and where a buckled column goes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix
from tests.mechanics.beams import EA, EI, GJ, MATERIAL, L, R, beam, elastic, end, order, rest


def spectrum(robot, state):
    """Eigenvalues of the tangent stiffness in units that make its diagonal one, ascending."""
    K = stiffness_matrix(robot, state)[0].toarray()
    scale = 1.0 / np.sqrt(np.abs(np.diag(K)))
    return np.linalg.eigvalsh(scale[:, None] * K * scale)


def critical(build, theory, free_modes):
    """Load at which the smallest eigenvalue changes its sign, those of free rigid modes left out."""

    def smallest(load):
        values = spectrum(*build(load))
        return values[0] if values[0] < -1e-12 else values[free_modes]

    return brentq(smallest, 0.8 * theory, 1.1 * theory, xtol=1e-6 * theory)


def compressed(edges, supports, load):
    """A straight column shortened by its load: in equilibrium, stable or not."""
    strain = load / EA
    free_end = [rn.PointForce(at="beam.end", force=(-load, 0, 0))] if len(supports) == 1 else []
    robot = beam(edges, *supports, *free_end)
    sim = rn.Simulation(robot)
    q = sim.state.q.copy()
    q[0 : 3 * robot.graph.node_count : 3] *= 1.0 - strain
    return robot, replace(sim.state, q=q)


COLUMNS = {
    "clamped and free": ([rn.Clamp(at="beam.start")], np.pi**2 / 4.0, 0),
    "hinged at both ends": ([rn.Hinge(at="beam.start"), rn.Hinge(at="beam.end")], np.pi**2, 1),
    "clamped and hinged": ([rn.Clamp(at="beam.start"), rn.Hinge(at="beam.end")], 20.190729, 0),
    "clamped at both ends": ([rn.Clamp(at="beam.start"), rn.Clamp(at="beam.end")], 4.0 * np.pi**2, 0),
}


@pytest.mark.parametrize("case", COLUMNS)
def test_euler_load(case):
    supports, factor, free_modes = COLUMNS[case]
    theory, sizes, errors = factor * EI / L**2, (8, 16, 32), []
    for n in sizes:
        load = critical(
            lambda load, n=n: compressed(n, supports, load), theory * (1.0 - 0.01 * (n < 16)), free_modes
        )
        # a column that shortens by P / EA first buckles at P (1 - P / EA) = P_Euler
        errors.append(load * (1.0 - load / EA) / theory - 1.0)
    assert abs(errors[-1]) < 5e-3
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.02)


def test_a_column_buckles_into_the_elastica():
    """At 1.063 times Euler's load its end turns by 40 degrees (Timoshenko & Gere, table 2-4)."""
    load = 1.063 * np.pi**2 * EI / (4.0 * L**2)
    push = [0.0, 1e-3 * load]
    state = None
    for side in push[::-1]:  # a push aside, then without
        loads = rn.PointForce(at="beam.end", force=(-load, 0, side))
        traj = rest(beam(64, rn.Clamp(at="beam.start"), loads), start=state)
        state = traj.state()
    tip = end(traj, "beam.end") / L
    assert tip[0] == pytest.approx(0.881, abs=4e-3) and tip[2] == pytest.approx(0.422, abs=8e-3)
    last = np.diff(traj.x[-1], axis=0)[-1]
    assert np.degrees(np.arctan2(last[2], last[0])) == pytest.approx(40.0, abs=0.8)


@pytest.mark.parametrize("push", [1e-2, 1e-4, 1e-6, 0.0])
def test_unstable_equilibrium_is_left(push):
    """Beyond its load a column does not stay straight, however little pushes it, and goes where pushed."""
    load = 1.2 * np.pi**2 * EI / (4.0 * L**2)
    loads = rn.PointForce(at="beam.end", force=(-load, 0, push * load))
    robot = beam(16, rn.Clamp(at="beam.start"), loads)
    traj = rest(robot)
    tip = end(traj, "beam.end")
    assert np.hypot(tip[1], tip[2]) > 0.6 * L
    assert spectrum(robot, traj.state())[0] > 0.0 or push == 0.0  # without a push any azimuth is as good
    if push > 0.0:
        assert tip[2] > 0.6 * L and abs(tip[1]) < 1e-6


def twisted_ring(n, radius, turn):
    """A ring of a straight rod, cut, twisted by ``turn`` and joined: a motor is the cut."""
    angles = 2.0 * np.pi * np.arange(n) / n
    points = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    figure = rn.StickFigure()
    figure.rod("ring", list(points), closed=True, natural="straight", material=MATERIAL, radius=R)
    robot = rn.Robot(figure.build(), [*elastic(), rn.Motor(at="ring:0", angle=lambda t: turn)])
    sim = rn.Simulation(robot)
    model, q = sim.model, sim.state.q.copy()
    rotor = model.edge2[np.flatnonzero(model.spring_node == 0)[0]]
    # the twist is shared by all springs: the angle of the k-th edge after the cut
    place = (np.arange(n) - rotor) % n
    q[model.twist0 :] = turn * (1.0 - (place + 0.5) / n)
    return robot, replace(sim.state, q=q, tau=np.full(n, -turn / n))


def test_michell_ring():
    """A twisted ring writhes at 2 pi sqrt(3) EI / GJ (Michell 1889)."""
    theory = 2.0 * np.pi * np.sqrt(3.0) * EI / GJ
    sizes = (24, 48, 72)
    # free are six rigid motions, and the same turn of every section
    errors = [critical(lambda turn, n=n: twisted_ring(n, 0.1, turn), theory, 7) / theory - 1.0 for n in sizes]
    assert abs(errors[-1]) < 5e-3
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.1)


def test_a_twisted_ring_has_seven_zero_modes():
    robot, state = twisted_ring(24, 0.1, 8.0)
    values = np.sort(np.abs(spectrum(robot, state)))
    assert values[6] < 1e-12 < 1e-6 < values[7]
    # in balance, with its twist spread evenly
    assert rest(robot, start=state).internal.torque[-1] == pytest.approx(-GJ * 8.0 / (0.2 * np.pi), rel=1e-2)
