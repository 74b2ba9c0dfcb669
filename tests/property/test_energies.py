"""Elastic energies on random robots in random states far from rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rodnet as rn
from rodnet.testing import Probe, taylor_slope
from rodnet.testing.states import random_rotation
from rodnet.testing.strategies import generators, probes

few = settings(deadline=None, max_examples=30)


class Stiffening(rn.EnergyModel):
    """Bending that stiffens, psi = 1/2 EI |k|^2 + 1/4 b |k|^4: its second derivative is a full matrix."""

    strain = "curvature"
    b = rn.Parameter(1e-7, unit="N m^4", bounds=(0, None), null=0.0)

    def psi(self, strain, p):
        k, b = strain.kappa, np.broadcast_to(np.ravel(p.b), len(strain.kappa))
        square = np.sum(k**2, axis=1)
        second = (b * square)[:, None, None] * np.eye(2) + 2.0 * b[:, None, None] * k[:, :, None] * k[
            :, None, :
        ]
        return 0.25 * b * square**2, (b * square)[:, None] * k, second


class Softening(rn.EnergyModel):
    """Twist that gives way, psi = GJ c (1 - cos(tau / c))."""

    strain = "twist"
    c = rn.Parameter(80.0, unit="rad/m", bounds=(1.0, None), kind="shape")

    def psi(self, strain, p):
        a, c = strain.tau / np.ravel(p.c), np.ravel(p.c)
        return strain.GJ * c**2 * (1 - np.cos(a)), strain.GJ * c * np.sin(a), strain.GJ * np.cos(a)


class Gas(rn.EnergyModel):
    """A stretch law that resists collapse, psi = EA (eps - ln(1 + eps))."""

    strain = "stretch"

    def psi(self, strain, p):
        e, EA = strain.eps, strain.EA
        return EA * (e - np.log1p(e)), EA * e / (1 + e), EA / (1 + e) ** 2


LAWS = {
    "stretching": lambda: [rn.Stretching()],
    "bending": lambda: [rn.Bending()],
    "twisting": lambda: [rn.Twisting()],
    "all": lambda: [rn.Stretching(), rn.Bending(), rn.Twisting()],
    "own laws": lambda: [Gas(), Stiffening(), Softening()],
}


@given(data=st.data(), law=st.sampled_from(sorted(LAWS)))
@settings(deadline=None, max_examples=100)
def test_force_and_hessian_are_the_derivatives_of_the_energy(data, law):
    probe = data.draw(probes(LAWS[law]))
    error, where = probe.jacobian_errors()["position"]
    assert error < 1e-6, where
    J = probe.jacobian()
    assert np.abs(J - J.T).max() <= 1e-12 * np.abs(J).max()
    # Taylor: a wrong gradient would leave a slope of 1, a wrong Hessian one of 2. In the mean of both sides the right
    # one leaves 4: of one side the cubic and quartic terms may cancel at steps that stand out of rounding
    rng = data.draw(generators())
    d = probe.units * rng.normal(size=len(probe.q))
    d *= 1e-2 / np.abs(d / probe.units).max()
    energy, slope, curvature = probe.energy(), -probe.forces() @ d, d @ J @ d
    values = lambda h: probe.energy(probe.q + h * d)  # noqa: E731
    mean = lambda h: 0.5 * (values(h) + values(-h))  # noqa: E731
    assert taylor_slope(values, [energy, slope], largest=1.0) > 1.5
    assert taylor_slope(mean, [energy, 0.0, 0.5 * curvature], largest=1.0) > 2.5


@given(probe=probes(LAWS["all"]), rng=generators())
@few
def test_rigid_motions_change_no_energy_and_rotate_forces(probe, rng):
    R, shift = random_rotation(rng), rng.normal(size=3)
    energy, forces = probe.energy(), probe.forces()
    other = probe.rotated(R, shift)
    assert other.energy() == pytest.approx(energy, rel=1e-11)
    assert np.abs(other.forces() - probe.turn_vector(forces, R)).max() <= 1e-10 * np.abs(forces).max()


@given(data=st.data(), law=st.sampled_from(sorted(LAWS)))
@few
def test_elastic_forces_and_moments_sum_to_zero(data, law):
    probe = data.draw(probes(LAWS[law]))
    F = probe.forces()
    force, moment = probe.resultant(F)
    x = probe.q[: probe.model.twist0].reshape(-1, 3)
    arm = np.linalg.norm(np.ptp(x, axis=0)) + np.abs(x).max()
    size = np.abs(F).sum()
    assert np.abs(force).max() <= 1e-12 * size
    assert np.abs(moment).max() <= 1e-11 * size * max(arm, probe.length)


@given(rng=generators(), angle=st.floats(-20.0, 20.0), flipped=st.booleans())
@few
def test_a_motor_turns_the_stiffness_of_an_elliptic_rotor_with_it(rng, angle, flipped):
    """A bent rotor that turns about its axis keeps its energy, if the stator's section is round."""
    fig = rn.StickFigure()
    material = rn.Material(E=1e6)
    points = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)]
    fig.rod("stator", [(-0.1, 0.0, 0.0), (0.0, 0.0, 0.0)], edges=2, material=material, radius=3e-3)
    if flipped:
        fig.rod(
            "rotor",
            [points[1], (0.05, 0.0, 0.0), "stator.end"],
            material=material,
            section=rn.elliptic(4e-3, 2e-3),
        )
        between = ("stator:1-2", "rotor:1-2")
    else:
        fig.rod(
            "rotor", ["stator.end", points[1]], edges=2, material=material, section=rn.elliptic(4e-3, 2e-3)
        )
        between = ("stator:1-2", "rotor:0-1")
    graph = fig.build()
    rotor = graph.rods["rotor"]
    bend = np.zeros((graph.node_count, 3))
    bend[np.setdiff1d(rotor.nodes, graph.nodes("stator")), 1:] = 0.01 * rng.normal(size=(2, 2))
    energies = []
    for turned in (0.0, angle):
        terms = [rn.Stretching(), rn.Bending(), rn.Twisting()]
        robot = rn.Robot(graph, [*terms, rn.Motor(between=between, angle=lambda t, turned=turned: turned)])
        model = rn.Simulation(robot).model
        for b in model.bound:
            b.begin_step(model, 1.0, 1.0, {}, {})
        R = rn.kinematics.frames.rotation(np.array([turned, 0.0, 0.0]))
        q = np.zeros(model.dof_count)
        q[: model.twist0] = (graph.x0 + bend @ R.T).ravel()
        q[model.twist0 + rotor.edges] = -turned if flipped else turned
        ev = rn.solve.evaluation.Evaluation(model)
        assert ev.update(q, np.zeros_like(q), 0.0, 1.0, 0.0, False)
        energies.append(sum(b.energy(ev) for b in model.bound))
    # the reference frame of a bent rotor is transported, which a turn about the stator's axis does not disturb
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


def test_the_taylor_test_sees_a_wrong_hessian():
    rng = np.random.default_rng(0)
    probe = Probe(rn.Robot(_rod(), [rn.Stretching(), rn.Bending(), rn.Twisting()]), rng)
    d = 1e-2 * probe.units * rng.uniform(-1.0, 1.0, len(probe.q))
    energy, slope, curvature = probe.energy(), -probe.forces() @ d, d @ probe.jacobian() @ d
    values = lambda h: probe.energy(probe.q + h * d)  # noqa: E731
    assert taylor_slope(values, [energy, slope, 0.51 * curvature], largest=1.0) == pytest.approx(2.0, abs=0.3)
    assert taylor_slope(values, [energy, 1.01 * slope], largest=1.0) == pytest.approx(1.0, abs=0.3)


def _rod():
    fig = rn.StickFigure()
    return fig.rod(
        "rod", [(0, 0, 0), (0.1, 0, 0), (0.15, 0.05, 0)], edges=5, material=rn.Material(E=1e6), radius=3e-3
    ).build()
