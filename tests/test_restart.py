"""Trajectory files under bad circumstances, and restarts that differ from nothing."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn


def worm():
    """A rod with three overlapping waves of natural curvature and a turning joint."""
    figure = rn.StickFigure()
    material = rn.Material(E=1e6, rho=1000.0)
    figure.rod("worm", [(0, 0, 0), (0.2, 0, 0)], edges=8, material=material, radius=3e-3)
    waves = [
        rn.CurvatureWave(amplitude=17.3, name="one"),
        rn.CurvatureWave(amplitude=3.7, frequency=0.3, axis=2, name="two"),
        rn.CurvatureWave(amplitude=2.1, frequency=2.3, name="three"),
    ]
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    drag = rn.ResistiveForce(viscosity=5.0)
    return rn.Robot(figure.build(), [*elastic, drag, *waves, rn.Motor(at="worm:3", rpm=30.0)])


@pytest.mark.parametrize("stepper", ["euler", "alpha", "sdirk2"])
def test_a_restart_is_bit_equal_with_actuators_and_keeps_the_saving_times(tmp_path, stepper):
    file = tmp_path / "run.nc"
    whole = rn.Simulation(worm(), stepper=stepper).run(1.0, save_every=10)
    rn.Simulation(worm(), stepper=stepper).run(0.37, save_every=10, out=file)
    sim = rn.Simulation(worm(), stepper=stepper)
    sim.restore(rn.Trajectory.load(file, sim.robot).state())
    rest = sim.run(0.63, save_every=10, out=file, append=True)
    one, two = whole.state(), rest.state()
    for name in ("t", "index", "q", "v", "a", "acc", "tangents", "directors", "tau", "turns"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name
    extra = np.isin(rest.t, whole.t, invert=True)
    assert rest.t[extra].tolist() == [0.37]
    assert np.array_equal(rest.x[~extra], whole.x)


def test_a_motor_must_not_outrun_the_time_step():
    sim = rn.Simulation(rn.robots.flagellated(edges=4, rpm=4000.0), dt=0.01)
    with pytest.raises(
        rn.TermError, match=r"'motor' makes 0\.667 turns in one time step.* take dt below 0\.0075 s"
    ):
        sim.step()


def test_metrics_of_a_motor_that_stands_still():
    traj = rn.Simulation(rn.robots.flagellated(edges=4, rpm=0.0)).run(0.05)
    with pytest.raises(rn.ParameterError, match="turns at a constant speed"):
        rn.robots.flagellated_metrics(traj)


def test_files_that_are_not_trajectories(tmp_path):
    (tmp_path / "text.nc").write_text("text")
    with pytest.raises(rn.OutputError, match=r"cannot read .*text\.nc"):
        rn.Trajectory.load(tmp_path / "text.nc")
    with pytest.raises(rn.OutputError, match=r"missing\.nc"):
        rn.Trajectory.load(tmp_path / "missing.nc")
    file = tmp_path / "cut.nc"
    rn.Simulation(rn.robots.flagellated(edges=4)).run(0.1, out=file)
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(rn.OutputError, match=r"cut\.nc"):
        rn.Trajectory.load(file)
