"""What instruments see of a trajectory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.inference.readings import Shaping

E = [rn.Stretching(), rn.Bending(), rn.Twisting()]


@pytest.fixture(scope="module")
def swinging():
    """A pendulum of a rod, and its trajectory."""
    figure = rn.StickFigure()
    material = rn.Material(E=1e6, rho=1200.0)
    figure.rod("rod", [(0, 0, 0), (0.3, 0, 0)], edges=10, material=material, radius=4e-3)
    robot = rn.Robot(figure.build(), [*E, rn.Gravity(), rn.Clamp(at="rod.start")])
    return robot, rn.Simulation(robot, dt=2e-3, stepper="sdirk2").run(0.4)


def recorded(t, x, **options):
    return rn.Recording(t, x, **options)


def test_points_between_nodes_and_at_frames(swinging):
    robot, traj = swinging
    eye = rn.Markers(robot, {"tip": "rod.end", "near": "rod@0.045m", "node": "rod:3"})
    (seen,) = rn.observe(eye, traj, traj.t[::10])
    assert seen.shape == (21, 3, 3)
    assert np.array_equal(seen[:, 0], traj.x[::10, -1])
    assert np.allclose(seen[:, 1], 0.5 * (traj.x[::10, 1] + traj.x[::10, 2]), atol=1e-15)
    assert np.array_equal(seen[:, 2], traj.x[::10, 3])


def test_between_states_cubics_are_exact(swinging):
    robot, traj = swinging
    gauge = rn.Reading(robot, "poly", lambda view: [view.t**3 - view.t, view.t**2])
    t = np.linspace(0.0, 0.4, 173)
    (seen,) = rn.observe(gauge, traj, t)
    assert np.allclose(seen, np.stack([t**3 - t, t**2], axis=1), rtol=0, atol=1e-14)


def test_lag_looks_earlier_and_never_before_the_start(swinging):
    robot, traj = swinging
    t = np.linspace(0.0, 0.4, 41)
    prompt, late = rn.Markers(robot, ["rod.end"]), rn.Markers(robot, ["rod.end"], lag=0.02)
    a, b = rn.observe([prompt, late], traj, t)
    assert np.allclose(b[2:], a[:-2], atol=1e-12)
    assert np.array_equal(b[0], a[0])
    with pytest.raises(rn.ParameterError, match=r"trajectory from 0 to 0\.4 s"):
        rn.observe(prompt, traj, [0.5])


def test_a_camera_whose_place_is_known_may_stand_anywhere(swinging):
    """Markers must begin near their points as this camera sees them."""
    robot, traj = swinging
    eye = rn.Markers(robot, ["rod.end", "rod:5"], shift=[2.0, 0.0, 0.0], rotation=[0.0, 0.0, 0.5 * np.pi])
    seen = rn.observe([eye], traj, traj.t[:5])[0]
    rec = rn.Recording(traj.t[:5], seen)
    eye.check(rec)
    with pytest.raises(rn.RecordingError, match="from where the robot"):
        rn.Markers(robot, ["rod.end", "rod:5"]).check(rec)


def test_camera_turns_scales_shifts_and_projects(swinging):
    robot, traj = swinging
    v = np.array([0.1, -0.2, 0.3])
    plain = rn.Markers(robot, ["rod.end", "rod:5"])
    eye = rn.Markers(robot, ["rod.end", "rod:5"], scale=1.1, rotation=v, shift=[0.01, 0, 0.02], plane="xz")
    x, seen = rn.observe([plain, eye], traj, traj.t[::50])
    expected = 1.1 * Rotation.from_rotvec(v).apply(x.reshape(-1, 3)).reshape(x.shape) + [0.01, 0, 0.02]
    assert np.allclose(seen, expected[..., [0, 2]], atol=1e-14)


def test_a_marker_beside_the_axis_turns_with_the_rod():
    """A rod turned about its axis: the marker runs on a circle of its offset."""
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.1, 0, 0)], edges=2, material=rn.Material(E=1e6, rho=1e3), radius=2e-3)
    turn = rn.PrescribedMotion(
        at="rod:0-1", orientation=lambda t: Rotation.from_rotvec([3.0 * t, 0.0, 0.0]).as_matrix()
    )
    robot = rn.Robot(figure.build(), [*E, turn])
    traj = rn.Simulation(robot, dt=1e-2, stepper="sdirk2").run(1.0)
    (x,) = rn.observe(rn.Markers(robot, ["rod@25%"], offset1=5e-3, offset2=2e-3), traj, traj.t)
    off = x[:, 0] - [0.025, 0, 0]
    assert np.allclose(np.linalg.norm(off, axis=1), np.hypot(5e-3, 2e-3), rtol=1e-9)
    angle = np.unwrap(np.arctan2(off[:, 2], off[:, 1]))
    assert angle[-1] - angle[0] == pytest.approx(3.0, rel=1e-6)  # right-handed about the tangent


def test_head_speed_and_angle(tmp_path):
    robot = rn.robots.flagellated(2, rpm=100.0, edges=6)
    traj = rn.Simulation(robot, dt=1e-2).run(1.0)
    counter, dial = rn.HeadSpeed(robot), rn.HeadAngle(robot, unit="rev")
    speed, angle = rn.observe([counter, dial], traj, traj.t)
    assert speed[-1] == pytest.approx(traj.w[-1, robot.graph.edge_indices("head:0-1")[0]] * 30 / np.pi)
    assert angle[-1] == pytest.approx(np.sum(speed[1:] * np.diff(traj.t)) / 60.0, rel=1e-9)  # implicit Euler
    rec = rn.Recording(
        traj.t, np.zeros((len(traj.t), 1, 3)), channels={"head_speed": speed, "head_angle": angle + 7}
    )
    assert np.array_equal(counter.measured(rec), speed)
    assert dial.measured(rec)[-1] == pytest.approx(angle[-1])


def test_an_angle_counts_from_the_first_frame_and_so_must_be_read_there():
    """A counter that comes on later does not know the turns until then: they would be a constant error."""
    robot = rn.robots.flagellated(2, rpm=100.0, edges=6)
    dial, t = rn.HeadAngle(robot, "dial"), 0.1 + 0.01 * np.arange(50)
    angle = 3.0 * t
    angle[:5] = angle[20] = np.nan
    rec = rn.Recording(t, np.zeros((50, 1, 3)), name="monday", channels={"dial": angle})
    with pytest.raises(rn.RecordingError, match=r"'monday'.*'dial'.*0\.05 s later.*rec\.cut\(rec\.t\[5\]"):
        dial.measured(rec)
    cut = rec.cut(rec.t[5], rec.t[-1])
    measured = dial.measured(cut)
    assert np.isnan(measured[[0, 15]]).all()  # the first counts from itself
    assert measured[-1] == pytest.approx(3.0 * cut.duration)


def test_what_was_recorded_goes_with_what_is_predicted(swinging):
    robot, traj = swinging
    (x,) = rn.observe(rn.Markers(robot, ["rod:5", "rod.end"]), traj, traj.t)
    suspect = np.zeros(x.shape[:2], dtype=bool)
    suspect[4, 1] = True
    rec = recorded(traj.t, x, names=["mid", "tip"], suspect=suspect)
    eye = rn.Markers(robot, {"tip": "rod.end"})
    assert np.isnan(eye.measured(rec)[4]).all() and np.array_equal(eye.measured(rec)[5, 0], x[5, 1])
    eye.check(rec)
    with pytest.raises(rn.RecordingError, match="units='mm'"):
        eye.check(recorded(traj.t, 40.0 + x, names=["mid", "tip"]))
    with pytest.raises(rn.RecordingError, match="no marker 'top'"):
        rn.Markers(robot, {"top": "rod.end"}).measured(rec)
    with pytest.raises(rn.RecordingError, match="2 markers, but 3"):
        rn.Markers(robot, ["rod:1", "rod:2", "rod:3"]).measured(rec)
    with pytest.raises(rn.RecordingError, match=r"2 markers, but 1 points are listed.*by name: \{'mid': "):
        rn.Markers(robot, ["rod.end"]).measured(rec)  # which of the two it is nobody knows
    with pytest.raises(rn.RecordingError, match="no channel 'head_speed'"):
        rn.HeadSpeed(robot, on="rod:0-1").measured(rec)
    with pytest.raises(rn.GraphError):
        rn.Markers(robot, ["tail.end"])
    with pytest.raises(rn.RecordingError, match="axes"):
        rn.Markers(robot, ["rod.end"], plane="xw")


def test_markers_sit_elsewhere_along_their_rod_and_slip(swinging):
    robot, traj = swinging
    points = ["rod:3", "rod@0.1m", "rod.end"]
    (seen,) = rn.observe(rn.Markers(robot, points, misplaced=[0.045, 0.0, -0.02]), traj, traj.t)
    (there,) = rn.observe(rn.Markers(robot, ["rod@0.135m", "rod@0.1m", "rod@0.28m"]), traj, traj.t)
    assert np.allclose(seen, there, atol=1e-14)
    (slips,) = rn.observe(rn.Markers(robot, points, drift=[0.1, 0.0, -0.3]), traj, traj.t)
    for k in (0, 100, 200):
        s = 0.1 * traj.t[k], -0.3 * traj.t[k]
        (there,) = rn.observe(
            rn.Markers(robot, [f"rod@{0.09 + s[0]}m", "rod@0.1m", f"rod@{0.3 + s[1]}m"]), traj, traj.t[[k]]
        )
        assert np.allclose(slips[k], there[0], atol=1e-14)
    # beyond the end it is where the last edge leads
    (beyond,) = rn.observe(rn.Markers(robot, ["rod.end"], misplaced=0.01), traj, traj.t)
    along = traj.x[:, -1] - traj.x[:, -2]
    assert np.allclose(beyond[:, 0], traj.x[:, -1] + along / 3.0, atol=1e-14)
    with pytest.raises(rn.RecordingError, match="drift has shape"):
        rn.Markers(robot, points, drift=[0.1, 0.2])


def test_a_marker_that_slips_round_a_ring_stays_on_it():
    figure = rn.StickFigure()
    angle = 2.0 * np.pi * np.arange(16) / 16
    ring = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    figure.rod("ring", ring, closed=True, material=rn.Material(E=1e6, rho=1200.0), radius=4e-3)
    robot = rn.Robot(figure.build(), E)
    view = rn.Simulation(robot, dt=1e-3).observe()
    edge = float(robot.graph.rest_length[0])
    for moved, expected in (
        (-edge, ring[-1]),
        (-2.5 * edge, 0.5 * (ring[-2] + ring[-3])),
        (17.0 * edge, ring[1]),
    ):
        (seen,) = rn.Markers(robot, ["ring:0"], misplaced=moved).read(view)
        assert np.allclose(seen, expected, atol=1e-12)


def test_any_function_of_a_state(swinging):
    robot, traj = swinging
    gauge = rn.Reading(robot, "height", lambda view: view.x[-1, 2], unit="m")
    (z,) = rn.observe(gauge, traj, traj.t)
    assert np.array_equal(z, traj.x[:, -1, 2])


def test_what_a_camera_changes_is_told_without_reading_twice(swinging):
    """Derivatives of readings by all that may be off are the difference quotients of readings."""
    robot, traj = swinging
    options = {
        "misplaced": [0.012, -0.047],
        "drift": [-0.2, 0.01],
        "offset1": 1e-3,
        "offset2": -2e-3,
        "scale": 1.1,
        "rotation": [0.1, 0.2, -0.1],
        "shift": [0.1, 0, 0],
    }
    eye = rn.Markers(robot, ["rod.end", "rod:5"], plane="xz", **options)
    view, h = traj.view(150), 1e-6
    assert view.t > 0.2

    def changed(name, index, step):
        values = dict(options)
        values[name] = options[name] + step if index is None else [*options[name]]
        if index is not None:
            values[name][index] += step
        return rn.Markers(robot, ["rod.end", "rod:5"], plane="xz", **values)

    places = [
        ("offset1", None),
        ("offset2", None),
        ("scale", None),
        *(("rotation", k) for k in range(3)),
        ("shift", 2),
        *((name, k) for name in ("misplaced", "drift") for k in range(2)),
    ]
    near = [(changed(*place, -h), changed(*place, h), 2.0 * h) for place in places]
    rows = np.zeros((2, 2, 13))
    Shaping(eye, list(range(1, 12)), near).add(view, rows)
    for k, (low, high, width) in enumerate(near):
        quotient = (high.read(view) - low.read(view)) / width
        np.testing.assert_allclose(rows[..., k + 1], quotient, atol=1e-8)
    assert not rows[..., [0, 12]].any()
