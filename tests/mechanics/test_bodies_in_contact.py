"""Rigid bodies that touch walls, rods and each other, or move in a fluid: derivatives, momenta, no penetration."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.testing.states import Probe

G = 9.81
SOFT = rn.Material(E=1e7, rho=1000.0)
WIDE = {"reach": 0.1, "stiffness": 10.0, "rod_radius": 1e-5, "friction": 0.4, "slip": 0.05}


THIN = {**WIDE, "reach": 0.2, "stiffness": 0.1, "rod_radius": 1e-3}


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def gripper(tilt=0.0):
    """A cross of stiff parts as one body with a soft rod on it, and a free rod beside it."""
    figure = rn.StickFigure()
    figure.rod("arm", [(0.02, 0, 0), (0.05, 0.01, 0), (0.08, 0, 0.01)], material=SOFT, radius=2e-3)
    figure.rod(
        "bar", [(0.0, -0.03, 0.02), (0.02, 0.0, 0.03), (0.05, 0.03, 0.02 + tilt)], material=SOFT, radius=2e-3
    )
    figure.rigid("stem", [(-0.02, 0, 0), "arm.start"], radius=3e-3)
    figure.rigid("cross", [(0, -0.03, 0), (0, 0.03, 0.005)], radius=3e-3)
    figure.body(["stem", "cross"], name="hub", mass=0.01, com=(0.003, 0.001, 0), inertia=(2e-6, 3e-6, 4e-6))
    return figure.build()


@pytest.mark.parametrize(
    "term",
    [
        rn.RodContact(**WIDE),
        rn.PlaneContact((0, 0, -0.1), (0.3, 0.1, 1.0), **{**WIDE, "reach": 0.4, "stiffness": 0.1}),
        rn.TubeContact(((0, 0, -0.3), (1, 0.2, -0.3)), 0.6, **{**WIDE, "reach": 0.55, "stiffness": 0.1}),
        rn.TubeContact(((0, 0, -0.1), (0.2, 1, -0.1)), 0.02, inside=False, **THIN),
    ],
)
def test_derivatives_of_contact_on_bodies(term):
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(6):
        probe = Probe(rn.Robot(gripper(), [term]), rng, turn=0.6, stretch=(0.7, 1.4), source_turn=0.5)
        if not np.any(probe.forces()[probe.model.bodies.own]):
            continue
        checked += 1
        for by, (error, where) in probe.jacobian_errors().items():
            assert error < 2e-6, f"{by}: {where}"
    assert checked >= 2


def gaps(traj, name):
    """Gaps of a wall, or of the pairs of rods within reach, over all states [m]."""
    bound = next(b for b in rn.Simulation(traj.robot).model.bound if b.term.name == name)
    found = [bound.gaps(np.ascontiguousarray(x)) for x in traj.x]
    return np.concatenate([np.ravel(g[1] if isinstance(g, tuple) else g) for g in found])


def frame(height, name="frame", x=0.0, mass=0.02):
    """Figure with a square body of four stiff edges, 40 mm wide, level at a height."""
    figure = rn.StickFigure()
    h = 0.02
    corners = [(x - h, -h, height), (x + h, -h, height), (x + h, h, height), (x - h, h, height)]
    figure.rigid(name, corners, radius=2e-3)
    figure.rigid(f"{name}_last", [f"{name}.end", f"{name}.start"], radius=2e-3)
    figure.body(
        [name, f"{name}_last"], name=f"{name}_body", mass=mass, com=(x, 0, height), inertia=(3e-6, 3e-6, 6e-6)
    )
    return figure


@pytest.mark.parametrize(("stepper", "dt"), [("euler", 2e-2), ("sdirk2", 5e-3)])
def test_a_body_falls_on_a_plane_and_rests(stepper, dt):
    """However fast it comes, tilted and spinning, it is stopped; at rest the plane carries the weight."""
    plane = rn.PlaneContact((0, 0, 0), stiffness=3e4, friction=0.4, damping=5.0)
    robot = rn.Robot(frame(0.05).build(), [rn.Gravity(), plane])
    velocity = np.tile([0.0, 0.0, -5.0], (robot.graph.node_count, 1))
    sim = rn.Simulation(robot, dt, stepper=stepper, velocity=velocity, spin={"frame_body": (10.0, 3.0, 5.0)})
    traj = sim.run(1.5)
    assert gaps(traj, "plane").min() > 0.0
    assert np.abs(traj.v[-1]).max() < 5e-3
    assert traj.term_forces("plane")[-1, :, 2].sum() == pytest.approx(G * 0.02, rel=1e-2)
    energy = traj.energies["kinetic"] + 0.02 * G * traj.x[:, :, 2].mean(axis=1)
    assert np.all(np.diff(energy) <= 1e-3 * energy[0])


def test_a_body_is_not_jumped_by_a_rod_nor_by_a_body():
    """A thin rod flies at a frame faster than its diameter per step, and a second frame follows."""
    figure = frame(0.0)
    figure.rod("bar", [(-0.05, 0, 0.02), (0.05, 0, 0.02)], edges=4, material=SOFT, radius=1e-3)
    figure.rigid("beam", [(0, -0.05, 0.03), (0, 0.05, 0.03)], radius=1e-3)
    figure.body("beam", mass=5e-3)
    robot = rn.Robot(figure.build(), [*elastic(), rn.RodContact(friction=0.2)])
    velocity = np.zeros((robot.graph.node_count, 3))
    velocity[robot.graph.nodes(["bar", "beam"])] = (0.0, 0.0, -4.0)
    sim = rn.Simulation(robot, 1e-2, velocity=velocity)
    traj = sim.run(0.05)
    assert gaps(traj, "contact").min() > 0.0
    z = {name: traj.x[-1][robot.graph.nodes(name)][:, 2].mean() for name in ("frame", "bar:2", "beam")}
    assert z["frame"] < z["bar:2"] < z["beam"]
    assert z["frame"] < -0.02  # pushed along


def momenta(sim, state):
    """Linear and angular momentum of robots with bodies, about the origin."""
    ev, m = sim.newton.ev, sim.model
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.q[:] = state.q
    ev.bodies.place()
    v = state.v.copy()
    ev.bodies.set_rigid(v)
    v, x = v[: m.twist0].reshape(-1, 3), state.q[: m.twist0].reshape(-1, 3)
    spin = m.edge_inertia[: len(ev.T)] * state.v[m.twist0 : m.turn0]
    return m.node_mass @ v, np.einsum("n,ni->i", m.node_mass, np.cross(x, v)) + spin @ ev.T


def test_a_collision_of_a_body_and_a_rod_keeps_momenta():
    figure = rn.StickFigure()
    figure.rod("bar", [(-0.04, 0.01, 0.0034), (0.04, 0.01, 0.0034)], edges=4, material=SOFT, radius=1e-3)
    figure.rigid("beam", [(0.01, -0.04, 0), (0.01, 0.02, 0)], radius=2e-3)
    figure.body("beam", mass=3e-3, com=(0.01, -0.01, 0.001), inertia=(2e-6, 1e-6, 2e-6))
    robot = rn.Robot(figure.build(), [*elastic(), rn.RodContact(friction=0.3)])
    velocity = np.zeros((robot.graph.node_count, 3))
    velocity[robot.graph.nodes("bar")] = (0.1, 0.0, -0.5)
    tight = rn.Tolerance(residual=1e-12, update=1e-14)
    sim = rn.Simulation(robot, 5e-5, velocity=velocity, tolerance=tight)
    p0, L0 = momenta(sim, sim.state)
    traj = sim.run(4e-3)
    p, L = momenta(sim, sim.state)
    beam = traj.v[-1][robot.graph.nodes("beam")]
    assert np.abs(beam).max() > 0.05  # it has been hit
    assert np.abs(p - p0).max() < 1e-9 * np.linalg.norm(p0)
    assert np.abs(L - L0).max() < 1e-2 * np.linalg.norm(L0)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_body_in_a_fluid_falls_as_its_added_mass_allows(stepper):
    """A level cylinder of mass m starts with m g / (m + m_a), whatever turns; along its axis with g."""
    m, length, r = 0.02, 0.08, 5e-3
    fluid = rn.AddedMass(density=1000.0)
    added = 1000.0 * np.pi * r**2 * length
    figure = rn.StickFigure()
    figure.rigid("rod", [(-length / 2, 0, 0), (0, 0, 0), (length / 2, 0, 0)], radius=r)
    figure.body("rod", mass=m, inertia=(1e-6, 1e-5, 1e-5))
    for direction, total in (((0, 0, -1), m + added / 2 + added / 2), ((-1, 0, 0), m)):
        robot = rn.Robot(figure.build(), [rn.Gravity(direction=direction), fluid])
        sim = rn.Simulation(robot, 1e-3, stepper=stepper)
        traj = sim.run(0.05)
        wanted = G * m / total * np.array(direction)
        late = 0.5 * traj.dt if stepper == "euler" else 0.0
        assert traj.v[-1] == pytest.approx(np.tile(wanted * traj.t[-1], (3, 1)), abs=1e-9)
        way = 0.5 * traj.t[-1] ** 2 + late * traj.t[-1]
        assert (traj.x[-1] - traj.x[0]) == pytest.approx(np.tile(wanted * way, (3, 1)), abs=1e-9)


@pytest.mark.parametrize("turn", [0.3, 0.8, 3.0])
@pytest.mark.parametrize("out", [0.05, 0.095])
def test_a_spinning_bar_stays_on_its_side_of_a_peg(turn, out):
    """However far it turns in a step, it stops at the peg and slides along it, and never comes out behind."""
    figure = rn.StickFigure()
    figure.rigid("bar", [(-0.1, 0, 0), (0, 0, 0), (0.1, 0, 0)], mass=0.02, radius=2e-3)
    figure.body("bar", inertia=(1e-6, 6e-5, 6e-5), com=(0, 0, 0))
    steel = rn.Material(E=2e11, rho=7800.0)
    figure.rod("peg", [(0, out, -0.02), (0, out, 0.02)], edges=2, material=steel, radius=3e-3)
    held = [rn.Clamp(at="peg.start"), rn.Clamp(at="peg.end")]
    robot, spin = rn.Robot(figure.build(), [*elastic(), rn.RodContact(), *held]), 20.0
    traj = rn.Simulation(robot, turn / spin, spin={"bar": (0, 0, spin)}).run(
        turn / spin * max(1, round(2.0 / turn))
    )
    bar = traj.x[:, robot.graph.nodes("bar")]
    along = bar[:, 2] - bar[:, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    side = np.cross(along, (0, out, 0) - bar[:, 1])[:, 2]
    assert side.min() > 5e-3  # the sum of the radii
    assert side[-1] < 6e-3  # and it has come to the peg
    angle = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    assert angle[-1] < spin * traj.t[-1] - 0.05
