"""Tendon-driven rods on paper: arcs, helices, capstan friction, and balance of forces."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.kinematics.frames import material_frames, transport
from rodnet.testing import Probe
from rodnet.testing.states import random_rotation
from tests.mechanics.beams import MATERIAL, L, R, elastic, order

H = 0.01  # offset of the tendons [m]
SLIM = rn.Material(E=1e9, nu=0.5, rho=1000.0)
EI, GJ = 1e9 * np.pi / 4 * R**4, SLIM.G * np.pi / 2 * R**4


def arm(edges, *terms, points=((0, 0, 0), (L, 0, 0)), clamp=True):
    """A slim rod along x whose m1 is z."""
    figure = rn.StickFigure()
    figure.rod("arm", points, edges=edges, material=SLIM, radius=R, director=(0, 0, 1.0))
    held = [rn.Clamp(at="arm.start")] if clamp else []
    return rn.Robot(figure.build(), [*elastic(), *terms, *held])


def rest(robot, **options):
    return rn.equilibrium(robot, residual=1e-10, **options)


def along(offset=(H, 0.0)):
    return [("arm", offset)]


# -- geometry and virtual work -------------------------------------------------------------------
def branched():
    figure = rn.StickFigure()
    figure.rod(
        "arm", [(0, 0, 0), (0.1, 0, 0.02)], edges=5, material=MATERIAL, section=rn.elliptic(4e-3, 2e-3)
    )
    figure.rod("twig", ["arm:3", (0.06, 0.07, 0.0)], edges=4, material=MATERIAL, radius=R)
    return figure.build()


ROUTE = [("arm:0", (4e-3, 1e-3)), ("arm:2", (0.0, 5e-3, 1e-3)), "arm:3", ("twig:1", (3e-3, 0.0)), "twig.end"]


def eyelets(ev):
    """Positions of the eyelets of ROUTE, by frames transported from their sources."""
    graph = ev.model.graph
    frames = material_frames(ev.T, transport(ev.d1s, ev.ts, ev.T), ev.theta)
    points = []
    for item in ROUTE:
        place, offset = (item, (0, 0)) if isinstance(item, str) else item
        node, rod = graph.node(place), graph.rods[place[:3].replace("twi", "twig")]
        mine = [e for e in rod.edges if node in graph.edges[e]]
        arm = np.zeros(3)
        arm[: len(offset)] = offset
        points.append(ev.x[node] + np.mean([frames[e] @ arm for e in mine], axis=0))
    return np.array(points)


def test_forces_are_those_of_virtual_work():
    """A tendon of tension T does the work -T dL, along any motion."""
    probe = Probe(rn.Robot(branched(), [rn.Tendon(route=ROUTE, tension=3.0)]), np.random.default_rng(5))
    rng = np.random.default_rng(6)

    def length(q):
        return np.linalg.norm(np.diff(eyelets(probe.evaluate(q)), axis=0), axis=1).sum()

    for _ in range(5):
        step = 1e-5 * probe.units * rng.normal(size=len(probe.q))
        work = -3.0 * (length(probe.q + step) - length(probe.q - step)) / 2.0
        assert probe.forces() @ step == pytest.approx(work, abs=1e-7 * np.abs(probe.forces()) @ np.abs(step))


@pytest.mark.parametrize(
    "options",
    [
        {"tension": 3.0},
        {"tension": 3.0, "friction": 0.5, "reach": 0.01},
        {"pull": 0.02, "stiffness": 200.0, "friction": 0.5, "reach": 0.01},
    ],
    ids=["tension", "friction", "pull"],
)
def test_derivatives_and_balance_in_random_states(options):
    """The Jacobian is exact; a tendon between points of a robot is an internal force, and turns with it."""
    rng = np.random.default_rng(7)
    for k in range(3):
        probe = Probe(rn.Robot(branched(), [rn.Tendon(route=ROUTE, **options)]), np.random.default_rng(k))
        bound = probe.model.bound[0]
        memory = bound.next_memory(probe.evaluate())
        memory[1:4], memory[4:7] = rng.uniform(-1, 1, 3), rng.uniform(50, 200, 3)
        memory[7:11] *= rng.uniform(0.9, 1.1, 4)
        bound.restore(probe.model, memory)
        assert probe.jacobian_errors()["position"][0] < 1e-9
        F = probe.forces()
        force, moment = probe.resultant(F)
        assert np.abs(force).max() < 1e-13 * np.abs(F).max()
        assert np.abs(moment).max() < 1e-12 * np.abs(F).max()
        turn = random_rotation(rng)
        other = probe.rotated(turn, rng.normal(size=3)).forces()
        assert other == pytest.approx(probe.turn_vector(F, turn), abs=1e-11 * np.abs(F).max())


@pytest.mark.parametrize(
    "options",
    [{"tension": 3.0}, {"pull": 0.02, "stiffness": 200.0, "friction": 0.5, "reach": 0.01}],
    ids=["tension", "pull"],
)
def test_a_tendon_in_space_moves_no_centre_and_gives_no_spin(options):
    """Of a free robot the tendon's forces, and its moments, those on the edges' twist included, sum to zero."""
    n = 12
    phase = np.linspace(0, 3 * np.pi, n + 1)
    helix = [("arm", 4e-3 * np.stack([np.cos(phase), np.sin(phase), 0.2 * np.sin(2 * phase)], axis=1))]
    tendon = rn.Tendon(route=helix, **options)
    robot = arm(n, tendon, clamp=False)
    probe = Probe(robot, np.random.default_rng(11), turn=0.5)
    bound = probe.model.bound[3]
    F = bound.forces(probe.evaluate())
    assert np.abs(F[probe.model.twist0 :]).max() > 1e-6  # it twists
    force, moment = probe.resultant(F)
    assert np.abs(force).max() < 1e-13 * np.abs(F).max()
    assert np.abs(moment).max() < 1e-13 * np.abs(F).max() * L
    # and so in time: neither momentum nor angular momentum appears
    traj = rn.Simulation(robot, 1e-3, tolerance=rn.Tolerance(residual=1e-12)).run(0.02)
    mass = robot.graph.node_mass
    momentum = np.einsum("n,tnc->tc", mass, traj.v)
    size = (mass[:, None] * np.abs(traj.v[-1])).sum()
    assert size > 1e-6
    assert np.abs(momentum).max() < 1e-9 * size


# -- shapes --------------------------------------------------------------------------------------
def test_a_parallel_tendon_bends_a_rod_to_an_arc():
    """Constant curvature T h / EI, at second order in the edge length; tension all along."""
    tension, sizes, errors = 0.8 * EI / L / H, (8, 16, 32), []
    for n in sizes:
        tendon = rn.Tendon(route=along(), tension=tension)
        traj = rest(arm(n, tendon))
        length = L * (1.0 - tension / (1e9 * np.pi * R**2))  # the rod gets a little shorter
        x, z = length * np.sin(0.8) / 0.8, length * (1 - np.cos(0.8)) / 0.8
        errors.append(np.linalg.norm(traj.x[-1, -1] - [x, 0.0, z]))
        assert traj.internal.bending[-1, :, 0] == pytest.approx(tension * H, rel=1.5 / n**2)
        assert tendon.tensions(traj)[-1] == pytest.approx(tension, rel=1e-12)
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 3e-4 * L


def test_a_finer_mesh_has_the_same_eyelets_and_the_rod_bows_between_them():
    """Under a tendon's chord the axis bows as a compressed rod, k^2 = T / EI: a part turns by 2 k h tan(k l / 2)."""
    parts, h = 4, 0.02 * L / 4
    k = parts / L
    term = rn.Tendon(route=along((h, 0.0)), tension=k**2 * EI)
    robot, angles = arm(parts, term), []
    for _ in range(4):
        t = np.diff(rest(robot).x[-1, robot.graph.rods["arm"].nodes[-2:]], axis=0)[0]
        angles.append(np.arctan2(t[2], t[0]) + 0.5 * np.linalg.norm(t) * k**2 * h)  # of the last edge's end
        robot = robot.refined()
    exact = parts * 2.0 * k * h * np.tan(0.5)
    errors = np.abs(np.array(angles[1:]) - exact)
    assert errors[-1] < 2e-3 * exact and exact - angles[0] > 0.08 * exact
    assert np.all(np.diff(np.log2(errors)) < -1.8)


@pytest.mark.parametrize("held", ["start", "end"])
def test_a_clamp_at_either_end_carries_the_eyelet_there(held):
    tendon = rn.Tendon(route=along(), tension=0.6 * EI / L / H)
    traj = rest(arm(12, tendon, rn.Clamp(at=f"arm.{held}"), clamp=False))
    assert traj.internal.bending[-1, :, 0] == pytest.approx(0.6 * EI / L, rel=5e-3)
    assert abs(traj.internal.bending[-1, :, 1]).max() < 1e-6 * EI / L


def test_drawing_in_a_length_turns_the_tip_by_length_over_offset():
    tendon = rn.Tendon(route=along(), pull=0.9 * H, stiffness=1e6)
    traj = rest(arm(20, tendon))
    tangent = traj.x[-1, -1] - traj.x[-1, -2]
    shorter = 1.0 - tendon.tensions(traj)[-1, 0] / (1e9 * np.pi * R**2)  # of the rod
    angle = (0.9 * H - (1 - shorter) * L) / H
    assert np.arctan2(tangent[2], tangent[0]) == pytest.approx(angle, rel=5e-4)
    assert tendon.tensions(traj)[-1] == pytest.approx(0.9 * EI / L / H, rel=0.1)


def test_a_slack_tendon_does_not_push():
    tendon = rn.Tendon(route=along(), pull=-0.05 * L, stiffness=1e4)
    traj = rest(arm(8, tendon, rn.PointForce(at="arm.end", force=(0, 0, 0.2 * EI / L**2))))
    alone = rest(arm(8, rn.PointForce(at="arm.end", force=(0, 0, 0.2 * EI / L**2))))
    assert traj.x[-1] == pytest.approx(alone.x[-1], abs=1e-6 * L)
    assert 0.0 <= tendon.tensions(traj)[-1].max() < 1e-3 * EI / L / H


def test_a_helical_tendon_twists_and_bends():
    """Moment of a pull T along the helix: T h cos(slope) across, T h sin(slope) about the axis."""
    n, pitch = 60, 0.1
    phase = 2 * np.pi * np.arange(n + 1) * (L / n) / pitch
    offsets = H * np.stack([np.cos(phase), np.sin(phase)], axis=1)
    tension, slope = 1e-4 * EI / L / H, np.arctan(2 * np.pi * H / pitch)
    traj = rest(arm(n, rn.Tendon(route=along(offsets), tension=tension)))
    inner = slice(1, n - 1)
    torque, bending = traj.internal.torque[-1, inner], traj.internal.bending[-1, inner]
    assert np.abs(torque) == pytest.approx(tension * H * np.sin(slope), rel=1e-2)
    assert np.linalg.norm(bending, axis=1) == pytest.approx(tension * H * np.cos(slope), rel=1e-2)
    twist = traj.theta[-1, -1] - traj.theta[-1, 0]
    assert abs(twist) == pytest.approx(tension * H * np.sin(slope) / GJ * L * (n - 1) / n, rel=1e-2)


# -- friction ------------------------------------------------------------------------------------
def ramped(n, mu, schedule, duration):
    """An arm whose tension changes slowly, heavily damped: nothing overshoots."""
    tension = 1.0 * EI / L / H
    tendon = rn.Tendon(route=along(), tension=tension, friction=mu, reach=1e-5, schedule=schedule)
    robot = arm(n, tendon, rn.KelvinVoigt(bend=0.05))
    return tension, tendon, rn.Simulation(robot, 0.05).run(duration)


def test_capstan_friction_eats_the_tension_along_an_arm():
    """T' = T exp(-mu turn) at each eyelet; along the arm dT/ds = -mu T (T h / EI), T = T0 / (1 + mu h T0 s / EI)."""
    n, mu = 24, 0.5
    tension, tendon, traj = ramped(n, mu, lambda t: min(t, 1.0), 2.0)
    found = tendon.tensions(traj)[-1]
    s = np.arange(n) * L / n  # a segment is beyond the eyelets before it
    assert found == pytest.approx(tension / (1.0 + mu * H * tension * s / EI), rel=0.01)
    edges = np.diff(traj.x[-1], axis=0)
    angles = np.arctan2(edges[:, 2], edges[:, 0])
    # between eyelets on the bisectors the tendon runs parallel to the edges
    assert np.log(found[:-2] / found[1:-1]) == pytest.approx(mu * np.diff(angles)[:-1], rel=0.02)
    assert np.log(found[0] / found[-1]) == pytest.approx(mu * (angles[-1] - angles[0]), rel=0.01)


def test_friction_holds_back_on_the_way_back():
    """At the same tension an arm is less bent while it is drawn in than while it is let go."""
    mu = 0.4
    _, tendon, traj = ramped(10, mu, lambda t: 0.5 + 0.5 * np.sin(np.pi * (t - 0.5) / 2.0), 3.5)
    up, top, down = (round((t + 0.5) / 0.05) for t in (0.0, 1.0, 2.0))
    tensions, tips = tendon.tensions(traj), traj.x[:, -1, 2]
    assert tensions[up, 0] == pytest.approx(tensions[down, 0], rel=1e-9)
    assert tips[top] > tips[down] > 1.1 * tips[up]
    assert np.all(np.diff(tensions[up]) < 0.0)  # drawn in, it pulls ever less towards the tip
    assert tensions[down, -1] > tensions[down, 0]  # let go, ever more


def test_statics_with_friction_warns_that_the_way_matters(recwarn):
    """A pulled arm, and one that is let go to the same tension: two equilibria, both with the warning."""
    tension = 0.8 * EI / L / H

    def bent(mu, factor, start=None):
        tendon = rn.Tendon(route=along(), tension=factor * tension, friction=mu, reach=1e-5, name="flexor")
        return rest(arm(8, tendon), start=start)

    with pytest.warns(rn.PathDependenceWarning, match="tendon 'flexor' .* depends on the way") as told:
        pulled = bent(0.4, 1.0)
    assert told[0].filename == __file__
    with pytest.warns(rn.PathDependenceWarning):
        half = bent(0.4, 0.5)
    with pytest.warns(rn.PathDependenceWarning):
        let_go = bent(0.4, 0.5, pulled.state())
    assert let_go.x[0, -1, 2] > 1.05 * half.x[0, -1, 2]
    recwarn.clear()
    bent(0.0, 1.0)  # without friction there is one
    bent(0.4, 0.0)  # and none acts where nothing pulls
    assert not recwarn


def test_a_cycle_costs_energy_and_the_powers_add_up():
    """Work of the drive over a slow cycle of tension: positive with friction, none without."""
    work = []
    for mu in (0.0, 0.4):
        tendon = rn.Tendon(
            route=along(), tension=0.8 * EI / L / H, friction=mu, reach=1e-5,
            schedule=lambda t: np.sin(np.pi * t) ** 2,
        )  # fmt: skip
        robot = arm(8, tendon, rn.MassDamping(rate=20.0))
        traj = rn.Simulation(robot, 5e-3, tolerance=rn.Tolerance(residual=1e-11)).run(1.0)
        powers = dict(traj.powers)
        kinetic = powers.pop("kinetic")
        assert np.abs(sum(powers.values()) - kinetic)[1:].max() < 1e-6 * np.abs(powers["tendon"]).max()
        drawn = np.array([traj.state(k).memories[3] for k in range(len(traj))])
        lengths = drawn[:, 15:23].sum(axis=1)
        pull = tendon.tensions(traj)[:, 0]
        work.append(-np.sum(0.5 * (pull[1:] + pull[:-1]) * np.diff(lengths)))
    stored = np.abs(traj.energies["bending"]).max()
    assert abs(work[0]) < 0.03 * stored  # what the damping takes
    assert work[1] > 0.15 * stored


# -- use -----------------------------------------------------------------------------------------
def test_antagonists_driven_by_inputs():
    """Two tendons on both sides cancel; what one gains the arm follows."""
    up = rn.Tendon(route=along(), pull=0.0, stiffness=1e4, name="up")
    down = rn.Tendon(route=along((-H, 0.0)), pull=0.0, stiffness=1e4, name="down")
    sim = rn.Simulation(arm(8, up, down, rn.MassDamping(rate=30.0)), 0.02)
    for _ in range(100):
        assert sim.step({"up.pull": 0.002, "down.pull": 0.002}).ok
    assert np.abs(sim.observe().x[:, 2]).max() < 1e-9
    for _ in range(150):
        assert sim.step({"up.pull": 0.004, "down.pull": 0.0}).ok
    x = sim.observe().x
    assert np.arctan2(*(x[-1] - x[-2])[[2, 0]]) == pytest.approx(0.004 / (2 * H), rel=0.02)


def test_bad_routes_are_named():
    make = lambda route, **o: arm(4, rn.Tendon(route=route, **({"tension": 1.0} | o)))  # noqa: E731
    with pytest.raises(rn.TermError, match="runs through 1 points"):
        make(["arm:1"])
    with pytest.raises(rn.TermError, match=r"offsets at 'arm' must be one or 5 vectors .* shape \(3, 2\)"):
        make([("arm", np.zeros((3, 2)))])
    with pytest.raises(rn.TermError, match="is no point of a route"):
        make(["arm:0", (1.0, 2.0)])
    with pytest.raises(rn.TermError, match="is not finite"):
        make([(0.0, np.nan, 0.0), "arm:1"])
    with pytest.raises(rn.TermError, match="are the same place"):
        make(["arm:0", "arm:0", "arm:1"])
    with pytest.raises(rn.TermError, match=r"give tension= or pull="):
        rn.Tendon(route=["arm:0", "arm:1"])
    with pytest.raises(rn.TermError, match=r"pull= needs stiffness="):
        rn.Tendon(route=["arm:0", "arm:1"], pull=0.0)
    with pytest.raises(rn.GraphError, match="arm:9"):
        make(["arm:0", "arm:9"])
