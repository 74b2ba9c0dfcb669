"""The paper's robot in every medium: it runs, is restarted bit for bit, and goes through a sweep."""

import numpy as np
import pytest

import rodnet as rn

MU = 6.828
MEDIA = {
    "lighthill": lambda: [
        rn.ResistiveForce(on="tail*", viscosity=MU, coefficients="lighthill", length=0.111)
    ],
    "current": lambda: [rn.ResistiveForce(on="tail*", viscosity=MU, flow=rn.ShearFlow(0.05))],
    "granular": lambda: [rn.GranularForce(on="tail*", surface=0.05, CF=2e3, CS=5e3, gamma=4.0)],
    "power law": lambda: [rn.PowerLawForce(on="tail*", viscosity=MU, rate=10.0, exponent=0.5)],
    "bingham": lambda: [rn.BinghamForce(on="tail*", viscosity=MU, yield_stress=5.0, speed=1e-4)],
    "plane wall": lambda: [rn.PlaneWallForce(on="tail*", viscosity=MU, point=(0, 0, -0.05))],
    "tube": lambda: [rn.TubeForce(on="tail*", viscosity=MU, tube_radius=0.053)],
    "crowd": lambda: [rn.CrowdedForce(on="tail*", viscosity=MU, crowding=0.5, range=0.05)],
    "added mass": lambda: [rn.ResistiveForce(on="tail*", viscosity=MU), rn.AddedMass(on="tail*")],
}


def robot(medium, rpm=60.0):
    plain = rn.robots.flagellated(n_tails=2, rpm=rpm, edges=6)
    terms = [t for t in plain.terms if t.name != "drag"]
    return rn.Robot(plain.graph, [*terms, *MEDIA[medium]()], sensors=plain.sensors)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
@pytest.mark.parametrize("medium", sorted(MEDIA))
def test_the_paper_robot_runs_and_is_restarted_bit_for_bit(medium, stepper, tmp_path):
    """Head and tails turn apart by the motor's angle; a saved half run goes on like a whole one."""
    whole = rn.Simulation(robot(medium), 0.01, stepper=stepper).run(0.6)
    half = rn.Simulation(robot(medium), 0.01, stepper=stepper).run(0.3)
    half.save(tmp_path / "half.nc")
    again = rn.Simulation(robot(medium), 0.01, stepper=stepper)
    again.restore(rn.Trajectory.load(tmp_path / "half.nc", robot(medium)).state(-1))
    rest = again.run(0.3)
    assert np.array_equal(rest.x[-1], whole.x[-1]) and np.array_equal(rest.theta[-1], whole.theta[-1])
    head = whole.rods["head"].edges
    turned = whole.theta[-1, head[1]] - whole.theta[-1, head[0]]
    assert abs(turned) == pytest.approx(60.0 * 2 * np.pi / 60.0 * 0.6, rel=0.05)
    assert np.all(np.isfinite(whole.x))
    if medium != "current":
        assert np.all(whole.powers[robot(medium).terms[5].name][1:] <= 0.0)


def ends(traj):
    return {"end": traj.x[-1, -1]}


def test_every_medium_goes_through_a_sweep():
    """In another process the values are those of a run here, bit for bit."""
    found = rn.sweep(robot, {"medium": sorted(MEDIA)}, ends, duration=0.05, workers=1)
    for medium in MEDIA:
        assert found["error"].sel(medium=medium).item() == ""
        here = rn.Simulation(robot(medium), 0.01).run(0.05).x[-1, -1]
        assert np.array_equal(found["end"].sel(medium=medium).values, here)


@pytest.mark.parametrize("medium", sorted(MEDIA))
def test_every_medium_goes_through_a_file(medium, tmp_path):
    first = rn.Robot(robot(medium).graph, robot(medium).terms)  # sensors that are functions cannot
    first.save(tmp_path / "robot.toml")
    ends = [rn.Simulation(r, 0.01).run(0.05).x[-1] for r in (first, rn.Robot.load(tmp_path / "robot.toml"))]
    assert np.array_equal(*ends)


def test_flows_go_through_a_file(tmp_path):
    flows = (rn.UniformFlow((0.1, 0, 0)), rn.VortexFlow(0.02, core=0.03, centre=(0.1, 0, 0)), (0, 0.1, 0))
    for flow in flows:
        plain = robot("lighthill")
        law = rn.ResistiveForce(on="tail*", viscosity=MU, flow=flow)
        first = rn.Robot(plain.graph, [*plain.terms[:-1], law])
        first.save(tmp_path / "robot.toml")
        again = rn.Robot.load(tmp_path / "robot.toml")
        x, one = plain.graph.x0, first.terms[-1].flow.velocity(plain.graph.x0, 0.0)
        assert np.array_equal(again.terms[-1].flow.velocity(x, 0.0), one)


def test_walls_hold_the_robot_back():
    """Tails 20 mm off the axis of the paper's tube, of 53 mm inner radius, drag the more the narrower it is."""
    torque = []
    for radius in (10.0, 0.053, 0.0265):
        plain = robot("tube")
        law = rn.TubeForce(on="tail*", viscosity=MU, tube_radius=radius)
        terms = [t for t in plain.terms if t.kind != "drag" or t.name == "head"]
        traj = rn.Simulation(rn.Robot(plain.graph, [*terms, law]), 0.01).run(0.6)
        edge = traj.rods["head"].edges[0]
        torque.append(abs(traj.w[-1, edge]))
    # the tails turn less, so the head turns more of the motor's speed
    assert torque[0] < torque[1] < torque[2] < 2 * np.pi * 60.0 / 60.0
