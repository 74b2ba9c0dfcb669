"""Force cells and cameras that are off, and starts of robots with rigid bodies, in a calibration."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.inference.comparison import Comparison
from rodnet.inference.modes import soft_modes
from tests.inference.swings import DT, POINTS, cable, eyes, record

WHITE = rn.NoiseModel(white=2e-4)
TIGHT = rn.Tolerance(residual=1e-12, update=1e-14, iterations=60)


def differences_agree(trial, values, scales):
    J = trial.evaluate(values, scales).jacobian
    for k, path in enumerate(scales):
        step = 1e-3 * scales[path]
        up, down = (trial.evaluate({**values, path: values[path] + s * step}).residual for s in (1, -1))
        quotient = (up - down) / (2 * step)
        assert np.abs(J[:, k] - quotient).max() < 1e-4 * np.abs(quotient).max(), path


# -- force cells --------------------------------------------------------------------------------
def test_a_force_cell_reads_the_reaction():
    robot = cable()
    traj = rn.Simulation(robot, dt=DT, stepper="sdirk2").run(0.1)
    cell = rn.EndForce(robot, "force", at="clamp", gain=2.0, zero=[0.1, 0.0, 0.0])
    (read,) = rn.observe(cell, traj, traj.t)
    np.testing.assert_allclose(read - [0.1, 0.0, 0.0], -2.0 * traj.reactions["clamp"].force, atol=1e-9)
    assert np.abs(read[:, 2]).max() > 0.05


def cell_and_camera(rec, robot):
    return [rn.EndForce(robot, "force", at="clamp", axes="xz"), rn.Markers(robot, POINTS)]


def weighed(robot, gain, seed=0, duration=0.3):
    """A recording with a force cell, too, that shows too much."""
    rec = record(robot, WHITE, seed, duration)
    traj = rn.Simulation(robot, dt=DT, stepper="sdirk2").run(duration)
    (force,) = rn.observe(rn.EndForce(robot, "force", at="clamp", axes="xz", gain=gain), traj, traj.t)
    force = force + 1e-3 * np.random.default_rng(seed).standard_normal(force.shape)
    return rec.replace(channels={"force": force})


def test_readings_that_depend_on_parameters_have_their_derivatives():
    rec = weighed(cable(), 1.0, duration=0.08)
    noise = {"markers": WHITE, "end_force": rn.NoiseModel(white=1e-3)}
    case = rn.Case(lambda rec: cable(), cell_and_camera, options=lambda rec, robot: {"tolerance": TIGHT})
    values = {"cable.E": 2.2e6, "cable.rho": 1100.0, "end_force.gain": 1.1, "end_force.zero[2]": 0.01}
    scales = {"cable.E": 2e6, "cable.rho": 1000.0, "end_force.gain": 1.0, "end_force.zero[2]": 0.1}
    differences_agree(Comparison(case, rec, noise), values, scales)


def test_forces_tell_mass_from_stiffness_and_the_gain_of_their_cell():
    rec = weighed(cable(), 1.05)
    found = rn.calibrate(
        cable(E=3e6, rate=0.8), [rec], observe=cell_and_camera, workers=0,
        free=["cable.E", "mass_damping.rate", "end_force.gain"], noise={"end_force": 1e-3},
    )  # fmt: skip
    gain = found.parameters["end_force.gain"]
    assert abs(gain.value - 1.05) < 3.5 * gain.sd * gain.value < 0.02
    assert abs(np.log(found.values["cable.E"] / 2e6)) < 3.5 * found.parameters["cable.E"].sd


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": "clmp"}, "did you mean 'clamp'"),
        ({"at": "clamp", "axes": "xw"}, "axes"),
        ({"at": "clamp"}, "forces"),
    ],
)
def test_bad_force_cells_are_named(options, message):
    with pytest.raises(rn.RecordingError, match=message):
        rn.EndForce(cable(), "force", **options).measured(weighed(cable(), 1.0, duration=0.05))


# -- cameras ------------------------------------------------------------------------------------
def test_a_camera_that_is_off_is_found_with_the_robot():
    traj = rn.Simulation(cable(), dt=DT, stepper="sdirk2").run(0.5)
    off = {"scale": 1.02, "rotation": [0.0, 0.03, 0.0], "lag": 0.016}
    (seen,) = rn.observe(rn.Markers(cable(), POINTS, **off), traj, traj.t)
    seen = seen + WHITE.sample(traj.t, len(POINTS), np.random.default_rng(0))
    rec = rn.Recording(traj.t, seen, names=list(POINTS), noise=WHITE)
    free = ["cable.E", "mass_damping.rate", "markers.scale", "markers.rotation[1]", "markers.lag"]
    found = rn.calibrate(cable(E=3e6, rate=0.8), [rec], observe=eyes, free=free, workers=0)
    truth = {"cable.E": 2e6, "mass_damping.rate": 1.5, "markers.scale": 1.02, "markers.rotation[1]": 0.03,
             "markers.lag": 0.016}  # fmt: skip
    for path, value in truth.items():
        one = found.parameters[path]
        error = np.log(one.value / value) if one.log else one.value - value
        assert abs(error) < 3.5 * one.sd, path
    assert found.variance_factor == 1.0


def test_derivatives_of_what_markers_that_slip_show_are_those_of_whole_runs():
    rec = record(cable(), WHITE, duration=0.08)
    case = rn.Case(lambda rec: cable(), eyes, options=lambda rec, robot: {"tolerance": TIGHT})
    values = {"cable.E": 2.2e6, "cable.rho": 1100.0, "markers.misplaced[0]": 4e-3, "markers.drift[1]": 0.05}
    scales = {"cable.E": 2e6, "cable.rho": 1e3, "markers.misplaced[0]": 1e-3, "markers.drift[1]": 1e-2}
    differences_agree(Comparison(case, rec, {"markers": WHITE}), values, scales)


LENS = {"lens": 3.0, "keystone": [0.1, 0.0, -0.2], "bow": [0.0, 0.1, 0.05], "middle": [0.1, 0.0, -0.02]}


def test_a_lens_shows_what_is_far_from_the_middle_farther_off():
    even, bent = rn.Markers(cable(), POINTS), rn.Markers(cable(), POINTS, lens=2.0, middle=[0.1, 0.0, 0.0])
    assert not even.bends and bent.bends
    sim = rn.Simulation(cable(), dt=DT)
    off = even.read(sim.observe()) - [0.1, 0.0, 0.0]
    far = np.linalg.norm(off, axis=1, keepdims=True)
    np.testing.assert_allclose(
        bent.read(sim.observe()) - [0.1, 0.0, 0.0], (1.0 + 2.0 * far**2) * off, atol=1e-15
    )
    tilted = rn.Markers(cable(), POINTS, plane="xz", keystone=[0.5, 9.0, 0.0], bow=[0.0, 9.0, 0.3])
    x, z = (even.read(sim.observe())[:, k] for k in (0, 2))
    wider = 1.0 + 0.5 * x
    np.testing.assert_allclose(
        tilted.read(sim.observe()), np.stack([wider * x, wider * z + 0.3 * (x**2 + z**2)], axis=1), atol=1e-15
    )


def test_derivatives_through_a_lens_are_those_of_whole_runs():
    rec = record(cable(), WHITE, duration=0.08)

    def bent(rec, robot):
        return [rn.Markers(robot, POINTS, **LENS)]

    case = rn.Case(lambda rec: cable(), bent, options=lambda rec, robot: {"tolerance": TIGHT})
    values = {
        "cable.E": 2.2e6, "markers.scale": 1.02, "markers.rotation[1]": 0.1, "markers.offset1": 2e-3,
        "markers.misplaced[0]": 4e-3, "markers.lens": 2.0, "markers.keystone[2]": 0.1, "markers.bow[0]": -0.1,
        "markers.middle[0]": 0.07,
    }  # fmt: skip
    scales = {path: abs(value) for path, value in values.items()}
    differences_agree(Comparison(case, rec, {"markers": WHITE}), values, scales)


# -- rigid bodies ---------------------------------------------------------------------------------
def loaded(E=2e6):
    """A cable with a block at its end."""
    figure = rn.StickFigure()
    material = rn.Material(E=E, nu=0.5, rho=1200.0)
    figure.rod("cable", [(0, 0, 0), (0.2, 0, -0.1)], edges=3, material=material, radius=4e-3)
    figure.rigid("block", ["cable.end", (0.24, 0, -0.1), (0.24, 0.03, -0.1)])
    figure.body("block", mass=0.02)
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    return rn.Robot(
        figure.build(), [*elastic, rn.Gravity(), rn.Clamp(at="cable.start"), rn.MassDamping(rate=1.0)]
    )


CORNERS = {"mid": "cable:2", "tip": "cable.end", "corner": "block.end"}


def test_modes_move_rigid_bodies_as_such():
    robot = loaded()
    modes = soft_modes(robot, 4)[:, : 3 * robot.graph.node_count].reshape(4, -1, 3)
    x, block = robot.graph.x0, robot.graph.bodies[0].nodes
    for mode in modes:
        for i in block:
            for j in block:
                assert abs((mode[i] - mode[j]) @ (x[i] - x[j])) < 1e-9


def cross():
    """Four equal arms in a plane, held where they meet: every mode is one of eight, or of four and twice two."""
    figure = rn.StickFigure()
    ends = [(0.2, 0, 0), (0, 0.2, 0), (-0.2, 0, 0), (0, -0.2, 0)]
    for k, end in enumerate(ends):
        root = (0, 0, 0) if k == 0 else "arm0.start"
        figure.rod(
            f"arm{k}", [root, end], edges=6, material=rn.Material(E=2e6, nu=0.5, rho=1200.0), radius=4e-3
        )
    return rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm0.start")])


def straight():
    """A rod that may bend to either side, with finer edges at its root."""
    figure = rn.StickFigure()
    nodes = [(x, 0, 0) for x in (0.0, 0.002, *np.linspace(0.02, 0.3, 14))]
    figure.rod("rod", nodes, material=rn.Material(E=2e6, nu=0.5, rho=1200.0), radius=4e-3)
    return rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="rod.start")])


@pytest.mark.parametrize(("make", "count"), [(straight, 5), (cross, 7), (loaded, 4)])
def test_modes_are_those_of_another_mesh(make, count):
    """Of modes that cost the same any combination is one: an amplitude means the same whatever the mesh."""
    coarse = make().refined()
    fine = coarse.refined()
    away = np.linalg.norm(fine.graph.x0[None] - coarse.graph.x0[:, None], axis=2)
    assert away.min(axis=1).max() < 1e-12
    a, b = (
        soft_modes(robot, count)[:, : 3 * robot.graph.node_count].reshape(count, -1, 3)
        for robot in (coarse, fine)
    )
    b = b[:, away.argmin(axis=1)]
    for k in range(count):
        assert np.sum(a[k] * b[k]) > 0.99 * np.linalg.norm(a[k]) * np.linalg.norm(b[k])
        assert np.linalg.norm(b[k]) == pytest.approx(np.linalg.norm(a[k]), rel=0.05)


def test_starts_of_robots_with_rigid_bodies_are_found():
    robot = loaded()
    modes = soft_modes(robot, 2)[:, : 3 * robot.graph.node_count].reshape(2, -1, 3)
    see = lambda rec, robot: rn.Markers(robot, CORNERS)  # noqa: E731
    traj = rn.Simulation(robot, dt=DT, stepper="sdirk2", velocity=0.15 * modes[0] - 0.1 * modes[1]).run(0.3)
    (seen,) = rn.observe(see(None, robot), traj, traj.t)
    seen = seen + WHITE.sample(traj.t, len(CORNERS), np.random.default_rng(0))
    rec = rn.Recording(traj.t, seen, names=list(CORNERS), noise=WHITE)
    found = rn.calibrate(
        robot, [rec], observe=see, free=["cable.E"], start={"cable.E": 2.6e6}, per_trial=["initial.velocity"],
        modes=2, workers=0,
    )  # fmt: skip
    E, own = found.parameters["cable.E"], found.per_trial["recording"]
    assert abs(np.log(E.value / 2e6)) < 3.5 * E.sd < 0.05
    for k, speed in ((0, 0.15), (1, -0.1)):
        one = own[f"initial.velocity[{k}]"]
        assert abs(one.value - speed) < 3.5 * one.sd < 0.05
    assert found.variance_factor == 1.0


def test_a_displaced_body_keeps_its_shape():
    rec = record(cable(), WHITE, duration=0.05)
    trial = Comparison(
        rn.Case(lambda rec: loaded(), lambda rec, robot: rn.Markers(robot, POINTS)), rec, {}, 3
    )
    robot, _ = trial.robot_at({"initial.position[0]": 0.01, "initial.position[1]": -0.02})
    block = robot.graph.bodies[0].nodes
    arms = [x[block] - x[block][0] for x in (trial.robot.graph.x0, robot.graph.x0)]
    np.testing.assert_allclose(arms[1] @ arms[1].T, arms[0] @ arms[0].T, atol=1e-12)
    assert np.abs(arms[1] - arms[0]).max() > 1e-4
