"""A thread that is tied to a rod pulls as a spring does, wherever the mesh has its nodes."""

import numpy as np
import pytest

import rodnet as rn

LENGTH, RADIUS, E = 0.2, 2e-3, 1e7
EI = E * np.pi * RADIUS**4 / 4.0


def beam(edges, *terms):
    fig = rn.StickFigure()
    fig.rod(
        "rod", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=rn.Material(E=E, nu=0.5, rho=1000.0), radius=RADIUS
    )  # fmt: skip
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="rod.start")]
    return rn.Robot(fig.build(), [*elastic, *terms])


@pytest.mark.parametrize("place", [0.5, 0.61])
def test_a_cantilever_on_a_spring(place):
    """The spring takes a share: deflection F / (k + 3 EI / a^3) at the place a that it is tied to (Euler-Bernoulli)."""
    a, k, F = place * LENGTH, 0.3, 2e-4
    thread = rn.Tether(on="rod", stiffness=k, fz=-F, place=place, width=0.005, point=(a, 0.0, 0.0))
    robot = beam(40, thread)
    state = rn.equilibrium(robot)
    seen = rn.observe([rn.Markers(robot, [f"rod@{100 * place}%"])], state, state.t[-1:])[0][0, 0]
    assert seen[2] == pytest.approx(-F / (k + 3.0 * EI / a**3), rel=5e-3)


def test_the_anchor_is_where_the_pull_ends():
    """A hook at p pulls as F = k p does about the origin."""
    hook = np.array([0.1, 0.02, 0.05])
    one = rn.Tether(on="rod", stiffness=0.2, point=hook)
    other = rn.Tether(on="rod", stiffness=0.2, **dict(zip(("fx", "fy", "fz"), 0.2 * hook, strict=True)))
    shapes = [rn.equilibrium(beam(12, law)).x[-1] for law in (one, other)]
    np.testing.assert_allclose(*shapes, rtol=0.0, atol=1e-10)
    assert shapes[0][6, 2] > 0.002


def test_what_it_pulls_with_is_the_same_on_every_mesh():
    tips = [
        rn.equilibrium(beam(n, rn.Tether(on="rod", fz=2e-4, place=0.63, width=0.1))).x[-1, -1, 2]
        for n in (10, 20, 40, 80)
    ]
    steps = np.abs(np.diff(tips))
    assert steps[-1] < 2e-3 * tips[-1]
    assert steps[0] / steps[-1] > 8.0  # second order


def test_a_thread_has_one_rod():
    fig = rn.StickFigure()
    for name, y in (("a", 0.0), ("b", 0.1)):
        fig.rod(name, [(0, y, 0), (0.1, y, 0)], edges=4, material=rn.Material(E=E, rho=1000.0), radius=RADIUS)
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    with pytest.raises(rn.TermError, match="tied to one rod, not to a, b; give on="):
        rn.Robot(fig.build(), [*elastic, rn.Tether(stiffness=1.0)])
    with pytest.raises(rn.TermError, match="must be a place"):
        rn.Tether(on="a", point=(0, 0))
