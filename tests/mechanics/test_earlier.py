"""What a rod had been through before: it stays in the shape that it took on, with its loads if it bears them."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.statics import bearing_strains

E, R, RHO = 4e7, 3e-3, 1100.0
ELASTIC = rn.Stretching, rn.Bending, rn.Twisting
RUBBER = rn.Material(E=E, nu=0.5, rho=RHO)
EI = E * np.pi * R**4 / 4


def cable(*terms, branch=True):
    """Held by a gripper at both ends, bent out of every plane, with a branch to its side."""
    s = np.linspace(0.0, 1.0, 21)
    line = 0.6 * np.stack([s, 0.15 * np.sin(2.0 * np.pi * s), -0.3 * np.sin(np.pi * s)], axis=1)
    fig = rn.StickFigure()
    fig.rod("cable", list(line), material=RUBBER, radius=R, natural="straight")
    if branch:
        along = np.linspace(0.0, 1.0, 6)[1:, None]
        tip = line[8] + along * np.array([0.02, 0.12, -0.05]) + along**2 * np.array([0.03, 0.0, 0.04])
        fig.rod("branch", ["cable:8", *tip], material=RUBBER, radius=R, natural="straight")
    held = [rn.Clamp(at="cable.start"), rn.Clamp(at="cable.end")]
    return rn.Robot(fig.build(), [*(law() for law in ELASTIC), rn.Gravity(g=9.81), *held, *terms])


def moved(*terms):
    """Largest distance that the cable goes from its start within a second, while losses let it come to rest."""
    traj = rn.Simulation(cable(*terms, rn.MassDamping(rate=3.0)), 0.01, stepper="sdirk2").run(1.0)
    return np.linalg.norm(traj.x - traj.x[0], axis=2).max()


def test_a_cable_that_bears_its_weight_stays_where_it_begins():
    """A set alone lets it sag by centimetres; less what bears the weight, it gives by its axial strain alone."""
    alone = moved(rn.EarlierSet(share=1.0))
    assert alone > 0.01
    borne = moved(rn.EarlierSet(share=1.0), rn.BalancedStart(part=1.0))
    assert borne < 0.01 * alone
    half = moved(rn.EarlierSet(share=1.0), rn.BalancedStart(part=0.5))
    assert half == pytest.approx(0.5 * alone, rel=0.1)


def test_moments_at_the_start_are_those_of_a_beam_between_walls():
    """w L^2/12 at the walls and -w L^2/24 in the middle: of all that hold the weight the ones of least energy."""
    length, edges = 0.4, 80
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (length, 0, 0)], edges=edges, material=RUBBER, radius=R)
    held = [rn.Clamp(at="beam.start"), rn.Clamp(at="beam.end")]
    robot = rn.Robot(fig.build(), [*(law() for law in ELASTIC), rn.Gravity(g=9.81), *held])
    model = rn.Simulation(robot, 0.01).model
    strain = bearing_strains(robot)
    moment = np.linalg.norm(np.einsum("nij,nj->ni", model.spring_stiffness, strain), axis=1)
    weight = RHO * np.pi * R**2 * 9.81
    inner = [n for n in range(model.spring_count) if model.edge1[n] < edges > model.edge2[n]]
    x = model.x0[model.spring_node[inner], 0]
    expected = weight / 12.0 * (6.0 * length * x - length**2 - 6.0 * x**2)
    assert moment[inner] == pytest.approx(np.abs(expected), abs=2e-3 * weight * length**2)
    wall = np.setdiff1d(np.arange(model.spring_count), inner)
    # a wall's spring is that of half an edge; there the moment is that of its node
    assert moment[wall] == pytest.approx(weight * length**2 / 12.0, rel=0.02)


def test_what_nothing_holds_bears_nothing():
    """A rod that falls has no moments."""
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=RUBBER, radius=R)
    laws = [*(law() for law in ELASTIC), rn.Gravity(g=9.81)]
    held = bearing_strains(rn.Robot(fig.build(), [*laws, rn.Clamp(at="rod.start")]))
    assert np.abs(held).max() > 1e-3
    falling = bearing_strains(rn.Robot(fig.build(), laws))
    assert np.abs(falling).max() < 1e-4 * np.abs(held).max()
