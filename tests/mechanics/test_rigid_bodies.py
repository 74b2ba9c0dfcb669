"""True rigid bodies: free motion, pendulums, derivatives, rods and motors on bodies, statics, restart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import rodnet as rn
from rodnet.kinematics.frames import rotation
from rodnet.testing.states import Probe, random_rotation

ELASTIC = (rn.Stretching, rn.Bending, rn.Twisting)
TIGHT = rn.Tolerance(residual=1e-12, update=1e-14)
RUBBER = rn.Material(E=1e7, rho=1000.0)


def elastic():
    return [term() for term in ELASTIC]


def angle(name="top", **options):
    """A body of two edges at a right angle."""
    figure = rn.StickFigure()
    figure.rigid(name, [(0, 0, 0), (0.1, 0, 0), (0.1, 0.05, 0)], radius=0.01)
    return figure.body(name, **options)


MOMENTS, COM = np.array([1e-3, 2e-3, 2.6e-3]), np.array([0.04, 0.03, 0.02])


def exact_rotation(times, omega):
    """Orientations of a free body with principal axes x, y, z: Euler's equations, to 1e-12."""

    def rate(_, y):
        w, R = y[:3], y[3:].reshape(3, 3)  # in the body
        W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([np.cross(MOMENTS * w, w) / MOMENTS, (R @ W).ravel()])

    start = np.concatenate([omega, np.eye(3).ravel()])
    found = solve_ivp(rate, (0.0, times[-1]), start, t_eval=times, rtol=1e-12, atol=1e-12, method="DOP853")
    return np.moveaxis(found.y[3:].reshape(3, 3, -1), -1, 0)


def free_top(stepper, dt, duration=1.0, omega=(8.0, 0.4, 1.0)):
    """Trajectory of the free top, and its distance from the exact motion at the end."""
    robot = rn.Robot(angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [])
    sim = rn.Simulation(robot, dt, stepper=stepper, spin={"top": omega}, tolerance=TIGHT)
    traj = sim.run(duration)
    R = exact_rotation(traj.t, np.array(omega))
    expected = COM + (robot.graph.x0 - COM) @ np.swapaxes(R, 1, 2)
    return traj, float(np.abs(traj.x - expected)[-1].max())


@pytest.mark.parametrize(("stepper", "order"), [("euler", 1.0), ("sdirk2", 2.0), ("alpha", 2.0)])
def test_a_free_asymmetric_top_tumbles_as_eulers_equations_say(stepper, order):
    errors = [free_top(stepper, dt)[1] for dt in (8e-3, 4e-3, 2e-3)]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert slopes[-1] == pytest.approx(order, abs=0.25)
    assert errors[-1] < (2e-3 if order == 2.0 else 3e-2)


@pytest.mark.parametrize(("stepper", "allowed"), [("sdirk2", 2e-4), ("alpha", 2e-4)])
def test_a_free_top_keeps_its_energy_and_angular_momentum(stepper, allowed):
    """Some 20 turns about an axis next to the unstable one of three."""
    omega = np.array([0.05, 10.0, 0.05])
    robot = rn.Robot(angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [])
    sim = rn.Simulation(robot, 2e-3, stepper=stepper, spin={"top": omega}, tolerance=TIGHT)
    traj = sim.run(4.0, save_every=10)
    energy = traj.energies["kinetic"]
    assert energy[0] == pytest.approx(0.5 * omega @ (MOMENTS * omega), rel=1e-12)
    assert np.abs(energy / energy[0] - 1.0).max() < allowed
    spin = []
    for k, x in enumerate(traj.x):
        t1, t2 = x[1] - x[0], x[2] - x[1]
        R = np.stack([t1 / 0.1, t2 / 0.05, np.cross(t1, t2) / 0.005], axis=1)
        spin.append(R @ (MOMENTS * (R.T @ traj.rates[k, -3:])))
    assert np.abs(np.array(spin) - spin[0]).max() < allowed * np.linalg.norm(spin[0])
    # it turns over, as the intermediate axis theorem says
    assert (traj.x[:, 1] - traj.x[:, 0])[:, 1].std() > 0.005


def test_precession_of_a_symmetric_top():
    """The axis of a free symmetric top goes round its angular momentum at L / I1."""
    moments = np.array([1.2e-3, 2e-3, 2e-3])
    figure = rn.StickFigure()
    figure.rigid("top", [(-0.05, 0, 0), (0.05, 0, 0)], radius=0.01)
    figure.body("top", mass=0.3, inertia=moments)
    omega = np.array([20.0, 1.0, 0.0])
    L = moments * omega
    sim = rn.Simulation(rn.Robot(figure.build(), []), 1e-3, stepper="alpha", spin={"top": omega}, tolerance=TIGHT)
    traj = sim.run(1.0)
    axis = (traj.x[:, 1] - traj.x[:, 0]) / 0.1
    e = L / np.linalg.norm(L)
    across = axis - (axis @ e)[:, None] * e
    a, b = across[0] / np.linalg.norm(across[0]), np.cross(e, across[0] / np.linalg.norm(across[0]))
    turned = np.unwrap(np.arctan2(across @ b, across @ a))
    assert turned[-1] == pytest.approx(np.linalg.norm(L) / moments[1], rel=2e-4)
    assert np.linalg.norm(across, axis=1) == pytest.approx(np.linalg.norm(across[0]), rel=1e-3)
    # a straight body shows its own spin as the twist of its edges, here about an axis that precesses
    spin = np.gradient(traj.theta[:, 0], traj.t)[1:-1]
    assert spin == pytest.approx(omega[0], rel=1e-4)


@pytest.mark.parametrize("stepper", ["sdirk2", "alpha"])
@pytest.mark.parametrize("node", [0, 2])
def test_period_of_a_compound_pendulum(stepper, node):
    """T = 2 pi sqrt(I / (m g l)) about any of its nodes, which becomes the base of the body."""
    figure = rn.StickFigure()
    figure.rigid("bob", [(0, 0, 0), (0.03, 0, -0.15), (0, 0, -0.3)], radius=0.01)
    figure.body("bob", mass=0.8, com=(0, 0, -0.2), inertia=(3e-3, 2e-3, 4e-3))
    up = -1.0 if node == 0 else 1.0
    robot = rn.Robot(figure.build(), [rn.Gravity(direction=(0, 0, up)), rn.Hinge(at=f"bob:{node}")])
    traj = rn.Simulation(robot, 4e-3, stepper=stepper, spin={"bob": (0.01, 0, 0)}, tolerance=TIGHT).run(3.0)
    y = traj.x[:, 2 - node, 1]
    k = np.flatnonzero(y[1:-1] * y[2:] < 0) + 1
    zeros = traj.t[k] - y[k] * (traj.t[k + 1] - traj.t[k]) / (y[k + 1] - y[k])
    arm = 0.2 if node == 0 else 0.1
    assert 2.0 * np.diff(zeros).mean() == pytest.approx(
        2.0 * np.pi * np.sqrt((3e-3 + 0.8 * arm**2) / (0.8 * 9.81 * arm)), rel=2e-4
    )
    # the hinge carries weight and centrifugal force, and the powers add up
    assert traj.reactions["hinge"].force[0] == pytest.approx((0, 0, -up * 0.8 * 9.81), rel=1e-3, abs=1e-12)
    p = traj.powers
    assert np.abs(p["gravity"] + p["hinge"] + p["elastic"] - p["kinetic"])[1:].max() < 1e-9 * np.abs(p["kinetic"]).max()


def branched(bodies=True):
    """Two bodies of two and one edges, joined by a rod; a second rod hangs on the larger one."""
    figure = rn.StickFigure()
    figure.rigid("hub", [(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0.01)], mass=0.05, radius=6e-3)
    figure.rod("link", ["hub.end", (0.09, 0.03, 0.03)], edges=4, material=RUBBER, section=rn.elliptic(4e-3, 3e-3))
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
    sim = rn.Simulation(loaded(branched()), 0.02, stepper=stepper, spin={"hub": (5.0, -8.0, 3.0), "tip": (2.0, 1.0, 9.0)})
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
        from rodnet.solve.newton import StepReport, _Motion

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
    assert np.abs(L - L0).max() < (5e-3 if stepper == "sdirk2" or stepper == "alpha" else 5e-2) * np.linalg.norm(L0)


def test_two_bodies_on_a_rod_swing_as_very_stiff_parts_do():
    """Against parts that are stiffer and stiffer: the difference falls with their compliance."""

    def shape(graph):
        robot = rn.Robot(graph, [*elastic(), rn.Gravity(), rn.Clamp(at="tail.end")])
        return rn.Simulation(robot, 2e-3, stepper="sdirk2").run(0.2).x

    def stiff(factor):
        figure = rn.StickFigure()
        figure.rigid("hub", [(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0.01)], mass=0.05, radius=6e-3, stiffening=(factor, factor))
        figure.rod("link", ["hub.end", (0.09, 0.03, 0.03)], edges=4, material=RUBBER, radius=4e-3)
        figure.rigid("tip", ["link.end", (0.11, 0.03, 0.01)], mass=0.03, radius=5e-3, stiffening=(factor, factor))
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
    assert errors[1] < 0.2 * errors[0] and errors[2] < 2e-3 * moved


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


def test_a_body_hangs_with_its_centre_below_the_hinge():
    robot = rn.Robot(
        angle(mass=0.5, com=COM, inertia=MOMENTS).build(), [rn.Gravity(), rn.Hinge(at="top.start")]
    )
    traj = rn.equilibrium(robot)
    x = traj.x[0]
    t1, t2 = (x[1] - x[0]) / 0.1, (x[2] - x[1]) / 0.05
    centre = np.stack([t1, t2, np.cross(t1, t2)], axis=1) @ COM
    assert centre == pytest.approx((0, 0, -np.linalg.norm(COM)), abs=1e-6)


def test_a_gripper_that_turns_a_body_feels_its_inertia():
    """Force and moment of a body that is turned about a node: m a of the centre, I alpha + w x I w."""
    w, rate = 3.0, lambda t: np.array([0.0, 0.0, 1.5 * t * t])
    robot = rn.Robot(
        angle(mass=0.5, com=COM, inertia=MOMENTS).build(),
        [rn.PrescribedMotion(at="top.start", orientation=lambda t: rotation(rate(t)))],
    )
    traj = rn.Simulation(robot, 1e-3, stepper="sdirk2").run(0.5)
    spin, alpha = w * traj.t[-1], w
    c = rotation(rate(traj.t[-1])) @ COM
    z = np.array([0, 0, 1.0])
    force = 0.5 * (alpha * np.cross(z, c) + spin**2 * np.cross(z, np.cross(z, c)))
    reaction = traj.reactions["motion"]
    assert reaction.force[-1] == pytest.approx(force, rel=1e-3, abs=1e-4)
    inertia = np.diag(MOMENTS) + 0.5 * (COM @ COM * np.eye(3) - np.outer(COM, COM))
    R = rotation(rate(traj.t[-1]))
    inertia = R @ inertia @ R.T
    moment = inertia @ (alpha * z) + np.cross(spin * z, inertia @ (spin * z))
    assert reaction.moment[-1] == pytest.approx(moment, rel=1e-3, abs=1e-5)


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


def test_masses_of_a_body_are_equivalent_to_four_points():
    body = angle(mass=0.7, com=COM, inertia=MOMENTS).build().bodies[0]
    points = body.mass_points() - COM
    S = 0.7 / 4 * points.T @ points
    assert points.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-15)
    assert np.trace(S) * np.eye(3) - S == pytest.approx(np.diag(MOMENTS), abs=1e-15)


def test_inertia_of_a_straight_part_is_that_of_a_cylinder():
    figure = rn.StickFigure().rigid("bar", [(0, 0, 0), (0.1, 0, 0), (0.3, 0, 0)], mass=0.6, radius=0.02)
    body = figure.body("bar").build().bodies[0]
    across = 0.6 * (0.3**2 / 12 + 0.02**2 / 4)
    assert body.com == pytest.approx((0.15, 0, 0))
    assert body.inertia == pytest.approx(np.diag([0.5 * 0.6 * 0.02**2, across, across]), rel=1e-12)


BAD = {
    "unknown part": (lambda: rn.StickFigure().body("head"), "there is no part 'head'"),
    "soft part": (
        lambda: rn.StickFigure().rod("a", [(0, 0, 0), (1, 0, 0)], material=RUBBER, radius=0.1).body("a"),
        "'a' is a soft rod",
    ),
    "twice": (lambda: angle().body("top"), "already belongs to the body 'top'"),
    "mass": (lambda: angle(mass=-1.0), "mass = -1.0 must be positive"),
    "no mass": (lambda: angle().build(), "give mass="),
    "com": (lambda: angle(mass=1.0, com=(0, 0)), "com must be a finite point"),
    "inertia": (lambda: angle(mass=1.0, inertia=(1.0, 1.0, 3.0)), "no body has the principal moments"),
    "asymmetric": (lambda: angle(mass=1.0, inertia=np.triu(np.ones((3, 3)))), "must be symmetric"),
    "shape": (lambda: angle(mass=1.0, inertia=1.0), r"of shape \(3,\) or \(3, 3\)"),
    "no parts": (lambda: rn.StickFigure().body([]), "at least one stiff part"),
    "shared node": (
        lambda: angle(mass=1.0).rigid("b", ["top.end", (0.2, 0.1, 0)]).body("b", mass=1.0).build(),
        "the bodies 'top' and 'b' share a node",
    ),
    "two nodes held": (
        lambda: rn.Robot(angle(mass=1.0).build(), [rn.Hinge(at=["top:0", "top:2"])]),
        "positions of 2 nodes of the rigid body 'top' are prescribed",
    ),
    "spin": (
        lambda: rn.Simulation(rn.Robot(angle(mass=1.0).build(), []), spin={"to": (0, 0, 1)}),
        "no rigid body 'to' is free to move; there are top",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_bodies(case):
    make, message = BAD[case]
    with pytest.raises(rn.RodnetError, match=message):
        make()


def test_a_three_bar_chain_of_two_bodies_rings_at_its_frequency():
    """Two equal bodies on a soft rod: antisymmetric bending, w^2 = 2 EI / (L I) for bodies without an arm."""
    E, r, L, inertia = 1e6, 2e-3, 0.1, 1e-4
    figure = rn.StickFigure()
    figure.rod("rod", [(-L / 2, 0, 0), (L / 2, 0, 0)], edges=20, material=rn.Material(E=E, rho=1e-3), radius=r)
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
    exact = brentq(lambda T: T - 2 * np.pi / w, 0.5 * np.pi / w, 10 * np.pi / w)
    assert 2 * np.diff(zeros).mean() == pytest.approx(exact, rel=2e-3)
