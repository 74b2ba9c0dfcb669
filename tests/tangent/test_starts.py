"""Derivatives by where a run begins, where terms remember it or are defined by it; and by the last state."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn

RUBBER = rn.Material(E=1e6, nu=0.5, rho=1000.0)
LAWS = {
    "maxwell": rn.MaxwellMedium(modulus=5.0, time=0.3),
    "friction": rn.DryFriction(moment=2e-5, curvature=2.0),
    "set": rn.PlasticSet(share=0.5, time=0.1),
    "earlier": rn.EarlierSet(share=0.5),
    "head": rn.StokesHead(
        at="rod.start", edge="rod:0-1", shape=np.diag([1.0, 5, 5, 1, 1, 1]), viscosity=1e-3
    ),
}


def robot(law, x=None):
    fig = rn.StickFigure()
    s = np.linspace(0.0, 1.0, 6)
    fig.rod(
        "rod",
        list(0.2 * np.stack([s, 0.3 * s**2, 0.0 * s], axis=1)),
        material=RUBBER,
        radius=3e-3,
        natural="straight",
    )
    graph = fig.build()
    graph = graph if x is None else graph.with_positions(x)
    return rn.Robot(graph, [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.MassDamping(rate=2.0), law])


@pytest.mark.parametrize("name", LAWS)
def test_a_start_elsewhere_changes_what_is_remembered_of_it(name):
    """Against runs of robots that are posed so."""
    plain = robot(LAWS[name])
    x0 = plain.graph.x0
    bend = np.zeros_like(x0)
    bend[:, 2] = (x0[:, 0] / 0.2) ** 2
    options = {"dt": 0.01, "tolerance": rn.Tolerance(residual=1e-12, update=1e-14, iterations=60)}
    found = rn.sensitivities(plain, 0.2, initial={"bend": {"x": bend}}, **options)
    step = 1e-5
    ends = [rn.Simulation(robot(LAWS[name], x0 + h * bend), **options).run(0.2).x[-1] for h in (step, -step)]
    quotient = (ends[0] - ends[1]) / (2.0 * step)
    mine = found.x[-1, ..., 0]
    np.testing.assert_allclose(mine, quotient, atol=2e-3 * np.abs(quotient).max())


@pytest.mark.parametrize(("duration", "every"), [(0.104, 4), (0.1, 4), (0.12, 4), (0.096, 1)])
def test_the_last_state_has_its_own_derivative(duration, every):
    """A duration need not be steps, nor these multiples of those that are kept."""
    found = rn.sensitivities(
        robot(rn.Gravity()), duration, parameters=["rod.E"], observe={"tip": lambda view: view.x[-1]}, dt=0.01,
        save_every=every,
    )  # fmt: skip
    assert len(found.x) == len(found.trajectory) == len(found.outputs["tip"])
    tip = found.x[-1, 5, :, 0]
    np.testing.assert_allclose(found.outputs["tip"][-1][:, 0], tip, rtol=1e-6, atol=1e-12)
    whole = rn.sensitivities(robot(rn.Gravity()), duration, parameters=["rod.E"], dt=0.01, save_every=1)
    np.testing.assert_allclose(tip, whole.x[-1, 5, :, 0], rtol=1e-9)
