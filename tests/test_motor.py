"""A motor turns the natural twist of its joint and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.statics import stiffness_matrix

ELASTIC = (rn.Stretching, rn.Bending, rn.Twisting)


def two_rods(angle: float, kink: float = 0.0, section: rn.Section | None = None) -> rn.Robot:
    """Two soft rods with a motor between them; the second leaves at an angle ``kink`` [rad]."""
    fig = rn.StickFigure()
    section = section or rn.circular(3e-3)
    rubber = rn.Material(E=1e6)
    fig.rod("stator", [(-0.1, 0, 0), (0, 0, 0)], edges=4, material=rubber, section=section)
    tip = (0.1 * np.cos(kink), 0.1 * np.sin(kink), 0.0)
    fig.rod("rotor", ["stator.end", tip], edges=4, material=rubber, section=section)
    motor = rn.Motor(at="stator.end", angle=lambda t: angle * t)
    return rn.Robot(fig.build(), [*(t() for t in ELASTIC), rn.Clamp(at="stator.start"), motor])


def tip_stiffness(robot: rn.Robot, turned: rn.State) -> np.ndarray:
    """Compliance of the rotor's tip to forces across the rod, shape (3, 3) [m/N]."""
    K, free = stiffness_matrix(robot, turned, t=1.0)
    tip = 3 * robot.graph.node("rotor.end") + np.arange(3)
    rows = [int(np.flatnonzero(free == dof)[0]) for dof in tip]
    load = np.zeros((len(free), 3))
    load[rows, range(3)] = 1.0
    return np.linalg.solve(K.toarray(), load)[rows]


def turned(robot: rn.Robot, angle: float) -> rn.State:
    """The state in which the rotor has followed the motor."""
    start = None
    for t in np.linspace(0.0, 1.0, max(int(abs(angle) / 0.5), 1) + 1)[1:]:
        start = rn.equilibrium(robot, t=t, start=start).state()
    return start


@pytest.mark.parametrize("angle", [0.5, 1.0, 2.0, np.pi, 5.0, 40.0])
def test_bending_stiffness_does_not_depend_on_the_angle(angle):
    """Averaged frames would lose it all at half a turn (cos^2 of half the twist)."""
    at_rest = tip_stiffness(two_rods(0.0), turned(two_rods(0.0), 0.0))
    robot = two_rods(angle)
    compliance = tip_stiffness(robot, turned(robot, angle))
    assert np.abs(compliance - at_rest).max() < 1e-10 * np.abs(at_rest).max()


def test_a_kinked_shaft_turns_about_the_rotors_own_axis():
    """The stator carries the kink: the rotor spins in place."""
    robot = two_rods(1.7, kink=0.6)
    traj = rn.equilibrium(robot, t=1.0, start=turned(robot, 1.7))
    assert np.abs(traj.x[-1] - robot.graph.x0).max() < 1e-9
    rotor = robot.graph.edge_indices("rotor:2-3")[0]
    assert traj.theta[-1, rotor] == pytest.approx(1.7, abs=1e-9)
    assert sum(traj.energies.values())[-1] < 1e-20


def test_an_elliptic_rotor_takes_its_soft_direction_along():
    flat = rn.elliptic(4e-3, 2e-3)
    quarter = np.pi / 2.0
    straight, crossed = (
        tip_stiffness(two_rods(a, section=flat), turned(two_rods(a, section=flat), a)) for a in (0.0, quarter)
    )
    # turned by a quarter, the rotor's soft direction lies across the stator's: in between
    assert straight[2, 2] / straight[1, 1] == pytest.approx(4.0, rel=1e-2) or straight[1, 1] / straight[
        2, 2
    ] == pytest.approx(4.0, rel=1e-2)
    low, high = sorted((straight[1, 1], straight[2, 2]))
    assert low < crossed[1, 1] < high and low < crossed[2, 2] < high


def test_motor_by_pair_runs_the_other_way():
    """between=(stator, rotor) says which edge turns, whatever the order of drawing."""
    base = rn.robots.flagellated(2, 100.0, edges=6)
    terms = [t for t in base.terms if t.name != "motor"]
    there = rn.Robot(base.graph, [*terms, rn.Motor(between=("head:0-1", "head:1-2"), rpm=100.0)])
    back = rn.Robot(base.graph, [*terms, rn.Motor(between=("head:1-2", "head:0-1"), rpm=100.0)])
    runs = [rn.Simulation(r, dt=1e-2).run(1.0) for r in (base, there, back)]
    head = base.graph.rods["head"].edges[0]
    assert np.array_equal(runs[0].x, runs[1].x)
    # about the direction from stator to rotor: seen from the other side that is the same relative turn
    assert runs[2].w[-1, head] == pytest.approx(runs[0].w[-1, head], rel=1e-6)


class Leveller(rn.Actuator):
    """A servo that turns by what a sensor says."""

    drives = "twist"

    def command(self, t, sensors, p):
        return 100.0 * sensors["height"]


@pytest.mark.parametrize("compressed", [0.0, 8.0])
def test_an_equilibrium_reads_the_sensors(compressed):
    """It is the one of the angle that is read there; also where it is found by descent, beyond buckling."""
    base = two_rods(0.0)
    crook = rn.PointForce(at="rotor.end", force=(-compressed * 1e-3, 0.0, -1e-4))
    terms = [*(t for t in base.terms if t.name != "motor"), crook]
    servo = Leveller(between=("stator:3-4", "rotor:0-1"), name="servo")
    robot = rn.Robot(base.graph, [*terms, servo], sensors={"height": lambda s: s.position("rotor.end")[2]})
    found = rn.equilibrium(robot)
    angle = 100.0 * found.at("rotor.end")[-1, 2]
    assert angle < -0.01
    fixed = rn.Motor(between=("stator:3-4", "rotor:0-1"), angle=lambda t: angle)
    same = rn.equilibrium(rn.Robot(base.graph, [*terms, fixed]), start=None)
    assert found.x[-1] == pytest.approx(same.x[-1], abs=1e-6)
