"""Clamps that slide along an axis: what they hold, what they let go, and what they feel."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from tests.mechanics.beams import EI, GJ, MATERIAL, WEIGHT, L, R, beam, elastic, end, order, rest

P = 1e-3 * EI / L**2


def guided(edges, **load):
    """Clamped at the start, guided across the rod at the end."""
    force = rn.PointForce(at="beam.end", force=(0.0, 0.0, -P))
    return rest(beam(edges, rn.Clamp(at="beam.start"), rn.Slider(at="beam.end", axis=(0, 0, 1)), force))


def test_contract():
    rn.testing.check_term(rn.Slider)
    turning = rn.Slider(
        at="rod.start",
        axis=(0, 1, 0),
        position=lambda t: (0.01 * np.sin(t), 0.0, 0.0),
        orientation=lambda t: Rotation.from_rotvec([0.2 * np.sin(t), 0.0, 0.1 * t]),
    )
    rn.testing.check_term(turning)


def test_a_guided_beam_sinks_by_a_twelfth():
    """P L^3 / (12 EI), to second order; its end stays level."""
    sizes = (8, 16, 32)
    errors = [end(guided(n), "beam.end")[2] / (-P * L**3 / (12.0 * EI)) - 1.0 for n in sizes]
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.1)
    assert abs(errors[-1]) < 2e-3
    traj = guided(16)
    held, clamp = traj.reactions["slider"], traj.reactions["clamp"]
    assert held.force[-1] == pytest.approx((held.force[-1, 0], 0.0, 0.0), abs=1e-6 * P)
    assert clamp.force[-1, 2] == pytest.approx(P, rel=1e-6)
    # both walls carry P L / 2
    for moment in (held.moment[-1, 1], clamp.moment[-1, 1]):
        assert moment == pytest.approx(-0.5 * P * L, rel=1e-3)


def test_a_column_between_sliding_clamps_bends_and_buckles_as_euler_says():
    """Under thrust P a force Q in the middle bends it by Q / P (tan(k L / 4) / k - L / 4), k^2 = P / EI."""
    critical, Q = 4.0 * np.pi**2 * EI / L**2, 1e-4 * EI / L**2

    def middle(share):
        push = rn.PointForce(at="beam.end", force=(-share * critical, 0.0, 0.0))
        side = rn.PointForce(at="beam:20", force=(0.0, 0.0, Q))
        ends = rn.Clamp(at="beam.start"), rn.Slider(at="beam.end", axis=(1, 0, 0))
        return rn.equilibrium(beam(40, *ends, push, side)).x[-1, 20, 2]

    for share in (0.5, 0.9):
        k = np.sqrt(share * critical / EI)
        theory = Q / (share * critical) * (np.tan(0.25 * k * L) / k - 0.25 * L)
        assert middle(share) == pytest.approx(theory, rel=0.03)
    assert middle(1.05) > 0.1 * L


def test_a_twisted_rod_under_a_weight_keeps_its_tension():
    """The torque is GJ phi / L, and the sliding end carries none of the pull."""
    pull, turn = 0.1 * EI / L**2, 2.5 * np.pi
    robot = beam(
        20,
        rn.Clamp(at="beam.start"),
        rn.Slider(
            at="beam.end",
            axis=(1, 0, 0),
            orientation=lambda t: Rotation.from_rotvec([turn * min(t, 1.0), 0, 0]),
        ),
        rn.PointForce(at="beam.end", force=(pull, 0.0, 0.0)),
        rn.MassDamping(rate=20.0),
    )
    traj = rn.Simulation(robot, 0.02).run(4.0)
    assert traj.internal.tension[-1] == pytest.approx(pull, rel=1e-6)
    assert traj.internal.torque[-1] == pytest.approx(GJ * turn / L, rel=1e-6)
    assert traj.reactions["slider"].moment[-1, 0] == pytest.approx(GJ * turn / L, rel=1e-6)
    assert abs(traj.reactions["slider"].force[-1, 0]) == 0.0


def test_a_rod_between_sliders_falls_freely_and_level():
    """Nothing acts along the axis, over many lengths of an edge."""
    sliders = [rn.Slider(at=at, axis=(0, 0, 1), name=at[5:]) for at in ("beam.start", "beam.end")]
    sim = rn.Simulation(beam(10, rn.Gravity(g=9.81), *sliders), 0.01, stepper="sdirk2")
    traj = sim.run(0.5)
    assert traj.x[-1, :, 2] == pytest.approx(-0.5 * 9.81 * 0.25, rel=1e-6)
    assert traj.x[-1, :, 0] == pytest.approx(np.linspace(0.0, L, 11), abs=1e-9 * L)
    assert np.abs(traj.reactions["start"].force).max() < 1e-6 * WEIGHT * 9.81 * L


def test_a_slider_in_the_middle_of_a_rod_is_a_wall_for_both_sides():
    """A free rod through a bushing: each side hangs as from a clamp."""
    robot = beam(20, rn.Gravity(g=9.81), rn.Slider(at="beam:8", axis=(1, 0, 0)))
    walled = beam(20, rn.Gravity(g=9.81), rn.Clamp(at="beam:8"))
    assert rest(robot).x[-1, :, 2] == pytest.approx(rest(walled).x[-1, :, 2], abs=1e-5 * L)


def test_a_weight_on_a_rope_through_a_guide():
    """A rigid body hangs from a rod whose end slides down with it: both fall at g, straight."""
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0, 0, -L)], edges=6, material=MATERIAL, radius=R)
    fig.rigid("weight", ["rod.end", (0, 0, -1.2 * L)], mass=0.01)
    fig.body("weight")
    terms = [*elastic(), rn.Gravity(g=9.81), rn.Slider(at="rod.start", axis=(0, 0, 1))]
    traj = rn.Simulation(rn.Robot(fig.build(), terms), 0.01, stepper="sdirk2").run(0.3)
    assert traj.x[-1] - traj.x[0] == pytest.approx(np.tile([0.0, 0.0, -0.5 * 9.81 * 0.09], (8, 1)), abs=1e-9)


def test_bad_sliders_are_refused():
    for axis in ((1, 1, 0), (0, 0, 0), "x", (1, 0)):
        with pytest.raises(rn.TermError, match="along x, y or z"):
            rn.Slider(at="beam.end", axis=axis)
    with pytest.raises(rn.TermError, match="another constraint holds"):
        beam(4, rn.Slider(at="beam.end", axis=(1, 0, 0)), rn.Hinge(at="beam.end"))
    with pytest.raises(rn.TermError, match="both ends of an edge"):
        beam(4, rn.Slider(at="beam:3-4", axis=(1, 0, 0)))
    far = rn.Slider(at="beam.end", axis=(1, 0, 0), position=lambda t: (0.0, L, 0.0))
    with pytest.raises(rn.TermError, match="at t = 0"):
        rn.Simulation(beam(4, far))
