"""Damping against theory: which motions decay, how fast, and which do not."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigh

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix
from rodnet.testing import Probe
from tests.mechanics.beams import EI, MATERIAL, RHO, WEIGHT, E, L, R, beam, elastic, order

TIGHT = rn.Tolerance(residual=1e-12, update=1e-14, iterations=50)
ROOTS = np.array([1.875104069, 4.694091133, 7.854757438])  # of cos(x) cosh(x) = -1


def damping_matrix(robot):
    """Derivative of minus the forces by the rates at rest, over the free degrees of freedom."""
    sim = rn.Simulation(robot)
    m, ev, state = sim.model, sim.newton.ev, sim.state
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    parts = []
    for cv in (0.0, 1.0):
        ev.update(state.q, np.zeros(m.dof_count), 0.0, 1.0, cv, True)
        parts.append(m.jacobian().toarray())
    return parts[1] - parts[0], np.diag(m.mass[m.free])


def decay_rates(robot):
    """Decay rates and angular frequencies of all damped vibrations about the initial shape."""
    K = stiffness_matrix(robot)[0].toarray()
    C, M = damping_matrix(robot)
    n, heavy = len(K), np.diag(1.0 / np.diag(M))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-heavy @ K, -heavy @ C]])
    values = np.linalg.eigvals(A)
    values = values[values.imag > 1e-9 * np.abs(values).max()]
    return -values.real, np.abs(values)


def test_each_mode_of_a_cantilever_decays_at_its_own_rate():
    """Kelvin-Voigt: a mode of frequency w decays at time w^2 / 2, by the time of what it strains."""
    times = {"stretch": 2e-7, "bend": 3e-5, "twist": 5e-7}
    rates, omega = decay_rates(beam(32, rn.Clamp(at="beam.start"), rn.KelvinVoigt(**times)))
    theory = {
        "bend": ROOTS**2 * np.sqrt(EI / WEIGHT) / L**2,
        "twist": np.array([0.5, 1.5]) * np.pi / L * np.sqrt(MATERIAL.G / RHO),
        "stretch": np.array([0.5, 1.5]) * np.pi / L * np.sqrt(E / RHO),
    }
    for mode, frequencies in theory.items():
        for w in frequencies:
            k = np.argmin(np.abs(omega / w - 1.0))
            assert omega[k] == pytest.approx(w, rel=1e-2)
            assert rates[k] == pytest.approx(0.5 * times[mode] * w**2, rel=2e-2)
            assert rates[k] == pytest.approx(0.5 * times[mode] * omega[k] ** 2, rel=1e-5)


def test_mass_damping_takes_all_modes_alike():
    rates, _ = decay_rates(beam(12, rn.Clamp(at="beam.start"), rn.MassDamping(rate=3.0)))
    assert rates == pytest.approx(1.5, rel=1e-6)


@pytest.mark.parametrize("law", [rn.KelvinVoigt(bend=2e-2), rn.MassDamping(rate=1.0)], ids=lambda t: t.name)
def test_a_swing_decays_as_the_damping_ratio_says(law):
    """The first mode in time: what is left of a cantilever's swing from one turning point to the next."""
    robot = beam(6, rn.Clamp(at="beam.start"), law)
    rates, omega = decay_rates(robot)
    rate, omega = rates[np.argmin(omega)], omega.min()
    half = np.pi / np.sqrt(omega**2 - rate**2)
    K, free = stiffness_matrix(robot)
    sim = rn.Simulation(robot)
    shape = np.zeros(sim.model.dof_count)
    shape[free] = eigh(K.toarray(), np.diag(sim.model.mass[free]))[1][:, 0]
    velocity = 1e-3 * shape[: 3 * robot.graph.node_count].reshape(-1, 3) / np.abs(shape).max()
    traj = rn.Simulation(robot, half / 60, stepper="sdirk2", velocity=velocity).run(4 * half)
    swing = traj.x[:, -1] @ velocity[-1] / np.linalg.norm(velocity[-1])
    turns = [swing[60 * k : 60 * (k + 1)] for k in range(4)]
    peaks = np.array([np.abs(t).max() for t in turns])
    assert np.log(peaks[:-1] / peaks[1:]) / half == pytest.approx(rate, rel=5e-3)


def test_rigid_motion_of_any_shape_is_not_damped():
    """v = u + w x r and a spin w . t: no strain changes, whatever the shape and the source frames."""
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.1, 0, 0), (0.15, 0.06, 0.05)], edges=7, material=MATERIAL, radius=R)
    figure.rod("arm", ["rod:3", (0.05, -0.08, 0.02)], edges=4, material=MATERIAL, radius=R)
    law = rn.KelvinVoigt(stretch=1.0, bend=1.0, twist=1.0)
    probe = Probe(rn.Robot(figure.build(), [law]), np.random.default_rng(4))
    m, ev = probe.model, probe.evaluate()
    spin, shift = np.array([0.3, -0.7, 0.4]), np.array([1.0, 2.0, -0.5])
    v = np.zeros(m.dof_count)
    v[: m.twist0] = (shift + np.cross(spin, ev.x)).ravel()
    # the twist angle counts the spin that the transported director does not have
    across = np.cross(spin, ev.T)
    v[m.twist0 :] = ev.T @ spin + np.sum(ev.S * across, axis=1)
    typical = np.abs(probe.forces()).max()
    assert np.abs(probe.forces(v=v)).max() < 1e-13 * typical


@pytest.mark.parametrize(("stepper", "expected"), [("euler", 1.0), ("sdirk2", 2.0), ("alpha", 2.0)])
def test_damping_keeps_the_order_of_the_stepper(stepper, expected):
    def tip(steps):
        push = rn.PointForce(at="beam.end", force=lambda t: np.array([0, 0.02 * t, -0.03 * t]))
        law = rn.KelvinVoigt(stretch=1e-3, bend=5e-2, twist=1e-2)
        robot = beam(5, rn.Clamp(at="beam.start"), push, law, rn.MassDamping(rate=1.0))
        return rn.Simulation(robot, 0.4 / steps, stepper=stepper, tolerance=TIGHT).run(0.4).x[-1, -1]

    gaps = [
        np.abs(a - b).max()
        for a, b in pairwise(
            [tip(n) for n in ((40, 80, 160, 320) if stepper == "euler" else (20, 40, 80, 160))]
        )
    ]
    assert order((1, 2, 4), gaps) > expected - 0.15


def test_a_driven_joint_is_damped_against_its_natural_angle():
    """A rotor that keeps up with its motor loses nothing, though it turns against the stator."""
    figure = rn.StickFigure()
    figure.rod("stator", [(0, 0, 0), (0.1, 0, 0)], edges=3, material=MATERIAL, radius=R)
    figure.rod("rotor", ["stator.end", (0.2, 0, 0)], edges=3, material=MATERIAL, radius=R)
    for between in (("stator:2-3", "rotor:0-1"), ("rotor:0-1", "stator:2-3")):
        terms = [rn.Motor(between=between, rpm=60.0), rn.KelvinVoigt(bend=0.1, twist=0.1)]
        clamp = rn.Clamp(at="stator.start")
        traj = rn.Simulation(rn.Robot(figure.build(), [*elastic(), clamp, *terms]), 0.01).run(1.5)
        lost = 0.1 * np.pi / 2 * R**4 * MATERIAL.G / (0.1 / 3) * (2 * np.pi) ** 2  # were it an idle joint
        assert np.abs(traj.powers["damping"][-1]) < 1e-9 * lost
        assert traj.w[-1, -1] == pytest.approx(2 * np.pi, rel=1e-6)


def test_a_driven_curvature_is_damped_against_its_natural_shape():
    """A light rod that follows its natural curvature freely loses next to nothing."""
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (L, 0, 0)], edges=8, material=rn.Material(E=1e7, rho=1e-3), radius=R)
    wave = rn.CurvatureWave(amplitude=5.0, wavelength=1e3, frequency=1.0)
    robot = rn.Robot(figure.build(), [*elastic(), wave, rn.KelvinVoigt(bend=0.1), rn.Clamp(at="rod.start")])
    idle = 0.1 * EI * L * (5.0 * 2 * np.pi) ** 2
    traj = rn.Simulation(robot, 0.01).run(0.4)
    assert np.abs(traj.powers["damping"][5:]).max() < 1e-3 * idle
    assert np.ptp(traj.x[:, -1, :], axis=0).max() > 0.1 * L
