"""The motor: how its joint bends, how fast it turns, and where its power goes."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix

TIGHT = rn.Tolerance(residual=1e-11, update=1e-13)


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


# -- the joint -----------------------------------------------------------------------------------
def joint(bend, *terms, section=None, rotor_director=(0, 0, 1.0), flip=False):
    """Two soft rods, clamped at one end; the second leaves at a natural angle ``bend``."""
    material, section = rn.Material(E=1e6), section or rn.circular(3e-3)
    tip = np.array([0.1, 0, 0]) + 0.1 * np.array([np.cos(bend), np.sin(bend), 0])
    figure = rn.StickFigure()
    figure.rod(
        "stator", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=material, section=section, director=(0, 0, 1.0)
    )
    line = [tip, "stator.end"] if flip else ["stator.end", tip]
    figure.rod("rotor", line, edges=4, material=material, section=section, director=rotor_director)
    return rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="stator.start"), *terms])


def motor(angle, flip=False):
    between = ("stator:3-4", "rotor:3-4" if flip else "rotor:0-1")
    return rn.Motor(between=between, angle=lambda t: angle)


def turned(robot, angle):
    """Stress-free state with the rotor turned about its own axis."""
    sim = rn.Simulation(robot)
    q = sim.state.q.copy()
    q[sim.model.twist0 + robot.graph.rods["rotor"].edges] += angle
    return replace(sim.state, q=q, tau=np.zeros(sim.model.spring_count))


def difference(K, K0):
    scale = 1.0 / np.sqrt(np.abs(np.diag(K0)))
    return np.abs(scale[:, None] * (K - K0) * scale).max()


@pytest.mark.parametrize("bend", [0.0, 0.7, 0.5 * np.pi])
@pytest.mark.parametrize("angle", [0.4, 1.0, 2.0, np.pi, 5.0, 40.0])
def test_stiffness_of_a_motor_joint_does_not_depend_on_its_angle(bend, angle):
    """The whole tangent matrix: bending, twisting and their coupling."""
    K0 = stiffness_matrix(joint(bend))[0].toarray()
    robot = joint(bend, motor(angle))
    K = stiffness_matrix(robot, turned(robot, angle))[0].toarray()
    assert difference(K, K0) < 1e-10
    assert np.linalg.eigvalsh(K).min() > 0.0


@pytest.mark.parametrize("bend", [0.0, 0.7])
@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("angle", [0.4, 2.0, 0.5 * np.pi])
def test_an_elliptic_rotor_takes_its_soft_direction_along(bend, flip, angle):
    """Turned by the motor, it is the rotor that was drawn turned."""
    section = rn.elliptic(4e-3, 2e-3)
    drawn = (-1.0 if flip else 1.0) * np.array([np.cos(bend), np.sin(bend), 0])  # as the rod is stored
    side = np.cross(drawn, (0, 0, 1.0))
    # positive turns the rotor by the right hand about the direction from stator to rotor
    hand = -angle if flip else angle
    director = np.cos(hand) * np.array([0, 0, 1.0]) + np.sin(hand) * side
    K0 = stiffness_matrix(joint(bend, section=section, rotor_director=director, flip=flip))[0].toarray()
    robot = joint(bend, motor(angle, flip), section=section, flip=flip)
    K = stiffness_matrix(robot, turned(robot, hand))[0].toarray()
    assert difference(K, K0) < 1e-10


def test_the_paper_s_joint_bends_alike_at_every_angle():
    """A transverse load on the rotor gives the same deflection whatever the motor's angle."""
    load = rn.PointForce(at="rotor.end", force=(0, 2e-3, -5e-3))
    tips = []
    for angle in (0.0, 1.0, 2.0, 3.0, 12.0):
        traj = rn.equilibrium(joint(0.0, motor(angle), load), residual=1e-11)
        tips.append(traj.at("rotor.end")[-1])
    assert np.abs(np.array(tips) - tips[0]).max() < 1e-10
    assert tips[0][2] < -0.01


def test_a_speed_driven_motor_rests_in_statics():
    """Equilibrium takes no time: the motor stays at the angle of the start."""
    robot = joint(0.3, rn.Gravity(), rn.Motor(at="stator.end", rpm=100.0))
    still = rn.equilibrium(robot)
    reference = rn.equilibrium(joint(0.3, rn.Gravity()))
    assert still.x[-1] == pytest.approx(reference.x[-1], abs=1e-9)
    # and after a quarter of a turn, a quarter of a turn
    sim = rn.Simulation(robot, 0.01)
    sim.run(0.15)
    again = rn.equilibrium(robot, start=sim.state)
    assert again.state().memories[-1][0] == pytest.approx(0.5 * np.pi)


# -- speed ---------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def steady():
    return rn.Simulation(rn.robots.flagellated(2, 100.0), 1e-2).run(20.0)


def test_relative_speed_is_the_commanded_one(steady):
    head, shaft = (steady.w[-1, steady.rods["head"].edges[k]] for k in (0, 1))
    assert abs(head) + abs(shaft) == pytest.approx(100.0 * 2 * np.pi / 60, rel=1e-6)
    assert head * shaft < 0.0


@pytest.mark.parametrize("n_tails", [2, 3, 4, 5])
@pytest.mark.parametrize("rpm", [25.0, 100.0, 200.0, 300.0])
def test_no_step_fails_or_is_halved(n_tails, rpm):
    traj = rn.Simulation(rn.robots.flagellated(n_tails, rpm), 1e-2).run(4.0, save_every=400)
    assert traj.stats["substeps"] == traj.stats["steps"] == 400
    assert traj.stats["fallbacks"] == 0


def test_speed_falls_as_one_over_the_tails_stiffness():
    """Almost rigid tails bend by an amount, and propel by a force, that is as 1 / EI."""
    speeds = []
    for stiffer in (1e2, 1e3, 1e4):
        traj = rn.Simulation(rn.robots.flagellated(2, 100.0, E=1.2e6 * stiffer), 1e-2, tolerance=TIGHT).run(
            8.0
        )
        speeds.append(rn.robots.flagellated_metrics(traj).speed)
    assert np.array(speeds[:-1]) / speeds[1:] == pytest.approx(10.0, rel=1e-3)
    assert speeds[-1] < 1e-3 * 0.2152e-3


@pytest.mark.parametrize(("root", "expected"), [("rigid", 1.0), ("clamped", 2.0)])
def test_order_in_edge_length(root, expected):
    """Both roots tend to 0.2302 mm/s, at first and at second order."""
    sizes = np.array([14, 27, 54, 108])
    speeds = []
    for edges in sizes:
        traj = rn.Simulation(rn.robots.flagellated(2, 100.0, root=root, edges=int(edges)), 1e-2).run(
            24.0, save_every=10
        )
        speeds.append(1e3 * rn.robots.flagellated_metrics(traj).speed)
    errors = np.abs(np.array(speeds) - 0.23016)
    slope = -np.polyfit(np.log(sizes[:3]), np.log(errors[:3]), 1)[0]
    assert slope == pytest.approx(expected, abs=0.15)
    assert errors[-1] < (4e-3 if root == "rigid" else 5e-5)


@pytest.mark.parametrize(("stepper", "expected"), [("euler", 1.0), ("sdirk2", 2.0)])
def test_order_in_dt_of_the_steady_state(stepper, expected):
    """Of a light robot: with its mass the second order shows only once dt is below mass over drag, 2 ms."""
    speeds = []
    for dt in (0.06, 0.03, 0.015):
        robot = rn.robots.flagellated(2, 100.0, root="clamped", edges=8, rho=1e-3, mass=3.5e-8)
        traj = rn.Simulation(robot, dt, stepper=stepper, tolerance=TIGHT).run(24.0)
        m = rn.robots.flagellated_metrics(traj)
        speeds.append((m.speed, m.head_rpm))
    gaps = np.abs(np.diff(speeds, axis=0))
    assert np.log2(gaps[0] / gaps[1]) == pytest.approx(expected, abs=0.35)


# -- power ---------------------------------------------------------------------------------------
def balance(robot, dt, duration, stepper, after):
    """Gain of stored and kinetic energy minus the work of all terms, and the work of actuators [J]."""
    traj = rn.Simulation(robot, dt, stepper=stepper, tolerance=TIGHT).run(duration)
    k = round(after / dt)
    energy = sum(traj.energies.values())[k:]
    given = sum(v for n, v in traj.powers.items() if n not in ("elastic", "kinetic"))[k:]
    work = 0.5 * dt * np.sum(given[:-1] + given[1:])
    actuators = [t.name for t in robot.terms if t.kind == "actuator"]
    driven = sum(np.abs(traj.powers[n][k:]).sum() * dt for n in actuators)
    return energy[-1] - energy[0] - work, driven


def test_powers_add_up_at_every_state(steady):
    """motor + drag + head + elastic = kinetic, to the solver's tolerance, also while it starts."""
    powers = dict(steady.powers)
    kinetic = powers.pop("kinetic")
    total = sum(powers.values())
    assert np.abs(total - kinetic)[1:].max() < 1e-7 * np.abs(powers["motor"]).max()


def test_motor_feeds_the_drag_in_the_steady_state(steady):
    """What flows in flows out; the stored energy, differenced in time, stays."""
    last = steady.t > 18.0
    dissipated = -(steady.powers["drag"] + steady.powers["head"])[last]
    assert steady.powers["motor"][last] == pytest.approx(dissipated, rel=1e-5)
    stored = sum(v for n, v in steady.energies.items() if n != "kinetic")[last]
    assert np.abs(np.gradient(stored, steady.dt)).max() < 1e-5 * dissipated.mean()


@pytest.mark.parametrize("section", [rn.circular(3e-3), rn.elliptic(4e-3, 2e-3)], ids=["round", "elliptic"])
@pytest.mark.parametrize("flip", [False, True])
def test_motor_power_over_time(section, flip):
    """Independently of the identity above: energies at two times, and the work in between, at O(dt^2)."""
    gaps = []
    for dt in (0.02, 0.01):
        between = ("stator:3-4", "rotor:3-4" if flip else "rotor:0-1")
        drag = rn.ResistiveForce(viscosity=2.0, axial_torque=True)
        robot = joint(
            0.3, rn.Gravity(), drag, rn.Motor(between=between, rpm=60.0), section=section, flip=flip
        )
        gap, driven = balance(robot, dt, 1.0, "sdirk2", after=0.3)
        gaps.append(abs(gap) / driven)
    assert gaps[1] < 1e-3
    assert gaps[0] / gaps[1] > 3.0


def test_power_of_a_curvature_wave():
    """An undulating rod: what the wave puts in is dissipated, but for the stepper's O(dt)."""
    gaps = []
    for dt in (0.01, 0.005):
        figure = rn.StickFigure()
        figure.rod("rod", [(0, 0, 0), (0.1, 0, 0)], edges=8, material=rn.Material(E=1e6), radius=3e-3)
        wave = rn.CurvatureWave(amplitude=20.0, wavelength=0.1, frequency=1.0)
        robot = rn.Robot(figure.build(), [*elastic(), wave, rn.ResistiveForce(viscosity=5.0)])
        gap, driven = balance(robot, dt, 1.5, "euler", after=0.5)
        gaps.append(abs(gap) / driven)
    assert gaps[1] < 5e-3
    assert gaps[0] / gaps[1] == pytest.approx(2.0, abs=0.2)
