"""Buoyancy, and forces that turn with the robot."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eig
from scipy.optimize import brentq

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix
from tests.mechanics.beams import EI, MATERIAL, RHO, WEIGHT, L, R, beam, elastic, rest

G = 9.81


# -- buoyancy ------------------------------------------------------------------------------------
def body(*terms):
    """A rod, a thicker elliptic branch, and a stiff head of its own mass."""
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.1, 0, 0.05)], edges=6, material=MATERIAL, radius=R)
    figure.rod("arm", ["rod:3", (0.05, 0.08, 0)], edges=4, material=MATERIAL, section=rn.elliptic(5e-3, 3e-3))
    figure.rigid("head", ["rod.start", (-0.03, 0, 0)], mass=RHO * np.pi * 4e-3**2 * 0.03, radius=4e-3)
    return rn.Robot(figure.build(), [*elastic(), *terms])


def test_a_robot_of_the_fluid_s_density_floats():
    robot = body(rn.Gravity(fluid_density=RHO))
    traj = rn.Simulation(robot, 0.02).run(1.0)
    assert np.abs(traj.x - robot.graph.x0).max() < 1e-9
    assert np.abs(traj.term_forces("gravity", -1)).max() < 1e-12 * G * robot.graph.node_mass.sum()


@pytest.mark.parametrize("ratio", [0.25, 2.0])
def test_lighter_than_the_fluid_it_rises_and_heavier_it_sinks(ratio):
    robot = body(rn.Gravity(g=G, fluid_density=ratio * RHO))
    traj = rn.Simulation(robot, 0.01, stepper="sdirk2").run(0.5)
    assert traj.x[-1, :, 2] - robot.graph.x0[:, 2] == pytest.approx((ratio - 1.0) * G * 0.5**2 / 2, abs=1e-8)


def test_a_cantilever_sags_by_what_is_left_of_its_weight():
    clamp = rn.Clamp(at="beam.start")
    wet = rest(beam(8, clamp, rn.Gravity(g=G, fluid_density=0.6 * RHO)))
    dry = rest(beam(8, clamp, rn.Gravity(g=0.4 * G)))
    assert wet.x[-1] == pytest.approx(dry.x[-1], abs=1e-10)


# -- follower forces -----------------------------------------------------------------------------
def growth(load, edges):
    """Largest growth rate of small vibrations of a column under a follower force, over the first frequency."""
    push = rn.FollowerForce(at="beam.end", force=(0, 0, -load * EI / L**2))
    robot = beam(edges, rn.Clamp(at="beam.start"), push)
    K, free = stiffness_matrix(robot, rn.equilibrium(robot).state())
    mass = rn.Simulation(robot).model.mass[free]
    squares = eig(K.toarray(), np.diag(mass), right=False)
    return np.abs(np.sqrt(squares.astype(complex)).imag).max() / np.sqrt(EI / WEIGHT / L**4)


def test_beck_s_column_flutters_at_20_05():
    """It never buckles; at 20.05 EI / L^2 two frequencies meet and the vibration grows."""
    coarse, fine = (brentq(lambda p, n=n: growth(p, n) - 0.2, 17.0, 23.0, xtol=1e-3) for n in (12, 24))
    assert growth(19.0, 24) < 0.05 and growth(21.0, 24) > 1.0
    assert fine == pytest.approx(20.05, rel=0.01)
    assert (4.0 * fine - coarse) / 3.0 == pytest.approx(20.05, rel=2e-3)  # at second order


def test_a_transverse_follower_bends_a_cantilever_like_the_elastica():
    """EI phi'' = -F cos(phi - phi_tip), integrated back from the tip, where the force is normal to the beam."""
    for load in (2.0, 6.0):
        force = load * EI / L**2

        def back(s, y, force=force):
            return [y[1], -force / EI * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]

        # angles from the tip's tangent, arc length from the tip
        found = solve_ivp(back, (0.0, L), [0.0, 0.0, 0.0, 0.0], rtol=1e-10, atol=1e-13).y[:, -1]
        turn, x, y = found[0], found[2], found[3]
        tip = np.array([np.cos(turn) * x + np.sin(turn) * y, abs(np.cos(turn) * y - np.sin(turn) * x)])
        push = rn.FollowerForce(at="beam.end", force=(0, force, 0))
        robot = beam(40, rn.Clamp(at="beam.start"), push, director=(0, 1.0, 0))
        state = None
        for share in np.linspace(0.25, 1.0, 4):
            part = robot.with_parameters({"follower.scale": share})
            traj = rn.equilibrium(part, start=state)
            state = traj.state()
        end = traj.x[-1, -1]
        assert [end[0], np.hypot(*end[1:])] == pytest.approx(tip, abs=2e-3 * L)


def test_a_follower_turns_with_its_edge():
    """On a stiff free rod it is a body force: the rod circles or spins as the torque m1 x t says."""
    push = rn.FollowerForce(at="beam:4", force=lambda t: np.array([0.0, 0.0, 1e-3]))
    robot = beam(8, push)
    velocity = np.cross((0, 0, 2.0), robot.graph.x0 - [L / 2, 0, 0])
    traj = rn.Simulation(robot, 2e-3, stepper="sdirk2", velocity=velocity).run(0.5)
    mass = robot.graph.node_mass
    momentum = np.einsum("n,tni->ti", mass, traj.v)
    assert np.linalg.norm(momentum[-1]) < 1e-3 * 0.5
    turned = 1e-3 / 2.0 * np.array([np.sin(1.0), 1.0 - np.cos(1.0)])
    assert momentum[-1, :2] == pytest.approx(turned, rel=1e-2)
