"""Step size control: accuracy follows the tolerance, runs end on time, restarts are bit-equal."""

import numpy as np
import pytest

import rodnet as rn


def cable(drag: float = 0.1, **options) -> rn.Simulation:
    """A cable that swings from one end in a medium."""
    fig = rn.StickFigure()
    material = rn.Material(E=1e6, nu=0.5, rho=1000.0)
    fig.rod("cable", [(0, 0, 0), (0.3, 0, 0)], edges=12, material=material, radius=3e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Hinge(at="cable.start")]
    medium = rn.ResistiveForce(eta_t=0.5 * drag, eta_n=drag)
    return rn.Simulation(rn.Robot(fig.build(), [*terms, medium]), **options)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_the_error_follows_the_tolerance(stepper):
    """A ten times smaller tolerance gives about as much smaller an error, and more steps."""
    fine = cable(dt=2e-4, stepper="sdirk2").run(0.4, save_every=2000).x[-1]
    errors, steps = [], []
    for tolerance in (3e-2, 3e-3):
        traj = cable(dt=1e-3, stepper=stepper, adaptive=tolerance).run(0.4)
        assert traj.t[-1] == 0.4
        errors.append(np.abs(traj.x[-1] - fine).max() / 0.3)
        steps.append(traj.stats["steps"])
    assert errors[1] < 0.2 * errors[0] and errors[1] < 1e-2
    assert steps[1] > steps[0]


def test_long_steps_where_nothing_changes_and_short_ones_where_it_does():
    """A fall needs short steps, coming to rest long ones, bounded as asked."""
    sim = cable(drag=1.0, dt=1e-4, stepper="sdirk2", adaptive=rn.Adaptive(1e-2, longest=0.05))
    traj = sim.run(4.0)
    lengths = np.diff(traj.t)
    assert lengths.max() <= 0.05 * (1 + 1e-9)
    assert lengths[traj.t[1:] > 3.0].mean() > 3.0 * lengths[traj.t[1:] < 0.1].mean()


def test_the_paper_s_robot_at_a_tenth_of_a_percent():
    """Steps of up to half a turn of the motor, an accuracy that dt = 0.01 s gives with a hundred times as many."""
    robot = rn.robots.flagellated(n_tails=2, rpm=100.0)
    sim = rn.Simulation(robot, dt=0.01, stepper="sdirk2", adaptive=0.03)
    got = rn.robots.flagellated_metrics(sim.run(30.0))
    assert got.speed == pytest.approx(2.15240e-4, rel=1e-3)
    assert got.head_rpm == pytest.approx(95.5049, rel=1e-3)
    assert sim.state.index < 300


def test_a_motor_bounds_the_step():
    """The natural angle of a motor joint is known up to whole turns only: no step takes half of one."""
    robot = rn.robots.flagellated(n_tails=2, rpm=600.0)
    sim = rn.Simulation(robot, dt=0.2, stepper="sdirk2", adaptive=0.5)
    traj = sim.run(2.0)
    assert np.diff(traj.t).max() < 0.05


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_a_restart_is_bit_equal(tmp_path, stepper):
    whole = cable(dt=1e-3, stepper=stepper, adaptive=1e-2)
    first = cable(dt=1e-3, stepper=stepper, adaptive=1e-2)
    for _ in range(10):
        whole.step()
        first.step()
    first.run(0.01, out=tmp_path / "run.nc")
    second = cable(dt=1e-3, stepper=stepper, adaptive=1e-2)
    second.restore(rn.Trajectory.load(tmp_path / "run.nc", second.robot).state())
    for _ in range(10):
        first.step()
        second.step()
    assert first.t == second.t
    assert np.array_equal(first.state.q, second.state.q) and np.array_equal(first.state.v, second.state.v)


@pytest.mark.parametrize(
    "bad", [{"tolerance": 0.0}, {"tolerance": 2.0}, {"longest": 1e-9}, {"shortest": -1.0}]
)
def test_bad_settings(bad):
    with pytest.raises(rn.ParameterError, match="Adaptive"):
        rn.Adaptive(**bad)


def test_runs_within_runs_end_where_they_should():
    sim = cable(dt=1e-3, stepper="sdirk2", adaptive=1e-2)
    steps = sim.iterate(0.02)
    next(steps)
    sim.run(0.005)
    assert [view.t for view in steps][-1] == 0.02
    seen = [(view.t, sim.step().ok) for view in sim.iterate(0.01) if view.t >= 0.03]
    assert seen[-1][1] and sim.t > 0.03


def test_fixed_and_chosen_steps_do_not_share_a_file(tmp_path):
    first = cable(dt=1e-3)
    first.run(0.01, out=tmp_path / "run.nc")
    second = cable(dt=1e-3, adaptive=1e-2)
    second.restore(rn.Trajectory.load(tmp_path / "run.nc", first.robot).state(-1))
    with pytest.raises(rn.OutputError, match="its adaptive is not this simulation's"):
        second.run(0.01, out=tmp_path / "run.nc", append=True)


@pytest.mark.parametrize("bad", [True, "0.01", [0.01]])
def test_bad_controls(bad):
    with pytest.raises(rn.ParameterError, match="adaptive"):
        cable(adaptive=bad)
