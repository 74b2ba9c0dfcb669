"""Sizes and moduli that look like another unit are told, usual ones are not."""

from __future__ import annotations

import warnings

import pytest

import rodnet as rn
from rodnet.plausible import doubts


@pytest.mark.parametrize(
    ("size", "radius", "material", "message"),
    [
        (100.0, 2.0, {}, "radius of 'arm' is 2 m; if lengths are in millimetres"),
        (0.1, 0.02, {}, "edges of 'arm' are 0.01 m long and its radius is 0.02 m"),
        (0.1, 1e-3, {"E": 1.2}, "Young's modulus of 'arm' is 1.2 Pa; if it is in MPa"),
        (0.1, 1e-3, {"rho": 1.1}, r"density of 'arm' is 1.1 kg/m\^3; if it is in g/cm\^3"),
    ],
)
def test_units_that_are_not_meant_are_told(size, radius, material, message):
    made = rn.Material(**{"E": 1e6, **material})
    fig = rn.StickFigure().rod("arm", [(0, 0, 0), (size, 0, 0)], edges=10, material=made, radius=radius)
    with pytest.warns(rn.PlausibilityWarning, match=message):
        rn.Simulation(rn.Robot(fig.build(), [rn.Stretching()]))


def test_usual_units_raise_no_doubts():
    for made in (rn.robots.flagellated(2), rn.robots.flagellated(5, root="clamped")):
        assert doubts(made.graph) == []


def test_edges_in_two_to_see_what_the_mesh_does_raise_none():
    made = rn.Material(E=1e6)
    fig = rn.StickFigure().rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=16, material=made, radius=5e-3)
    robot = rn.Robot(fig.build(), [rn.Stretching()])
    assert doubts(robot.graph) == doubts(robot.refined().graph) == []


SAND = {"CF": 1.8e5, "CS": 4.2e5, "gamma": 4.0, "surface": 0.05}


def screw(*media, at="head:1", head=((0, 0, 0), (0.02, 0, 0), (0.05, 0, 0))):
    """A straight head that a motor turns against a bent tail."""
    made = rn.Material(E=1e8)
    fig = rn.StickFigure().rod("head", list(head), material=made, radius=5e-3)
    fig.rod("tail", ["head.end", (0.15, 0.0, 0.02), (0.2, 0.0, 0.0)], edges=6, material=made, radius=3e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), *media, rn.Motor(at=at, rpm=10.0)]
    return rn.Robot(fig.build(), terms)


def idle(robot):
    from rodnet.plausible import idle_motors

    sim = rn.Simulation(robot)
    return idle_motors(sim.model, sim.state.q)


def test_a_motor_that_turns_a_head_in_sand_without_torque_is_told():
    with pytest.warns(
        rn.PlausibilityWarning, match="motor 'motor' turns 'head', which lies in its axis.*axial_torque"
    ):
        rn.Simulation(screw(rn.GranularForce(**SAND)))
    assert idle(screw(rn.BinghamForce(viscosity=1.0, yield_stress=5.0), rn.KelvinVoigt(twist=0.1)))


@pytest.mark.parametrize(
    "media",
    [
        [],  # nothing around it: inertia alone
        [rn.GranularForce(**SAND, axial_torque=True)],
        [rn.ResistiveForce(viscosity=1.0, axial_torque=True)],
        [rn.GranularForce(**SAND), rn.StokesHead(at="head:1", viscosity=1.0, radius=0.02)],
        [rn.GranularForce(**SAND), rn.Clamp(at="head.start")],
        [rn.GranularForce(**SAND), rn.PlaneContact(point=(0, 0, -0.1))],
    ],
)
def test_a_motor_that_turns_against_something_raises_no_doubt(media):
    assert idle(screw(*media)) == []


def test_a_bent_head_sweeps_through_the_medium_and_raises_no_doubt():
    head = (0, 0.03, 0), (0.02, 0, 0), (0.03, 0, 0), (0.05, 0, 0)
    assert idle(screw(rn.GranularForce(**SAND), head=head, at="head:2")) == []


def test_a_tendon_that_folds_as_soon_as_the_robot_bends_is_told():
    """Over an edge as short as a clamp may be, but not if the route leaves one of its eyelets out."""
    made = rn.Material(E=1e6)
    points = [(0, 0, 0), (1e-5, 0, 0), *((0.2 * k / 8, 0, 0) for k in range(1, 9))]
    fig = rn.StickFigure().rod("arm", points, material=made, radius=4e-3)

    def pulled(*route):
        terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm:0-1")]
        return rn.Robot(
            fig.build(), [*terms, rn.Tendon(route=[(r, (4e-3, 0.0)) for r in route], tension=1.0)]
        )

    with pytest.warns(rn.PlausibilityWarning, match="eyelets 0 and 1 .* 1e-05 m apart .* runs? backwards"):
        rn.Simulation(pulled("arm"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rn.Simulation(pulled("arm:0", "arm:2-9"))
