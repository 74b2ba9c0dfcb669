"""The paper's robot in the paper's numbers, and what the paper says of it."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

import rodnet as rn


@cache
def measured(
    n_tails: int, rpm: float, duration: float = 30.0, dt: float = 1e-2, stepper: str = "euler", **options
):
    """Metrics and trajectory of a run; cached, since several tests look at the same one."""
    robot = rn.robots.flagellated(n_tails, rpm, **options)
    traj = rn.Simulation(robot, dt=dt, stepper=stepper).run(duration)
    return rn.robots.flagellated_metrics(traj), traj


@pytest.mark.parametrize(
    ("n_tails", "head", "tails", "speed"), [(2, 95.50, 4.50, 0.2152e-3), (3, 97.474, 2.526, 0.1336e-3)]
)
def test_numbers_at_the_papers_mesh(n_tails, head, tails, speed):
    m, _ = measured(n_tails, 100.0)
    assert m.converged
    assert m.head_rpm == pytest.approx(head, abs=0.05)
    assert m.tail_rpm == pytest.approx(tails, abs=0.05)
    assert m.speed == pytest.approx(speed, rel=5e-3)
    # the motor turns the tails against the head
    assert m.head_rpm + m.tail_rpm == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("n_tails", [2, 3, 4, 5])
@pytest.mark.parametrize("rpm", [25.0, 300.0])
def test_the_whole_range_of_speeds_runs(n_tails, rpm):
    """No step fails from 25 to 300 rpm, and the robot advances head first."""
    m, traj = measured(n_tails, rpm, duration=max(8.0, 4 * 60.0 / rpm))
    assert traj.status == "finished"
    assert traj.stats["fallbacks"] == 0
    assert m.speed > 0.0
    head = traj.rods["head"].nodes[1]
    assert traj.x[-1, head, 0] > traj.x[len(traj) // 2, head, 0]


def test_efficiency_of_two_tails_peaks_near_150_rpm():
    efficiency = {
        rpm: measured(2, rpm, duration=15.0)[0].efficiency for rpm in (100.0, 130.0, 150.0, 170.0, 200.0)
    }
    assert max(efficiency, key=efficiency.get) == 150.0


def test_two_tails_are_faster_than_three_at_100_rpm():
    assert measured(2, 100.0)[0].speed > 1.5 * measured(3, 100.0)[0].speed


def test_speed_grows_with_tails_if_the_head_cannot_turn():
    """The paper's thought experiment: C2 to infinity, so that omega_h = 0."""
    speeds = [measured(n, 30.0, duration=10.0, C2=1e6)[0].speed for n in (2, 3, 4, 5)]
    assert np.all(np.diff(speeds) > 0.0)
    assert measured(2, 30.0, duration=10.0, C2=1e6)[0].head_rpm < 1e-3


def test_rigid_tails_do_not_propel():
    soft = measured(2, 100.0)[0].speed
    stiff = measured(2, 100.0, duration=10.0, E=1.2e6 * 1e4)[0].speed
    assert abs(stiff) < 1e-3 * soft


def convergence(root: str, sizes: tuple[int, ...]) -> np.ndarray:
    return np.array([measured(2, 100.0, duration=20.0, root=root, edges=n)[0].speed for n in sizes])


def test_the_clamped_root_converges_at_second_order():
    sizes = (8, 16, 32, 64)
    speeds = convergence("clamped", sizes)
    steps = np.abs(np.diff(speeds))
    order = np.log2(steps[:-1] / steps[1:])
    assert order == pytest.approx(2.0, abs=0.25)
    limit = speeds[-1] + (speeds[-1] - speeds[-2]) / 3.0
    assert limit == pytest.approx(0.2302e-3, rel=1e-3)


def test_the_papers_rigid_root_converges_at_first_order_to_the_same_limit():
    speeds = convergence("rigid", (14, 28, 56, 112))
    steps = np.diff(speeds)
    assert np.log2(steps[:-1] / steps[1:]) == pytest.approx(1.0, abs=0.15)
    assert 2.0 * speeds[-1] - speeds[-2] == pytest.approx(0.2302e-3, rel=5e-3)


def eased(t: float) -> float:
    """Angle of a motor that comes up to 100 rpm within a second, without shaking the stiff head."""
    s = min(t, 1.0)
    return 2.0 * np.pi * 100.0 / 60.0 * (s**4 * (2.5 - 3.0 * s + s * s) + max(t - 1.0, 0.0))


@pytest.mark.parametrize(("stepper", "order"), [("euler", 1.0), ("sdirk2", 2.0), ("alpha", 2.0)])
def test_order_in_time(stepper, order):
    """The shape after a smooth start converges with dt at the stepper's order."""
    robot = rn.robots.flagellated(2, 100.0, edges=8)
    terms = [t for t in robot.terms if t.name != "motor"]
    robot = rn.Robot(robot.graph, [*terms, rn.Motor(at="head:1", angle=eased)])
    tight = rn.Tolerance(residual=1e-10)
    x = [
        rn.Simulation(robot, dt=dt, stepper=stepper, tolerance=tight).run(0.8).x[-1].ravel()
        for dt in (0.02, 0.01, 0.005, 0.0025)
    ]
    steps = np.array([np.linalg.norm(b - a) for a, b in pairwise(x)])
    assert np.log2(steps[:-1] / steps[1:])[-1] == pytest.approx(order, abs=0.3)


def test_the_motors_power_goes_into_the_medium_and_into_stored_energy():
    _, traj = measured(2, 100.0, duration=5.0)
    power = traj.powers
    given = power["motor"] + power["drag"] + power["head"]
    # what is not dissipated is the rate of elastic and kinetic energy, to the solver's tolerance
    stored = power["kinetic"] - power["elastic"]
    assert np.abs(given - stored).max() <= 1e-7 * np.abs(power["motor"]).max()


def test_in_the_steady_state_nothing_is_stored():
    _, traj = measured(2, 100.0)
    late = traj.t > 25.0
    energy = sum(traj.energies.values())[late]
    assert np.ptp(energy) < 1e-7 * energy.mean()
    power = traj.powers
    left = (power["motor"] + power["drag"] + power["head"])[late]
    # implicit Euler loses some kinetic energy of the turning head, about 4e-7 of the power
    assert np.abs(left).max() < 1e-6 * power["motor"][-1]


def test_half_edge_drag_agrees_with_the_papers_tangents():
    node, edge = measured(2, 100.0)[0], measured(2, 100.0, tangent="edge")[0]
    assert edge.speed == pytest.approx(node.speed, rel=1e-4)


def test_metrics_need_whole_turns_of_the_right_robot():
    traj = rn.Simulation(rn.robots.flagellated(2, 100.0, edges=4), dt=1e-2).run(0.5)
    with pytest.raises(rn.ParameterError, match="two motor turns"):
        rn.robots.flagellated_metrics(traj)
    with pytest.raises(rn.ParameterError, match="n_tails"):
        rn.robots.flagellated(0, 100.0)
