"""Runs that are interrupted or fail in the middle: what was computed is kept."""

from __future__ import annotations

import signal

import numpy as np
import pytest

import rodnet as rn


def swimmer(**options) -> rn.Robot:
    return rn.robots.flagellated(2, 120.0, edges=6, **options)


def test_ctrl_c_keeps_what_was_computed(tmp_path):
    def interrupt(view):
        if view.t > 0.1:
            raise KeyboardInterrupt
        return False

    traj = rn.Simulation(swimmer(), dt=1e-2).run(1.0, stop=interrupt, out=tmp_path / "run.nc")
    assert traj.status == "interrupted"
    assert traj.t[-1] == pytest.approx(0.11)
    assert np.array_equal(rn.Trajectory.load(tmp_path / "run.nc").t, traj.t)


def test_ctrl_c_is_heeded_where_python_would_forget_it():
    """In a finaliser, KeyboardInterrupt is printed and gone; a second Ctrl-C does not wait."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it

    class Finalised:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def ask(state):
        if state.t > 0.045:
            Finalised()
        return False

    traj = rn.Simulation(swimmer(), dt=1e-2).run(1.0, stop=ask)
    assert (traj.status, traj.state().index) == ("interrupted", 5)

    def ask_twice(state):
        if state.t > 0.045:
            Finalised()
            signal.raise_signal(signal.SIGINT)
        return False

    assert rn.Simulation(swimmer(), dt=1e-2).run(1.0, stop=ask_twice).status == "interrupted"
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def arm(*terms: rn.Term, sensors=None) -> rn.Robot:
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=6, material=rn.Material(E=1e6), radius=3e-3)
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), *terms], sensors
    )


@pytest.mark.parametrize("where", ["sensor", "event", "actuator"])
def test_ctrl_c_inside_a_users_function_keeps_what_was_computed(tmp_path, where):
    """Wherever it strikes, what is in memory and on disk is whole, and the run can go on from there."""
    armed = [True]

    def strike(t):
        if t > 0.045 and armed[0]:
            raise KeyboardInterrupt
        return t

    robot = arm(
        rn.Clamp(at="arm.start"),
        rn.Motor(at="arm:3", angle=lambda t: strike(t) if where == "actuator" else t),
        sensors={"clock": lambda s: strike(s.t) if where == "sensor" else s.t},
    )
    events = [rn.Event(lambda s: strike(s.t) - 1.0 if where == "event" else 1.0 + s.sensors["clock"])]
    sim = rn.Simulation(robot, dt=1e-2)
    traj = sim.run(1.0, events=events, out=tmp_path / "run.nc")
    assert traj.status == "interrupted"
    last = 0.04 if where == "actuator" else 0.05
    assert traj.t == pytest.approx(np.arange(0, last + 0.005, 0.01))
    assert np.array_equal(rn.Trajectory.load(tmp_path / "run.nc").x, traj.x)
    armed[0] = False
    rest = sim.run(0.05, out=tmp_path / "run.nc", append=True)
    assert rest.t == pytest.approx(np.arange(0, last + 0.055, 0.01))


def test_a_users_mistake_in_the_middle_of_a_run_is_raised_and_the_file_says_failed(tmp_path):
    def broken(view):
        return 1.0 / (view.t < 0.045)

    sim = rn.Simulation(arm(rn.Clamp(at="arm.start"), sensors={"s": broken}), dt=1e-2)
    with pytest.raises(ZeroDivisionError):
        sim.run(0.1, out=tmp_path / "run.nc", stop=lambda s: s.sensors["s"] < 0.0)
    kept = rn.Trajectory.load(tmp_path / "run.nc")
    assert kept.status == "failed" and kept.t[-1] == pytest.approx(0.05)
