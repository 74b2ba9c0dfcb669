"""The inertia of the fluid around rods against formulas and conservation laws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import rodnet as rn
from rodnet.solve.evaluation import Evaluation
from rodnet.testing import Probe, check_term
from tests.mechanics.beams import AREA, EI, WEIGHT, L, beam, elastic, rest

FLUID = 1500.0 * AREA  # kg/m, more than the rod's own 1000
STEPPERS = ("euler", "sdirk2", "alpha")
TIGHT = rn.Tolerance(residual=1e-11, update=1e-14)


def fluid(**options):
    return rn.AddedMass(density=1500.0, **options)


def test_the_term_keeps_the_contract():
    check_term(rn.AddedMass)
    check_term(rn.AddedMass(coefficient=0.5, density=800.0))


def test_jacobian_by_acceleration():
    """With rates and accelerations that follow the position the Jacobian is that of a time step."""
    probe = Probe(rn.Robot(beam(4).graph, [fluid()]), np.random.default_rng(2))
    m, ev, rng = probe.model, probe.ev, np.random.default_rng(3)
    a, cv, ca, h = rng.normal(size=m.dof_count), 30.0, 900.0, 1e-7

    def force(step):
        ev.a[:] = a + ca * step
        ev.ca = ca
        return probe.evaluate(probe.q + step, probe.v + cv * step, cv=cv, jac=True).F.copy()

    force(np.zeros(m.dof_count))
    J = m.jacobian().toarray()
    for k in range(0, m.twist0):
        step = h * np.eye(m.dof_count)[k]
        slope = (force(step) - force(-step)) / (2 * h)
        assert -slope[m.free] == pytest.approx(J[:, k], abs=1e-6 * np.abs(J).max())


@pytest.mark.parametrize("stepper", STEPPERS)
def test_a_rod_that_is_pushed_carries_fluid_across_but_not_along(stepper):
    """a = f / (m + m_a) across, f / m along, from the first step on."""
    for direction, mass in (((0, 0, 1.0), WEIGHT + FLUID), ((1.0, 0, 0), WEIGHT)):
        robot = beam(4, rn.Gravity(g=2.0, direction=direction), fluid())
        traj = rn.Simulation(robot, 1e-3, stepper=stepper, tolerance=TIGHT).run(0.02)
        speed = traj.v[:, :, np.argmax(direction)]
        wanted = 2.0 * WEIGHT / mass * traj.t[:, None]
        assert speed == pytest.approx(np.broadcast_to(wanted, speed.shape), abs=1e-9)


def test_a_rod_that_moves_obliquely_is_turned_broadside():
    """Munk's moment: (m + m_a) L^3/12 alpha = m_a L V^2 sin cos, on the first step."""
    n, V, angle = 40, 0.3, 0.6
    velocity = np.tile(V * np.array((np.cos(angle), np.sin(angle), 0.0)), (n + 1, 1))
    robot = beam(n, fluid(), points=((-L / 2, 0, 0), (L / 2, 0, 0)))
    dt = 1e-4
    traj = rn.Simulation(robot, dt, stepper="sdirk2", velocity=velocity, tolerance=TIGHT).run(20 * dt)
    arms = robot.graph.x0[:, 0]
    mass = robot.graph.node_mass * (1.0 + FLUID / WEIGHT)
    spin = (mass * arms) @ (traj.v[-1, :, 1] - velocity[:, 1]) / (mass @ arms**2)
    moment = -FLUID * L * V**2 * np.sin(angle) * np.cos(angle)
    assert spin / traj.t[-1] == pytest.approx(moment / ((WEIGHT + FLUID) * L**3 / 12), rel=5e-3)


def crossed():
    """A bent rod with a branch, soft enough to swing widely."""
    figure = rn.StickFigure()
    material = rn.Material(E=2e6, rho=1000.0)
    options = {"material": material, "radius": 4e-3, "natural": "straight"}
    figure.rod("arm", [(0, 0, 0), (0.1, 0, 0.01), (0.15, 0.06, 0.05)], edges=8, **options)
    figure.rod("twig", ["arm:4", (0.1, -0.05, 0.02)], edges=3, **options)
    return rn.Robot(figure.build(), [*elastic(), fluid()])


def fluid_of(traj):
    """Momentum and energy of the fluid at the recorded states."""
    from rodnet.solve.model import Model

    model = Model(traj.robot)
    ev, momentum, energy = Evaluation(model), [], []
    for k in range(len(traj)):
        state = traj.state(k)
        ev.set_source(state.tangents, state.directors, state.tau, state.q)
        ev.update(state.q, state.v, state.t, traj.dt, 0.0, False)
        momentum.append(model.bound[-1].momentum(ev))
        energy.append(model.bound[-1].energy(ev))
    return np.array(momentum), np.array(energy)


def test_momentum_and_energy_of_robot_and_fluid_are_conserved():
    """What the robot loses the fluid has: errors vanish with the time step, as its square."""
    robot = crossed()
    velocity = 0.3 * np.random.default_rng(2).normal(size=(robot.graph.node_count, 3))
    drift, losses = [], []
    for dt in (4e-4, 2e-4, 1e-4):
        sim = rn.Simulation(robot, dt, stepper="alpha", velocity=velocity, tolerance=TIGHT)
        traj = sim.run(0.02)
        momentum, energy = fluid_of(traj)
        total = momentum + np.einsum("n,tni->ti", robot.graph.node_mass, traj.v)
        drift.append(np.abs(total - total[0]).max() / np.linalg.norm(total[0]))
        sums = energy + sum(traj.energies.values())
        losses.append(np.abs(sums - sums[0]).max() / sums[0])
    assert drift[-1] < 5e-3 and losses[-1] < 5e-2
    assert np.all(np.log2(np.array(drift[:-1]) / drift[1:]) > 1.5), drift
    # the power that the fluid takes is the rate of its energy
    rate = np.gradient(energy, traj.t)
    assert -traj.powers["fluid"][5:-5] == pytest.approx(rate[5:-5], abs=0.03 * np.abs(rate).max())


@pytest.mark.parametrize("stepper", ["sdirk2", "alpha"])
def test_a_submerged_cantilever_swings_slower(stepper):
    """omega = 1.875^2 sqrt(EI / ((m + m_a) L^4)): the square root of the masses' ratio."""
    n, found = 20, {}
    bent = rest(beam(n, rn.Clamp(at="beam.start"), rn.PointForce(at="beam.end", force=(0, 0, 1e-3))))
    for name, terms, mass in (("air", [], WEIGHT), ("water", [fluid()], WEIGHT + FLUID)):
        omega = 1.8751041**2 * np.sqrt(EI / (mass * L**4))
        robot = beam(n, rn.Clamp(at="beam.start"), *terms)
        sim = rn.Simulation(robot, 0.01 * 2 * np.pi / omega, stepper=stepper, tolerance=TIGHT)
        q = sim.state.q.copy()
        q[: 3 * (n + 1)] = bent.x[-1].ravel()
        sim.restore(replace(sim.state, q=q))
        traj = sim.run(8 * 2 * np.pi / omega)
        z = traj.at("beam.end")[:, 2] * np.hanning(len(traj))
        amplitude = lambda w, z=z, t=traj.t: -abs(z @ np.exp(1j * w * t))  # noqa: E731
        found[name] = minimize_scalar(amplitude, bounds=(0.8 * omega, 1.2 * omega), method="bounded").x
        assert found[name] == pytest.approx(omega, rel=5e-3)
    assert found["water"] / found["air"] == pytest.approx(np.sqrt(WEIGHT / (WEIGHT + FLUID)), rel=1e-3)


def test_a_gripper_feels_the_inertia_of_the_fluid():
    """Over a shake its force gives robot and fluid their momentum: recorded accelerations count, too."""
    led = rn.PrescribedMotion(
        at="beam:0-1", position=lambda t: np.array((0, 0.01 * t**3 * 1e2, 0)), orientation=lambda t: np.eye(3)
    )
    traj = rn.Simulation(beam(6, led, fluid()), 1e-3, stepper="sdirk2", tolerance=TIGHT).run(0.1)
    given = np.trapezoid(traj.reactions["motion"].force, traj.t, axis=0)
    held = fluid_of(traj)[0] + np.einsum("n,tni->ti", traj.robot.graph.node_mass, traj.v)
    assert held[-1, 1] > 0.1 * (WEIGHT + FLUID) * L * traj.v[-1, 0, 1]
    assert given == pytest.approx(held[-1] - held[0], abs=0.01 * held[-1, 1])
