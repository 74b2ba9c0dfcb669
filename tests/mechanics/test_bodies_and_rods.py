"""Rigid bodies with rods, motors, drag and loads on them: derivatives, momenta, stiff parts, statics, restart."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.newton import StepReport, _Motion
from rodnet.testing.states import Probe, random_rotation

TIGHT = rn.Tolerance(residual=1e-12, update=1e-14)
RUBBER = rn.Material(E=1e7, rho=1000.0)


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def branched(bodies=True):
    """Two bodies of two and one edges, joined by a rod; a second rod hangs on the larger one."""
    figure = rn.StickFigure()
    figure.rigid("hub", [(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0.01)], mass=0.05, radius=6e-3)
    figure.rod(
        "link", ["hub.end", (0.09, 0.03, 0.03)], edges=4, material=RUBBER, section=rn.elliptic(4e-3, 3e-3)
    )
    figure.rigid("tip", ["link.end", (0.11, 0.03, 0.01)], mass=0.03, radius=5e-3)
    figure.rod("tail", ["hub:1", (0.03, -0.03, 0.05)], edges=3, material=RUBBER, radius=3e-3)
    if bodies:
        figure.body("hub").body("tip", com=(0.1, 0.035, 0.02))
    return figure.build()


def loaded(graph):
    mu = rn.Parameter(0.5, unit="Pa s")
    return rn.Robot(
        graph,
        [
            *elastic(),
            rn.Gravity(),
            rn.ResistiveForce(viscosity=mu, tangent="edge", axial_torque=True),
            rn.StokesHead(viscosity=mu, radius=0.01, at="hub:1"),
            rn.PointTorque(on="hub:1-2", torque=(0.01, 0.02, -0.03)),
            rn.PointForce(at="tip.end", force=(0.1, -0.2, 0.3)),
            rn.Motor(between=("hub:0-1", "tail:0-1"), rpm=50.0),
        ],
    )


@pytest.mark.parametrize("seed", range(3))
def test_forces_turn_with_the_robot_and_have_the_right_derivatives(seed):
    """At random states with bodies far from their last orientation, geometric stiffness included."""
    rng = np.random.default_rng(seed)
    robot = loaded(branched())
    probe = Probe(robot, rng, source_turn=1.2)
    for by, (error, where) in probe.jacobian_errors().items():
        assert error < 2e-6, (by, where)
    # without what singles out a direction
    own = [t for t in robot.terms if t.name not in ("gravity", "force", "torque")]
    probe = Probe(rn.Robot(robot.graph, own), rng, source_turn=1.2)
    R, shift = random_rotation(rng), rng.normal(size=3)
    F = probe.forces()
    other = probe.rotated(R, shift).forces()
    assert np.abs(other - probe.turn_vector(F, R)).max() < 1e-9 * np.abs(F).max()


def test_elastic_forces_on_bodies_are_a_gradient_without_resultant():
    rng = np.random.default_rng(7)
    probe = Probe(rn.Robot(branched(), elastic()), rng, source_turn=1.2)
    free, F = probe.model.free, probe.forces()
    direction = np.zeros(len(F))
    direction[free] = (rng.normal(size=len(F)) * probe.units)[free] * 1e-5
    difference = probe.energy(probe.q + direction) - probe.energy(probe.q - direction)
    assert difference == pytest.approx(-2.0 * F @ direction, rel=1e-6)
    K = probe.jacobian()
    assert np.abs(K - K.T).max() < 1e-9 * np.abs(K).max()
    force, moment = probe.resultant(F)
    assert np.abs(force).max() < 1e-10 * np.abs(F).max()
    assert np.abs(moment).max() < 1e-9 * np.abs(F).max()


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_the_whole_residual_has_the_right_derivative(stepper):
    """Inertia and all, at a state far from the accepted one."""
    sim = rn.Simulation(
        loaded(branched()), 0.02, stepper=stepper, spin={"hub": (5.0, -8.0, 3.0), "tip": (2.0, 1.0, 9.0)}
    )
    sim.run(0.1)
    m, newton, state, rng = sim.model, sim.newton, sim.state, np.random.default_rng(0)
    ev, dt = newton.ev, 0.02
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    cv, ca = sim.stepper.coefficients(dt)
    v0, a0 = sim.stepper.offsets(state, dt, [])
    v0 = np.zeros(m.dof_count) if v0 is None else v0
    units = np.where(np.arange(m.dof_count) < m.twist0, 1e-2, 1.0)[m.free]

    def residual(update, jac=False):
        full = state.q.copy()
        full[m.free] += update
        newton._base[:] = full
        q = newton._base.copy()
        motion = _Motion(state.q, cv, ca, v0, a0, m.held, None)
        newton._base[:] = q
        newton._move(np.zeros(len(m.free)), 0.0, motion)
        assert newton._residual(state.t + dt, dt, motion, jac, StepReport()) is not None
        return newton._r.copy()

    start = 0.05 * units * rng.normal(size=len(m.free))
    start[m.free >= m.turn0] *= 10.0
    r = residual(start, True)
    J = m.jacobian().toarray()
    assert np.all(np.isfinite(r))
    scale = np.abs(J) @ units
    for _ in range(5):
        d = units * rng.normal(size=len(units))
        h = 1e-6
        slope = (residual(start + h * d) - residual(start - h * d)) / (2 * h)
        assert np.abs(slope - J @ d).max() < 1e-6 * scale.max()


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_momenta_of_bodies_and_rods(stepper):
    """A free robot of two bodies on a rod: linear momentum to round-off, angular momentum as dt allows."""
    graph = branched()
    robot = rn.Robot(graph, elastic())
    sim = rn.Simulation(robot, 5e-4, stepper=stepper, spin={"hub": (0, 4.0, 9.0)}, tolerance=TIGHT)
    m = sim.model

    def momenta(state):
        ev = sim.newton.ev
        ev.set_source(state.tangents, state.directors, state.tau, state.q)
        ev.q[:] = state.q
        ev.bodies.place()
        v = state.v.copy()
        ev.bodies.set_rigid(v)
        v, x = v[: m.twist0].reshape(-1, 3), state.q[: m.twist0].reshape(-1, 3)
        return m.node_mass @ v, np.einsum("n,ni->i", m.node_mass, np.cross(x, v))

    p0, L0 = momenta(sim.state)
    sim.run(0.1)
    p, L = momenta(sim.state)
    assert np.abs(p - p0).max() < 1e-9 * np.linalg.norm(L0) / graph.size
    # spins of soft edges about their own axes are not coupled back
    assert np.abs(L - L0).max() < (
        5e-3 if stepper == "sdirk2" or stepper == "alpha" else 5e-2
    ) * np.linalg.norm(L0)


def test_two_bodies_on_a_rod_swing_as_very_stiff_parts_do():
    """Against parts that are stiffer and stiffer: the difference falls with their compliance.

    Not by SDIRK2, which has an error of first order in dt where stiff parts turn.
    """

    def shape(graph):
        robot = rn.Robot(graph, [*elastic(), rn.Gravity(), rn.Clamp(at="tail.end")])
        return rn.Simulation(robot, 1e-3, stepper="alpha").run(0.1).x

    def stiff(factor):
        figure = rn.StickFigure()
        figure.rigid(
            "hub",
            [(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0.01)],
            mass=0.05,
            radius=6e-3,
            stiffening=(factor, factor),
        )
        figure.rod("link", ["hub.end", (0.09, 0.03, 0.03)], edges=4, material=RUBBER, radius=4e-3)
        figure.rigid(
            "tip", ["link.end", (0.11, 0.03, 0.01)], mass=0.03, radius=5e-3, stiffening=(factor, factor)
        )
        figure.rod("tail", ["hub:1", (0.03, -0.03, 0.05)], edges=3, material=RUBBER, radius=3e-3)
        figure.joint("hub:1", hub="hub:0-1")
        return figure

    figure = stiff(1e4)
    # the masses of stiff parts are lumped: half of each edge's at its ends
    x = np.array([(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0.01)])
    l = np.linalg.norm(np.diff(x, axis=0), axis=1)
    m = 0.05 / l.sum() * np.array([l[0] / 2, l.sum() / 2, l[1] / 2])
    com = m @ x / m.sum()
    S = np.einsum("n,ni,nj->ij", m, x - com, x - com)
    spin = lambda S, ends, m, r: (  # noqa: E731
        np.trace(S) * np.eye(3) - S
        + sum(0.5 * k * r**2 * np.outer(t, t) / (t @ t) for k, t in zip(m, np.diff(ends, axis=0), strict=True))
    )  # fmt: skip
    figure.body("hub", com=com, inertia=spin(S, x, 0.05 * l / l.sum(), 6e-3))
    y = np.array([(0.09, 0.03, 0.03), (0.11, 0.03, 0.01)])
    arm = 0.5 * (y[1] - y[0])
    S = 0.03 * np.outer(arm, arm)
    figure.body("tip", inertia=spin(S, y, [0.03], 5e-3))
    rigid = shape(figure.build())
    errors = [np.abs(shape(stiff(f).build()) - rigid).max() for f in (1e2, 1e3, 1e4)]
    moved = np.abs(rigid[-1] - rigid[0]).max()
    assert moved > 5e-3
    assert errors[2] < 0.5 * errors[0] and errors[2] < 1e-3 * moved


def test_a_motor_between_a_body_and_a_rod_turns_them_against_each_other():
    """Free, without a medium: angular momentum stays zero, so speeds go as 1 / inertia."""
    figure = rn.StickFigure()
    figure.rigid("stator", [(-0.05, 0, 0), (0, 0, 0)], radius=0.01)
    figure.body("stator", mass=0.1, inertia=(2e-6, 1e-4, 1e-4))
    figure.rod("shaft", ["stator.end", (0.02, 0, 0)], edges=2, material=rn.Material(E=1e9), radius=2e-3)
    figure.rigid("rotor", ["shaft.end", (0.04, 0, 0)], radius=0.01)
    figure.body("rotor", mass=0.05, inertia=(1e-6, 2e-5, 2e-5))
    # twice as slow until pi / 20 s, without a kink
    ramp = lambda t: 10.0 * (t - 0.05 * np.sin(t / 0.05)) if t < np.pi / 20 else 20.0 * t - np.pi / 2  # noqa: E731
    robot = rn.Robot(figure.build(), [*elastic(), rn.Motor(at="stator.end", angle=ramp)])
    sim = rn.Simulation(robot, 1e-3, stepper="sdirk2")
    traj = sim.run(1.0)
    stator, rotor = (traj.theta[-1, traj.rods[n].edges[0]] for n in ("stator", "rotor"))
    assert rotor - stator == pytest.approx(20.0 - np.pi / 2, abs=1e-3)
    shaft = robot.graph.edge_inertia.sum()
    assert rotor / -stator == pytest.approx(2e-6 / (1e-6 + shaft), rel=2e-2)
    assert traj.powers["motor"][50] > 0.0


@pytest.mark.parametrize("n_tails", [2, 3])
def test_the_papers_robot_with_rigid_bodies(n_tails):
    """Within 0.5 % of the very stiff parts, in speed and in the head's rate."""
    run = lambda rigid: rn.robots.flagellated_metrics(  # noqa: E731
        rn.Simulation(rn.robots.flagellated(n_tails, 100.0, rigid=rigid)).run(20.0)
    )
    stiff, body = run("stiff"), run("body")
    assert body.speed == pytest.approx(stiff.speed, rel=2e-3)
    assert body.head_rpm == pytest.approx(stiff.head_rpm, rel=5e-4)
    assert body.head_rpm + body.tail_rpm == pytest.approx(100.0, rel=1e-6)


def test_a_weight_on_a_cantilever():
    """Statics: tip deflection F L^3 / 3EI and slope F L^2 / 2EI, and the moment of a centre that lies off."""
    E, r, L, mass = 1e9, 3e-3, 0.2, 1e-4
    figure = rn.StickFigure()
    figure.rod("arm", [(0, 0, 0), (L, 0, 0)], edges=40, material=rn.Material(E=E, rho=1e-6), radius=r)
    figure.rigid("weight", ["arm.end", (L + 0.02, 0, 0)], radius=r)
    figure.body("weight", mass=mass, com=(L + 0.05, 0, 0.0))
    robot = rn.Robot(figure.build(), [*elastic(), rn.Gravity(), rn.Clamp(at="arm.start")])
    traj = rn.equilibrium(robot)
    EI, F, d = E * np.pi * r**4 / 4, mass * 9.81, 0.05
    tip, far = traj.x[0, robot.graph.rods["weight"].nodes, 2]
    assert tip == pytest.approx(-F * L**3 / (3 * EI) - F * d * L**2 / (2 * EI), rel=1e-3)
    assert (far - tip) / 0.02 == pytest.approx(-F * L**2 / (2 * EI) - F * d * L / EI, rel=2e-3)
    reaction = traj.reactions["clamp"]
    assert reaction.force[0] == pytest.approx((0, 0, F), abs=1e-3 * F)
    assert reaction.moment[0] == pytest.approx((0, -F * (L + d), 0), abs=1e-3 * F * L)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_restart_is_bit_equal(tmp_path, stepper):
    make = lambda: rn.Simulation(loaded(branched()), 1e-3, stepper=stepper, spin={"tip": (1.0, 2.0, 3.0)})  # noqa: E731
    whole = make().run(0.04)
    make().run(0.02, out=tmp_path / "run.nc")
    sim = make()
    sim.restore(rn.Trajectory.load(tmp_path / "run.nc", sim.robot).state())
    rest = sim.run(0.02)
    for name in ("q", "v", "a", "acc", "tangents", "directors", "tau", "turns"):
        assert np.array_equal(getattr(whole.state(), name), getattr(rest.state(), name)), name


def test_adaptive_steps_of_a_robot_with_bodies():
    sim = rn.Simulation(loaded(branched()), 1e-3, stepper="sdirk2", adaptive=1e-2)
    fine = rn.Simulation(loaded(branched()), 5e-4, stepper="sdirk2").run(0.05)
    moved = np.abs(fine.x[-1] - fine.x[0]).max()
    assert np.abs(sim.run(0.05).x[-1] - fine.x[-1]).max() < 0.02 * moved


def test_bodies_keep_their_shape_and_powers_add_up():
    robot = loaded(branched())
    traj = rn.Simulation(robot, 5e-3, tolerance=TIGHT, spin={"tip": (1.0, 2.0, 3.0)}).run(0.5)
    for body in robot.graph.bodies:
        x = traj.x[:, body.nodes]
        distance = np.linalg.norm(x[:, :, None] - x[:, None], axis=-1)
        assert np.abs(distance - distance[0]).max() < 1e-14
    power = dict(traj.powers)
    kinetic = power.pop("kinetic")
    # rates of twist angles are spins up to dt^2
    assert np.abs(sum(power.values()) - kinetic)[1:].max() < 1e-4 * np.abs(kinetic).max()
    assert np.all(traj.internal.tension[:, robot.graph.bodies[0].edges] == 0.0)


def test_two_bodies_on_a_soft_rod_ring_at_their_frequency():
    """Two equal bodies on a soft rod: antisymmetric bending, w^2 = 2 EI / (L I) for bodies without an arm."""
    E, r, L, inertia = 1e6, 2e-3, 0.1, 1e-4
    figure = rn.StickFigure()
    figure.rod(
        "rod", [(-L / 2, 0, 0), (L / 2, 0, 0)], edges=20, material=rn.Material(E=E, rho=1e-3), radius=r
    )
    for name, end, x in (("left", "rod.start", -0.5), ("right", "rod.end", 0.5)):
        figure.rigid(name, [end, (x * (L + 0.01), 0, 0)], radius=r)
        figure.body(name, mass=10.0, com=(x * L, 0, 0), inertia=(inertia,) * 3)
    spin = {"left": (0, 0, -1e-3), "right": (0, 0, 1e-3)}
    w = np.sqrt(2 * E * np.pi * r**4 / 4 / (L * inertia))
    dt = 2 * np.pi / w / 200
    sim = rn.Simulation(rn.Robot(figure.build(), elastic()), dt, stepper="sdirk2", spin=spin)
    traj = sim.run(400 * dt)
    right = traj.rods["right"].nodes
    tilt = (traj.x[:, right[1]] - traj.x[:, right[0]])[:, 1]
    k = np.flatnonzero(tilt[1:-1] * tilt[2:] < 0) + 1
    zeros = traj.t[k] - tilt[k] * (traj.t[k + 1] - traj.t[k]) / (tilt[k + 1] - tilt[k])
    assert 2 * np.diff(zeros).mean() == pytest.approx(2 * np.pi / w, rel=2e-3)


def test_a_moved_drawing_takes_its_bodies_along():
    graph, R = branched(), random_rotation(np.random.default_rng(3))
    turned = graph.with_positions(graph.x0 @ R.T + (1.0, 2.0, 3.0))
    assert turned.bodies[0].com == pytest.approx(R @ graph.bodies[0].com + (1.0, 2.0, 3.0), abs=1e-12)
    assert turned.bodies[0].inertia == pytest.approx(R @ graph.bodies[0].inertia @ R.T, abs=1e-15)
    make = lambda g: rn.Simulation(rn.Robot(g, elastic()), 1e-3, stepper="alpha")  # noqa: E731
    assert make(turned).model.frames0[graph.bodies[0].edges] == pytest.approx(
        R @ make(graph).model.frames0[graph.bodies[0].edges], abs=1e-12
    )
    with pytest.raises(rn.GraphError, match="deform the rigid body 'hub'"):
        graph.with_positions(graph.x0 * (1.0, 1.0, 1.1))
