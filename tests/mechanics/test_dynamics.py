"""Free flight, conservation, dissipation, order in time and natural frequencies."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigh

import rodnet as rn
from rodnet.kinematics.frames import material_frames
from rodnet.solve.statics import stiffness_matrix
from tests.mechanics.beams import EI, MATERIAL, RHO, WEIGHT, E, L, beam, elastic, order

TIGHT = rn.Tolerance(residual=1e-12, update=1e-14, iterations=50)
STEPPERS = ("euler", "sdirk2", "alpha")


def hook(E=2e5, radius=4e-3, **options):
    """A bent rod with a branch, soft enough to swing widely."""
    figure = rn.StickFigure()
    material = rn.Material(E=E, rho=1000.0)
    figure.rod(
        "arm",
        [(0, 0, 0), (0.1, 0, 0.01), (0.15, 0.06, 0.05)],
        edges=8,
        material=material,
        radius=radius,
        **options,
    )
    figure.rod("twig", ["arm:4", (0.1, -0.05, 0.02)], edges=3, material=material, radius=radius, **options)
    return figure.build()


@pytest.mark.parametrize("stepper", STEPPERS)
def test_free_fall_is_exact(stepper):
    """x = x0 + v t - g t^2 / 2; implicit Euler falls by g dt^2 n (n + 1) / 2."""
    graph, g, dt, n = hook(), 9.81, 0.01, 100
    velocity = np.tile((0.3, -0.2, 1.0), (graph.node_count, 1))
    robot = rn.Robot(graph, [*elastic(), rn.Gravity(g=g)])
    tight = rn.Tolerance(residual=1e-11)  # velocities are exact as far as Newton's method is
    sim = rn.Simulation(robot, dt, stepper=stepper, velocity=velocity, tolerance=tight)
    traj = sim.run(n * dt, save_every=10)
    k = np.arange(0, n + 1, 10)
    fallen = 0.5 * g * dt**2 * (k * (k + 1) if stepper == "euler" else k**2)
    expected = graph.x0 + (k * dt)[:, None, None] * (0.3, -0.2, 1.0) - fallen[:, None, None] * (0, 0, 1.0)
    assert traj.x == pytest.approx(expected, abs=1e-12)
    assert traj.v[-1, :, 2] == pytest.approx(1.0 - g * n * dt, abs=1e-10)


@pytest.mark.parametrize("stepper", STEPPERS)
def test_linear_momentum_is_conserved(stepper):
    """A free robot that shakes and tumbles: every Newton step keeps the sum of momenta."""
    graph = hook(natural="straight")
    rng = np.random.default_rng(2)
    velocity = 0.3 * rng.normal(size=(graph.node_count, 3))
    sim = rn.Simulation(rn.Robot(graph, elastic()), 2e-3, stepper=stepper, velocity=velocity)
    traj = sim.run(0.3)
    momentum = np.einsum("n,tni->ti", graph.node_mass, traj.v)
    scale = graph.node_mass @ np.linalg.norm(velocity, axis=1)
    assert np.abs(momentum - momentum[0]).max() < 1e-12 * scale
    moved = np.einsum("n,tni->ti", graph.node_mass, traj.x - graph.x0)
    assert np.abs(moved[-1] - momentum[0] * 0.3).max() < 1e-12 * scale


def test_angular_momentum_is_conserved():
    """Of a free robot of thin rods: their spin about their own axes, 2e-5 of it all, is not coupled back."""
    graph = hook(E=2e9, radius=4e-4)
    x = graph.x0 - graph.node_mass @ graph.x0 / graph.node_mass.sum()
    velocity = np.cross((3.0, -5.0, 2.0), x)
    robot = rn.Robot(graph, elastic())
    traj = rn.Simulation(robot, 1e-3, stepper="alpha", velocity=velocity, tolerance=TIGHT).run(0.3)
    spin = np.einsum("n,tni->ti", graph.node_mass, np.cross(traj.x, traj.v))
    assert np.abs(spin - spin[0]).max() < 4e-5 * np.linalg.norm(spin[0])


@pytest.mark.parametrize("dt", [1e-1, 1e-2, 1e-3])
def test_implicit_euler_never_gains_energy(dt):
    """From a shape far from natural, and from a random velocity."""
    graph = hook(natural="straight")
    velocity = 0.5 * np.random.default_rng(5).normal(size=(graph.node_count, 3))
    traj = rn.Simulation(rn.Robot(graph, elastic()), dt, velocity=velocity).run(100 * dt)
    energy = sum(traj.energies.values())
    assert np.diff(energy).max() < 1e-8 * energy[0]
    assert energy[-1] < 0.9 * energy[0]


def test_second_order_steppers_keep_the_energy_of_a_swing():
    """A rod that swings under gravity: what is lost falls with dt, and is little."""
    figure = rn.StickFigure().rod(
        "rod", [(0, 0, 0), (0.3, 0, 0)], edges=6, material=rn.Material(E=1e6), radius=4e-3
    )
    robot = rn.Robot(figure.build(), [*elastic(), rn.Gravity(), rn.Hinge(at="rod.start")])
    weight = 9.81 * robot.graph.node_mass
    for stepper, allowed in (("sdirk2", 2e-3), ("alpha", 2e-3), ("euler", 0.3)):
        traj = rn.Simulation(robot, 2e-3, stepper=stepper, tolerance=TIGHT).run(0.5)
        energy = sum(traj.energies.values()) + traj.x[:, :, 2] @ weight
        released = np.abs(traj.x[:, :, 2] @ weight).max()
        assert np.abs(energy - energy[0]).max() < allowed * released


def eased(t):
    """Angle of a motor that comes up to 5 turns per second within 0.4 s, with three smooth derivatives."""
    s = min(t / 0.4, 1.0)
    return 10.0 * np.pi * (0.4 * s**4 * (2.5 - 3.0 * s + s * s) + max(t - 0.4, 0.0))


# -- order in time -------------------------------------------------------------------------------
def whirl(stepper, steps, drag):
    """Positions and material directors of a motor-driven soft rod that is pushed about in space."""
    material = rn.Material(E=3e5)
    figure = rn.StickFigure()
    figure.rod(
        "stator", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=material, section=rn.elliptic(5e-3, 3e-3)
    )
    figure.rod("rotor", ["stator.end", (0.18, 0, 0)], edges=4, material=material, radius=4e-3)
    push = rn.PointForce(
        at="rotor.end",
        force=lambda t: np.array([0, 0.05 * np.sin(8 * t) ** 4, 0.05 * np.sin(5 * t) ** 4]),
    )
    motor = rn.Motor(at="stator.end", angle=eased)
    robot = rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="stator.start"), push, motor, *drag])
    sim = rn.Simulation(robot, 0.4 / steps, stepper=stepper, tolerance=TIGHT)
    sim.run(0.4)
    state, k = sim.state, sim.model.twist0
    frames = material_frames(state.tangents, state.directors, state.q[k:])
    return np.concatenate([state.q[:k] / 0.18, frames[:, :, 0].ravel()])


DRAGS = {
    "axial torque": [rn.ResistiveForce(viscosity=5.0, axial_torque=True)],
    "6 x 6 head": [
        rn.ResistiveForce(viscosity=5.0),
        rn.StokesHead(resistance=np.diag([0.1] * 3 + [3e-4] * 3), at="rotor.end"),
    ],
    "head": [
        rn.ResistiveForce(viscosity=5.0),
        rn.StokesHead(viscosity=5.0, radius=0.01, C1=0.1, at="rotor.end"),
    ],
}


@pytest.mark.parametrize("drag", DRAGS)
@pytest.mark.parametrize("stepper", STEPPERS)
def test_order_in_time_of_spinning_and_bending_rods(stepper, drag):
    """Torques about edges that turn are where frames could spoil the order."""
    declared = {"euler": 1, "sdirk2": 2, "alpha": 2}[stepper]
    ends = [whirl(stepper, n, DRAGS[drag]) for n in (80, 160, 320, 640)]
    gaps = [np.abs(a - b).max() for a, b in pairwise(ends)]
    assert order((1, 2, 4), gaps) > declared - 0.1


# -- natural frequencies -------------------------------------------------------------------------
ROOTS = np.array([1.875104069, 4.694091133, 7.854757438])  # of cos(x) cosh(x) = -1


def modes(robot):
    """Angular frequencies [rad/s] and shapes of small vibrations about the initial shape."""
    K, free = stiffness_matrix(robot)
    model = rn.Simulation(robot).model
    squares, vectors = eigh(K.toarray(), np.diag(model.mass[free]))
    shapes = np.zeros((model.dof_count, len(free)))
    shapes[free] = vectors
    return np.sqrt(np.abs(squares)), shapes[: 3 * model.graph.node_count]


def test_frequencies_of_a_cantilever():
    """Bending twice (two planes), torsion and axial waves of a clamped rod, all at second order."""
    bending = ROOTS**2 * np.sqrt(EI / WEIGHT) / L**2
    torsion = 0.5 * np.pi / L * np.sqrt(MATERIAL.G / RHO)
    axial = 0.5 * np.pi / L * np.sqrt(E / RHO)
    sizes, errors = (16, 32, 64), {"bending": [], "torsion": [], "axial": []}
    for n in sizes:
        found = modes(beam(n, rn.Clamp(at="beam.start")))[0]
        assert found[0:6:2] == pytest.approx(found[1:6:2], rel=1e-6)  # round
        errors["bending"].append(np.abs(found[0:6:2] / bending - 1.0))
        for name, theory in (("torsion", torsion), ("axial", axial)):
            errors[name].append(np.abs(found / theory - 1.0).min())
    for k in range(3):
        assert order(sizes, np.array(errors["bending"])[:, k]) == pytest.approx(2.0, abs=0.1)
    assert errors["bending"][-1][0] < 1e-3
    for name in ("torsion", "axial"):
        assert order(sizes, errors[name]) == pytest.approx(2.0, abs=0.05) and errors[name][-1] < 1e-4


def test_period_of_the_first_mode():
    """Generalised-alpha lets it ring slower by (omega dt)^2 / 12 or a little more, and hardly damps it."""
    n, turns = 12, 6
    robot = beam(n, rn.Clamp(at="beam.start"))
    omega, shapes = modes(robot)
    period = 2.0 * np.pi / omega[0]
    velocity = (shapes[:, 0] / np.abs(shapes[:, 0]).max()).reshape(-1, 3) * 1e-4 * L * omega[0]
    side = velocity[-1] / np.linalg.norm(velocity[-1])
    lag = []
    for steps in (50, 100, 200):
        sim = rn.Simulation(robot, period / steps, stepper="alpha", velocity=velocity, tolerance=TIGHT)
        back = rn.Event(lambda s: s.position("beam.end") @ side, "back", direction=-1)
        traj = sim.run(turns * period, events=[back])
        lag.append(np.polyfit(np.arange(turns), traj.events["back"], 1)[0] / period - 1.0)
        assert np.abs(traj.x[-2 * steps :, -1] @ side).max() == pytest.approx(1e-4 * L, rel=0.01)
    assert lag[1] == pytest.approx((omega[0] * period / 100) ** 2 / 12.0, rel=0.1)
    assert order((1, 2, 4), lag) == pytest.approx(2.0, abs=0.1)
