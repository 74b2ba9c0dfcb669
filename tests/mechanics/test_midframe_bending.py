"""Bending in the frame half way between two edges: the same at any twist."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import EI, GJ, MATERIAL, L, R, order


def beam(edges, *terms, law):
    """A straight rod with a law of bending."""
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    return rn.Robot(fig.build(), [rn.Stretching(), law(), rn.Twisting(), *terms])


def test_contract():
    rn.testing.check_term(rn.MidframeBending)


@pytest.mark.parametrize("twist", [0.0, 0.5, 2.0, 3.0])
def test_bending_energy_does_not_depend_on_twist(twist):
    """Two edges bent by phi about an axis across: 1/2 EI/l (2 tan(phi/2))^2 whatever the twist between them."""
    phi = 0.3
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (L, 0, 0), (2 * L, 0, 0)], material=MATERIAL, radius=R)
    graph = fig.build()
    bent = graph.with_positions([(0, 0, 0), (L, 0, 0), (L + L * np.cos(phi), L * np.sin(phi), 0)])
    found = {}
    for law in (rn.Bending, rn.MidframeBending):
        sim = rn.Simulation(rn.Robot(bent, [rn.Stretching(), law()]), 1.0)
        q = sim.state.q.copy()
        q[-1] = twist
        ev = sim.newton.ev
        ev.update(q, 0 * q, 0.0, 1.0, 0.0, False)
        found[law] = sim.model.bound[1].energy(ev)
    theory = 0.5 * EI / L * (2.0 * np.tan(0.5 * phi)) ** 2
    assert found[rn.MidframeBending] == pytest.approx(theory, rel=1e-10)
    assert found[rn.Bending] == pytest.approx(theory * np.cos(0.5 * twist) ** 2, rel=1e-10)


def critical_torque(law, n):
    """Torque at which a straight rod that is clamped at both ends and twisted loses its stability [N m]."""
    sim = rn.Simulation(beam(n, rn.Clamp(at="beam.start"), rn.Clamp(at="beam.end", name="far"), law=law), 1.0)
    model, ev = sim.model, sim.newton.ev
    last = model.ghosts[-1].edge

    def lowest(twist):
        q = sim.state.q.copy()
        q[model.twist0 : model.twist0 + n] = twist * (np.arange(n) + 0.5) / n
        q[model.twist0 + last] = -twist  # it points the other way
        ev.update(q, 0 * q, 0.0, 1.0, 0.0, True)
        assert np.abs(ev.stress[:, 2]) == pytest.approx(GJ * twist / L, rel=1e-9)
        return np.linalg.eigvalsh(model.jacobian().toarray())[0]

    low, high = 0.0, 30.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if lowest(middle) > 0.0 else (low, middle)
    return GJ * low / L


def test_a_twisted_rod_buckles_where_theory_says():
    """Between clamps at 2.861 pi EI / L (Greenhill 1883), and on coarse meshes far nearer to it than `Bending`."""
    theory, sizes = 2.8606 * np.pi * EI / L, (20, 40)
    averaged, even = (
        [critical_torque(law, n) / theory - 1.0 for n in sizes] for law in (rn.Bending, rn.MidframeBending)
    )
    assert order(sizes, averaged) == pytest.approx(2.0, abs=0.3)
    assert order(sizes, even) == pytest.approx(2.0, abs=0.4)
    assert abs(even[0]) < 0.25 * abs(averaged[0])
