"""A clamped beam against Euler-Bernoulli, the elastica and Saint-Venant torsion."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import (
    EA,
    EI,
    GJ,
    MATERIAL,
    WEIGHT,
    E,
    L,
    R,
    beam,
    elastic,
    elastica,
    end,
    order,
    rest,
)

CLAMP = rn.Clamp(at="beam.start")
FINE = (32, 64, 128)


def test_own_weight_small_load():
    g = 1e-3 * 8.0 * EI / (WEIGHT * L**3)  # sags by a thousandth of its length
    theory = WEIGHT * g * L**4 / (8.0 * EI)
    sizes = (8, 16, 32, 64)
    sags = [-end(rest(beam(n, rn.Gravity(g=g), CLAMP)), "beam.end")[2] for n in sizes]
    errors = np.array(sags) / theory - 1.0
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 3e-4


def test_own_weight_elastica():
    """Twenty times EI / L^3 of weight: the tip hangs 0.83 L below the clamp."""
    w = 20.0 * EI / L**3
    x, z, moment = elastica(lambda s: w * (L - s))
    assert z < -0.8 * L
    errors, moments = [], []
    for n in FINE:
        traj = rest(beam(n, rn.Gravity(g=w / WEIGHT), CLAMP))
        errors.append(np.linalg.norm(end(traj, "beam.end") - (x, 0.0, z)) / L)
        moments.append(-traj.reactions["clamp"].moment[-1, 1] / moment - 1.0)
    assert order(FINE, errors) > 1.85
    assert errors[-1] < 6e-5
    assert order(FINE, moments) > 1.7 and abs(moments[-1]) < 1e-4


@pytest.mark.parametrize("load", [3.0, 10.0])
def test_end_force_elastica(load):
    P = load * EI / L**2
    x, z, _ = elastica(lambda s: np.full_like(s, P))
    if load == 10.0:  # Mattiasson's tables of the inextensible elastica
        assert (1.0 - x / L, -z / L) == pytest.approx((0.55500, 0.81061), abs=3e-4)
    errors = []
    for n in FINE:
        traj = rest(beam(n, rn.PointForce(at="beam.end", force=(0, 0, -P)), CLAMP))
        errors.append(np.linalg.norm(end(traj, "beam.end") - (x, 0.0, z)) / L)
    assert order(FINE, errors) > 1.85
    assert errors[-1] < 4e-5


def test_end_moment_bends_the_beam_into_an_arc():
    """A quarter of a circle: curvature M / EI everywhere."""
    M = EI * 0.5 * np.pi / L
    radius = L / (0.5 * np.pi)
    sizes = (16, 32, 64)
    errors = []
    for n in sizes:
        traj = rest(beam(n, rn.PointTorque(on="beam.end", torque=(0, -M, 0)), CLAMP))
        errors.append(np.linalg.norm(end(traj, "beam.end") - (radius, 0.0, radius)) / L)
        assert np.linalg.norm(traj.internal.moment[-1], axis=1) == pytest.approx(M, rel=1e-6)
    assert order(sizes, errors) > 1.9
    assert errors[-1] < 2e-4


@pytest.mark.parametrize("edges", [3, 16])
def test_end_torque_twists_evenly(edges):
    T = 1e-4
    traj = rest(beam(edges, rn.PointTorque(on="beam.end", torque=(T, 0, 0)), CLAMP))
    middle = (np.arange(edges) + 0.5) * L / edges
    assert traj.theta[-1] == pytest.approx(T * middle / GJ, abs=1e-10)
    assert traj.internal.torque[-1] == pytest.approx(T, rel=1e-9)
    assert traj.reactions["clamp"].moment[-1] == pytest.approx((-T, 0, 0), abs=1e-9 * T)


def test_torque_of_many_turns_is_counted():
    """Eight turns of end torque, in steps, on a rod that is held against writhing by a pull."""
    robot, state = None, None
    for turns in (2, 4, 6, 8):
        T = GJ * 2.0 * np.pi * turns / L
        pull = 4.0 * T**2 / (4.0 * EI)  # four times Greenhill's limit
        loads = [
            rn.PointTorque(on="beam.end", torque=(T, 0, 0)),
            rn.PointForce(at="beam.end", force=(pull, 0, 0)),
        ]
        robot = beam(16, *loads, CLAMP)
        traj = rest(robot, start=state)
        state = traj.state()
    assert traj.theta[-1, -1] == pytest.approx(16.0 * np.pi * 15.5 / 16.0, rel=1e-9)


def stepped(edges, *terms):
    """Two radii: the outer 40 % are half as thick."""
    figure = rn.StickFigure()
    radii = np.where(np.arange(10 * edges) < 6 * edges, R, 0.5 * R)
    figure.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=10 * edges, material=MATERIAL, radius=radii)
    return rn.Robot(figure.build(), [*elastic(), *terms, CLAMP])


def test_stepped_rod():
    inner, outer = 0.6 * L, 0.4 * L
    P = 1e-4 * EI / L**2
    theory = P * (16.0 * outer**3 + L**3 - outer**3) / (3.0 * EI)
    sizes = (1, 2, 4)
    sags = [
        -end(rest(stepped(n, rn.PointForce(at="beam.end", force=(0, 0, -P)))), "beam.end")[2] for n in sizes
    ]
    errors = np.array(sags) / theory - 1.0
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.02) and abs(errors[-1]) < 2e-3
    # torsion and stretching have no discretisation error: the step lies between two half edges
    T, N = 1e-5, 1e-2
    twisted = rest(stepped(1, rn.PointTorque(on="beam.end", torque=(T, 0, 0))))
    last = L / 20.0  # from the middle of the last edge to the end
    assert twisted.theta[-1, -1] == pytest.approx(T / GJ * (inner + 16.0 * (outer - last)), rel=1e-9)
    pulled = rest(stepped(1, rn.PointForce(at="beam.end", force=(N, 0, 0))))
    assert end(pulled, "beam.end")[0] - L == pytest.approx(N / EA * (inner + 4.0 * outer), rel=1e-9)


def test_elliptic_and_hollow_sections():
    """m1 is the direction of half axis a: a load along m1 bends the stiff way."""
    a, b = 3e-3, 1e-3
    P, n = 1e-6, 32
    sections = [
        (rn.elliptic(a, b), (0, 0, 1.0), np.pi / 4.0 * a**3 * b),
        (rn.elliptic(a, b), (0, 1.0, 0), np.pi / 4.0 * a * b**3),
        (rn.hollow(R, 0.8 * R), (0, 0, 1.0), np.pi / 4.0 * R**4 * (1.0 - 0.8**4)),
    ]
    for section, director, inertia in sections:
        robot = beam(
            n, rn.PointForce(at="beam.end", force=(0, 0, -P)), CLAMP, section=section, director=director
        )
        sag = -end(rest(robot), "beam.end")[2]
        assert sag == pytest.approx(P * L**3 / (3.0 * E * inertia), rel=1e-3)
    # a load between the axes bends sideways, too: unsymmetric bending
    robot = beam(
        n, rn.PointForce(at="beam.end", force=(0, 0, -P)), CLAMP,
        section=rn.elliptic(a, b), director=(0, 1.0, 1.0),
    )  # fmt: skip
    tip = end(rest(robot), "beam.end")
    stiff, soft = (P * np.sqrt(0.5) * L**3 / (3.0 * E * np.pi / 4.0 * i) for i in (a**3 * b, a * b**3))
    sideways = np.sqrt(0.5) * (soft - stiff)
    assert -tip[2] == pytest.approx(np.sqrt(0.5) * (soft + stiff), rel=1e-3)
    assert abs(tip[1]) == pytest.approx(sideways, rel=1e-3)


def test_clamp_direction_and_rod_direction_do_not_matter():
    P = (1e-3, 2e-3, -4e-3)
    tips = []
    for reverse in (False, True):
        points = [(0, 0, 0), (0.1, 0.02, 0), (0.18, 0.05, 0.03)]
        held, free = ("beam.end", "beam.start") if reverse else ("beam.start", "beam.end")
        robot = beam(
            14, rn.PointForce(at=free, force=P), rn.Clamp(at=held), points=points[:: -1 if reverse else 1]
        )
        tips.append(end(rest(robot), free))
    assert tips[0] == pytest.approx(tips[1], abs=1e-9)
