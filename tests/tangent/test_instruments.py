"""Derivatives of readings by the parameters of instruments, and of laws that have none."""

import copy

import numpy as np
import pytest

import rodnet as rn
from tests.tangent import whole_runs as wr
from tests.tangent.test_whole_runs import cable

OPTIONS = dict(dt=0.02, stepper="sdirk2", tolerance=wr.ROUND_OFF)


def changed(eyes, path, change):
    """The instrument with one of its parameters changed."""
    eyes, (key, _, index) = copy.copy(eyes), path.removeprefix("markers.").partition("[")
    value = np.array(getattr(eyes, key).value, dtype=float)
    value[int(index[:-1]) if index else ...] += change
    setattr(eyes, key, getattr(eyes, key).with_value(value))
    return eyes


def test_a_camera_that_is_turned_scaled_late_and_beside_the_axis():
    robot = cable()
    eyes = rn.Markers(
        robot, {"tip": "left.end", "middle": "stem@50%"}, offset1=2e-3, scale=1.02, rotation=[0.1, -0.05, 0.2],
        lag=0.013, aside2=[1e-3, -3e-3],
    )  # fmt: skip
    own = ["scale", "rotation[1]", "offset1", "offset2", "aside1[0]", "aside2[1]", "shift[2]", "lag"]
    paths = ["stem.E", *(f"markers.{name}" for name in own)]
    found = rn.sensitivities(robot, 0.2, parameters=paths, observe=[eyes], **OPTIONS)
    traj = rn.Simulation(robot, **OPTIONS).run(0.2)
    assert found.observed["markers"] == pytest.approx(rn.observe(eyes, traj, traj.t)[0], abs=1e-15)
    slopes = found.outputs["markers"]
    assert eyes.rods == ("left", "stem") and not slopes[:, 1, :, paths.index("markers.aside1[0]")].any()
    for c, path in enumerate(paths[1:], start=1):
        up, down = (rn.observe(changed(eyes, path, s * 1e-5), traj, traj.t)[0] for s in (1.0, -1.0))
        expected = (up - down) / 2e-5
        assert slopes[..., c] == pytest.approx(expected, abs=2e-6 * np.abs(expected).max()), path
    step = 1e-4 * robot.parameters["stem.E"].value
    runs = [robot.with_parameters({"stem.E": 2e6 + s * step}) for s in (1.0, -1.0)]
    up, down = (rn.observe(eyes, rn.Simulation(r, **OPTIONS).run(0.2), traj.t)[0] for r in runs)
    expected = (up - down) / (2.0 * step)
    assert slopes[..., 0] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("markers.zoom", "no parameter 'zoom'"),
        ("markers.shift", "one of 3 values, 'markers.shift\\[0\\]'"),
        ("markers.shift[3]", "one of 3 values"),
        ("markers.scale[0]", "one number"),
    ],
)
def test_a_bad_path_is_refused(path, message):
    robot = cable()
    with pytest.raises(rn.ParameterError, match=message):
        rn.sensitivities(robot, 0.1, parameters=[path], observe=[rn.Markers(robot, ["left.end"])])


class Cornered(rn.DragModel):
    """Resists the more the farther its memory is from zero, which begins at ``offset``."""

    memory_size = 1
    offset = rn.Parameter(0.0, unit="1")

    def initial_memory(self, site, p):
        return np.full((len(site.v), 1), 1.0) * p.offset

    def update(self, site, p, m_old):
        return -(1.0 + np.abs(m_old)) * site.v, m_old


def test_what_has_no_derivative_is_refused():
    robot = cable(Cornered(on="left"))
    with pytest.raises(rn.DerivativeError, match=r"derivative by 'drag.offset' at t = .* increase"):
        rn.sensitivities(robot, 0.1, parameters=["drag.offset"], **OPTIONS)
    # beside the corner there is one
    found = rn.sensitivities(
        robot.with_parameters({"drag.offset": 0.3}), 0.1, parameters=["drag.offset"], **OPTIONS
    )
    assert np.abs(found.x[-1]).max() > 0.0
