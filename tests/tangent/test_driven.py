"""Laws that are measured against what an actuator drives, and factors on drag in a flow: derivatives of whole runs."""

import numpy as np
import pytest

import rodnet as rn
from tests.tangent.whole_runs import at_end, by_one, last, parts

OPTIONS = {"dt": 5e-3, "stepper": "sdirk2"}
MOTOR = rn.Motor(at="rod:3", rpm=200.0)
WAVE = rn.CurvatureWave(amplitude=20.0, wavelength=0.08, frequency=4.0)
SLOW = rn.SlowCurvature(curvature=15.0, time_constant=0.02)
VISCOUS = rn.KelvinVoigt(bend=0.01, twist=0.01)
THINNING = rn.PowerLawChange(exponent=0.6, speed=0.02)
CASES = {
    "motor and viscosity": ([MOTOR, VISCOUS], ["damping.twist", "damping.bend"]),
    "wave and viscosity": ([WAVE, VISCOUS], ["damping.bend", "rod.E", "wave.amplitude"]),
    "slow curvature and viscosity": ([SLOW, VISCOUS], ["damping.bend", "rod.E"]),
    "wave and cubic": ([WAVE, rn.CubicBending(hardening=2e-3)], ["cubic.hardening", "rod.E"]),
    "wave and compliance": ([WAVE, rn.JointCompliance(at="rod:4", length=0.01)], ["give.length", "rod.E"]),
    "thinning in a flow": ([THINNING], ["thinning.exponent", "thinning.speed", "drag.eta_n"]),
}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_whole_runs(name):
    terms, paths = CASES[name]
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=8, material=rn.Material(E=1e6, rho=1100.0), radius=2e-3)
    flow = (0.1, 0.0, 0.05) if terms == [THINNING] else None
    drag = rn.ResistiveForce(eta_t=0.5, eta_n=1.0, flow=flow)
    elastic = rn.Stretching(), rn.Bending(), rn.Twisting()
    robot = rn.Robot(fig.build(), [*elastic, rn.Clamp(at="rod.start"), rn.Gravity(), drag, *terms])
    found = rn.sensitivities(robot, 0.05, parameters=paths, **OPTIONS)
    run = lambda one: last(one, 0.05, **OPTIONS)  # noqa: E731
    here = run(robot)
    for k, path in enumerate(paths):
        expected, allowed = by_one(robot, path, run, here, parts(robot))
        assert np.all(np.abs(at_end(found)[:, k] - expected) <= allowed), path
