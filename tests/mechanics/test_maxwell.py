"""A medium that is elastic for a while: closed forms of a rod that is pulled through it, and its two limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import rodnet as rn
from tests.mechanics.beams import order

RHO, R, LENGTH = 1000.0, 3e-3, 0.3
MASS = RHO * np.pi * R**2  # per length
ETA, MODULUS, TIME, LOAD = 0.4, 6.0, 0.15, 0.5


def pulled(*terms, load=LOAD, edges=4):
    """A straight rod that lies across the load on it, so that it moves as one."""
    figure = rn.StickFigure()
    material = rn.Material(E=2e7, rho=RHO)
    figure.rod("rod", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=material, radius=R)
    elastic = rn.Stretching(), rn.Bending(), rn.Twisting()
    return rn.Robot(figure.build(), [*elastic, rn.LocalLaw(gz=load), *terms])


def way(t, eta=ETA, modulus=MODULUS, time=TIME):
    """Where it is after some time: m v' = f - eta v - G z, z' = v - z / T, x' = v."""
    A = np.array(
        [
            [-eta / MASS, -modulus / MASS, 0.0, LOAD / MASS],
            [1.0, -1.0 / time, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [0.0] * 4,
        ]
    )
    return (expm(A * t) @ [0.0, 0.0, 0.0, 1.0])[2]


def test_a_rod_that_is_pulled_through_a_jeffreys_medium():
    """The exact solution of the linear equations, at second order in the step."""
    law = rn.ResistiveForce(eta_t=ETA, eta_n=ETA), rn.MaxwellMedium(modulus=MODULUS, time=TIME)
    steps, errors = (20, 40, 80), []
    for n in steps:
        traj = rn.Simulation(pulled(*law), 0.4 / n, stepper="sdirk2").run(0.4)
        errors.append(abs(traj.x[-1, 0, 2] - way(0.4)))
    assert order(steps, errors) == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 1e-3 * way(0.4)
    assert abs(way(0.4) - way(0.4, modulus=0.0)) > 0.3 * way(0.4)  # it matters


def test_what_forgets_at_once_is_viscous_and_what_never_forgets_a_bed_of_springs():
    moved = lambda *law: rn.Simulation(pulled(*law), 2e-3, stepper="sdirk2").run(0.4).x[-1, 0, 2]  # noqa: E731
    fluid = rn.ResistiveForce(eta_t=ETA, eta_n=ETA)
    quick = moved(fluid, rn.MaxwellMedium(modulus=0.3 / 1e-4, time=1e-4))
    assert quick == pytest.approx(moved(rn.ResistiveForce(eta_t=ETA + 0.3, eta_n=ETA + 0.3)), rel=2e-3)
    long = moved(fluid, rn.MaxwellMedium(modulus=MODULUS, time=1e6))
    springs = moved(fluid, rn.LocalLaw(name="springs", kzz=-MODULUS))
    assert long == pytest.approx(springs, rel=1e-4)


def test_where_it_is_pulled_for_long_it_goes_on_as_in_a_fluid():
    """Steady speed f / (eta + G T), and a stretch of v T; let go, it springs back by what is not forgotten."""
    law = rn.ResistiveForce(eta_t=ETA, eta_n=ETA), rn.MaxwellMedium(modulus=MODULUS, time=TIME)
    sim = rn.Simulation(pulled(*law), 5e-3, stepper="sdirk2")
    traj = sim.run(3.0)
    speed = LOAD / (ETA + MODULUS * TIME)
    assert traj.v[-1, :, 2] == pytest.approx(np.full(5, speed), rel=1e-4)
    assert traj.state(-1).memories[-1][:, 2] == pytest.approx(np.full(5, speed * TIME), rel=1e-4)


def test_the_same_whatever_the_mesh_and_its_halves():
    law = rn.ResistiveForce(eta_t=ETA, eta_n=ETA)
    whole = pulled(law, rn.MaxwellMedium(modulus=MODULUS, time=TIME))
    halves = pulled(
        law,
        rn.MaxwellMedium(on=["rod:0-1", "rod:1-2"], name="one", modulus=MODULUS, time=TIME),
        rn.MaxwellMedium(on=["rod:2-3", "rod:3-4"], name="two", modulus=MODULUS, time=TIME),
    )
    ends = [rn.Simulation(r, 0.01).run(0.2).x[-1] for r in (whole, halves)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)


def test_in_statics_it_has_relaxed():
    """A rod on springs rests where it would without the medium."""
    bed = rn.LocalLaw(name="bed", kzz=-40.0)
    rests = [rn.equilibrium(pulled(bed, *law)).x[-1, :, 2] for law in ((), (rn.MaxwellMedium(modulus=9.0),))]
    assert rests[0] == pytest.approx(np.full(5, LOAD / 40.0), rel=1e-6)
    assert rests[1] == pytest.approx(rests[0], rel=1e-9)


def test_a_rod_that_is_held_elsewhere_from_the_start_begins_without_stretch():
    """What hangs on a grip that is shifted begins moved along: nothing has been stretched by that."""
    still = rn.ImperfectMotion(
        at="rod.start", position=lambda t: np.zeros(3), orientation=lambda t: np.eye(3), shift_z=5e-3
    )
    robot = pulled(still, rn.MaxwellMedium(modulus=MODULUS, time=TIME), load=0.0)
    traj = rn.Simulation(robot, 0.01).run(0.1)
    assert traj.x[:, :, 2] == pytest.approx(np.full((len(traj.t), 5), 5e-3), abs=1e-9)
    assert np.abs(traj.state(-1).memories[-1][:, :3]).max() < 1e-9
