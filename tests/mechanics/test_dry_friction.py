"""Dry friction in bending and twist: loops, what stays bent, and that it only ever takes energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.terms.friction_kernels import dahl, dahl_slope
from tests.mechanics.beams import EI, GJ, MATERIAL, L, R, beam, elastic

few = settings(deadline=None, max_examples=50)


class Fold(rn.Constraint):
    """Two edges that are bent against each other by a given angle about z."""

    def __init__(self, *, at, angle, **options):
        super().__init__(at=at, **options)
        self.angle = angle

    def position(self, t, x0, p):
        turn = Rotation.from_rotvec([0.0, 0.0, self.angle(t)]).as_matrix()
        return np.vstack([x0[:2], x0[1] + turn @ (x0[2] - x0[1])])


def folded(angle, dt, duration, friction):
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (L, 0, 0)], edges=2, material=MATERIAL, radius=R)
    terms = [*elastic(), friction, Fold(at=["rod:0", "rod:1", "rod:2"], angle=angle)]
    return rn.Simulation(rn.Robot(figure.build(), terms), dt).run(duration)


def strain(angle):
    return 2.0 * np.tan(0.5 * angle)


@pytest.mark.parametrize("steps", [8, 200])
def test_a_bending_loop_has_the_area_of_dahl_s_law(steps):
    """To and fro between -Y and Y the state ends on tanh Y, and a loop costs 4 (Y - tanh Y), whatever the steps."""
    moment, curvature, reach = 2e-3, 4.0, 0.6
    scale = curvature * L / 2
    law = rn.DryFriction(moment=moment, curvature=curvature)
    traj = folded(lambda t: reach * np.sin(2 * np.pi * t), 1.0 / steps, 4.0, law)
    state = [traj.state(k).memories[3][0] for k in range(len(traj))]
    Y = strain(reach) / scale
    side = int(np.argmax(np.abs(state[steps // 4][:3])))
    z = np.array([m[side] for m in state])
    assert np.abs(z[steps // 4 + 3 * steps]) == pytest.approx(np.tanh(Y), abs=1e-6)  # settled
    assert z[steps // 4 + 3 * steps] == pytest.approx(-z[3 * steps // 4 + 3 * steps], abs=1e-7)
    if steps > 100:
        y = np.array([m[3 + side] for m in state])[-steps - 1 :]
        force = moment * z[-steps - 1 :]
        loop = abs(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(y)))
        assert loop == pytest.approx(moment * scale * 4.0 * (Y - np.tanh(Y)), rel=5e-3)
        work = -np.sum(traj.powers["friction"][-steps:]) / steps  # at the ends of steps: of first order
        assert work == pytest.approx(loop, rel=0.05)


def test_the_loop_does_not_depend_on_speed_or_steps():
    law = rn.DryFriction(moment=2e-3, curvature=4.0)
    path = lambda t: 0.5 * np.sin(2 * np.pi * t)  # noqa: E731
    ends = [
        folded(lambda t, r=r: path(r * t), 1.0 / (r * n), 1.25 / r, law) for r, n in ((1, 8), (5, 8), (1, 80))
    ]
    z = np.array([traj.state().memories[3][0, :3] for traj in ends])
    assert z == pytest.approx(np.tile(z[0], (3, 1)), abs=1e-9)


def test_twist_friction_against_a_turning_grip():
    """Turned far one way the torque is GJ angle / L plus the friction, and back, minus it."""

    def reaction(sense):
        turn = lambda t: Rotation.from_rotvec([sense(t), 0, 0]).as_matrix()  # noqa: E731
        grip = rn.PrescribedMotion(at="beam.end", orientation=turn)
        law = rn.DryFriction(torque=3e-4, twist=0.2)
        robot = beam(6, rn.Clamp(at="beam.start"), grip, law)
        traj = rn.Simulation(robot, 0.02).run(1.0)
        return traj.reactions["motion"].moment[-1, 0]

    up = reaction(lambda t: 0.8 * np.sin(0.5 * np.pi * t))
    down = reaction(lambda t: 0.8 * np.sin(np.pi * t) + 0.4 * (1 - np.cos(np.pi * t)))
    assert up == pytest.approx(GJ * 0.8 / L + 3e-4, abs=1e-7)
    assert down == pytest.approx(GJ * 0.8 / L - 3e-4, abs=1e-7)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_a_loop_in_twist_costs_its_area(stepper):
    """Work of the grip over a slow cycle between -A and A: each spring 4 tau s (Y - tanh Y), Y = A / (n s)."""
    turns, amplitude, n = 3.0, 0.8, 4
    law = rn.DryFriction(torque=3e-4, twist=2.0)
    sense = lambda t: amplitude * np.sin(2 * np.pi * t)  # noqa: E731
    turn = lambda t: Rotation.from_rotvec([sense(t), 0, 0]).as_matrix()  # noqa: E731
    grip = rn.PrescribedMotion(at="beam.end", orientation=turn)
    steps = 250
    robot = beam(n, rn.Clamp(at="beam.start"), grip, law)
    traj = rn.Simulation(robot, 1.0 / steps, stepper=stepper).run(turns)
    torque, angle = traj.reactions["motion"].moment[-steps - 1 :, 0], sense(traj.t[-steps - 1 :])
    work = np.sum(0.5 * (torque[1:] + torque[:-1]) * np.diff(angle))
    # the walls at both ends have springs of half an edge that friction acts in, too: all share the twist evenly
    lengths = np.array([0.5, *[1.0] * (n - 1), 0.5]) * L / n
    reach = amplitude / L  # rad/m
    assert work == pytest.approx(4 * 3e-4 * np.sum(lengths * (reach - 2.0 * np.tanh(reach / 2.0))), rel=0.01)


def test_a_bent_rod_stays_bent_within_its_friction():
    """Equilibrium band: released, a rod rests where friction holds what elasticity wants back."""
    moment = 0.2 * EI / L
    law = rn.DryFriction(moment=moment, curvature=0.02 / L)
    push = rn.PointForce(at="beam.end", force=(0, 0, -2.0 * EI / L**2))
    clamp = rn.Clamp(at="beam.start")
    loaded = rn.equilibrium(beam(8, clamp, law, push))
    free = beam(8, clamp, law, rn.PointForce(at="beam.end", force=(0, 0, 0)))
    rest = rn.equilibrium(free, start=loaded.state())
    assert rest.x[-1, -1, 2] < 0.05 * loaded.x[-1, -1, 2] < 0.0
    assert np.linalg.norm(rest.internal.bending[-1], axis=1).max() <= moment * (1 + 1e-6)
    z = rest.state().memories[4][:, :3]
    assert np.linalg.norm(z, axis=1).max() <= 1.0
    # and what elasticity wants back is what friction holds, spring by spring
    assert rest.internal.bending[-1] == pytest.approx(-moment * z[:, :2], abs=1e-6 * moment)
    never = rn.equilibrium(free)
    assert np.abs(never.x[-1] - free.graph.x0).max() < 1e-12


def test_strands_that_held_a_rod_keep_it_bent_from_the_first_moment_on():
    """Far below the pre-sliding scale their moments stay what they were: EI kappa = moment |sum of the pulls|."""
    moment = 1e-4 * EI / L
    for pull in ((2.0, 0.0), (-0.6, 0.8), (0.0, 0.0)):
        law = rn.DryFriction(moment=moment, curvature=1.0 / L, pull={"beam": pull})
        found = rn.equilibrium(beam(8, rn.Clamp(at="beam.start"), law))
        bent = found.internal.bending[-1] / moment
        assert bent == pytest.approx(np.tile(pull, (len(bent), 1)), abs=1e-3)
        m1 = found.robot.graph.d1[0]
        towards = pull[0] * m1 + pull[1] * np.cross([1.0, 0.0, 0.0], m1)
        assert found.x[-1, -1] - [L, 0, 0] == pytest.approx(0.5e-4 * L * towards, abs=1e-7 * L)


def test_strands_rub_only_where_they_ran():
    figure = rn.StickFigure()
    figure.rod("near", [(0, 0, 0), (L, 0, 0)], edges=3, material=MATERIAL, radius=R)
    figure.rod("far", ["near.end", (2 * L, 0, 0)], edges=3, material=MATERIAL, radius=R)
    law = rn.DryFriction(moment=1e-6, curvature=1.0, pull={"near": (1.0, 0.0)})
    robot = rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="near.start"), law])
    bent = np.linalg.norm(rn.equilibrium(robot).internal.bending[-1], axis=1)
    # at the wall, at two nodes, and at that between the two, where they end
    assert (bent > 0.5e-6).sum() == 4 and (bent < 1e-12).sum() == 2


def test_a_term_that_only_tells_what_was_pulled_changes_no_bit():
    clamp = rn.Clamp(at="beam.start")
    note = rn.DryFriction(moment=1e-3, pull={"beam": (1.0, 0.0)}, rubs=False)
    one, two = (rn.Simulation(beam(6, rn.Gravity(), clamp, *more), 0.01).run(0.1) for more in ((), (note,)))
    np.testing.assert_array_equal(one.x, two.x)


def test_powers_add_up_with_friction():
    law = rn.DryFriction(moment=1e-4, torque=1e-4, curvature=1.0, twist=1.0)
    robot = beam(6, rn.Gravity(), rn.Clamp(at="beam.start"), law, rn.KelvinVoigt(bend=1e-3))
    traj = rn.Simulation(robot, 5e-3, stepper="sdirk2", tolerance=rn.Tolerance(residual=1e-11)).run(0.2)
    powers = dict(traj.powers)
    kinetic = powers.pop("kinetic")
    assert np.abs(sum(powers.values()) - kinetic)[1:].max() < 1e-7 * np.abs(powers["gravity"]).max()
    assert traj.powers["friction"].min() < -1e-3 * np.abs(powers["gravity"]).max()


@few
@given(arrays(float, (12, 3), elements=st.floats(-3.0, 3.0)))
def test_any_walk_only_takes_energy(path):
    """Force at the end of a step times the step covers the energy stored, 1/2 z^2; the state stays in its disc."""
    z = np.zeros((1, 3))
    for step in path:
        new, slope = dahl(z, step[None]), dahl_slope(z, step[None])[0]
        assert np.sum(new * step) >= 0.5 * np.sum(new**2) - 0.5 * np.sum(z**2) - 1e-12
        assert np.linalg.norm(new[:, :2]) <= 1.0 + 1e-12 >= abs(new[0, 2])
        halves = dahl(dahl(z, 0.3 * step[None]), 0.7 * step[None])
        assert halves == pytest.approx(new, abs=1e-12)
        assert np.all(np.isfinite(slope))
        z = new
