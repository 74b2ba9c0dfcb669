"""Drag laws on random robots: derivatives, dissipation, objectivity, compiled twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

import rodnet as rn
from rodnet.testing import Probe
from rodnet.testing.states import random_rotation
from rodnet.testing.strategies import generators, probes, robots

few = settings(deadline=None, max_examples=30)


class Quadratic(rn.DragModel):
    """f = -c |v| v, differenced by the framework."""

    c = rn.Parameter(3.0, unit="N s^2/m^3", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}

    def force(self, site, p):
        return -p.c * rn.norm(site.v) * site.v


class QuadraticAcross(rn.DragModel):
    """Drag of the flow across the rod, f = -c |w| w with w = v - (v.t) t, with derivatives."""

    c = rn.Parameter(3.0, unit="N s^2/m^3", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}

    def force(self, site, p):
        across = site.v - rn.dot(site.v, site.tangent) * site.tangent
        return -p.c * rn.norm(across) * across

    def jacobian(self, site, p):
        v, t = site.v, site.tangent
        vt = rn.dot(v, t)
        w = v - vt * t
        speed = np.maximum(rn.norm(w), 1e-300)
        by_w = -p.c * speed
        by_w = (
            by_w[:, :, None] * np.eye(3) - np.asarray(p.c / speed)[:, :, None] * w[:, :, None] * w[:, None, :]
        )
        dw_dv = np.eye(3) - t[:, :, None] * t[:, None, :]
        dw_dt = -vt[:, :, None] * np.eye(3) - t[:, :, None] * v[:, None, :]
        return {"v": by_w @ dw_dv, "tangent": by_w @ dw_dt, "x": np.zeros((len(v), 3, 3))}


@njit
def linear_across(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    along = v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]
    for i in range(3):
        f[i] = -p[0] * radius * (v[i] - along * tangent[i])
        for j in range(3):
            dfdv[i, j] = p[0] * radius * tangent[i] * tangent[j]
            dfdtangent[i, j] = p[0] * radius * tangent[i] * v[j]
        dfdv[i, i] -= p[0] * radius
        dfdtangent[i, i] += p[0] * radius * along


class LinearAcross(rn.DragModel):
    """f = -c r (v - (v.t) t), with a compiled twin."""

    c = rn.Parameter(200.0, unit="Pa s/m", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}
    kernel = linear_across

    def force(self, site, p):
        return -p.c * site.radius[:, None] * (site.v - rn.dot(site.v, site.tangent) * site.tangent)


class Layered(rn.DragModel):
    """Linear drag of a medium that is thicker below, f = -c exp(-z/h) v: depends on the place."""

    c = rn.Parameter(1.0, unit="Pa s", bounds=(0, None), null=0.0)
    h = rn.Parameter(0.05, unit="m", bounds=(1e-6, None), kind="shape")
    claims = {"dissipative"}

    def force(self, site, p):
        return -p.c * np.exp(-site.x[:, 2:] / p.h) * site.v


class Bristles(rn.DragModel):
    """Friction with pre-sliding: an elastic bristle per site that gives way at a yield force."""

    k = rn.Parameter(2e3, unit="N/m^2", bounds=(0, None), null=0.0)
    reach = rn.Parameter(1e-3, unit="m", bounds=(1e-9, None), kind="shape")
    memory_size = 3
    claims = {"dissipative", "objective"}

    def update(self, site, p, m_old):
        bristle = m_old + site.v * site.dt
        bristle = bristle / np.maximum(1.0, rn.norm(bristle) / p.reach)
        return -p.k * bristle, bristle


def stokes(**options):
    return lambda: [rn.StokesHead(at="r0:1", **options)]


def resistance():
    rng = np.random.default_rng(7)
    A = rng.normal(size=(6, 6)) * np.repeat([0.3, 0.01], 3)
    skew = np.outer(A[0], A[1])
    return A.T @ A + skew - skew.T


GIVEN = {
    "half edges": lambda: [rn.ResistiveForce(viscosity=2.0)],
    "node tangents": lambda: [rn.ResistiveForce(viscosity=2.0, tangent="node")],
    "axial torque": lambda: [rn.ResistiveForce(viscosity=2.0, axial_torque=True, length=0.2)],
    "coefficients": lambda: [rn.ResistiveForce(eta_t=1.0, eta_n=3.0)],
    "sphere": stokes(viscosity=2.0, radius=0.02, C1=2.4, C2=0.04),
    "6 x 6": stokes(resistance=resistance()),
    "with jacobian": lambda: [QuadraticAcross()],
    "with kernel": lambda: [LinearAcross()],
    "kernel at nodes": lambda: [LinearAcross(tangent="node")],
}
DIFFERENCED = {
    "plain": lambda: [Quadratic()],
    "plain at nodes": lambda: [Quadratic(tangent="node")],
    "by place": lambda: [Layered()],
    "memory": lambda: [Bristles()],
}
LAWS = GIVEN | DIFFERENCED


def remember(probe):
    """Give laws with memory a history."""
    for b in probe.model.bound:
        if b.memory is not None:
            for _ in range(3):
                b.restore(probe.model, b.next_memory(probe.evaluate()))


@given(data=st.data(), law=st.sampled_from(sorted(LAWS)))
@settings(deadline=None, max_examples=70)
def test_jacobian_is_the_derivative_of_the_force(data, law):
    probe = data.draw(probes(LAWS[law], rods=(1, 4)))
    remember(probe)
    for error, where in probe.jacobian_errors().values():
        assert error < (1e-6 if law in GIVEN else 1e-5), where


@given(data=st.data(), law=st.sampled_from(sorted(set(LAWS) - {"memory"})))
@settings(deadline=None, max_examples=80)
def test_power_is_never_positive(data, law):
    probe = data.draw(probes(LAWS[law]))
    F = probe.forces()
    assert F @ probe.v <= 1e-13 * np.abs(F) @ np.abs(probe.v)
    assert F @ probe.v < 0.0


@given(data=st.data(), law=st.sampled_from(sorted(set(LAWS) - {"by place"})))
@few
def test_drag_turns_with_the_robot(data, law):
    probe, rng = data.draw(probes(LAWS[law])), data.draw(generators())
    R = random_rotation(rng)
    F, turned = probe.forces(), probe.rotated(R, rng.normal(size=3)).forces()
    assert np.abs(turned - probe.turn_vector(F, R)).max() <= 1e-11 * np.abs(F).max()


@given(robot=robots(lambda: [rn.Stretching(), rn.Bending(), rn.Twisting(), Bristles()]), rng=generators())
@few
def test_a_medium_with_memory_returns_no_more_than_it_stored(robot, rng):
    """The work of elastoplastic friction along any path from a fresh state is negative."""
    probe = Probe(rn.Robot(robot.graph, [Bristles()]), rng)
    bound, model, work, spent = probe.model.bound[0], probe.model, 0.0, 0.0
    rate, phase = rng.uniform(5.0, 50.0, len(probe.v)), rng.uniform(0.0, 6.0, len(probe.v))
    for k in range(60):
        v = probe.v * np.sin(rate * k * probe.dt + phase)
        ev = probe.evaluate(v=v)
        power = float(bound.forces(ev) @ v)
        work, spent = work + power * probe.dt, spent + abs(power) * probe.dt
        bound.restore(model, bound.next_memory(ev))
        assert work <= 1e-12 * spent


@given(data=st.data(), tangent=st.sampled_from(["edge", "node"]))
@few
def test_compiled_twin_equals_the_law(data, tangent):
    class Plain(LinearAcross):
        kernel = None

    probe = data.draw(probes(lambda: [LinearAcross(tangent=tangent)]))
    other = Probe(rn.Robot(probe.model.graph, [Plain(tangent=tangent)]), np.random.default_rng(0))
    other.q, other.v, other.source = probe.q, probe.v, probe.source
    F, J = probe.forces(), probe.jacobian(cv=3.0)
    assert np.abs(other.forces() - F).max() <= 1e-13 * np.abs(F).max()
    assert np.abs(other.jacobian(cv=3.0) - J).max() <= 1e-6 * np.abs(J).max()


def test_one_value_per_site_is_one_value_per_site():
    fig = rn.StickFigure()
    graph = fig.rod(
        "rod", [(0, 0, 0), (0.1, 0, 0)], edges=2, material=rn.Material(E=1e6), radius=3e-3
    ).build()
    for law in (Quadratic, LinearAcross):
        values = []
        for c in (2.0, [2.0, 2.0, 6.0, 6.0]):
            probe = Probe(rn.Robot(graph, [law(c=c)]), np.random.default_rng(0))
            values.append(probe.forces()[: probe.model.twist0].reshape(-1, 3))
        assert values[1][0] == pytest.approx(values[0][0])
        assert values[1][2] == pytest.approx(3.0 * values[0][2])
