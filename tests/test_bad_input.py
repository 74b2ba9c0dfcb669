"""Bad input gets a clear error, naming the culprit and the remedy, before any computing."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn

RUBBER = rn.Material(E=1e6)


def figure(**options) -> rn.StickFigure:
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (1, 0, 0)], edges=10, material=RUBBER, radius=0.01, **options)
    return fig


def robot(*terms: rn.Term) -> rn.Robot:
    return rn.Robot(figure().build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), *terms])


def rod(points, **options):
    options = {"material": RUBBER, "radius": 0.01, **options}
    return lambda: rn.StickFigure().rod("arm", points, **options).build()


CASES = {
    "zero length": (rod([(0, 0, 0), (0, 0, 0), (1, 0, 0)]), "'arm'.*zero length.*remove"),
    "coincident": (
        lambda: figure().rod("leg", [(1, 0, 0), (1, 1, 0)], edges=3, material=RUBBER, radius=0.01).build(),
        "'arm:10' and 'leg:0' coincide.*pass the reference",
    ),
    "unknown rod in on": (lambda: robot(rn.Gravity(on="leg*")), "'leg\\*'.*known are: arm"),
    "unknown rod in at": (lambda: robot(rn.Clamp(at="amr.start")), "'amr'.*did you mean 'arm'"),
    "node beyond": (lambda: robot(rn.Hinge(at="arm:11")), "'arm' has nodes 0 to 10"),
    "negative stiffness": (lambda: rn.Material(E=-1.0), "E = -1.0 must be a positive"),
    "negative radius": (rod([(0, 0, 0), (1, 0, 0)], radius=-0.01), "'arm'.*radius = -0.01"),
    "text for a number": (lambda: rn.Material(E="1e6"), "E = '1e6'"),
    "Poisson": (lambda: rn.Material(E=1.0, nu=0.7), "nu = 0.7"),
    "NaN point": (rod([(0, 0, 0), (np.nan, 0, 0)]), "'arm'.*not a finite point"),
    "NaN parameter": (lambda: rn.Gravity(g=np.nan), "'g' = nan is not finite"),
    "NaN force": (lambda: rn.PointForce(at="arm.end", force=(0, 0, np.nan)), "PointForce: force.*finite"),
    "NaN velocity": (
        lambda: rn.Simulation(robot(), velocity=np.full((11, 3), np.nan)),
        "velocity must be finite",
    ),
    "NaN motor": (lambda: rn.Motor(at="arm:3", rpm=np.nan), "'rpm' = nan"),
    "out of bounds": (lambda: rn.ResistiveForce(viscosity=-1.0), "'viscosity' = -1.0.*outside its bounds"),
    "wrong unit": (
        lambda: rn.Gravity(g=rn.Parameter(1.0, unit="Pa s")),
        r"Gravity\.g is in \[m/s\^2\].*\[Pa s\]",
    ),
    "dt zero": (lambda: rn.Simulation(robot(), dt=0.0), "dt = 0.0 must be a positive"),
    "dt negative": (lambda: rn.Simulation(robot(), dt=-1e-3), "dt = -0.001"),
    "duration": (lambda: rn.Simulation(robot()).run(0.0), "duration = 0.0"),
    "motor at an end": (lambda: robot(rn.Motor(at="arm.end", rpm=1.0)), "no spring to drive.*choose a node"),
    "unwritable": (lambda: rn.Simulation(robot()).run(0.1, out="/proc/nowhere/run.nc"), "cannot write"),
    "unknown parameter": (
        lambda: rn.ResistiveForce(viscosty=1.0),
        "no parameter 'viscosty'; it has viscosity",
    ),
    "class for instance": (lambda: rn.Robot(figure().build(), [rn.Bending]), "with brackets"),
    "figure for graph": (lambda: rn.Robot(figure(), []), r"fig\.build\(\)"),
    "prescribed twice": (
        lambda: robot(rn.Clamp(at="arm.start"), rn.Hinge(at="arm.start")),
        "x of arm:0 is prescribed twice, by 'clamp' and by 'hinge'",
    ),
    "illegal name": (lambda: figure().group("a[0]", []), "not a valid name"),
    "name taken": (
        lambda: figure().rod("arm", [(0, 1, 0), (1, 1, 0)], material=RUBBER, radius=0.01),
        "is taken",
    ),
    "folded": (rod([(0, 0, 0), (1, 0, 0), (0.5, 0, 0)]), "'arm' folds back"),
    "nothing soft": (
        lambda: rn.StickFigure().rigid("a", [(0, 0, 0), (1, 0, 0)]).build(),
        "at least one soft rod",
    ),
    "two directions": (rod([(0, 0, 0), (1, 0, 0)], director=(1, 0, 0)), "'arm'.*parallel"),
    "radius and section": (
        rod([(0, 0, 0), (1, 0, 0)], section=rn.circular(0.01)),
        "either radius= or section=",
    ),
    "input without actuator": (
        lambda: rn.Simulation(robot()).step({"motor.rpm": 1.0}),
        "'motor.rpm'.*no actuators",
    ),
    "unknown stepper": (lambda: rn.Simulation(robot(), stepper="rk4"), "'rk4'; known are euler"),
    "constraint that jumps": (
        lambda: rn.Simulation(robot(rn.PrescribedMotion(at="arm.start", position=lambda t: np.ones(3)))),
        "must start at the robot's initial position",
    ),
    "no equilibrium": (lambda: rn.equilibrium(robot(rn.Gravity())), "nothing holds.*translation along z"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_named(case):
    act, message = CASES[case]
    with pytest.raises(rn.RodnetError, match=f"(?s){message}"):
        act()


def test_a_force_that_turns_nan_names_the_node(tmp_path):
    force = rn.PointForce(at="arm.end", force=lambda t: (0.0, 0.0, np.nan if t > 0.05 else 0.0))
    sim = rn.Simulation(robot(rn.Clamp(at="arm.start"), force), dt=1e-2)
    with pytest.raises(rn.ConvergenceError, match=r"not a finite number.*arm:10") as caught:
        sim.run(1.0, out=tmp_path / "run.nc")
    assert caught.value.time == pytest.approx(0.05)
    assert len(caught.value.trajectory) == 6
    kept = rn.Trajectory.load(tmp_path / "run.nc")
    assert kept.status == "failed" and kept.t[-1] == pytest.approx(0.05)
