"""Contact with walls: weight, Coulomb friction, the capstan, walls that no step can jump."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.testing import check_term

G = 9.81
ELASTIC = (rn.Stretching, rn.Bending, rn.Twisting)


def robot(points, *terms, edges=8, radius=2e-3, E=1e7, **options):
    """One rod with its elastic energies and the given terms."""
    figure = rn.StickFigure()
    figure.rod("rod", points, edges=edges, material=rn.Material(E=E, rho=1000.0), radius=radius, **options)
    return rn.Robot(figure.build(), [*(term() for term in ELASTIC), *terms])


def gaps(traj, name):
    """Gap of every site of a wall at every state [m]."""
    model = rn.Simulation(traj.robot).model
    bound = next(b for b in model.bound if b.term.name == name)
    return np.array([bound.gaps(np.ascontiguousarray(x)) for x in traj.x])


SLIDING = {"friction": 0.4, "slip": 0.05, "stiffness": 0.1}
AXIS = ((0, 0, -0.5), (1, 0.2, -0.5))
THIN = {"inside": False, "reach": 0.2, "rod_radius": 1e-3, "friction": 2.0}


@pytest.mark.parametrize(
    "wall",
    [
        rn.PlaneContact((0, 0, -0.1), reach=0.3, damping=2.0, **SLIDING),
        rn.PlaneContact((0, 0, -0.5), (0.3, 0.1, 1.0), reach=2.0, stiffness=0.1, friction=0.4, slip=1e-4),
        rn.TubeContact(AXIS, 0.9, reach=0.8, damping=1.0, **SLIDING),
        rn.TubeContact(AXIS, 0.1, inside=False, reach=0.9, damping=1.0, **SLIDING),
        rn.TubeContact(((0, 0, -0.1), (0.2, 1, -0.1)), 0.02, stiffness=0.2, **THIN),
    ],
)
def test_derivatives_of_walls(wall):
    """Also where the closest point is inside an edge, and where a rod sticks."""
    check_term(wall, states=4)


def test_rod_rests_on_a_plane():
    """The plane carries exactly the weight, at a distance below the reach."""
    made = robot([(0, 0, 2.1e-3), (0.1, 0, 2.1e-3)], rn.Gravity(), rn.PlaneContact((0, 0, 0)))
    traj = rn.equilibrium(made)
    carried = traj.term_forces("plane")[-1].sum(axis=0)
    assert carried == pytest.approx([0, 0, G * made.graph.node_mass.sum()], rel=1e-7, abs=1e-9)
    gap = gaps(traj, "plane")[-1]
    assert np.all(gap > 0.0) and np.all(gap < 2e-4)


def slope(angle, friction, **options):
    """A rod along an inclined plane that falls to the right."""
    normal = np.array([np.sin(angle), 0, np.cos(angle)])
    down = np.array([np.cos(angle), 0, -np.sin(angle)])
    points = [2.199e-3 * normal, 2.199e-3 * normal + 0.1 * down]
    return robot(points, rn.Gravity(), rn.PlaneContact((0, 0, 0), normal, friction=friction), **options), down


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_inclined_plane(stepper):
    """A rod sticks below the angle of friction, and above slides with g (sin a - mu cos a)."""
    angle, friction = np.radians(25.0), np.tan(np.radians(15.0))
    sliding, down = slope(angle, friction)
    mass = sliding.graph.node_mass
    traj = rn.Simulation(sliding, 5e-3, stepper=stepper).run(0.3)
    speed = (traj.v @ down) @ mass / mass.sum()
    half = len(traj) // 2
    found = (speed[-1] - speed[half]) / (traj.t[-1] - traj.t[half])
    assert found == pytest.approx(G * (np.sin(angle) - friction * np.cos(angle)), rel=1e-3)
    sticking, down = slope(angle, np.tan(np.radians(35.0)))
    traj = rn.Simulation(sticking, 5e-3, stepper=stepper).run(0.3)
    assert np.abs(traj.v[half:] @ down).max() < 1e-3  # the slip speed
    assert np.abs((traj.x[-1] - traj.x[0]) @ down).max() < 1e-3 * 0.3


def test_rod_rolls_down_a_slope():
    """Across the slope a solid cylinder that does not slip rolls with two thirds of g sin a."""
    angle, gap = np.radians(20.0), 1.999e-4
    normal = np.array([np.sin(angle), 0, np.cos(angle)])
    down = np.array([np.cos(angle), 0, -np.sin(angle)])
    start = (2e-3 + gap) * normal
    plane = rn.PlaneContact((0, 0, 0), normal, friction=0.8)
    made = robot([start, start + 0.05 * np.eye(3)[1]], rn.Gravity(), plane, edges=4)
    traj = rn.Simulation(made, 2e-3).run(0.2)
    speed, half = traj.v[:, 2] @ down, len(traj) // 2
    found = (speed[-1] - speed[half]) / (traj.t[-1] - traj.t[half])
    assert found == pytest.approx(2.0 / 3.0 * G * np.sin(angle), rel=5e-3)
    assert np.abs(traj.w[-1] * 2e-3) == pytest.approx(speed[-1], rel=0.01)


def test_sliding_rod_stops():
    """A rod thrown along a plane stops after v^2 / (2 mu g)."""
    friction, speed = 0.3, 1.0
    made = robot(
        [(0, 0, 2.1e-3), (0.1, 0, 2.1e-3)], rn.Gravity(), rn.PlaneContact((0, 0, 0), friction=friction)
    )
    velocity = np.tile([speed, 0.0, 0.0], (made.graph.node_count, 1))
    traj = rn.Simulation(made, 1e-3, velocity=velocity).run(0.45)
    assert np.abs(traj.v[-1]).max() < 1e-4
    way = (traj.x[-1] - traj.x[0])[:, 0].mean()
    assert way == pytest.approx(speed**2 / (2.0 * friction * G), rel=5e-3)


@pytest.mark.parametrize("inside", [True, False])
def test_walls_are_not_jumped(inside):
    """At 10 m/s and dt = 0.01 s a rod moves by many radii in a step, and stays on its side."""
    axis = ((0, 0, 0), (0, 1, 0))
    start = [(-0.02, 0, 0.02), (0.02, 0.03, 0.025)] if inside else [(-0.02, 0, 0.05), (0.02, 0.03, 0.05)]
    wall = rn.TubeContact(axis, 0.04 if inside else 0.02, inside=inside, friction=0.2)
    made = robot(start, wall, edges=4)
    velocity = np.tile([0.0, 0.0, -10.0], (made.graph.node_count, 1))
    traj = rn.Simulation(made, 1e-2, velocity=velocity).run(0.1)
    assert gaps(traj, "tube").min() > 0.0
    assert np.linalg.norm(traj.v[-1], axis=1).max() < 10.0


def test_capstan():
    """A rod drawn round a cylinder is held by exp(mu phi) times less."""
    R, radius, friction, hold, leg = 0.05, 5e-4, 0.3, 10.0, 0.08
    Rc = R + radius + 1e-5
    arc = np.linspace(np.pi, 0.0, 33)
    over = np.stack([Rc * np.cos(arc), 0 * arc, Rc * np.sin(arc)], axis=1)
    down = np.linspace(leg, 0.0, 9)[:-1, None] * [0, 0, -1.0]
    points = np.vstack([down + over[0], over, down[::-1] + over[-1]])
    # corners of the polygon outwards, so that edges stay clear of the cylinder
    points[:, [0, 2]] *= 1.0 / np.cos(0.5 * np.pi / 32)
    figure = rn.StickFigure()
    figure.rod("rod", points, material=rn.Material(E=1e9, rho=1000.0), radius=radius, natural="straight")
    made = rn.Robot(
        figure.build(),
        [
            *(term() for term in ELASTIC),
            rn.TubeContact(((0, 0, 0), (0, 1, 0)), R, inside=False, friction=friction),
            rn.PointForce(at="rod.start", force=(0, 0, -hold)),
            rn.PrescribedMotion(at="rod.end", position=lambda t: np.array([0, 0, -0.1 * t])),
        ],
    )
    traj = rn.Simulation(made, 5e-3).run(0.3)
    tension = traj.internal.tension[-1]
    assert tension[0] == pytest.approx(hold, rel=1e-2)
    assert tension[-1] / tension[0] == pytest.approx(np.exp(friction * np.pi), rel=0.02)


@pytest.mark.parametrize("inner", [0.02, 2.1e-3])
def test_rod_on_the_axis_of_a_tube(inner):
    """On the axis no direction is outward and nothing pushes, in a narrow tube as in a wide one; off it the rod is
    kept inside.
    """
    made = robot([(0, 0, 0), (0.1, 0, 0)], rn.TubeContact(((0, 0, 0), (1, 0, 0)), inner, friction=0.3))
    still = rn.Simulation(made, 1e-2).run(0.05)
    assert np.abs(still.x - still.x[0]).max() < 1e-15
    traj = rn.Simulation(rn.Robot(made.graph, [*made.terms, rn.Gravity()]), 1e-2).run(0.1)
    assert gaps(traj, "tube").min() > 0.0
    assert traj.term_forces("tube")[-1, :, 2].sum() > 0.0


def test_restart_with_contact(tmp_path):
    """A run continued from a file equals the uninterrupted one bit for bit, sliding included."""
    made, _ = slope(np.radians(25.0), 0.2)
    sim = rn.Simulation(made, 5e-3, stepper="sdirk2")
    sim.run(0.05, out=tmp_path / "half.nc")
    whole = sim.run(0.05)
    other = rn.Simulation(made, 5e-3, stepper="sdirk2")
    other.restore(rn.Trajectory.load(tmp_path / "half.nc", made).state(-1))
    assert np.array_equal(other.run(0.05).x[-1], whole.x[-1])


def test_bad_walls():
    with pytest.raises(rn.TermError, match=r"normal is zero"):
        rn.PlaneContact((0, 0, 0), (0, 0, 0))
    with pytest.raises(rn.TermError, match=r"two points of the axis are the same"):
        rn.TubeContact(((0, 0, 0), (0, 0, 0)), 0.1)
    with pytest.raises(rn.TermError, match=r"node 'rod:0' begins 0.001 m behind the wall"):
        robot([(0, 0, 1e-3), (0.1, 0, 3e-3)], rn.PlaneContact((0, 0, 0)))
    tube = ((0, 0, 0), (1, 0, 0))
    with pytest.raises(
        rn.TermError, match=r"reach of 0.02 m is longer than the clearance of 0.018 m between .*rod:"
    ):
        robot([(0, 0, 0), (0.1, 0, 0)], rn.TubeContact(tube, 0.02, reach=0.02))
    with pytest.raises(rn.TermError, match=r"of radius 0.002 m does not fit into the tube of radius 0.002 m"):
        robot([(0, 0, 0), (0.1, 0, 0)], rn.TubeContact(tube, 0.002))
