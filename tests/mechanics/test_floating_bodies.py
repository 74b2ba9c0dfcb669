"""Archimedes: what rigid bodies displace holds them up, about the centre of their volume."""

import numpy as np
import pytest
import trimesh

import rodnet as rn
from tests.same_robots import same_robots, through_a_file

G, RHO = 9.81, 1000.0


def box(density=RHO):
    mesh = trimesh.creation.box((0.06, 0.04, 0.03))
    mesh.apply_translation((0.01, 0.002, -0.003))
    mesh.density = density
    return mesh


def afloat(fluid=RHO, terms=(), **options):
    figure = rn.StickFigure()
    figure.rigid("hull", [(-0.02, 0, 0), (0, 0, 0), (0.04, 0, 0)], radius=5e-3)
    figure.body("hull", **options)
    return rn.Robot(figure.build(), [rn.Gravity(g=G, fluid_density=fluid), *terms])


def fall(robot, duration=0.2, **options):
    traj = rn.Simulation(robot, 1e-3, stepper="alpha", **options).run(duration)
    return traj.t, traj.x[:, 1] - traj.x[0, 1], traj


def test_a_mesh_gives_the_volume_and_it_floats_in_a_fluid_of_its_density():
    robot = afloat(mesh=box())
    (body,) = robot.graph.bodies
    assert body.volume == pytest.approx(0.06 * 0.04 * 0.03, rel=1e-12)
    assert body.mass == pytest.approx(RHO * body.volume, rel=1e-12)
    assert body.com == pytest.approx([0.01, 0.002, -0.003], abs=1e-12)
    assert body.inertia[0, 0] == pytest.approx(body.mass * (0.04**2 + 0.03**2) / 12, rel=1e-9)
    _, moved, traj = fall(robot)
    assert np.abs(moved).max() < 1e-10
    assert np.abs(traj.x - traj.x[0]).max() < 1e-10


@pytest.mark.parametrize("ratio", [0.4, 2.5])
def test_it_sinks_or_rises_with_what_is_left_of_its_weight(ratio):
    t, moved, traj = fall(afloat(mesh=box(ratio * RHO)))
    assert moved[:, 2] == pytest.approx((1.0 / ratio - 1.0) * G * t**2 / 2, abs=1e-6)
    assert np.abs(np.ptp(traj.x - traj.x[:, :1], axis=0)).max() < 1e-9  # without turning


def test_a_volume_of_its_own_takes_the_place_of_the_parts():
    _, moved, _ = fall(afloat(mass=0.05, volume=3e-5), 0.1)
    assert moved[-1, 2] == pytest.approx((3e-5 * RHO / 0.05 - 1.0) * G * 0.1**2 / 2, abs=1e-7)
    _, bare, _ = fall(afloat(mass=0.05, volume=0.0), 0.1)
    assert bare[-1, 2] == pytest.approx(-G * 0.1**2 / 2, abs=1e-7)
    _, parts, _ = fall(afloat(mass=0.05), 0.1)
    cylinder = np.pi * 5e-3**2 * 0.06
    assert parts[-1, 2] == pytest.approx((cylinder * RHO / 0.05 - 1.0) * G * 0.1**2 / 2, abs=1e-7)


def test_a_keel_rights_the_hull_with_the_period_of_its_pendulum():
    """Neutral, its centre of mass a distance d below that of its volume: I phi'' = -m g d sin(phi)."""
    mesh, d = box(), 0.008
    com = mesh.center_mass - [0.0, 0.0, d]
    inertia = np.diag([3e-5, 4e-5, 5e-5])
    robot = afloat(mesh=mesh, com=com, inertia=inertia)
    mass, tilt = mesh.mass, 0.02
    positions = robot.graph.x0
    R = rotation(tilt)
    graph = robot.graph.with_positions(com + (positions - com) @ R.T)
    robot = rn.Robot(graph, robot.terms)
    body = graph.bodies[0]
    assert body.cob == pytest.approx(com + R @ [0, 0, d], abs=1e-12)
    omega = np.sqrt(mass * G * d / inertia[1, 1])
    t, _, traj = fall(robot, 0.5)
    direction = traj.x[:, 2] - traj.x[:, 0]
    angle = -np.arctan2(direction[:, 2], direction[:, 0])
    assert angle == pytest.approx(tilt * np.cos(omega * t), abs=3e-3 * tilt)


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def test_it_is_the_same_from_a_file(tmp_path):
    robot = afloat(mesh=box(), com=(0.0, 0.001, -0.01), inertia=(3e-5, 4e-5, 5e-5))
    same_robots(robot, through_a_file(robot, tmp_path))
    turned = robot.graph.with_positions(robot.graph.x0 @ rotation(0.7).T + [0.1, 0, 0])
    robot = rn.Robot(turned, robot.terms)
    same_robots(robot, through_a_file(robot, tmp_path))


def test_what_makes_no_body_is_told():
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    inside_out = box()
    inside_out.invert()
    plain = box(density=1.0)
    for options, message in (
        ({"mesh": sheet}, "is not closed"),
        ({"mesh": inside_out}, "points inward"),
        ({"mesh": plain}, r"give mass= \[kg\], or set mesh.density"),
        ({"mesh": "hull.stl"}, "must be a trimesh.Trimesh, not str"),
        ({"mesh": box(), "com": (0, 0, 0)}, "give inertia= about com"),
        ({"volume": -1.0}, "volume = -1.0 must be"),
        ({"volume": 1e-5, "cob": (0, 0)}, "cob must be a finite point"),
        ({"cob": (0, 0, 0)}, "give volume="),
        ({"mass": 0.1, "volume": 1e-5, "cob": (0, 0, 0.1), "inertia": (1.5e-6, 1e-6, 1e-6)}, None),
        ({"mass": 0.1, "volume": 1e-5, "cob": (0, 0, 0.1), "inertia": (0.0, 1e-6, 1e-6)}, "its mass is flat"),
    ):
        if message is None:
            rn.Simulation(afloat(**options))
            continue
        with pytest.raises(rn.GraphError, match=message):
            rn.Simulation(afloat(**options))
