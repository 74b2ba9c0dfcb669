"""What is measured on any robot: the way of its centre of mass, its largest strain, its energy."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rodnet as rn
from rodnet.metrics import centre_of_mass, effort, travel, why_at_rest
from tests.mechanics.beams import MATERIAL, L, R, elastic

G = 9.81


def swing(edges=6, *terms):
    figure = rn.StickFigure().rod("arm", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    return rn.Robot(figure.build(), [*elastic(), *terms])


def test_a_falling_robot_goes_its_way():
    robot = swing(4, rn.Gravity(g=G))
    traj = rn.Simulation(robot, 1e-3, stepper="alpha").run(0.2)
    found = travel(traj)
    assert found["displacement_mm"] == pytest.approx(1e3 * G * 0.2**2 / 2, rel=1e-6)
    assert found["speed_mm_s"] == pytest.approx(1e3 * G * 0.2 / 2, rel=1e-6)
    assert found["path_mm"] == pytest.approx(found["displacement_mm"], rel=1e-9)
    energy = effort(traj)
    mass = robot.graph.node_mass.sum()
    assert energy["work_mJ"] == pytest.approx(1e3 * mass * (G * 0.2) ** 2 / 2, rel=1e-5)
    assert energy["energy_gap"] < 1e-5 and energy["dissipated_mJ"] == 0.0
    assert energy["bending_strain"] < 1e-9


def test_the_strain_of_an_arc_is_radius_over_radius_of_curvature():
    """A moment M at the end of a cantilever bends it to kappa = M / EI everywhere."""
    kappa = 3.0
    EI = MATERIAL.E * np.pi / 4 * R**4
    robot = swing(10, rn.Clamp(at="arm.start"), rn.PointTorque(on="arm.end", torque=(0, kappa * EI, 0)))
    traj = rn.equilibrium(robot)
    assert effort(traj)["bending_strain"] == pytest.approx(R * kappa, rel=5e-3)


def test_the_balance_counts_what_is_put_in_taken_and_stored():
    lift = rn.PointForce(at="arm.end", force=lambda t: (0, 0, 0.02 * np.sin(4 * np.pi * t)))
    robot = swing(6, rn.Clamp(at="arm.start"), lift, rn.ResistiveForce(viscosity=2.0))
    fine, coarse = (effort(rn.Simulation(robot, dt, stepper="sdirk2").run(0.6)) for dt in (2.5e-3, 1e-2))
    assert fine["work_mJ"] > fine["dissipated_mJ"] > 0.0
    assert fine["energy_gap"] < 0.2 * coarse["energy_gap"] < 0.02  # of second order


def test_a_body_s_own_mass_counts():
    figure = rn.StickFigure()
    figure.rigid("key", [(0, 0, 0), (0.1, 0, 0), (0.1, 0.05, 0)], radius=5e-3)
    figure.body("key", mass=0.2, com=(0.04, 0.01, 0.02), inertia=(3e-5, 4e-5, 5e-5))
    robot = rn.Robot(figure.build(), [])
    sim = rn.Simulation(robot, 1e-3, stepper="alpha", spin={"key": (1.0, 9.0, 2.0)})
    traj = sim.run(0.3)
    centre = centre_of_mass(robot.graph, traj.x)
    assert centre[0] == pytest.approx([0.04, 0.01, 0.02], abs=1e-12)
    assert np.abs(np.diff(centre, n=2, axis=0)).max() < 1e-9  # free: it goes straight on


def test_a_robot_that_nothing_drives_is_told():
    clamp, drag = rn.Clamp(at="arm.start"), rn.ResistiveForce(viscosity=1.0)
    told = lambda *terms: why_at_rest(rn.Simulation(swing(4, *terms)))  # noqa: E731
    assert "nothing drives this robot" in told(clamp, drag)
    assert told(clamp, rn.Gravity()) is None
    assert told(rn.ResistiveForce(viscosity=1.0, flow=(0.1, 0, 0))) is None
    assert told(clamp, rn.CurvatureWave("arm")) is None
    assert told(rn.PrescribedMotion(at="arm.start", position=lambda t: (0, 0, 0.01 * t**3))) is None
    moving = rn.Simulation(swing(4), velocity=np.ones((5, 3)))
    assert why_at_rest(moving) is None
    bow = rn.StickFigure()
    points = [(0, 0, 0), (0.05, 0, 0), (0.1, 0.02, 0)]
    bow.rod("bow", points, material=MATERIAL, radius=R, natural="straight")
    assert why_at_rest(rn.Simulation(rn.Robot(bow.build(), elastic()))) is None


def test_a_run_prints_what_was_measured(tmp_path, monkeypatch):
    from rodnet.cli import app

    monkeypatch.chdir(tmp_path)
    swing(4, rn.Clamp(at="arm.start"), rn.Gravity()).save("arm.toml")
    done = CliRunner().invoke(app, ["run", "arm.toml", "--dt", "1e-2", "--duration", "0.1", "--no-progress"])
    assert done.exit_code == 0, done.output
    for text in (
        "mean speed of the centre of mass",
        "largest bending strain",
        "work put in",
        "missing in this balance",
    ):
        assert text in done.output
    assert "nothing drives" not in done.output
    found = json.loads(Path("runs/arm/summary.json").read_text())
    assert found["work_mJ"] > 0.0 and found["bending_strain"] > 0.0
    swing(4, rn.Clamp(at="arm.start")).save("still.toml")
    done = CliRunner().invoke(
        app, ["run", "still.toml", "--dt", "1e-2", "--duration", "0.1", "--no-progress"]
    )
    assert "nothing drives this robot" in done.output.replace("\n", " ")
