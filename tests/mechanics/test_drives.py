"""Drives with a lag and a load line, against what they do on paper."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import EI, L, R, beam, elastic

RPM = 2.0 * np.pi / 60.0
STALL, FREE = 2e-3, 120.0  # N m, rpm
MU = 50.0
LOAD = 4.0 * np.pi * MU * R**2 * 0.1  # axial drag of the rotor [N m s]


def shaft(motor, *terms, flip=False, rho=1000.0):
    """A clamped stator and a straight rotor."""
    figure, material = rn.StickFigure(), rn.Material(E=1e9, rho=rho)
    figure.rod("stator", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=material, radius=R)
    line = [(0.2, 0, 0), "stator.end"] if flip else ["stator.end", (0.2, 0, 0)]
    figure.rod("rotor", line, edges=4, material=material, radius=R)
    between = ("stator:3-4", "rotor:3-4" if flip else "rotor:0-1")
    terms = [*elastic(), rn.Clamp(at="stator.start"), motor(between), *terms]
    return rn.Robot(figure.build(), terms)


def motor(**options):
    return lambda between: rn.DCMotor(between=between, **options)


def spin(robot, stepper="euler", dt=0.01, duration=0.8):
    """Speed of the rotor about the direction from the stator [rpm], and the trajectory."""
    traj = rn.Simulation(robot, dt, stepper=stepper).run(duration)
    rotor = robot.graph.rods["rotor"]
    forward = 1.0 if robot.graph.x0[rotor.nodes[0], 0] < 0.15 else -1.0
    return forward * traj.w[:, rotor.edges].mean(axis=1) / RPM, traj


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
@pytest.mark.parametrize("flip", [False, True])
def test_it_settles_where_the_load_meets_its_line(stepper, flip):
    """A load c w meets the line w = w_c - d T at w_c / (1 + c d), whichever way the rotor is drawn."""
    drag = rn.ResistiveForce(viscosity=MU, axial_torque=True, on="rotor")
    for rpm in (90.0, -40.0):
        robot = shaft(motor(rpm=rpm, stall_torque=STALL, no_load_rpm=FREE), drag, flip=flip, rho=1.0)
        speed, traj = spin(robot, stepper)
        expected = rpm / (1.0 + LOAD * FREE * RPM / STALL)
        assert speed[-1] == pytest.approx(expected, rel=1e-6)
        assert 0.1 < expected / rpm < 0.95
        torque = abs(traj.internal.torque[-1]).max()
        assert torque == pytest.approx(abs(LOAD * expected * RPM), rel=1e-6)
        assert abs(expected) == pytest.approx(abs(rpm) - torque / STALL * FREE, rel=1e-6)
        # what it delivers is spent on the drag
        assert traj.powers["motor"][-1] == pytest.approx(LOAD * (expected * RPM) ** 2, rel=1e-5)


def test_a_blocked_motor_holds_its_stall_torque():
    robot = shaft(motor(rpm=60.0, stall_torque=STALL, no_load_rpm=FREE), rn.Clamp(at="rotor.end", name="far"))
    traj = rn.Simulation(robot, 0.01).run(1.5)
    assert traj.internal.torque[-1] == pytest.approx(-STALL * 60.0 / FREE, rel=1e-6)
    angle = traj.state().memories[4][0]
    GJ = 1e9 / 3.0 * np.pi / 2 * R**4
    assert angle == pytest.approx(STALL * 60.0 / FREE * 0.2 / GJ, rel=1e-6)


def test_a_steeper_line_is_a_stiffer_motor_and_none_is_the_stiff_one():
    drag = rn.ResistiveForce(viscosity=MU, axial_torque=True, on="rotor")
    stiff, _ = spin(shaft(lambda b: rn.Motor(between=b, rpm=60.0), drag), duration=0.2)
    none, _ = spin(shaft(motor(rpm=60.0), drag), duration=0.2)
    assert np.array_equal(stiff, none)
    nearly, _ = spin(shaft(motor(rpm=60.0, stall_torque=1e4, no_load_rpm=60.0), drag), duration=0.2)
    assert nearly == pytest.approx(stiff, abs=1e-6 * 60.0)


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_the_lag_is_exact_whatever_the_step(dt):
    """Without load the angle is w (t - lag (1 - exp(-t / lag)))."""
    robot = shaft(motor(rpm=60.0, lag=0.1))
    traj = rn.Simulation(robot, dt).run(0.4)
    angle = np.array([traj.state(k).memories[4][0] for k in range(len(traj))])
    t = traj.t
    assert angle == pytest.approx(60.0 * RPM * (t - 0.1 * (1.0 - np.exp(-t / 0.1))), abs=1e-12)


def test_new_commands_and_a_restart_amid_the_transient(tmp_path):
    robot = shaft(motor(rpm=60.0, lag=0.05, stall_torque=STALL, no_load_rpm=FREE))
    whole, first = rn.Simulation(robot, 0.01, stepper="sdirk2"), rn.Simulation(robot, 0.01, stepper="sdirk2")
    for sim, steps in ((whole, 30), (first, 12)):
        for _ in range(steps):
            assert sim.step({"motor.rpm": 60.0 if sim.t < 0.1 else -30.0}).ok
    again = rn.Simulation(robot, 0.01, stepper="sdirk2")
    again.restore(first.state)
    while again.state.index < 30:
        again.step({"motor.rpm": -30.0})
    assert np.array_equal(again.state.q, whole.state.q)
    assert np.array_equal(again.state.memories[4], whole.state.memories[4])
    assert whole.state.memories[4][2] < 60.0 * RPM * 0.9  # on its way


def test_a_yielding_motor_refuses_what_it_cannot_eliminate():
    class Hard(rn.EnergyModel):
        strain = "twist"

        def psi(self, strain, p):
            return strain.GJ * strain.tau**4, 4 * strain.GJ * strain.tau**3, 12 * strain.GJ * strain.tau**2

    robot = shaft(motor(rpm=60.0, stall_torque=STALL, no_load_rpm=FREE)).with_terms(Hard())
    with pytest.raises(rn.TermError, match=r"motor.*linear twisting at its joint, not 'hard'"):
        rn.Simulation(robot, 0.01).step()
    with pytest.raises(rn.TermError, match="give rpm="):
        rn.DCMotor(at="beam:2")


# -- slow curvature ------------------------------------------------------------------------------
def test_curvature_follows_with_its_time_constant():
    """A light free rod takes the natural shape at once: 1 - exp(-t / T) up, exp(-t / T') down, at any step."""
    up, down, full = 0.1, 0.3, 6.0
    for dt in (0.01, 0.04):
        muscle = rn.SlowCurvature(
            curvature=full, time_constant=up, release=down, schedule=lambda t: float(t < 0.401)
        )
        traj = rn.Simulation(beam(6, muscle, rn.Clamp(at="beam.start")), dt).run(0.8)
        kappa = np.array([traj.state(k).memories[3][0, 0, 0] for k in range(len(traj))]) * 6 / L
        rising = traj.t < 0.401
        assert kappa[rising] == pytest.approx(full * (1 - np.exp(-traj.t[rising] / up)), abs=1e-9)
        peak = full * (1 - np.exp(-0.4 / up))
        assert kappa[~rising] == pytest.approx(peak * np.exp(-(traj.t[~rising] - 0.4) / down), abs=1e-9)


def test_at_rest_the_curvature_has_arrived():
    muscle = rn.SlowCurvature(curvature=5.0, drive=0.6, axis=2)
    traj = rn.equilibrium(beam(12, muscle, rn.Clamp(at="beam.start")), residual=1e-11)
    assert np.linalg.norm(traj.internal.bending[-1], axis=1).max() < 1e-9 * EI / L
    chord = np.linalg.norm(traj.x[-1, -1] - traj.x[-1, 0])
    assert chord == pytest.approx(2.0 / 3.0 * np.sin(3.0 * L / 2.0), rel=1e-3)


def test_the_transient_of_a_motor_that_gives_way_is_of_second_order():
    """The angle after a start against drag; with implicit Euler for the droop differences would fall by 2."""
    figure, material = rn.StickFigure(), rn.Material(E=1e9, rho=1000.0)
    figure.rod("stator", [(0, 0, 0), (0.1, 0, 0)], edges=2, material=material, radius=2e-3)
    figure.rod("rotor", ["stator.end", (0.2, 0, 0)], edges=2, material=material, radius=2e-3)
    drag = rn.ResistiveForce("rotor", viscosity=30.0, axial_torque=True)
    motor = rn.DCMotor(at="stator.end", rpm=90.0, stall_torque=2e-3, no_load_rpm=120.0, lag=0.1)
    energies = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    robot = rn.Robot(figure.build(), [*energies, rn.Clamp(at="stator.start"), drag, motor])
    for stepper, least in (("alpha", 3.8), ("sdirk2", 2.9)):
        angles = [
            rn.Simulation(robot, dt, stepper=stepper).run(0.3).theta[-1, -1] for dt in (0.01, 0.005, 0.0025)
        ]
        first, second = np.diff(angles)
        assert least < first / second < 4.4
