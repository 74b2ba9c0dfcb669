"""Runs: stepping, inputs, sensors, events, interruption, halving, restart, several robots at once."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.newton import Status


class Bristle(rn.DragModel):
    """Dry friction with pre-sliding: a bristle that stretches, then slips."""

    stiffness = rn.Parameter(50.0, unit="N/m^2", bounds=(0, None), null=0.0)
    reach = rn.Parameter(2e-3, unit="m", bounds=(1e-6, None), kind="shape")
    memory_size = 3

    def update(self, site, p, m_old):
        z = m_old + site.v * site.dt
        z = z * np.minimum(1.0, p.reach / np.maximum(rn.norm(z), 1e-12))
        return -p.stiffness * z, z


def swimmer(**options) -> rn.Robot:
    return rn.robots.flagellated(2, 120.0, edges=6, **options)


def with_memory() -> rn.Robot:
    """A robot with every kind of memory: a motor's angle, a wave, bristles."""
    base = swimmer()
    wave = rn.CurvatureWave(on="tail*", amplitude=5.0, wavelength=0.1, frequency=2.0)
    return base.with_terms(wave, Bristle(on="tail*"))


STATE = ("q", "v", "a", "acc", "tangents", "directors", "tau", "turns")


def same(one: rn.State, other: rn.State) -> bool:
    memories = zip(one.memories, other.memories, strict=True)
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in STATE) and all(
        (a is None and b is None) or np.array_equal(a, b) for a, b in memories
    )


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_restart_is_bit_equal(tmp_path, stepper):
    robot = with_memory()
    whole = rn.Simulation(robot, dt=1e-2, stepper=stepper).run(0.6)
    rn.Simulation(robot, dt=1e-2, stepper=stepper).run(0.25, out=tmp_path / "run.nc")
    sim = rn.Simulation(robot, dt=1e-2, stepper=stepper)
    sim.restore(rn.Trajectory.load(tmp_path / "run.nc", robot).state(-1))
    rest = sim.run(0.35, out=tmp_path / "run.nc", append=True)
    assert same(whole.state(-1), rest.state(-1))
    assert np.array_equal(rn.Trajectory.load(tmp_path / "run.nc").x, whole.x)


def test_run_step_and_iterate_agree():
    ran, stepped, iterated = (rn.Simulation(swimmer(), dt=1e-2) for _ in range(3))
    ran.run(0.2)
    for _ in range(20):
        assert stepped.step().ok
    views = list(iterated.iterate(0.2))
    assert len(views) == 20 and views[-1].t == pytest.approx(0.2)
    assert same(ran.state, stepped.state) and same(ran.state, iterated.state)


def test_inputs_reach_the_motor_and_stay():
    sim = rn.Simulation(swimmer(), dt=1e-2)
    sim.step({"motor.rpm": 60.0})
    *_, view = sim.iterate(0.5)
    relative = view.rpm("head:1-2") - view.rpm("head:0-1")
    assert relative == pytest.approx(60.0, rel=1e-6)


def test_sensors_are_read_before_the_step():
    """A law of the actuator sees the reading of the last accepted state, zero before the first step."""
    seen = []

    class Listening(rn.Actuator):
        drives = "twist_rate"

        def command(self, t, sensors, p):
            seen.append((round(t, 6), sensors["clock"]))
            return 1.0

    base = swimmer()
    terms = [t for t in base.terms if t.name != "motor"]
    robot = rn.Robot(base.graph, [*terms, Listening(at="head:1")], sensors={"clock": lambda s: s.t})
    sim = rn.Simulation(robot, dt=1e-2)
    seen.clear()
    sim.step()
    sim.step()
    assert seen == [(0.01, 0.0), (0.02, 0.01)]


def test_events_are_found_between_steps_and_can_stop():
    fig = rn.StickFigure()
    fig.rod("stone", [(0, 0, 1), (0.1, 0, 1)], edges=2, material=rn.Material(E=1e7), radius=5e-3)
    robot = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(g=10.0)])
    landing = rn.Event(lambda s: s.position("stone:1")[2], name="landing", terminal=True, direction=-1)
    never = rn.Event(lambda s: s.position("stone:1")[2], name="rising", direction=1)
    traj = rn.Simulation(robot, dt=1e-3, stepper="sdirk2").run(2.0, events=[landing, never], save_every=50)
    assert traj.status == "stopped"
    assert traj.events["landing"] == pytest.approx([np.sqrt(0.2)], rel=1e-5)
    assert traj.events["rising"] == []
    assert traj.t[-1] == pytest.approx(np.sqrt(0.2), abs=1e-3)
    stopped = rn.Simulation(robot, dt=1e-3).run(2.0, stop=lambda s: s.t > 0.1)
    assert stopped.t[-1] == pytest.approx(0.101)


def test_free_fall_is_exact_and_momentum_is_kept():
    fig = rn.StickFigure()
    bend = [(0.1 * np.cos(a), 0.1 * np.sin(a), 1.0) for a in np.linspace(0.0, 3.0, 15)]
    fig.rod("arc", bend, material=rn.Material(E=1e6), radius=4e-3, natural="straight")
    graph = fig.build()
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    mass = graph.node_mass
    falling = rn.Simulation(rn.Robot(graph, [*elastic, rn.Gravity(g=10.0)]), dt=2e-3, stepper="sdirk2").run(
        0.2
    )
    centre = np.einsum("n,tni->ti", mass, falling.x) / mass.sum()
    fall = centre[:, 2] - centre[0, 2] + 5.0 * falling.t**2
    assert np.abs(fall).max() < 1e-12
    for stepper in ("euler", "sdirk2", "alpha"):
        velocity = np.random.default_rng(1).standard_normal(graph.x0.shape)
        free = rn.Simulation(rn.Robot(graph, elastic), dt=2e-3, stepper=stepper, velocity=velocity).run(0.1)
        momentum = np.einsum("n,tni->ti", mass, free.v)
        assert np.abs(momentum - momentum[0]).max() < 1e-9 * np.abs(mass[:, None] * velocity).sum()


def clamped_arm(force: float) -> rn.Robot:
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (1, 0, 0)], edges=10, material=rn.Material(E=1e6), radius=5e-3)
    push = rn.PointForce(at="arm.end", force=lambda t: (0.0, 0.0, force if t > 0.095 else 0.0))
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm.start"), push]
    )


def test_a_violent_step_is_halved_and_the_step_recovers():
    sim = rn.Simulation(clamped_arm(60.0), dt=2e-2, tolerance=rn.Tolerance(iterations=4))
    results = [sim.step() for _ in range(12)]
    assert all(r.ok for r in results)
    substeps = [r.substeps for r in results]
    assert substeps[0] == 1 and max(substeps) > 1
    assert sim.t == pytest.approx(0.24)


def test_a_step_that_cannot_converge_is_a_value_and_raises_in_a_run(tmp_path):
    sim = rn.Simulation(clamped_arm(1e12), dt=1e-2)
    results = [sim.step() for _ in range(10)]
    assert not results[-1].ok and results[-1].status is not Status.CONVERGED
    assert sim.t == pytest.approx(results[-2].state.t if results[-2].ok else sim.t)
    with pytest.raises(rn.ConvergenceError) as caught:
        rn.Simulation(clamped_arm(1e12), dt=1e-2).run(0.5, out=tmp_path / "run.nc")
    error = caught.value
    assert "arm" in error.worst and error.time == pytest.approx(0.09)
    assert error.trajectory.t[-1] == pytest.approx(0.09)
    assert rn.Trajectory.load(tmp_path / "run.nc").t[-1] == pytest.approx(0.09)


def test_robots_in_one_graph_do_not_feel_each_other():
    def arm(fig, name, y, E):
        fig.rod(name, [(0, y, 0), (0.5, y, 0)], edges=6, material=rn.Material(E=E), radius=5e-3)

    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity()]
    together, alone = rn.StickFigure(), rn.StickFigure()
    arm(together, "one", 0.0, 1e7)
    arm(together, "two", 1.0, 3e6)
    arm(alone, "one", 0.0, 1e7)
    both = rn.Robot(together.build(), [*terms, rn.Clamp(at="one.start"), rn.Clamp(at="two.start")])
    single = rn.Robot(alone.build(), [*terms, rn.Clamp(at="one.start")])
    x = [
        rn.Simulation(r, dt=5e-3, tolerance=rn.Tolerance(residual=1e-11)).run(0.3).x[-1]
        for r in (both, single)
    ]
    assert np.abs(x[0][:7] - x[1]).max() < 1e-9


def test_energy_never_grows_without_actuation():
    """Implicit Euler only loses energy; SDIRK2's loss is of third order, generalised-alpha's of second."""
    fig = rn.StickFigure()
    arc = [(0.2 * np.sin(a), 0.0, 0.2 * np.cos(a)) for a in np.linspace(0.0, 1.5, 9)]
    fig.rod("arc", arc, material=rn.Material(E=2e5), radius=5e-3, natural="straight")
    robot = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arc.start")])
    energy = sum(rn.Simulation(robot, dt=2e-3).run(0.3).energies.values())
    assert np.all(np.diff(energy) <= 1e-12 * energy[0])
    for stepper, order in (("sdirk2", 3.0), ("alpha", 2.0)):
        drift = []
        for dt in (4e-3, 2e-3, 1e-3):
            energy = sum(rn.Simulation(robot, dt=dt, stepper=stepper).run(0.1).energies.values())
            drift.append(abs(energy[-1] - energy[0]))
        slopes = np.log2(drift[0] / drift[1]), np.log2(drift[1] / drift[2])
        assert slopes == pytest.approx((order, order), abs=0.3)


def arm(*terms: rn.Term, sensors=None) -> rn.Robot:
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=6, material=rn.Material(E=1e6), radius=3e-3)
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), *terms], sensors
    )


def test_time_goes_on_from_a_restored_state():
    """From an equilibrium at another time, and with another time step."""
    seen = []
    robot = arm(rn.Clamp(at="arm.start"), rn.Motor(at="arm:3", angle=lambda t: (seen.append(t), 0.1 * t)[1]))
    still = rn.equilibrium(robot, t=2.0).state()
    sim = rn.Simulation(robot, dt=1e-2)
    sim.restore(still)
    traj = sim.run(0.03)
    assert traj.t == pytest.approx([2.0, 2.01, 2.02, 2.03], abs=1e-12)
    assert seen[-1] == pytest.approx(2.03)
    finer = rn.Simulation(robot, dt=1e-3)
    finer.restore(traj.state())
    assert finer.run(2e-3).t == pytest.approx([2.03, 2.031, 2.032], abs=1e-12)


def test_a_state_of_another_robot_is_refused():
    sim = rn.Simulation(arm(rn.Clamp(at="arm.start")), dt=1e-2)
    with pytest.raises(rn.ParameterError, match="degrees of freedom"):
        sim.restore(rn.Simulation(swimmer(), dt=1e-2).state)
    with pytest.raises(rn.ParameterError, match="other terms"):
        sim.restore(
            rn.Simulation(arm(rn.Clamp(at="arm.start"), rn.PointForce(at="arm.end", force=(0, 0, 0)))).state
        )


def test_halved_steps_land_on_the_same_grid_and_converge_to_the_same_motion():
    """A step that was halved is as good as two of half the length."""
    sims = [rn.Simulation(clamped_arm(60.0), dt=2e-2, tolerance=rn.Tolerance(iterations=k)) for k in (4, 60)]
    fine = rn.Simulation(clamped_arm(60.0), dt=1e-4)
    for sim in (*sims, fine):
        sim.run(0.2)
    assert all(sim.t == 0.2 for sim in sims)
    errors = [np.abs(sim.state.q[:33] - fine.state.q[:33]).max() for sim in sims]
    assert errors[0] < errors[1]


def test_iterate_raises_with_the_place_and_stays_at_the_last_state(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the debug recording goes there
    sim = rn.Simulation(clamped_arm(1e12), dt=1e-2)
    with pytest.raises(rn.ConvergenceError, match="of arm:") as caught:
        for _ in sim.iterate(0.5):
            pass
    assert caught.value.trajectory is None
    assert sim.t == pytest.approx(0.09) == pytest.approx(caught.value.time)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_disconnected_robots_of_very_different_size(stepper):
    """The small one is solved as well beside the large one as alone, to the tolerance of the large one."""

    def build(names):
        fig = rn.StickFigure()
        for k, (name, size) in enumerate(names):
            line = [(0, k, 0), (size, k, 0)]
            fig.rod(name, line, edges=5, material=rn.Material(E=1e6), radius=0.02 * size)
        clamps = [rn.Clamp(at=f"{name}.start") for name, _ in names]
        return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), *clamps])

    tight = rn.Tolerance(residual=1e-12, update=1e-14, iterations=50)
    both, alone = (
        rn.Simulation(build(names), dt=2e-3, stepper=stepper, tolerance=tight).run(0.1).x[-1]
        for names in ([("small", 0.1), ("large", 0.5)], [("small", 0.1)])
    )
    assert np.abs(both[:6] - alone).max() < 1e-9


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_held_node_takes_no_initial_velocity(stepper):
    sim = rn.Simulation(
        arm(rn.Hinge(at="arm.start")), 1e-3, stepper=stepper, velocity=np.tile((0.0, 1.0, 0.0), (7, 1))
    )
    traj = sim.run(0.01)
    assert not traj.v[:, 0].any() and traj.v[0, 1, 1] == 1.0


def test_a_force_that_changes_between_two_steps_from_one_state_is_felt():
    force = [0.0]
    sim = rn.Simulation(
        arm(
            rn.Clamp(at="arm.start"),
            rn.PointForce(at="arm.end", force=lambda t: np.array([0.0, force[0], 0.0])),
        )
    )
    start = sim.state
    ends = []
    for force[0] in (0.0, 1e-3):
        sim.restore(start)
        sim.step()
        ends.append(sim.observe().position("arm.end")[1])
    assert ends[0] == 0.0 and ends[1] > 1e-6


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_run_ends_on_time_if_dt_does_not_divide_it(stepper):
    """The last step takes what is left, as a simulation with so short a step would."""
    robot = arm(rn.Clamp(at="arm.start"))
    sim = rn.Simulation(robot, 0.1, stepper=stepper)
    traj = sim.run(0.25)
    assert traj.t.tolist() == [0.0, 0.1, 0.2, 0.25]
    rest = rn.Simulation(robot, traj.t[3] - traj.t[2], stepper=stepper)
    rest.restore(traj.state(2))
    rest.step()
    assert np.array_equal(rest.state.q, sim.state.q)
    assert sim.run(until=0.5).t == pytest.approx([0.25, 0.35, 0.45, 0.5])
    assert [s.t for s in rn.Simulation(robot, 0.1, stepper=stepper).iterate(0.25)] == traj.t[1:].tolist()
    whole = rn.Simulation(robot, 0.1, stepper=stepper).run(0.3 - 1e-12)  # no step of 1e-12 s
    assert whole.t.tolist() == [0.0, 0.1, 0.2, 3 * 0.1]


def test_a_run_that_dt_does_not_divide_continues_bit_equal(tmp_path):
    robot = with_memory()
    whole = rn.Simulation(robot, 0.03).run(until=0.2)
    first = rn.Simulation(robot, 0.03)
    first.run(0.09, out=tmp_path / "run.nc")
    again = rn.Simulation(robot, 0.03)
    again.restore(rn.Trajectory.load(tmp_path / "run.nc", robot).state(-1))
    rest = again.run(until=0.2, out=tmp_path / "run.nc", append=True)
    assert np.array_equal(rest.t, whole.t) and whole.t[-1] == 0.2
    assert np.array_equal(rest.state(-1).q, whole.state(-1).q)


def test_runs_that_are_no_runs():
    sim = rn.Simulation(arm(rn.Clamp(at="arm.start")), 0.1)
    with pytest.warns(RuntimeWarning, match="0.02 s is shorter than the time step, dt = 0.1 s"):
        assert sim.run(0.02).t.tolist() == [0.0, 0.02]
    for bad in ({}, {"duration": 1.0, "until": 2.0}):
        with pytest.raises(rn.ParameterError, match="give the duration of a run"):
            sim.run(**bad)
    with pytest.raises(rn.ParameterError, match=r"until = 0.01 must be a time after t = 0.02 s"):
        sim.run(until=0.01)


def test_a_simulation_is_not_copied_but_its_state_is():
    sim = rn.Simulation(arm(rn.Clamp(at="arm.start")), 0.01)
    sim.run(0.03)
    for act in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(rn.NotCopyableError, match=r"twin\.restore\(sim\.state\)"):
            act(sim)
    twin = rn.Simulation(sim.robot, sim.dt, stepper=sim.stepper)
    twin.restore(pickle.loads(pickle.dumps(sim.state)))
    sim.step(), twin.step()
    assert np.array_equal(twin.state.q, sim.state.q)
    assert "t = 0.04 s after 4 steps" in repr(twin) and "dt = 0.01 s" in repr(twin)
