"""Constraints are exact, and a grasp injects no twist of its own."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.kinematics.frames import mean_rotation
from rodnet.terms import prescribed
from rodnet.terms.imperfect import ImperfectMotion
from rodnet.terms.motion import SmoothMotion

ELASTIC = (rn.Stretching, rn.Bending, rn.Twisting)


def rod_robot(*terms: rn.Term, edges: int = 10, E: float = 1e7, **options) -> rn.Robot:
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.5, 0, 0)], edges=edges, material=rn.Material(E=E), radius=4e-3, **options)
    return rn.Robot(fig.build(), [*(t() for t in ELASTIC), *terms])


def cone(angle: float) -> np.ndarray:
    """Orientation of a gripper whose axis has gone round a 30 degree cone by ``angle``, without net spin."""
    axis = np.array([np.cos(np.radians(30.0)), 0.0, np.sin(np.radians(30.0))])
    return (Rotation.from_rotvec(angle * axis) * Rotation.from_rotvec([-angle, 0.0, 0.0])).as_matrix()


def test_a_gripper_round_a_closed_cone_leaves_a_free_rod_untwisted():
    """The tangent's path encloses a solid angle of 48 degrees; the gripper's orientation comes back."""
    robot = rod_robot(rn.PrescribedMotion(at="rod:0-1", orientation=lambda t: cone(2.0 * np.pi * t)))
    start = None
    for t in np.linspace(0.0, 1.0, 25)[1:]:
        traj = rn.equilibrium(robot, t=t, start=start)
        start = traj.state()
        assert np.abs(start.tau).max() < 1e-10
    assert np.abs(traj.x[-1] - robot.graph.x0).max() < 1e-9


def test_a_full_turn_of_the_gripper_is_seen_as_twist():
    turn = rn.PrescribedMotion(
        at="rod.start",
        orientation=lambda t: Rotation.from_rotvec([2.0 * np.pi * t, 0, 0]).as_matrix(),
        name="turn",
    )
    robot = rod_robot(turn, rn.Clamp(at="rod.end"), E=1e7)
    start = None
    for t in np.linspace(0.0, 1.0, 13)[1:]:
        traj = rn.equilibrium(robot, t=t, start=start)
        start = traj.state()
    graph = robot.graph
    assert start.tau.sum() == pytest.approx(-2.0 * np.pi, abs=1e-9)
    torque = graph.GJ[0] * 2.0 * np.pi / 0.5
    assert np.abs(traj.reactions["turn"].moment[-1, 0]) == pytest.approx(torque, rel=1e-7)
    assert traj.reactions["clamp"].moment[-1, 0] == pytest.approx(
        -traj.reactions["turn"].moment[-1, 0], rel=1e-7
    )


def test_prescribed_motion_is_exact_and_its_work_is_seen():
    def path(t):
        return np.array([0.0, 0.05 * np.sin(9.0 * t) ** 2, 0.02 * np.sin(5.0 * t)])

    robot = rod_robot(rn.PrescribedMotion(at="rod.start", position=path), rn.Gravity())
    traj = rn.Simulation(robot, dt=2e-3, stepper="sdirk2").run(0.5)
    expected = np.array([path(t) for t in traj.t])
    assert np.abs(traj.x[:, 0] - expected).max() == 0.0
    speed = np.array([(path(t + 1e-6) - path(t - 1e-6)) / 2e-6 for t in traj.t])
    assert np.abs(traj.v[:, 0] - speed).max() < 1e-5
    power = traj.powers
    assert np.abs(power["motion"] + power["gravity"] + power["elastic"] - power["kinetic"])[1:].max() < 1e-7
    work = np.trapezoid(power["motion"] + power["gravity"], traj.t)
    energy = sum(traj.energies.values())
    assert work == pytest.approx(energy[-1] - energy[0], rel=2e-2)


def test_a_hinge_holds_the_place_and_leaves_the_rest_free():
    traj = rn.Simulation(rod_robot(rn.Hinge(at="rod.start"), rn.Gravity()), dt=5e-3, stepper="sdirk2").run(
        0.5
    )
    assert np.abs(traj.x[:, 0]).max() == 0.0
    assert traj.x[-1, -1, 2] < -0.05
    assert np.abs(traj.reactions["hinge"].moment).max() < 1e-15


def test_reactions_balance_the_loads():
    robot = rod_robot(
        rn.Clamp(at="rod.start"), rn.Gravity(), rn.PointForce(at="rod.end", force=(0.01, 0.02, -0.03))
    )
    traj = rn.equilibrium(robot)
    graph, x = robot.graph, traj.x[-1]
    loads = graph.node_mass[:, None] * np.array([0.0, 0.0, -9.81])
    loads[graph.node("rod.end")] += (0.01, 0.02, -0.03)
    reaction = traj.reactions["clamp"]
    assert reaction.force[-1] == pytest.approx(-loads.sum(axis=0), abs=1e-8)
    moment = np.cross(x - reaction.point[-1], loads).sum(axis=0)
    assert reaction.moment[-1] == pytest.approx(-moment, abs=1e-8)
    along = traj.internal.along("rod")
    assert np.linalg.norm(along.moment[-1, 0]) == pytest.approx(np.linalg.norm(moment), rel=1e-6)


def grasped(dt: float, twist: str) -> rn.Trajectory:
    def direction(t):
        return cone(2.0 * np.pi * t)[:, 0]

    grip = rn.Grasp(
        at="rod:0-1", position=lambda t: np.zeros(3), tangent=direction, twist=twist, duration=1.0
    )
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0)
    return rn.Simulation(rod_robot(grip, drag), dt=dt).run(1.0)


def test_a_grasp_without_spin_does_not_depend_on_the_time_step():
    """Without spin the gripper comes back turned by the solid angle of the cone, 2 pi (1 - cos 30)."""
    coarse, fine = (grasped(dt, "no-spin") for dt in (0.02, 0.005))
    frames = []
    for run in (coarse, fine):
        d1, t = run.directors[-1, 0], np.array([1.0, 0.0, 0.0])
        frames.append(np.cos(run.theta[-1, 0]) * d1 + np.sin(run.theta[-1, 0]) * np.cross(t, d1))
    assert np.abs(frames[0] - frames[1]).max() < 1e-6
    initial = rod_robot().graph.d1[0]
    turned = np.degrees(np.arccos(np.clip(initial @ frames[1], -1.0, 1.0)))
    assert turned == pytest.approx(360.0 * (1.0 - np.cos(np.radians(30.0))), abs=0.05)


def test_a_motion_from_a_place_is_the_motion_less_that_place():
    t = np.linspace(0.0, 1.0, 41)
    hand = rn.smooth_motion(t, np.stack([np.sin(3.0 * t), t**2, np.cos(t)], axis=1), 1e-4)
    moved, times = hand - hand(0.0), np.linspace(-0.3, 1.4, 30)
    np.testing.assert_allclose([moved(s) for s in times], [hand(s) - hand(0.0) for s in times], atol=1e-14)
    np.testing.assert_allclose(moved.many(times), hand.many(times) - hand(0.0), atol=1e-14)


FAR = 0.01


def swing(t: float) -> np.ndarray:
    return np.array([0.0, 0.0, FAR * np.sin(t)])


def known_of(position) -> object:
    """What is known of the motion of a rod's end: the robot is kept, and so is what it follows."""
    sim = rn.Simulation(rod_robot(rn.PrescribedMotion(at="rod.start", position=position)), dt=0.01)
    (held,) = sim.model.moving
    return sim, held.law.motions.of(held.law, (held.x0, held.arm, held.frames0))


def test_a_motion_that_another_robot_follows_is_known_and_one_that_has_changed_is_not(monkeypatch):
    """The robot of a recording is built again and again; a function says another thing when what it uses is another."""
    t = np.linspace(0.0, 1.0, 21)
    smooth = [rn.smooth_motion(t, np.outer(t**2, [0.0, 0.01, far]), 0.0) for far in (0.1, 0.1, 0.2)]
    kept = [known_of(position) for position in smooth]
    assert kept[0][1] is kept[1][1] is not kept[2][1]
    inner = [known_of(lambda t, far=far: far * swing(t)) for far in (1.0, 1.0, 2.0)]
    assert inner[0][1] is inner[1][1] is not inner[2][1]
    before = known_of(swing)
    assert known_of(swing)[1] is before[1]
    monkeypatch.setattr(sys.modules[__name__], "FAR", 0.02)
    after = known_of(swing)
    assert after[1] is not before[1]
    traj = after[0].run(0.1)
    assert traj.x[-1, 0, 2] == pytest.approx(0.02 * np.sin(0.1))


def swinging(functions=False, **imperfect):
    """A rod whose first edge is moved and turned by splines, or functions of them, with a rod rigidly fixed to it."""
    t = np.linspace(0.0, 1.0, 51)
    moved = rn.smooth_motion(t, 0.05 * np.sin(5.0 * t[:, None] * [1.0, 0.8, 0.6]), 0.0)
    turned = rn.smooth_rotation(
        t, Rotation.from_rotvec(np.sin(3.0 * t[:, None] * [1.0, 0.5, 0.2])).as_matrix(), 0.0
    )
    grip = ImperfectMotion if imperfect else rn.PrescribedMotion
    position, orientation = (
        (lambda t: moved(t) - moved(0.0), turned.__call__) if functions else (moved, turned)
    )
    return rod_robot(grip(at="rod:0-1", position=position, orientation=orientation, **imperfect))


CROOKED = {
    "gain": 0.1, "turning": -0.2, "shift_x": 2e-3, "shift_y": 1e-3, "shift_z": -1e-3, "lag": 0.05, "spread": 0.7,
}  # fmt: skip


@pytest.mark.parametrize(
    "imperfect",
    [{}, CROOKED, CROOKED | {"spread": 0.0}, CROOKED | {"turning": 0.0}, {"lag": -0.1, "spread": 1.0}],
)
def test_what_is_prescribed_at_many_times_is_what_is_prescribed_at_each(imperfect):
    (held,) = rn.Simulation(swinging(**imperfect), dt=0.01).model.moving
    times = np.linspace(-0.2, 1.3, 40)
    x, directors, turns = held.together(times)
    for k, t in enumerate(times):
        np.testing.assert_allclose(x[k], held.positions(t), rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(directors[k], held.directors(t), rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(turns[k], held.law.orientation(t, held.p), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize(("stepper", "functions"), [("euler", False), ("sdirk2", False), ("sdirk2", True)])
def test_a_later_motion_is_asked_at_once_for_what_an_earlier_one_was_asked_for(stepper, functions):
    """And moves the rod as it does when it is asked time by time."""

    def run(lag, until=0.5):
        sim = rn.Simulation(swinging(functions, **CROOKED | {"lag": lag}), dt=0.01, stepper=stepper)
        traj = sim.run(until)
        return traj.x, sim.model.moving[0].state

    prescribed._asked.clear()
    alone, _ = run(0.08)
    prescribed._asked.clear()
    prescribed._followed.clear()
    for lag in (0.01, 0.02):
        run(lag, 0.6)
    after, state = run(0.08)
    assert max(state._known.places) >= 0.6 - 1e-9
    np.testing.assert_allclose(after, alone, rtol=0.0, atol=1e-9)
    assert np.ptp(alone[:, 0], axis=0).max() > 0.01


def test_a_motion_that_ends_is_not_asked_for_times_that_only_a_later_gripper_came_to():
    def hand(t):
        if t > 0.4:
            raise ValueError("the recording ends at 0.4 s")
        return np.array([0.01 * np.sin(5.0 * t), 0.0, 0.0])

    def run(lag, until):
        gripped = rod_robot(ImperfectMotion(at="rod:0-1", position=hand, lag=lag))
        return rn.Simulation(gripped, dt=0.01).run(until)

    run(0.5, 0.8)
    moved = run(0.0, 0.3)
    np.testing.assert_allclose(moved.x[-1, 0] - moved.x[0, 0], hand(0.3), atol=1e-12)
    with pytest.raises(ValueError, match="the recording ends"):
        run(0.1, 0.8)


def test_a_short_run_does_not_wait_for_what_a_long_one_asked():
    asked = []

    def hand(t):
        asked.append(t)
        return np.array([0.01 * np.sin(5.0 * t), 0.0, 0.0])

    def run(lag, until):
        asked.clear()
        gripped = rod_robot(ImperfectMotion(at="rod:0-1", position=hand, lag=lag))
        rn.Simulation(gripped, dt=0.01).run(until)
        return len(asked)

    prescribed._asked.clear()
    many = run(0.1, 5.0)
    run(0.2, 0.1)
    assert run(0.3, 0.1) < many / 4
    assert max(asked) < 1.5


def test_a_constraint_of_ones_own_may_have_a_method_of_any_name():
    class Mine(rn.PrescribedMotion):
        speed = rn.Parameter(0.1, unit="m/s", bounds=(None, None))

        def position(self, t, x0, p):
            return x0 + np.array([p.speed * t, 0.0, 0.0])

        def many(self, count):
            return count

    for speed in (0.1, 0.2, 0.3):
        mine = Mine(at="rod:0-1", position=lambda t: np.zeros(3), speed=speed)
        moved = rn.Simulation(rod_robot(mine), dt=0.01).run(0.2).x
        np.testing.assert_allclose(moved[-1, 0] - moved[0, 0], [0.2 * speed, 0.0, 0.0], atol=1e-12)


def test_what_inherits_a_spline_is_asked_time_by_time():
    """It may move otherwise than its spline, which a motion that is asked at once for many times would not tell."""
    t = np.linspace(0.0, 1.0, 51)
    hand = rn.smooth_motion(t, 0.05 * np.sin(5.0 * t[:, None] * [1.0, 0.8, 0.6]), 0.0)

    class Damped(SmoothMotion):
        def __call__(self, time):
            return 0.5 * super().__call__(time)

    damped = Damped(hand.spline, hand.first, hand.last)

    def moved(lag):
        traj = rn.Simulation(rod_robot(ImperfectMotion(at="rod:0-1", position=damped, lag=lag)), dt=0.01).run(
            0.3
        )
        return traj.x[-1, 0] - traj.x[0, 0]

    for lag in (0.0, 0.01, 0.02):
        np.testing.assert_allclose(moved(lag), damped(0.3 - lag) - damped(-lag), atol=1e-12)


def test_closures_of_another_module_that_enclose_other_values_are_other_motions(tmp_path, monkeypatch):
    """One helper makes the motion of every recording: the second must not be served that of the first."""
    (tmp_path / "hands.py").write_text(
        "import numpy as np\n"
        "def follow(z):\n"
        "    def hand(t):\n"
        "        return np.array([0.0, 0.0, z * t])\n"
        "    return hand\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from hands import follow

    def robot(z):
        hand = follow(z)
        return rod_robot(rn.PrescribedMotion(at="rod:0-1", position=lambda t: hand(t) - hand(0.0)))

    kept = [robot(z) for z in (0.1, -0.2)]
    ends = [rn.Simulation(one, dt=0.01).run(0.1).x[-1, 0, 2] for one in kept]
    np.testing.assert_allclose(ends, [0.01, -0.02], atol=1e-12)


def test_runs_are_not_asked_for_all_times_of_all_runs_before():
    """Adaptive steps are others in each run: what is asked at once is what one run before asked for."""
    prescribed._asked.clear()
    asked = [0]
    for k in range(5):
        sim = rn.Simulation(swinging(**CROOKED | {"lag": 0.01 + 0.01 * k}), dt=0.01, adaptive=1e-2)
        sim.run(0.2)
        known = sim.model.moving[0].state._known
        assert len(known.places) <= len(known.asked.places) + max(asked)
        asked.append(len(known.asked.places))
    assert len(known.places) > 1.5 * asked[-1]  # steps are others in each run, or this tells nothing


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, 3.0])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 1.0])
def test_the_mean_of_two_rotations_is_the_rotation_nearest_to_theirs(angle, share):
    rng = np.random.default_rng(0)
    one = Rotation.random(3, random_state=rng).as_matrix()
    axis = rng.standard_normal((3, 3))
    other = one @ Rotation.from_rotvec(angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)).as_matrix()
    U, _, V = np.linalg.svd((1.0 - share) * one + share * other)
    np.testing.assert_allclose(mean_rotation(one, other, share), U @ V, atol=1e-11)
    np.testing.assert_allclose(mean_rotation(one[0], other[0], share), (U @ V)[0], atol=1e-11)
